#!/usr/bin/env python3
"""Measures the rigs that are brought along, other frame rates, and the weights of the GelSight Mini.

    results/rigs.py OUT [--program FILE] [--seeds N] [--duration SECONDS] [--only PART,...] [--jobs N]

Parts: the name of a rig (episodes with all its sensors), rates (the Allegro at other frame rates), calibration (a camera of the LEAP hand that is
off by 5 degrees and 10 mm), touch (the weights of the GelSight Mini on new presses). Writes OUT/RIG.jsonl for each rig, OUT/rates.jsonl,
OUT/rig_calibration.jsonl and OUT/rig_touch.jsonl, a line per run. What is there already is not measured again. No object here was used to
find the controllers of these rigs.
"""

import argparse
import json
import math
import shutil
import statistics
from pathlib import Path

import numpy as np
from PIL import Image

from program import caller

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ["077_rubiks_cube", "010_potted_meat_can", "025_mug", "055_baseball", "013_apple"]
RIGS = {
    "leap_digit": ["side", "front-left"],
    "leap_gelsight": ["side", "front-left"],
    "gripper_gelsight": ["front"],
    "three_fingers": ["side"],
    "allegro_digit": ["side"],
}
# Frame rates are compared on objects that nothing here was tuned with.
RATE_OBJECTS = ["005_tomato_soup_can", "010_potted_meat_can", "061_foam_brick", "large_dice", "013_apple"]
# Presses of which the contact covers more of the image than this show no edge from which depth could be told on a flat gel.
EDGE_IN_VIEW = 0.5


def evaluate(call, out, rig, objects, cameras, arguments, *words):
    call("evaluate", "--rig", rig, "--objects", ",".join(objects), "--seeds", arguments.seeds, "--duration", arguments.duration,
         "--cameras", ";".join(cameras), "--modes", "slam", "--modalities", "vitac", "--jobs", arguments.jobs, "--out", out, *words)
    return [json.loads(line) for line in (out / "runs.jsonl").read_text().splitlines()]


def row(rig, run, seconds):
    lasted_s = run["frames"] / 30
    return {
        "rig": rig, "object": run["object"], "seed": run["seed"], "camera": run["cameras"], "seconds": lasted_s, "end": run["end"],
        "kept": int(lasted_s > seconds - 0.5), "rad_s": run["turned_rad"] / lasted_s, "f5": run["f_score"].get("5", 0.0),
        "f5_seen": run["f_score_observed"].get("5", 0.0), "add_s_mm": run["add_s_mm"]["mean"],
    }


def rates(runs):
    usual = {(run["object"], run["seed"]): run for run in runs if run["variant"] == "full"}
    for run in runs:
        error, same = run["add_s_mm"]["mean"], usual[run["object"], run["seed"]]
        yield {"object": run["object"], "seed": run["seed"], "rate": run["variant"], "add_s_mm": error,
               "added_mm": error - same["add_s_mm"]["mean"], "f5": run["f_score"].get("5", 0.0)}


def calibration(call, out, seeds):
    for seed in range(seeds):
        log, wrong, found = (out / f"leap-{seed}-{name}" for name in ("log", "wrong", "found.json"))
        if not found.exists():
            for folder in (log, wrong):
                shutil.rmtree(folder, ignore_errors=True)
            call("generate", "--rig", "leap_digit", "--object", "cube70", "--logs", 1, "--duration", 6, "--seed", 100 + seed, "--cameras", "side",
                 "--out", log)
            call("disturb", next(log.glob("*/00")), "--out", wrong, "--camera-deg", 5, "--camera-mm", 10, "--seed", seed)
            call("calibrate", "--log", wrong, "--cameras", "side", "--duration", 5, "--out", found)
            shutil.copy(wrong / "disturbance.json", out / f"leap-{seed}-true.json")
            shutil.rmtree(log)
            shutil.rmtree(wrong)
        pose = json.loads(found.read_text())["cameras"][0]["pose"]
        true = dict(json.loads((out / f"leap-{seed}-true.json").read_text())["true_camera_poses"])["side"]
        trace = sum(true[i][k] * pose[i][k] for i in range(3) for k in range(3))
        yield {"seed": seed, "camera_deg": math.degrees(math.acos(max(-1, min(1, (trace - 1) / 2)))),
               "camera_mm": 1e3 * math.dist([line[3] for line in true[:3]], [line[3] for line in pose[:3]])}


def touch(call, out):
    weights, data, near = ROOT / "perception/touch/weights/gelsight_mini.safetensors", out / "presses", out / "presses-in-view"
    if not data.exists():
        call("touch", "data", "--profile", "gelsight_mini", "--objects", "test", "--images", 300, "--seed", 45, "--out", data)
    near.mkdir(exist_ok=True)
    for mask in data.glob("*_mask.png"):
        if (np.asarray(Image.open(mask)) > 127).mean() <= EDGE_IN_VIEW:
            for file in data.glob(mask.name.replace("mask.png", "*")):
                shutil.copy(file, near)
    for name, folder in (("all", data), ("edge in view", near)):
        scores = json.loads(call("touch", "evaluate", "--weights", weights, "--data", folder, "--profile", "gelsight_mini", "--json"))
        yield {"presses": name, **{key: value for key, value in scores.items() if not isinstance(value, (dict, list))}}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=20)
    parser.add_argument("--only", default=",".join([*RIGS, "rates", "calibration", "touch"]))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    parts = arguments.only.split(",")

    call = caller(arguments.program)

    def lines(name, rows):
        rows = list(rows)
        (arguments.out / name).write_text("".join(json.dumps(row) + "\n" for row in rows))
        return rows

    for rig in (rig for rig in RIGS if rig in parts):
        runs = evaluate(call, arguments.out / rig, rig, OBJECTS, RIGS[rig], arguments)
        measured = lines(f"{rig}.jsonl", (row(rig, run, arguments.duration) for run in runs))
        mean = {key: statistics.mean(row[key] for row in measured) for key in ("kept", "rad_s", "f5", "f5_seen", "add_s_mm")}
        print(rig, " ".join(f"{key} {value:.3f}" for key, value in mean.items()), flush=True)
    if "rates" in parts:
        runs = evaluate(call, arguments.out / "rates", "allegro_digit", RATE_OBJECTS, ["side"], arguments, "--rates")
        lines("rates.jsonl", rates(runs))
    if "calibration" in parts:
        lines("rig_calibration.jsonl", calibration(call, arguments.out, arguments.seeds))
    if "touch" in parts:
        lines("rig_touch.jsonl", touch(call, arguments.out))


if __name__ == "__main__":
    main()
