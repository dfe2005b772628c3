#!/usr/bin/env python3
"""Measures how a ball, a cylinder and a cube are held and turned in the air on the fingertips.

    results/air.py OUT [--program FILE] [--starts N] [--episodes N] [--controller NAME|FILE]
    results/air.py OUT --meshes

Balls of 65, 70, 75 and 80 mm; the program draws mass (48 to 200 g over all sizes) and friction (0.89 to 1.21) by the seed. Each start lasts 20 s after the
hand-over. `simulate` shows the controller the true place with noise, drift and latency: N starts per ball (default: 25). `run` shows it the estimate, with the
touch network and camera `side`: N episodes (default: 10) with `--mode pose` and as many with `--mode slam`. A start is alive if the ball's lowest point stays 30 mm
over the palm. A cylinder of 66 x 70 mm and a cube of 65 mm are played by `simulate` alone. Writes OUT/air.jsonl, a line per start, and OUT/air.json, the shares.
Starts that are there already are not made again. With --meshes only meshes are written, also those of the searches (notes/tried_in_the_hand.md).
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
# Balls on which the controllers are tuned, and cubes that are rolled on the palm, see hand.sh.
TUNED_MM = [64, 67, 71, 74, 78, 81]
CUBES_MM = [48, 51, 54]
CONTROLLERS = {"ball65": "air_ball", "ball70": "air_ball", "ball75": "air_large_ball", "ball80": "air_large_ball", "cylinder": "air_block", "cube": "air_block"}
# Not among the seeds of any tuning.
SEED = 9800
SECONDS = 21
LEAST_MM = 30


def write(path, points, faces):
    """Writes a mesh as OBJ; faces count points from 0."""
    text = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in points] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(text) + "\n")


def lathe(path, outline, around=96):
    """Writes the solid that an outline of radii and heights makes around z, all in metres. It begins and ends on the axis."""
    (_, low), *rings, (_, high) = outline
    points = [(0, 0, low), (0, 0, high)]
    points += [(r * math.cos(a), r * math.sin(a), z) for r, z in rings for a in (2 * math.pi * j / around for j in range(around))]
    at = lambda i, j: 2 + i * around + j % around
    faces = []
    for j in range(around):
        faces += [(0, at(0, j + 1), at(0, j)), (1, at(len(rings) - 1, j), at(len(rings) - 1, j + 1))]
        for i in range(len(rings) - 1):
            faces += [(at(i, j), at(i, j + 1), at(i + 1, j + 1)), (at(i, j), at(i + 1, j + 1), at(i + 1, j))]
    write(path, points, faces)


def ball(path, diameter_mm, rings=48):
    """Writes a ball."""
    radius = diameter_mm / 2000
    lathe(path, [(radius * math.sin(a), -radius * math.cos(a)) for a in (math.pi * i / rings for i in range(rings + 1))])


def cylinder(path, diameter_mm=66, height_mm=70):
    """Writes a cylinder that stands upright."""
    radius, top = diameter_mm / 2000, height_mm / 2000
    lathe(path, [(0, -top), (radius, -top), (radius, top), (0, top)])


def cube(path, edge_mm):
    """Writes a cube."""
    h = edge_mm / 2000
    points = [(x, y, z) for x in (-h, h) for y in (-h, h) for z in (-h, h)]
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    write(path, points, [face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))])


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
    parser.add_argument("--controller", help="controller for all objects (default: by shape and size)")
    parser.add_argument("--meshes", action="store_true")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for size in SIZES_MM + TUNED_MM:
        ball(arguments.out / f"ball{size}.obj", size)
    cylinder(arguments.out / "cylinder.obj")
    cube(arguments.out / "cube.obj", 65)
    for edge in CUBES_MM:
        cube(arguments.out / f"cube{edge}.obj", edge)
    if arguments.meshes:
        return
    path = arguments.out / "air.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    program = arguments.program.resolve()

    def say(words):
        result = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
        return json.loads(result.stdout)

    seeds = range(SEED, SEED + arguments.starts)
    tasks = [("physics", f"ball{size}", seed) for seed in seeds for size in SIZES_MM]
    tasks += [(shape, shape, seed) for seed in seeds for shape in ("cylinder", "cube")]
    tasks += [(mode, f"ball{SIZES_MM[k % len(SIZES_MM)]}", SEED + k) for k in range(arguments.episodes) for mode in ("pose", "slam")]
    for mode, shape, seed in tasks:
        if any((line["mode"], line["object"], line["seed"]) == (mode, shape, seed) for line in lines):
            continue
        mesh = arguments.out / f"{shape}.obj"
        words = ["--object", mesh, "--controller", arguments.controller or CONTROLLERS[shape], "--seed", seed, "--duration", SECONDS, "--json"]
        if mode not in ("pose", "slam"):
            outcome = say(["simulate", *words])
            air, lost = outcome["in_air"], False
        else:
            summary = say(["run", *words, "--mode", mode, "--quiet", "--overwrite", "--out", arguments.out / "run"])
            air = words_of(" ".join(event["text"] for event in summary["events"]))
            lost = any("lowers the object" in event["text"] for event in summary["events"])
        net = air["net_rad"]
        lines.append({"mode": mode, "object": shape, "seed": seed, "alive": int(air["least_height_mm"] >= LEAST_MM and not lost), "lowered": int(lost),
                      "least_height_mm": air["least_height_mm"], "touched_beside_tips": air["touched_beside_tips"],
                      "rad_s": round(math.hypot(*net) / (SECONDS - 1), 3), "net_rad": [round(a, 2) for a in net]})
        print(lines[-1], flush=True)
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    shares = {}
    for mode in ("physics", "pose", "slam", "cylinder", "cube"):
        of = [line for line in lines if line["mode"] == mode]
        held = [line for line in of if line["alive"]]
        if of:
            turned = [(SECONDS - 1) * line["rad_s"] for line in held]
            shares[mode] = {"starts": len(of), "alive": len(held) / len(of), "rad_s": statistics.median(line["rad_s"] if line["alive"] else 0 for line in of),
                            "held_rad": statistics.median(turned) if turned else 0, "least_height_mm": min((line["least_height_mm"] for line in held), default=None),
                            "touched_beside_tips": max((line["touched_beside_tips"] for line in held), default=None)}
    (arguments.out / "air.json").write_text(json.dumps(shares, indent=1) + "\n")
    print(json.dumps(shares))


if __name__ == "__main__":
    main()
