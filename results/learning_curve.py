#!/usr/bin/env python3
"""Trains a policy to turn a ball with our PPO and with that of stable-baselines3, in the same environments, with the same sizes, steps and passes.

    results/learning_curve.py OUT [--program FILE] [--steps N]

The Python in front needs our package and stable-baselines3: pip install ./python stable-baselines3. Writes OUT/curves.jsonl, a line for each half
million steps of each training, with means over the 82,000 steps before, and OUT/paces.jsonl. Our policy's critic knows the object's motion,
mass and friction, its units are elu and not tanh, its step size follows the divergence of the policies, and its environments vary more.
"""

import argparse
import csv
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK, MARK = 81_920, 500_000  # a line of our course; distance of the lines that are compared


def trained(command, course):
    """Runs a training, and returns its course and the minutes that it took."""
    begun = time.monotonic()
    subprocess.run(command, check=True, stdout=sys.stderr)
    with course.open() as file:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(file)], (time.monotonic() - begun) / 60


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--steps", type=int, default=2_000_000)
    arguments = parser.parse_args()
    out, steps = arguments.out.resolve(), str(arguments.steps)
    out.mkdir(parents=True, exist_ok=True)
    (out / "ball.safetensors.state").unlink(missing_ok=True)
    ours = [arguments.program, "hand", "train", "--object", "ball", "--steps", steps, "--scored-starts", "1", "--overwrite",
            "--out", out / "ball.safetensors"]
    theirs = [sys.executable, ROOT / "python/examples/train_ppo.py", "--steps", steps, "--out", out]
    trainings = {"ours": (ours, out / "ball.csv"), "stable-baselines3": (theirs, out / "ppo.csv")}
    with (out / "curves.jsonl").open("w") as curves, (out / "paces.jsonl").open("w") as paces:
        for name, (command, path) in trainings.items():
            course, minutes = trained(command, path)
            for mark in range(MARK, arguments.steps + 1, MARK):
                rows = [row for row in course if mark - BLOCK < row["steps"] <= mark]
                means = {value: statistics.mean(row[value] for row in rows) for value in ("reward", "rate_rad_s", "falls_per_minute")}
                curves.write(json.dumps({"training": name, "steps": mark, **means}) + "\n")
            last = course[-1]["steps"]
            paces.write(json.dumps({"training": name, "steps": last, "minutes": minutes, "steps_per_s": last / minutes / 60}) + "\n")


if __name__ == "__main__":
    main()
