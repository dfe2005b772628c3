#!/usr/bin/env python3
"""Measures shape, pose and stated deviation on objects that nobody tuned for.

    results/tracking.py OUT [--program FILE] [--objects A,B,...] [--random N] [--seed N] [--seeds N]
                        [--duration SECONDS] [--jobs N]

Generates a log of each random object (random:1000 to random:1039) and --seeds of each other object (by default those of `hollow`, `tall` and
`tall_tuned` in results/objects.toml), and estimates shape and pose from it with cameras `side` and `front-left`; of hollow objects also without touch.
Writes OUT/tracking.jsonl, a line per run, and OUT/reliability.svg: the error below which 95 % of the frames lie, over twice the stated
deviation. Logs and runs that are there already are not made again; logs are removed when their runs are done. Logs are worked on --jobs at a
time, with an equal share of the cores each.
"""

import argparse
import itertools
import json
import math
import os
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CAMERAS = ["side", "front-left"]
KINDS = ["hollow", "tall", "tall_tuned"]
# Stated deviations are sorted into these bins, mm.
EDGES_MM = [0, 1, 1.25, 1.5, 2, 3, 5, 10, 20]


class Measurement:
    def __init__(self, arguments):
        self.out, self.program, self.duration = arguments.out, arguments.program.resolve(), arguments.duration
        (self.out / "runs").mkdir(parents=True, exist_ok=True)
        self.environment = os.environ | {"RAYON_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // arguments.jobs))}

    def call(self, *words):
        result = subprocess.run([self.program, *map(str, words)], capture_output=True, text=True, env=self.environment)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
        return result.stdout

    def log(self, name, seed, folder):
        if not any(folder.glob("*/00")):
            self.call("generate", "--object", name, "--logs", 1, "--duration", self.duration, "--seed", seed,
                      "--cameras", ",".join(CAMERAS), "--controller", "suited", "--out", folder)
        return next(folder.glob("*/00"))

    def run(self, key, name, seed, folder, camera, modality):
        """Returns the scores of a run and the pairs of stated deviation and error of its frames, mm."""
        path = self.out / "runs" / f"{key}.json"
        if not path.exists():
            log, run = self.log(name, seed, folder), self.out / "runs" / key
            shutil.rmtree(run, ignore_errors=True)
            words = ["--log", log, "--cameras", camera, "--modality", modality, "--json", "--quiet", "--out", run]
            summary = json.loads(self.call("run", *words))
            head, *rows = [line.split(",") for line in (run / "trajectory.csv").read_text().splitlines()]
            error, deviation = head.index("add_s_mm"), head.index("deviation_mm")
            # The error of the first frame is 0: it fixes the coordinates.
            # Before the object was seen, a frame has no error.
            frames = [(float(row[deviation]) if row[deviation] else None, float(row[error])) for row in rows[1:] if row[error]]
            # An object that was never seen has no shape.
            f = summary["f_score"] or {"2": 0, "5": 0}
            observed = summary["observed"] or {"share": 0, "f_score": {"5": 0}}
            scores = {"f2": f["2"], "f5": f["5"], "observed": observed["share"], "observed_f5": observed["f_score"]["5"],
                      "add_s_mm": summary["add_s_mm"]["mean"], "final_mm": frames[-1][1],
                      "final_deviation_mm": frames[-1][0], "seconds": summary["simulated_s"]}
            path.write_text(json.dumps([scores, frames]))
            shutil.rmtree(run)
        return json.loads(path.read_text())


def reliability(frames):
    """Returns the drawing of the error that 95 % of the frames stay below, over twice the stated deviation."""
    points = []
    for low, high in zip(EDGES_MM, EDGES_MM[1:]):
        pairs = [(d, e) for d, e in frames if d is not None and low <= d < high]
        if len(pairs) >= 50:
            errors = sorted(e for _, e in pairs)
            points.append((2 * sum(d for d, _ in pairs) / len(pairs), errors[int(0.95 * (len(errors) - 1))], len(pairs)))
    # Both axes are logarithmic, from 1 mm.
    top = max([10, *(max(x, y) for x, y, _ in points)])
    along = lambda mm: math.log(max(mm, 1)) / math.log(top)
    at = lambda x, y: (50 + 340 * along(x), 360 - 340 * along(y))
    (x0, y0), (x1, y1) = at(1, 1), at(top, top)
    marks = "".join(f'<circle cx="{at(x, y)[0]:.1f}" cy="{at(x, y)[1]:.1f}" r="4" fill="#0072b2"/>'
                    f'<text x="{at(x, y)[0] + 7:.1f}" y="{at(x, y)[1] + 4:.1f}">{n}</text>' for x, y, n in points)
    ticks = "".join(f'<text x="{at(v, 1)[0]:.1f}" y="376" text-anchor="middle">{v}</text>'
                    f'<text x="44" y="{at(1, v)[1] + 4:.1f}" text-anchor="end">{v}</text>' for v in (1, 2, 5, 10, 20) if v <= top)
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="420" height="400" font-family="sans-serif" font-size="11">'
            f'<rect width="420" height="400" fill="white"/><path d="M50 20V360H390" fill="none" stroke="black"/>'
            f'<line x1="{x0}" y1="{y0}" x2="{x1}" y2="{y1}" stroke="#999" stroke-dasharray="4"/>{marks}{ticks}'
            f'<text x="220" y="394" text-anchor="middle">twice the stated deviation, mm (beside each point: frames)</text>'
            f'<text x="14" y="190" text-anchor="middle" transform="rotate(-90 14 190)">ADD-S, 95 % of the frames, mm</text></svg>\n')


def measured(measurement, name, kind, seed):
    """Returns the rows of the runs of a log, and the pairs of stated deviation and error of all their frames, mm."""
    key = f"{name.replace(':', '-')}-{seed}"
    folder = measurement.out / "logs" / key
    rows, all_frames = [], []
    for camera, modality in itertools.product(CAMERAS, ["vitac", "vi"] if kind == "hollow" else ["vitac"]):
        scores, frames = measurement.run(f"{key}-{camera}-{modality}", name, seed, folder, camera, modality)
        stated = [(d, e) for d, e in frames if d is not None]
        said = [e for d, e in stated if d <= 1]
        rows.append({
            "object": name, "kind": kind, "seed": seed, "camera": camera, "modality": modality, **scores, "frames": len(frames),
            "poor": int(scores["f5"] < 0.85), "observed_poor": int(scores["observed_f5"] < 0.85),
            "said_within_2mm": len(said), "within_2mm": sum(e <= 2 for e in said), "covered": sum(e <= 2 * d for d, e in stated),
            "stated": len(stated), "undeclared": sum(e > 10 and d < 3 for d, e in stated),
            "ends_undeclared": int(scores["final_mm"] > 10 and (scores["final_deviation_mm"] or 99) < 3),
        })
        all_frames += frames
    shutil.rmtree(folder, ignore_errors=True)
    return rows, all_frames


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    objects = tomllib.loads((ROOT / "results/objects.toml").read_text())
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--objects", default=",".join(name for kind in KINDS for name in objects[kind]))
    parser.add_argument("--random", type=int, default=40, help="number of random objects")
    parser.add_argument("--seed", type=int, default=9300, help="seed of the first log")
    parser.add_argument("--seeds", type=int, default=3, help="logs of each object that is not random")
    parser.add_argument("--duration", type=float, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    measurement = Measurement(arguments)
    random = [(f"random:{1000 + k}", "random") for k in range(arguments.random)]
    named = [(name, next((kind for kind in KINDS if name in objects[kind]), "other")) for name in filter(None, arguments.objects.split(","))]
    tasks = [(name, kind, arguments.seed + k) for listed in (random, named * arguments.seeds) for k, (name, kind) in enumerate(listed)]
    rows, all_frames = [], []
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for of_log, frames in pool.map(lambda task: measured(measurement, *task), tasks):
            rows += of_log
            all_frames += frames
            for row in of_log:
                print({key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()}, flush=True)
            (arguments.out / "tracking.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
            (arguments.out / "reliability.svg").write_text(reliability(all_frames))


if __name__ == "__main__":
    main()
