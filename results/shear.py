#!/usr/bin/env python3
"""Measures shear: seen in rendered images against FOTS's formula and against MuJoCo, and how well it tells the slip of pads.

results/shear.py OUT writes OUT/shear.jsonl, a line per case."""

import json
import math
import subprocess
import sys
from pathlib import Path

EXAMPLE = ["cargo", "run", "--quiet", "--release", "-p", "mvt-simulated", "--example", "shear", "--"]
# Reported objects; the coefficients of the tracker were chosen on others.
OBJECTS = "005_tomato_soup_can,010_potted_meat_can,017_orange,061_foam_brick,random:1000,random:1003"
# Deviation of slip in the tracker between frames at 30 Hz, from slip_still_1s_sigma_m and slip_changing_sigma_m, in millimetres. Parts of the change of shear, and of shear
# times that deviation, that predict slip best on six tuning objects of seed 50.
STILL, CHANGING, FOLLOWED, SLID = 0.05, 2.0, 0.7, 0.7


def lines(*arguments):
    done = subprocess.run([*EXAMPLE, *arguments], stdout=subprocess.PIPE, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def correlation(pairs):
    means = [sum(pair[k] for pair in pairs) / len(pairs) for k in (0, 1)]
    moment = lambda i, j: sum((pair[i] - means[i]) * (pair[j] - means[j]) for pair in pairs)
    return moment(0, 1) / math.sqrt(moment(0, 0) * moment(1, 1))


def scale(pairs):
    """Factor by which the first of each pair exceeds the second."""
    return sum(a * b for a, b in pairs) / sum(b * b for _, b in pairs)


def median(values):
    values = sorted(values)
    return values[len(values) // 2]


def presses(profile):
    seen = lines("presses", "--profile", profile, "--count", "300", "--seed", "9")
    shear = [pair for line in seen for pair in zip(line["seen_mm"], line["true_mm"])]
    twist = [(line["seen_rad"], line["true_rad"]) for line in seen]
    missed, moved = (math.sqrt(sum(line[name] ** 2 for line in seen)) for name in ("missed_mm", "moved_mm"))
    return {
        "case": profile,
        "presses": len(seen),
        "field_percent": 100 * missed / moved,
        "correlation": correlation(shear),
        "scale_percent": 100 * abs(scale(shear) - 1),
        "shear_mm": math.sqrt(sum((a - b) ** 2 for a, b in shear) / len(seen)),
        "twist_deg": math.degrees(math.sqrt(sum((a - b) ** 2 for a, b in twist) / len(seen))),
    }


def change(line):
    """Standard deviation of slip by the change of pressed area, millimetres."""
    before, after = line["pixels"]
    return STILL + CHANGING * (abs(before - after) + 200) / (before + after + 200)


def misfit(slips):
    """Negative log-likelihood of slips beside an expected one, in two dimensions with the tails of Cauchy's distribution; the one factor of
    all deviations is fitted."""
    at = lambda k: sum(2 * math.log(k * s) + 1.5 * math.log1p((r / (k * s)) ** 2) for r, s in slips) / len(slips)
    return min(at(0.05 * 1.1**k) for k in range(40))


def episodes():
    pads = lines("episodes", "--objects", OBJECTS, "--count", "2", "--seed", "90", "--duration", "6")
    felt = [pad for pad in pads if None not in pad["seen_mm"]]
    shear = [pair for pad in felt for pair in zip(pad["seen_mm"][1], pad["true_mm"][1])]
    stiffness = lambda pad: pad["stiffness_n_per_mm"]
    force = [(stiffness(pad) * mm, n) for pad in felt for mm, n in zip(pad["seen_mm"][1], pad["friction_n"])]
    area, by_shear = [], []
    for pad in felt:
        (was, now), slip, sigma = pad["seen_mm"], pad["slip_mm"], change(pad)
        expected = [FOLLOWED * (now[k] - was[k]) + SLID * sigma * now[k] for k in (0, 1)]
        area.append((math.hypot(*slip), sigma))
        by_shear.append((math.dist(slip, expected), sigma))
    return {
        "case": "hand",
        "pads": len(pads),
        "seen_percent": 100 * len(felt) / len(pads),
        "correlation": correlation(shear),
        "scale_percent": 100 * abs(scale(shear) - 1),
        "force_correlation": correlation(force),
        "slip_mm": median([slip for slip, _ in area]),
        "slip_left_mm": median([slip for slip, _ in by_shear]),
        "misfit_area": misfit(area),
        "misfit_shear": misfit(by_shear),
    }


def main():
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    cases = [presses("digit_markers"), presses("gelsight_mini_markers"), episodes()]
    (out / "shear.jsonl").write_text("".join(json.dumps(case) + "\n" for case in cases))


if __name__ == "__main__":
    main()
