#!/usr/bin/env python3
"""Scores `touch predict` on images of balls that real sensors took.

    results/real_touch.py OUT [--program FILE] [--data DIR] [--only NAME ...] [--weights FILE]

DIR (default: ../shared) has `real_digit` (a ball of 6.0 mm on DIGITs) and `real_gelsight_mini` (one of 9.5 mm). OUT/real_touch.jsonl
receives a line per case:

- digit: each set with its own untouched image; `dd` with the untouched image of `tx1` (other-day); `dd` read with a profile that was
  calibrated on `tx1` (calibrated); processor time of reading `tx2` over that of reading the same images as TACTO's (cost).
- gelsight: the ball beside the disc that its shading shows, without a calibration.
- disturbed: images as another light, another camera or a broken LED would make them, beside the same images undisturbed. A reading
  is right if the depth in contact is within 10 % and the contact agrees to 0.8; it is told if its plausibility is below 0.5.

No depth was measured: the truth of DIGITs is the ball inside a circle of contact that people fitted. --weights is for the sets of DIGITs.
Needs numpy and Pillow.
"""

import argparse
import csv
import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]


def image(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(float)


def contact_of(folder, name):
    return np.asarray(Image.open(folder / f"{name}_contact.png").convert("L")) > 127


def depth_of(folder, name):
    return np.load(folder / f"{name}_indentation_mm.npy").astype(float)


class Program:
    def __init__(self, path, out):
        self.path, self.out = path.resolve(), out

    def call(self, *words, may_refuse=False):
        """Runs a command, and returns whether it did not refuse."""
        result = subprocess.run([self.path, "touch", *map(str, words)], capture_output=True, text=True)
        if result.returncode != 0 and not may_refuse:
            sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
        return result.returncode == 0

    def predict(self, case, images, untouched, *options, may_refuse=False):
        """Returns the folder of the predictions; `None` if the images are refused."""
        folder = self.out / case
        shutil.rmtree(folder, ignore_errors=True)
        done = self.call("predict", "--images", images, "--untouched", untouched, "--out", folder, *options, may_refuse=may_refuse)
        return folder if done else None


def cost(program, data, profile):
    """Returns the processor time of reading a set as images of a sensor, seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    program.predict("cost", data, data / "untouched.png", "--profile", profile)
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def plausibilities(folder):
    return {row["id"]: float(row["plausibility"]) for row in csv.DictReader((folder / "predictions.csv").open())}


# DIGITs: 18.8 pixels per millimetre.

PX_PER_MM, BALL_MM = 18.8, 3.0


def usable(data):
    return [row for row in csv.DictReader((data / "circles.csv").open()) if row.get("usable", "yes") == "yes"]


def score_digit(data, predictions):
    """Returns the means over the images of a set, by the rules of shared/real_digit/score.py."""
    u, v = np.meshgrid(np.arange(240.0), np.arange(320.0))
    rows = []
    for row in usable(data):
        depth, contact = depth_of(predictions, row["id"]), contact_of(predictions, row["id"])
        x, y, a, fade = (float(row[k]) for k in ("centre_x_px", "centre_y_px", "contact_radius_px", "fade_px"))
        mask_x, mask_y, mask_radius = (float(row[k]) for k in ("mask_x_px", "mask_y_px", "mask_radius_px"))
        r, from_mask = np.hypot(u - x, v - y), np.hypot(u - mask_x, v - mask_y)
        inside, mask = r <= a, from_mask <= mask_radius
        truth = ((a * a - r * r) / 2 + a * fade) / (BALL_MM * PX_PER_MM) / PX_PER_MM
        terms = np.stack([np.ones(inside.sum()), (u - x)[inside], (v - y)[inside], -r[inside] ** 2 / 2 / PX_PER_MM**2], 1)
        weight = np.clip(depth, 0, None) * (from_mask < 2 * mask_radius)
        weight /= max(weight.sum(), 1e-9)
        rows.append((
            (mask & contact).sum() / max((mask | contact).sum(), 1),
            np.abs(depth - truth)[inside].mean(),
            np.linalg.lstsq(terms, depth[inside], rcond=None)[0][3],
            np.hypot((weight * u).sum() - x, (weight * v).sum() - y),
            100 * (contact & (from_mask > 1.5 * mask_radius)).mean(),
        ))
    table = np.array(rows)
    return {
        "images": len(table), "iou": float(table[:, 0].mean()), "mae_mm": float(table[:, 1].mean()),
        "ball_radius_mm": float(1 / np.median(table[:, 2])), "centre_px": float(np.median(table[:, 3])),
        "false_contact_percent": float(table[:, 4].mean()),
    }


# GelSight Mini: millimetres per pixel of 320 x 240, and the radius of the ball.

MINI_MM, MINI_BALL_MM = 0.0634, 4.75


def nelder_mead(f, start, step, rounds):
    """Returns where f is least (Nelder and Mead 1965)."""
    points = [np.array(start, float)] + [np.array(start, float) + step * np.eye(len(start))[i] for i in range(len(start))]
    values = [f(p) for p in points]
    for _ in range(rounds):
        order = np.argsort(values)
        points, values = [points[i] for i in order], [values[i] for i in order]
        middle = np.mean(points[:-1], 0)
        for factor, limit in ((2.0, values[0]), (1.0, values[-2]), (-0.5, values[-1])):
            candidate = middle + factor * (middle - points[-1])
            value = f(candidate)
            if value < limit:
                points[-1], values[-1] = candidate, value
                break
        else:
            points = [points[0] + 0.5 * (p - points[0]) for p in points]
            values = [f(p) for p in points]
    return points[int(np.argmin(values))]


def disc(change):
    """Returns centre (pixels) and radius (mm) of the contact of the ball, and the reach of the gel beyond it (mm), by its shading: within the
    contact the slope is that of the ball, beyond it the slope fades, and each colour changes linearly and quadratically with it."""
    v, u = np.mgrid[0:240, 0:320][:, ::2, ::2].astype(float)
    change = change[::2, ::2]
    strength = np.abs(change).sum(-1)
    weight = np.where(strength > 0.5 * np.percentile(strength, 97), strength, 0)
    centre = (weight * u).sum() / weight.sum(), (weight * v).sum() / weight.sum()
    near = np.hypot(u - centre[0], v - centre[1]) < 90
    total = (change[near] ** 2).sum()

    def misfit(parameters):
        x, y, a, fade = parameters
        if not (0.8 < a < 4.4 and 0.05 < fade < 3):
            return 2.0
        dx, dy = u - x, v - y
        away = np.maximum(np.hypot(dx, dy), 1e-9)
        r = away * MINI_MM
        inside = r < 2.2 * a
        flank = a / np.sqrt(MINI_BALL_MM**2 - a * a) * np.exp(-(r - a) / fade)
        slope = np.where(r < a, r / np.sqrt(np.maximum(MINI_BALL_MM**2 - r * r, 1e-6)), flank)
        sx, sy = slope * dx / away, slope * dy / away
        terms = np.stack([sx, sy, np.ones_like(sx), sx * sx, sy * sy, sx * sy], -1)[inside]
        left = change[inside] - terms @ np.linalg.lstsq(terms, change[inside], rcond=None)[0]
        return ((left**2).sum() + (change[near & ~inside] ** 2).sum()) / total

    return nelder_mead(misfit, [*centre, 2.2, 0.6], np.array([5, 5, 0.3, 0.2]), 70)


def score_gelsight(data, predictions, options=()):
    background = image(data / "background.png")
    v, u = np.mgrid[0:240, 0:320].astype(float)
    rows = []
    for path in sorted(predictions["images"].glob("*_img.png")):
        name = path.name.removesuffix("_img.png")
        x, y, a, fade = disc(image(path) - background)
        depth, contact = depth_of(predictions["folder"], name), contact_of(predictions["folder"], name)
        if depth.shape == (320, 240):
            # The program has turned the images clockwise.
            depth, contact = np.rot90(depth), np.rot90(contact)
        r = np.hypot(u - x, v - y) * MINI_MM
        inside = r <= a
        truth = (a * a - r * r) / 2 / MINI_BALL_MM + a * fade / MINI_BALL_MM
        places = np.argwhere(contact).astype(float)
        is_whole = a / MINI_MM < min(x, y, 319 - x, 239 - y)
        if len(places) < 10 or not is_whole:
            rows.append((0.0,) * 6 if len(places) < 10 else None)
            continue
        spread = np.linalg.eigvalsh(np.cov(places.T))
        terms = np.stack([np.ones(inside.sum()), (u - x)[inside], (v - y)[inside], -r[inside] ** 2 / 2], 1)
        rows.append((
            (inside & contact).sum() / (inside | contact).sum(),
            np.sqrt(spread[1] / max(spread[0], 1e-9)),
            MINI_MM * np.hypot(places[:, 1].mean() - x, places[:, 0].mean() - y),
            np.sqrt(len(places) / np.pi) * MINI_MM / a,
            np.abs(depth - truth)[inside].mean(),
            np.linalg.lstsq(terms, depth[inside], rcond=None)[0][3],
        ))
    table = np.array([row for row in rows if row is not None])
    iou, aspect, centre, radius, mae, _ = table.mean(0)
    return {
        "images": len(table), "iou": float(iou), "aspect": float(aspect), "centre_mm": float(centre), "radius_ratio": float(radius),
        "mae_mm": float(mae), "ball_radius_mm": float(1 / np.median(table[:, 5])),
    }


# Disturbances of images and their untouched image, each a function of levels from 0 to 255.


def disturbances():
    def light(factor):
        return lambda i: i * factor

    def colour(channel, factor):
        return lambda i: i * np.where(np.arange(3) == channel, factor, 1.0)

    cases = {f"light-{f}": (light(f), light(f)) for f in (0.15, 0.3, 0.5, 0.7, 1.5, 2.0)}
    for gamma in (0.45, 0.7, 1.5, 2.2):
        cases[f"gamma-{gamma}"] = (lambda i, g=gamma: 255 * (i / 255) ** g,) * 2
    cases["limited-range"] = (lambda i: 16 + i * 219 / 255,) * 2
    cases["narrow-range"] = (lambda i: 64 + i * 128 / 255,) * 2
    for channel, name in enumerate(("red", "green", "blue")):
        cases[f"dead-{name}"] = (colour(channel, 0.05),) * 2
        cases[f"weak-{name}"] = (colour(channel, 0.5),) * 2
    # The exposure has changed since the untouched image was taken.
    for drift in (0.9, 1.1, 1.2):
        cases[f"drift-{drift}"] = (light(drift), light(1.0))
    cases["saturated"] = (light(3.0), light(3.0))
    cases["grey"] = (lambda i: i.mean(-1, keepdims=True).repeat(3, -1),) * 2
    # A profile of a sensor that stands upright is right; these are put upright by the program, or told.
    cases["mirrored"] = (lambda i: i[:, ::-1],) * 2
    cases["turned"] = (lambda i: i[::-1, ::-1],) * 2
    cases["black"] = (lambda i: i * 0,) * 2
    return cases


def back(case, levels):
    """Puts predictions on a disturbed image where those on the undisturbed image are, if the program has left them turned."""
    return {"mirrored": levels[:, ::-1], "turned": levels[::-1, ::-1]}.get(case, levels)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--only", nargs="+", choices=("digit", "gelsight", "disturbed"), default=("digit", "gelsight", "disturbed"))
    parser.add_argument("--weights", type=Path, help="weights of a network for DIGITs")
    arguments = parser.parse_args()
    out, digit, mini = arguments.out, arguments.data / "real_digit", arguments.data / "real_gelsight_mini"
    if not digit.is_dir() or not mini.is_dir():
        sys.exit(f"{arguments.data} has no images of real sensors: nothing was measured; name the folder that has them with --data")
    out.mkdir(parents=True, exist_ok=True)
    program = Program(arguments.program, out)
    weights = ["--weights", arguments.weights.resolve()] if arguments.weights else []
    lines = []

    def add(**line):
        lines.append(line)
        print({key: round(value, 3) if isinstance(value, float) else value for key, value in line.items()}, flush=True)

    sets = ("dd", "tx1", "tx2")
    plain = {s: program.predict(s, digit / s, digit / s / "untouched.png", *weights) for s in sets}
    if "digit" in arguments.only:
        for s in sets:
            add(case=s, **score_digit(digit / s, plain[s]))
        other = program.predict("other-day", digit / "dd", digit / "tx1/untouched.png", *weights)
        add(case="other-day", **score_digit(digit / "dd", other))
        if not weights:
            profile = out / "tx1.toml"
            program.call(
                "calibrate", "--images", digit / "tx1", "--untouched", digit / "tx1/untouched.png", "--ball-mm", 6, "--out", profile,
                "--overwrite",
            )
            calibrated = program.predict("calibrated", digit / "dd", digit / "dd/untouched.png", "--profile", profile)
            add(case="calibrated", **score_digit(digit / "dd", calibrated))
            ratios = [cost(program, digit / "tx2", "digit") / cost(program, digit / "tx2", "tacto") for _ in range(3)]
            add(case="cost", ratio=float(np.median(ratios)))
    if "gelsight" in arguments.only:
        images = out / "gelsight_images"
        shutil.rmtree(images, ignore_errors=True)
        images.mkdir()
        for folder in (mini / "9.500mm").iterdir():
            shutil.copy(folder / "gelsight.png", images / f"{int(folder.name):02}_img.png")
        folder = program.predict("gelsight", images, mini / "background.png", "--profile", "gelsight_mini")
        add(case="gelsight", **score_gelsight(mini, {"images": images, "folder": folder}))
        as_digit = plausibilities(program.predict("gelsight-as-digit", images, mini / "background.png"))
        add(case="gelsight-as-digit", images=len(as_digit), plausible=float(np.mean([p >= 0.5 for p in as_digit.values()])))
    if "disturbed" in arguments.only:
        for case, (of_image, of_untouched) in disturbances().items():
            ratios, right, told, count = [], 0, 0, 0
            for s in sets:
                folder = out / "disturbed" / s
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(parents=True)
                write = lambda levels, path: Image.fromarray(np.clip(levels, 0, 255).round().astype("uint8")).save(path)
                rows = usable(digit / s)[:10]  # enough for a share
                for row in rows:
                    write(of_image(image(digit / s / f"{row['id']}_img.png")), folder / f"{row['id']}_img.png")
                write(of_untouched(image(digit / s / "untouched.png")), folder / "untouched.png")
                count += len(rows)
                read = program.predict(f"disturbed-{case}-{s}", folder, folder / "untouched.png", *weights, may_refuse=True)
                if read is None:
                    told += len(rows)
                    continue
                plausible = plausibilities(read)
                for name in (row["id"] for row in rows):
                    contact = contact_of(plain[s], name)
                    # The program has put images upright that it found to lie otherwise.
                    found = [(back(kind, contact_of(read, name)), back(kind, depth_of(read, name))) for kind in ("", case)]
                    overlaps = [(contact & c).sum() / max((contact | c).sum(), 1) for c, _ in found]
                    overlap, (_, depth) = max(overlaps), found[int(np.argmax(overlaps))]
                    ratio = depth[contact].mean() / max(depth_of(plain[s], name)[contact].mean(), 1e-3)
                    is_told = plausible[name] < 0.5
                    ratios.append(ratio)
                    told += is_told
                    right += not is_told and abs(ratio - 1) <= 0.1 and overlap >= 0.8
                shutil.rmtree(read)
            add(
                case=case, images=count, ratio=float(np.median(ratios)) if ratios else None,
                right=float(right / count), told=float(told / count), wrong=float(1 - (right + told) / count),
            )
    (out / "real_touch.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


if __name__ == "__main__":
    main()
