#!/usr/bin/env python3
"""Counts the frames in which the turn of white objects is wrong though the tracker says that it knows it.

results/plain.py OUT [--program FILE] writes meshes of solids of revolution without colours, runs an episode with each, and writes OUT/plain.jsonl, a
line per object: the share of frames that are more than 20 degrees off, in percent, and that of frames that are said to be known to 20 degrees all
the same."""

import argparse
import csv
import json
import math
from pathlib import Path

import program

# Sides of a ring.
ROUND = 48
# From pole to pole, radians.
ARCS = [math.pi * k / 24 for k in range(1, 24)]
# Radius and height above the middle of the rings of each solid, millimetres.
SOLIDS = {
    "ball": [(33 * math.sin(arc), -33 * math.cos(arc)) for arc in ARCS],
    "egg": [((27 + 5 * math.cos(arc)) * math.sin(arc), -42 * math.cos(arc)) for arc in ARCS],
    "can": [(33, -45), (33, 45)],
}
WRONG_DEG = 20


def mesh(rings):
    """Returns an OBJ in metres."""
    vertices = [(0, 0, rings[0][1]), (0, 0, rings[-1][1])]
    vertices += [(r * math.cos(turn), r * math.sin(turn), z) for r, z in rings for turn in (2 * math.pi * k / ROUND for k in range(ROUND))]
    faces = []
    for k in range(ROUND):
        columns = [[3 + ROUND * ring + (k + side) % ROUND for ring in range(len(rings))] for side in (0, 1)]
        faces += [(1, columns[1][0], columns[0][0]), (2, columns[0][-1], columns[1][-1])]
        for a, b, c, d in zip(columns[0], columns[1], columns[1][1:], columns[0][1:]):
            faces += [(a, b, c), (a, c, d)]
    lines = ["v " + " ".join(f"{1e-3 * x:.6f}" for x in vertex) for vertex in vertices] + ["f " + " ".join(map(str, face)) for face in faces]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for meshes, runs and results")
    parser.add_argument("--program", type=Path, default=Path("target/release/mambavitact"), help="the program (default: %(default)s)")
    arguments = parser.parse_args()
    call = program.caller(arguments.program)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.out / "plain.jsonl").open("w") as results:
        for name, rings in SOLIDS.items():
            path, run = arguments.out / f"{name}.obj", arguments.out / name
            path.write_text(mesh(rings))
            call("run", "--object", path, "--cameras", "front-left", "--duration", 8, "--seed", 1, "--quiet", "--out", run)
            with (run / "trajectory.csv").open() as file:
                frames = [(float(row["rotation_deg"]), float(row["deviation_deg"] or 180)) for row in csv.DictReader(file)]
            wrong = [deviation for error, deviation in frames if error > WRONG_DEG]
            percent = lambda count: 100 * count / len(frames)
            believed = sum(deviation <= WRONG_DEG for deviation in wrong)
            results.write(json.dumps({"object": name, "wrong_percent": percent(len(wrong)), "believed_percent": percent(believed)}) + "\n")


if __name__ == "__main__":
    main()
