#!/usr/bin/env python3
"""Measures the effect of a wrong calibration and of another seed of the estimator.

    results/calibration.py OUT [--program FILE] [--objects A,B,...] [--logs N] [--seed N] [--duration SECONDS] [--seeds N] [--jobs N]

Generates N logs per object, disturbs a copy of each (`mambavitact disturb`: cameras by 5 degrees and 10 mm, joints by 1 degree, a lag of
33 ms), and estimates shape and pose from both, with cameras `side` and `front-left` in turns. The objects are not those that the estimator
was tuned with: see results/objects.toml. Writes OUT/calibration.jsonl, a line per log, and OUT/seeds.jsonl, a line per first log of an
object and seed of the estimator. Logs and runs that are there already are not made again. Logs are worked on --jobs at a time, with an equal share
of the cores each.
"""

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CAMERAS = ["side", "front-left"]


class Measurement:
    def __init__(self, arguments):
        self.out, self.program, self.duration = arguments.out, arguments.program.resolve(), arguments.duration
        self.runs = self.out / "runs"
        self.runs.mkdir(parents=True, exist_ok=True)
        self.environment = os.environ | {"RAYON_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // arguments.jobs))}

    def call(self, *words):
        result = subprocess.run([self.program, *map(str, words)], capture_output=True, text=True, env=self.environment)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
        return result.stdout

    def log(self, name, seed):
        """Returns a log and its disturbed copy."""
        folder = self.out / "logs" / f"{name}-{seed}"
        log = folder / name / "00"
        if not log.exists():
            self.call("generate", "--object", name, "--logs", 1, "--duration", self.duration, "--seed", seed,
                      "--cameras", ",".join(CAMERAS), "--out", folder)
        wrong = self.out / "logs" / f"{name}-{seed}-wrong"
        if not wrong.exists():
            self.call("disturb", log, "--out", wrong, "--camera-deg", 5, "--camera-mm", 10, "--joints-deg", 1,
                      "--lag-ms", 33, "--seed", seed)
        return log, wrong

    def run(self, key, log, camera, *words):
        """Returns the scores of a run, with the share of frames that are wrong though the tracker was sure."""
        scores = self.runs / f"{key}.json"
        if not scores.exists():
            folder = self.runs / key
            shutil.rmtree(folder, ignore_errors=True)
            summary = json.loads(self.call("run", "--log", log, "--cameras", camera, "--json", "--quiet",
                                           "--out", folder, *words))
            rows = (folder / "trajectory.csv").read_text().splitlines()
            head = rows[0].split(",")
            error, state, confidence = (head.index(name) for name in ("add_s_mm", "state", "confidence"))
            frames = [row.split(",") for row in rows[1:]]
            sure = [row for row in frames if row[state] != "lost" and float(row[confidence]) >= 0.5]
            wrong = sum(float(row[error]) > 10 for row in sure)
            f = summary["f_score"] or {}
            scores.write_text(json.dumps({
                "f2": f.get("2"), "f5": f.get("5"), "add_s_mm": summary["add_s_mm"]["mean"],
                "final_mm": summary["add_s_mm"]["final"], "ends_lost": frames[-1][state] == "lost",
                "sure_but_wrong": wrong / len(frames), "frames_per_second": summary["frames_per_second"],
            }))
            shutil.rmtree(folder)
        return json.loads(scores.read_text())

    def errors(self, key, wrong, camera):
        """Returns how far the calibration after 5 s is from the true one."""
        path = self.runs / f"{key}-calibration.json"
        if not path.exists():
            self.call("calibrate", "--log", wrong, "--cameras", camera, "--duration", 5, "--out", path)
        found, true = json.loads(path.read_text()), json.loads((wrong / "disturbance.json").read_text())
        pose = dict(true["true_camera_poses"])[camera]
        refined = found["cameras"][0]["pose"]
        trace = sum(pose[i][k] * refined[i][k] for i in range(3) for k in range(3))
        offsets = zip(found["joint_offsets_deg"], true["joint_offsets_deg"])
        squares = [(a - b) ** 2 for a, b in offsets]
        return {
            "camera_deg": math.degrees(math.acos(max(-1, min(1, (trace - 1) / 2)))),
            "camera_mm": 1e3 * math.dist([row[3] for row in pose[:3]], [row[3] for row in refined[:3]]),
            "joints_deg": math.sqrt(sum(squares) / len(squares)),
            "lag_ms": abs(found["lag_ms"] - true["lag_ms"]),
        }


def lines(path, rows):
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def measured(measurement, name, seed, camera, estimator_seeds):
    """Returns the row of a log, and those of its seeds of the estimator."""
    log, wrong = measurement.log(name, seed)
    key = f"{name}-{seed}-{camera}"
    refined = measurement.run(f"{key}-refined", log, camera)
    row = {"object": name, "camera": camera, "first": int(estimator_seeds > 0), **measurement.errors(key, wrong, camera)}
    row |= {f"refined_{name}": value for name, value in refined.items()}
    for kind, path, words in (
        ("given", log, ["--calibration", "given"]),
        ("wrong", wrong, []),
        ("vision", log, ["--modality", "vi"]),
        ("wrong_vision", wrong, ["--modality", "vi"]),
        ("pose", log, ["--mode", "pose"]),
        ("wrong_pose", wrong, ["--mode", "pose"]),
    ):
        row |= {f"{kind}_{name}": value for name, value in measurement.run(f"{key}-{kind}", path, camera, *words).items()}
    row["f5_lost"] = refined["f5"] - row["wrong_f5"]
    row["add_s_gained_mm"] = row["wrong_add_s_mm"] - refined["add_s_mm"]
    row["pose_add_s_gained_mm"] = row["wrong_pose_add_s_mm"] - row["pose_add_s_mm"]
    row["vision_f5_lost"] = row["vision_f5"] - row["wrong_vision_f5"]
    row["refining_f5_lost"] = row["given_f5"] - refined["f5"]
    row["refining_add_s_gained_mm"] = refined["add_s_mm"] - row["given_add_s_mm"]
    errors = [measurement.run(f"{key}-seed{s}", log, camera, "--seed", s)["add_s_mm"] for s in range(estimator_seeds)]
    if not errors:
        return row, []
    median = statistics.median(errors)
    row["worst_over_median"] = max(errors) / median
    return row, [{"object": name, "camera": camera, "seed": s, "add_s_mm": error, "over_median": error / median,
                  "beyond_twice": int(error > 2 * median)} for s, error in enumerate(errors)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    objects = tomllib.loads((ROOT / "results/objects.toml").read_text())["report"]
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--objects", default=",".join(objects))
    parser.add_argument("--logs", type=int, default=3, help="logs per object")
    parser.add_argument("--seed", type=int, default=9200, help="seed of the first log")
    parser.add_argument("--duration", type=float, default=8)
    parser.add_argument("--seeds", type=int, default=5, help="seeds of the estimator on the first log of an object")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    measurement = Measurement(arguments)
    names = arguments.objects.split(",")
    tasks = [(name, arguments.seed + k, CAMERAS[(k + k // len(names)) % len(CAMERAS)], arguments.seeds if k < len(names) else 0)
             for k, name in enumerate(names * arguments.logs)]
    calibrations, seeds = [], []
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for (name, seed, camera, _), (row, of_seeds) in zip(tasks, pool.map(lambda task: measured(measurement, *task), tasks)):
            calibrations.append(row)
            seeds += of_seeds
            lines(arguments.out / "calibration.jsonl", calibrations)
            lines(arguments.out / "seeds.jsonl", seeds)
            print(f"{name}-{seed}-{camera}", {name: round(value, 3) for name, value in row.items() if isinstance(value, float)}, flush=True)


if __name__ == "__main__":
    main()
