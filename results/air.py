#!/usr/bin/env python3
"""Measures how a ball is held and turned in the air on the fingertips.

    results/air.py OUT [--program FILE] [--starts N] [--episodes N] [--controller NAME|FILE]

Balls of 65, 70, 75 and 80 mm; the program draws mass (48 to 200 g over all sizes) and friction (0.89 to 1.21) by the seed. Each start lasts 20 s after the
hand-over. `simulate` shows the controller the true place with noise, drift and latency: N starts per ball (default: 25). `run` shows it the estimate, with the
touch network and camera `side`: N episodes (default: 10) with `--mode pose` and as many with `--mode slam`. A start is alive if the ball's lowest point stays 30 mm
over the palm. Writes OUT/air.jsonl, a line per start, and OUT/air.json, the shares. Starts that are there already are not made again.
"""

import argparse
import json
import math
import re
import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIZES_MM = [65, 70, 75, 80]
# Not among the seeds of any tuning.
SEED = 9800
SECONDS = 21
LEAST_MM = 30


def ball(path, diameter_mm, rings=48):
    """Writes a ball as OBJ, in metres."""
    radius = diameter_mm / 2000
    points = [(0, 0, -radius), (0, 0, radius)]
    for i in range(1, rings):
        across, up = (radius * f(math.pi * i / rings) for f in (math.sin, lambda a: -math.cos(a)))
        points += [(across * math.cos(a), across * math.sin(a), up) for a in (math.pi * j / rings for j in range(2 * rings))]
    at = lambda i, j: 3 + (i - 1) * 2 * rings + j % (2 * rings)
    faces = []
    for j in range(2 * rings):
        faces += [(1, at(1, j + 1), at(1, j)), (2, at(rings - 1, j), at(rings - 1, j + 1))]
        for i in range(1, rings - 1):
            faces += [(at(i, j), at(i, j + 1), at(i + 1, j + 1)), (at(i, j), at(i + 1, j + 1), at(i + 1, j))]
    text = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in points] + [f"f {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(text) + "\n")


def words_of(text):
    """Returns the figures of a run's last event about the air."""
    number = r"(-?[0-9.]+)"
    match = re.search(rf"at least {number} mm over the palm, touched by more than fingertips {number} %.*?turned by {number}, {number} and {number} rad", text)
    height, beside, *net = map(float, match.groups())
    return {"least_height_mm": height, "touched_beside_tips": beside / 100, "net_rad": net}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--starts", type=int, default=25)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--controller", help="controller for all balls (default: by their size)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "air.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    program = arguments.program.resolve()

    def say(words):
        result = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
        return json.loads(result.stdout)

    tasks = [("physics", size, SEED + k) for k in range(arguments.starts) for size in SIZES_MM]
    tasks += [(mode, SIZES_MM[k % len(SIZES_MM)], SEED + k) for k in range(arguments.episodes) for mode in ("pose", "slam")]
    for mode, size, seed in tasks:
        if any((line["mode"], line["size_mm"], line["seed"]) == (mode, size, seed) for line in lines):
            continue
        mesh = arguments.out / f"ball{size}.obj"
        if not mesh.exists():
            ball(mesh, size)
        words = ["--object", mesh, "--controller", arguments.controller or ("air_ball" if size < 72.5 else "air_large_ball"), "--seed", seed, "--duration", SECONDS, "--json"]
        if mode == "physics":
            outcome = say(["simulate", *words])
            air, lost = outcome["in_air"], False
        else:
            summary = say(["run", *words, "--mode", mode, "--quiet", "--overwrite", "--out", arguments.out / "run"])
            air = words_of(" ".join(event["text"] for event in summary["events"]))
            lost = any("lowers the object" in event["text"] for event in summary["events"])
        net = air["net_rad"]
        lines.append({"mode": mode, "size_mm": size, "seed": seed, "alive": int(air["least_height_mm"] >= LEAST_MM and not lost), "lowered": int(lost),
                      "least_height_mm": air["least_height_mm"], "touched_beside_tips": air["touched_beside_tips"],
                      "rad_s": round(math.hypot(*net) / (SECONDS - 1), 3), "net_rad": [round(a, 2) for a in net]})
        print(lines[-1], flush=True)
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    shares = {}
    for mode in ("physics", "pose", "slam"):
        of = [line for line in lines if line["mode"] == mode]
        held = [line for line in of if line["alive"]]
        if of:
            shares[mode] = {"starts": len(of), "alive": len(held) / len(of), "rad_s": statistics.median(line["rad_s"] if line["alive"] else 0 for line in of),
                            "least_height_mm": min((line["least_height_mm"] for line in held), default=None),
                            "touched_beside_tips": max((line["touched_beside_tips"] for line in held), default=None)}
    (arguments.out / "air.json").write_text(json.dumps(shares, indent=1) + "\n")
    print(json.dumps(shares))


if __name__ == "__main__":
    main()
