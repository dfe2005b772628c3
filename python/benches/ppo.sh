#!/usr/bin/env bash
# Trains PPO of stable-baselines3 on TurnInHand with the cube. Leaves the curve in DIR/ppo.csv, and in DIR/ppo.json the mean reward of each 50,000 steps.
# Usage: ppo.sh DIR [arguments of python/examples/train_ppo.py]. Takes 12 minutes on 2 cores.
# Installs stable-baselines3, which brings torch, into a virtual environment in DIR.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=$(realpath -m "${1:?name a folder}")
shift
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" install --quiet --disable-pip-version-check "./python[gym]" stable-baselines3==2.9.2
    touch "$out/venv/ready"
fi
"$out/venv/bin/python" python/examples/train_ppo.py --out "$out" "$@"
"$out/venv/bin/python" - "$out" <<'END'
import csv, json, pathlib, statistics, sys

out = pathlib.Path(sys.argv[1])
with (out / "ppo.csv").open() as file:
    lines = list(csv.DictReader(file))
result = {"first": float(lines[0]["reward"]), "turned_rad": float(lines[-1]["turned_rad"])}
for until in range(50_000, 300_001, 50_000):
    rewards = [float(line["reward"]) for line in lines if until - 50_000 < int(line["steps"]) <= until]
    result[f"until_{until}"] = statistics.mean(rewards)
result["rise"] = result["until_300000"] - result["first"]
(out / "ppo.json").write_text(json.dumps(result) + "\n")
print(json.dumps(result))
END
