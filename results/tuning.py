#!/usr/bin/env python3
"""Measures how long `hand tune` takes for objects on which no controller was ever tuned, and the controllers that it finds.

    results/tuning.py OUT [--program FILE] [--starts N]

Three YCB objects, each with one command; the score is that of N starts (default: 40) of 20 s that the search never saw. Writes
OUT/tuning.jsonl, a line per object: minutes of wall time with the score, share alive, and median net rate about the axis (rad/s). Objects that
are there already are not tuned again. OUT/speed.json has the steps per second of the search and of MuJoCo alone.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Objects of which no shipped controller was made, with the axis and the controller from which the search starts.
TASKS = {"015_peach": ("-y", "tumble_ball"), "013_apple": ("-y", "tumble_ball"), "014_lemon": ("-z", "ball")}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--starts", type=int, default=40)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "tuning.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for name, (axis, start) in TASKS.items():
        if any(line["object"] == name for line in lines):
            continue
        words = ["hand", "tune", "--object", name, "--axis", axis, "--from", start, "--generations", 20, "--starts", 4,
                 "--scored-starts", arguments.starts, "--json", "--overwrite", "--out", arguments.out / f"{name}.toml"]
        begun = time.monotonic()
        result = subprocess.run([arguments.program.resolve(), *map(str, words)], stdout=subprocess.PIPE, text=True)
        if result.returncode != 0:
            sys.exit(f"{name}: exit status {result.returncode}")
        score = json.loads(result.stdout)
        lines.append({"object": name, "axis": axis, "minutes": (time.monotonic() - begun) / 60,
                      "alive": score["alive"], "rate_rad_s": score["rate_rad_s"]})
        print(lines[-1], flush=True)
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    speed = subprocess.run([arguments.program.resolve(), "hand", "speed", "--json"], stdout=subprocess.PIPE, text=True, check=True)
    (arguments.out / "speed.json").write_text(speed.stdout)


if __name__ == "__main__":
    main()
