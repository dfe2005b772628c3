#!/usr/bin/env python3
"""Measures SLAM with touch sensors that no training has seen, and that nobody calibrated.

    results/unit_slam.py OUT [--program FILE] [--units N] [--seed N]

All pads of the hand are one unit, which `touch units` draws as a DIGIT differs from others; the estimator takes it for the usual DIGIT. Of each unit there is a
log of 10 s with one of five objects (`side`), which is read by vision and touch, and by vision alone; beside it the same episode with TACTO's sensors.
Writes OUT/unit_slam.jsonl, a line per unit, and OUT/compared.json: means, and means of the differences with their standard errors. Units that are
there already are not measured again.
"""

import argparse
import json
import math
import shutil
import statistics
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from program import caller

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ["005_tomato_soup_can", "017_orange", "061_foam_brick", "large_dice", "018_plum"]
# Of the first episode.
EPISODE_SEED = 9900
KINDS = ["unit", "vision", "tacto"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="seed of the units")
    parser.add_argument("--objects", default=",".join(OBJECTS))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    out, objects = arguments.out, arguments.objects.split(",")
    out.mkdir(parents=True, exist_ok=True)

    call = caller(arguments.program)

    profiles = out / "profiles"
    if not profiles.exists():
        call("touch", "units", "--units", arguments.units, "--presses", 1, "--seed", arguments.seed, "--profiles", profiles)

    def measured(unit):
        path = out / f"{unit}.json"
        if path.exists():
            return json.loads(path.read_text())
        name, work = objects[unit % len(objects)], out / f"work-{unit}"
        row = {"unit": unit, "object": name}
        for sensor, profile in (("unit", profiles / f"{unit}.toml"), ("tacto", "tacto")):
            shutil.rmtree(work, ignore_errors=True)
            call("generate", "--object", name, "--logs", 1, "--duration", 10, "--seed", EPISODE_SEED + unit, "--cameras", "side", "--touch-profile", profile,
                 "--out", work / "log")
            log = next((work / "log").glob("*/00"))
            for kind, words in ((sensor, ["--modality", "vitac"]), ("vision", ["--modality", "vi"])):
                if f"{kind}_f5" not in row:
                    read_as = "tacto" if sensor == "tacto" else "digit"
                    summary = json.loads(call("run", "--log", log, *words, "--touch-profile", read_as, "--json", "--quiet", "--out", work / kind))
                    row |= {f"{kind}_f5": summary["f_score"]["5"], f"{kind}_add_s_mm": summary["add_s_mm"]["mean"]}
        shutil.rmtree(work)
        path.write_text(json.dumps(row))
        print(row, flush=True)
        return row

    with ThreadPoolExecutor(arguments.jobs) as pool:
        rows = list(pool.map(measured, range(arguments.units)))
    (out / "unit_slam.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    compared = {"units": len(rows)}
    for value in ("f5", "add_s_mm"):
        compared |= {f"{kind}_{value}": statistics.mean(row[f"{kind}_{value}"] for row in rows) for kind in KINDS}
        for other in ("tacto", "vision"):
            added = [row[f"unit_{value}"] - row[f"{other}_{value}"] for row in rows]
            compared |= {f"{value}_less_{other}": statistics.mean(added), f"{value}_less_{other}_error": statistics.stdev(added) / math.sqrt(len(added))}
    (out / "compared.json").write_text(json.dumps(compared, indent=2))
    print(json.dumps(compared, indent=2))


if __name__ == "__main__":
    main()
