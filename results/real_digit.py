#!/usr/bin/env python3
"""Scores `touch predict` on images of a 6 mm ball on real DIGITs.

    results/real_digit.py OUT [--program FILE] [--data DIR] [--weights FILE]

Writes OUT/real_digit.jsonl, a line per case: each sensor of DIR (default: tests/data/real_digit) with its own untouched image; `dd` with the
untouched image that `tx1` has; and `dd` read with a profile that was calibrated on `tx1`. With other weights than those that are
shipped for real DIGITs, only the first three. No depth was measured: the truth is the ball inside the
circle of contact. Needs numpy and Pillow.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PX_PER_MM, BALL_MM = 18.8, 3.0
U, V = np.meshgrid(np.arange(240.0), np.arange(320.0))


def score(folder, predictions):
    """Returns the means over the images of a folder."""
    rows = []
    for row in csv.DictReader((folder / "circles.csv").open()):
        if row.get("usable", "yes") != "yes":
            continue
        depth = np.load(predictions / f"{row['id']}_indentation_mm.npy").astype(float)
        contact = np.asarray(Image.open(predictions / f"{row['id']}_contact.png").convert("L")) > 127
        x, y, a, fade = (float(row[k]) for k in ("centre_x_px", "centre_y_px", "contact_radius_px", "fade_px"))
        mask_x, mask_y, mask_radius = (float(row[k]) for k in ("mask_x_px", "mask_y_px", "mask_radius_px"))
        r, from_mask = np.hypot(U - x, V - y), np.hypot(U - mask_x, V - mask_y)
        inside, mask = r <= a, from_mask <= mask_radius
        truth = ((a * a - r * r) / 2 + a * fade) / (BALL_MM * PX_PER_MM) / PX_PER_MM
        terms = np.stack([np.ones(inside.sum()), (U - x)[inside], (V - y)[inside], -r[inside] ** 2 / 2 / PX_PER_MM**2], 1)
        weight = np.clip(depth, 0, None) * (from_mask < 2 * mask_radius)
        weight /= max(weight.sum(), 1e-9)
        rows.append((
            (mask & contact).sum() / max((mask | contact).sum(), 1),
            np.abs(depth - truth)[inside].mean(),
            np.linalg.lstsq(terms, depth[inside], rcond=None)[0][3],
            np.hypot((weight * U).sum() - x, (weight * V).sum() - y),
            100 * (contact & (from_mask > 1.5 * mask_radius)).mean(),
        ))
    table = np.array(rows)
    return {
        "images": len(table), "iou": float(table[:, 0].mean()), "mae_mm": float(table[:, 1].mean()),
        "ball_radius_mm": float(1 / np.median(table[:, 2])), "centre_px": float(np.median(table[:, 3])),
        "false_contact_percent": float(table[:, 4].mean()),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--data", type=Path, default=ROOT / "tests/data/real_digit")
    parser.add_argument("--weights", type=Path, help="weights of a network")
    arguments = parser.parse_args()
    weights = ["--weights", arguments.weights.resolve()] if arguments.weights else []
    program, data, out = arguments.program.resolve(), arguments.data, arguments.out
    out.mkdir(parents=True, exist_ok=True)

    def call(*words):
        result = subprocess.run([program, "touch", *map(str, words)], capture_output=True, text=True)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")

    def predict(case, sensor, untouched, *options):
        folder = out / case
        shutil.rmtree(folder, ignore_errors=True)
        call("predict", "--images", data / sensor, "--untouched", data / untouched / "untouched.png", "--out", folder, *options)
        return {"case": case, **score(data / sensor, folder)}

    lines = [predict(sensor, sensor, sensor, *weights) for sensor in ("dd", "tx1", "tx2")]
    if not weights:
        profile = out / "tx1.toml"
        call("calibrate", "--images", data / "tx1", "--untouched", data / "tx1/untouched.png", "--ball-mm", 6, "--out", profile, "--overwrite")
        lines.append(predict("other-day", "dd", "tx1"))
        lines.append(predict("calibrated", "dd", "dd", "--profile", profile))
    (out / "real_digit.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for line in lines:
        print({key: round(value, 3) if isinstance(value, float) else value for key, value in line.items()})


if __name__ == "__main__":
    main()
