#!/usr/bin/env python3
"""Compares the policy `corrected` with the gaits that it corrects, from the same starts, which no search and no training has.

    results/corrections.py OUT [--program FILE] [--shapes N] [--starts N] [--seconds S]

Random shapes from seed 1000 on and objects of the catalogue; the training had random:0 to random:127 alone. Then runs with our own estimate of
ten objects. Writes OUT/shapes.jsonl and OUT/objects.jsonl, a line per object; OUT/compared.jsonl, means and the lower ends of their 95 %
intervals, and the folders OUT/suited and OUT/corrected of runs. What is there already is not measured again.
"""

import argparse
import json
import math
import statistics
from pathlib import Path

from program import caller

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ("005_tomato_soup_can,010_potted_meat_can,017_orange,061_foam_brick,054_softball,rubiks_cube_small,013_apple,large_dice,056_tennis_ball,"
           "018_plum,015_peach,055_baseball,077_rubiks_cube,cube70,016_pear,024_bowl").split(",")
RUNS = "077_rubiks_cube,005_tomato_soup_can,016_pear,010_potted_meat_can,013_apple,061_foam_brick,065-g_cups,055_baseball,015_peach,large_dice"
CONTROLLERS = ["suited", "corrected"]


def scores(call, objects, starts, path):
    """Plays both controllers with each object, and returns the lines of the file."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for name in objects[len(rows):]:
        row = {"object": name}
        for controller in CONTROLLERS:
            score = json.loads(call("hand", "score", "--object", name, "--controller", controller, "--scored-starts", starts, "--json"))
            row |= {f"{controller}_kept": score["alive"], f"{controller}_rad_s": score["rate_rad_s"], "gait": row.get("gait", score["controller"])}
        rows.append(row)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
    return rows


def compared(name, rows):
    for value in ("kept", "rad_s"):
        suited, corrected = ([row[f"{controller}_{value}"] for row in rows] for controller in CONTROLLERS)
        added = [b - a for a, b in zip(suited, corrected)]
        error = statistics.stdev(added) / math.sqrt(len(added))
        yield {"objects": name, "value": value, "count": len(rows), "suited": statistics.mean(suited), "corrected": statistics.mean(corrected),
               "suited_median": statistics.median(suited), "corrected_median": statistics.median(corrected),
               "added": statistics.mean(added), "added_at_least": statistics.mean(added) - 1.96 * error}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--shapes", type=int, default=100)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20)
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)

    call = caller(arguments.program)

    shapes = [f"random:{seed}" for seed in range(1000, 1000 + arguments.shapes)]
    rows = {name: scores(call, objects, arguments.starts, out / f"{name}.jsonl") for name, objects in (("shapes", shapes), ("objects", OBJECTS))}
    lines = [line for name, rows in rows.items() for line in compared(name, rows)]
    (out / "compared.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for line in lines:
        print(" ".join(f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}" for key, value in line.items()), flush=True)
    for controller in CONTROLLERS:
        call("evaluate", "--objects", RUNS, "--seeds", 1, "--duration", arguments.seconds, "--modes", "slam", "--modalities", "vitac", "--cameras", "side",
             "--controller", controller, "--out", out / controller)


if __name__ == "__main__":
    main()
