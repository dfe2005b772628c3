#!/usr/bin/env bash
# Trains PPO of stable-baselines3 on TurnInHand with the cube, and leaves the curve in DIR/ppo.csv. Usage: ppo.sh DIR [further arguments]
# Installs stable-baselines3, which brings torch, into a virtual environment in DIR.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=$(realpath -m "${1:?name a folder}")
shift
python3 -m venv "$out/venv"
"$out/venv/bin/pip" install --quiet "./python[gym]" stable-baselines3==2.9.2
"$out/venv/bin/python" python/examples/train_ppo.py --out "$out" "$@"
