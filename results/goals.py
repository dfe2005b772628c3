#!/usr/bin/env python3
"""Measures how often the hand reaches a goal orientation by the estimate.

    results/goals.py OUT [--program FILE] [--goals N]

Per object, N episodes (default: 10) of at most 30 s with the goal `pose`: an angle from 30 to 330 degrees, drawn by the episode's seed. Touch depth
comes from the network, camera `side`. An episode counts if the supervisor ended it within 30 s and the true orientation is then within 15 degrees of
the goal. Writes OUT/goals.jsonl, a line per episode. Episodes that are there already are not made again.
"""

import argparse
import json
import math
import random
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Objects, and the axis about which their controller turns on the left hand.
OBJECTS = {"cube70": (0, 0, 1), "005_tomato_soup_can": (0, 0, 1), "055_baseball": (0, 0, 1)}
# Not among the seeds of any tuning.
SEED = 9900


def turned(q, p):
    """Returns q times the inverse of p; quaternions w, x, y, z."""
    (w, x, y, z), (a, b, c, d) = q, (p[0], -p[1], -p[2], -p[3])
    return (w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a)


def angle_deg(q):
    return math.degrees(2 * math.acos(min(1.0, abs(q[0]))))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--goals", type=int, default=10)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "goals.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for k in range(arguments.goals):
        for name, axis in OBJECTS.items():
            seed = SEED + k
            if any((line["object"], line["seed"]) == (name, seed) for line in lines):
                continue
            goal_deg, run = round(random.Random(seed).uniform(30, 330)), arguments.out / "run"
            shutil.rmtree(run, ignore_errors=True)
            words = ["run", "--object", name, "--seed", seed, "--goal", f"pose={goal_deg}deg", "--duration", 30, "--json", "--quiet", "--out", run]
            result = subprocess.run([arguments.program.resolve(), *map(str, words)], capture_output=True, text=True)
            if result.returncode != 0:
                sys.exit(f"{name}, seed {seed}: {result.stderr.strip()}")
            summary = json.loads(result.stdout)
            head, *rows = [row.split(",") for row in (run / "trajectory.csv").read_text().splitlines()]
            at = head.index("true_qw")
            first, last = ([float(number) for number in row[at : at + 4]] for row in (rows[0], rows[-1]))
            half = math.radians(goal_deg) / 2
            goal = (math.cos(half), *(math.sin(half) * a for a in axis))
            error_deg = angle_deg(turned(turned(last, first), goal))
            ended = any("goal is reached" in event["text"] for event in summary["events"])
            lines.append({"object": name, "seed": seed, "goal_deg": goal_deg, "ended": ended, "seconds": summary["simulated_s"],
                          "error_deg": round(error_deg, 2), "reached": int(ended and error_deg <= 15)})
            print(lines[-1], flush=True)
            path.write_text("".join(json.dumps(line) + "\n" for line in lines))
            shutil.rmtree(run)


if __name__ == "__main__":
    main()
