#!/usr/bin/env python3
"""Plays the controller that `auto` chooses on the whole catalogue, and counts the objects that turn, rest or fall.

    results/catalogue.py OUT [--program FILE] [--all]

Three starts of 20 s per object (seeds 8101 to 8103), also of objects that `simulate` refuses. Writes OUT/catalogue.jsonl, a line per object with
the net angle about each axis as `hand survey --help` describes it, and OUT/catalogue.json. With --all, every controller is played on three starts of the
search instead, and OUT/survey.jsonl is written. The same command continues after an interruption.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Net angle from which on an object counts as turned, radians.
TURNED_RAD = 6.0


def turned_rad(row):
    """Returns the least net angle about one and the same axis in all starts, for the axis where it is greatest."""
    starts = row["net_rad"]
    signed = [[sign * start[axis] for start in starts] for axis in range(3) for sign in (1, -1)]
    return max(map(min, signed)) if row["kept"] else 0.0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--all", action="store_true")
    arguments = parser.parse_args()
    program, out = arguments.program.resolve(), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    if arguments.all:
        subprocess.run([program, "hand", "survey", "--out", out / "survey.jsonl"], check=True)
        return
    found = out / "catalogue.jsonl"
    subprocess.run([program, "hand", "survey", "--controller", "auto", "--seed", "8101", "--out", found], check=True)
    counts = {"objects": 0, "turned": 0, "refused": 0, "kept": 0, "dropped": []}
    for row in map(json.loads, found.read_text().splitlines()):
        counts["objects"] += 1
        # A refused object needs no episode.
        tried = subprocess.run([program, "simulate", "--object", row["object"], "--duration", "0.1"], capture_output=True, text=True)
        if tried.returncode != 0 and "--controller" not in tried.stderr:
            sys.exit(f"{row['object']}: {tried.stderr.strip()}")
        if turned_rad(row) >= TURNED_RAD and tried.returncode == 0:
            counts["turned"] += 1
        elif tried.returncode != 0:
            counts["refused"] += 1
        elif row["kept"]:
            counts["kept"] += 1
        else:
            counts["dropped"].append(row["object"])
    counts["foreseen"] = (counts["refused"] + counts["kept"]) / (counts["objects"] - counts["turned"])
    (out / "catalogue.json").write_text(json.dumps(counts) + "\n")
    print(counts)


if __name__ == "__main__":
    main()
