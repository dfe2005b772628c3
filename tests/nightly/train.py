#!/usr/bin/env python3
"""Trains a policy for one and a half million steps, some six minutes on two cores, and plays it from starts that the training could not have.

Usage: train.py PROGRAM FOLDER [STEPS], with a program that was built with `--features train`. The ball must stay in nine of ten starts and turn at
0.5 rad/s, and the rate must have grown to three times that of the first block of the training.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

program, folder = sys.argv[1], Path(sys.argv[2])
steps = sys.argv[3] if len(sys.argv) > 3 else "1500000"
folder.mkdir(parents=True, exist_ok=True)
policy = folder / "ball.safetensors"
train = ["hand", "train", "--object", "ball", "--steps", steps, "--out", policy, "--overwrite", "--json"]
said = subprocess.run([program, *train], check=True, capture_output=True, text=True).stdout
with policy.with_suffix(".csv").open() as file:
    rates = [float(line["rate_rad_s"]) for line in csv.DictReader(file)]
score = json.loads(said.splitlines()[0])
print(json.dumps({"first_rad_s": rates[0], "last_rad_s": rates[-1], "alive": score["alive"], "rate_rad_s": score["rate_rad_s"]}))
if not rates[-1] > 3 * rates[0] > 0:
    sys.exit("the policy does not beat its start")
if score["alive"] < 0.9 or score["rate_rad_s"] < 0.5:
    sys.exit("the policy does not hold the ball, or does not turn it")
