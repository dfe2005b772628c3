#!/usr/bin/env python3
"""Trains a policy for half a million steps, a few minutes on two cores, and compares it with its start.

Usage: train.py PROGRAM FOLDER [STEPS], with a program that was built with `--features train`. The ball must turn at three times the rate of the first
block of the training, and the policy must be played from starts that the training could not have.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

program, folder = sys.argv[1], Path(sys.argv[2])
steps = sys.argv[3] if len(sys.argv) > 3 else "500000"
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
