#!/usr/bin/env python3
"""Compares ways to choose the controllers of an episode by how fast the shape becomes known, from the same starts.

    results/explore.py OUT [--program FILE] [--objects NAME,...] [--seeds N] [--cameras NAME;...] [--modes MODES] [--jobs N]

Episodes of 30 s, touch depth from the network, one camera each. Per object and seed: `frontier` and `oracle` as `evaluate --explore` describes them,
`round-robin`, `random`, the controller of `auto` alone (`fixed`), and the schedule of it and the object's second safe controller in turns of 6 s
(`schedule`). Writes OUT/explore.jsonl, a line per episode with the mean F-score over time, and OUT/explore.json: means over all cameras and by camera, the
mean differences between frontier and the others with 95 % intervals, and the gains of frontier and oracle over the better of `fixed` and
`schedule`. A comparison uses the starts that its modes have in common. An object that fell keeps its last score. The
same command continues after an interruption; more --seeds or --modes add episodes.
"""

import argparse
import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = "077_rubiks_cube,cube70,rubiks_cube_small,large_dice,055_baseball,056_tennis_ball,ball,017_orange,013_apple,018_plum"
MODES = "frontier,oracle,round-robin,random,fixed,schedule"
# Not among the seeds of any tuning.
SEED = 9950
FIGURES = ["area_f5", "area_f2", "final_f5", "final_f2", "lowest_recall5", "dropped"]


def mean(values):
    return sum(values) / len(values)


def difference(pairs):
    """Returns the mean of paired differences with a 95 % interval of the normal distribution."""
    differences = [a - b for a, b in pairs]
    middle = mean(differences)
    spread = math.sqrt(sum((d - middle) ** 2 for d in differences) / max(len(differences) - 1, 1) / len(differences))
    return {"mean": middle, "low": middle - 1.96 * spread, "high": middle + 1.96 * spread}


def means(by_mode, starts):
    return {mode: {f: mean([played[s][f] for s in starts]) for f in FIGURES} for mode, played in by_mode.items()}


def summary(lines):
    by_mode = {}
    for line in lines:
        by_mode.setdefault(line["way"], {})[line["object"], line["seed"], line["cameras"]] = line
    common = lambda modes: set.intersection(*(set(by_mode[mode]) for mode in modes))
    # The oracle plays fewer starts than the others.
    others = {mode: played for mode, played in by_mode.items() if mode != "oracle"}
    starts = common(others or by_mode)
    cameras = sorted({camera for _, _, camera in starts})
    by_camera = {camera: means(others, [s for s in starts if s[2] == camera]) for camera in cameras}
    out = {"starts": len(starts), "means": means(others, starts), "by_camera": by_camera, "frontier_less": {}}
    for other in by_mode:
        if other != "frontier" and "frontier" in by_mode:
            both = common(["frontier", other])
            pairs = {f: [(by_mode["frontier"][s][f], by_mode[other][s][f]) for s in both] for f in FIGURES}
            out["frontier_less"][other] = {f: difference(pairs[f]) for f in FIGURES}
    plain = [mode for mode in ("fixed", "schedule") if mode in by_mode]
    if plain and {"frontier", "oracle"} <= set(by_mode):
        shared = common([*plain, "frontier", "oracle"])
        at = means({mode: by_mode[mode] for mode in [*plain, "frontier", "oracle"]}, shared)
        gain = lambda mode: {f: at[mode][f] - max(at[other][f] for other in plain) for f in FIGURES[:2]}
        out["gain"] = {"starts": len(shared), "frontier": gain("frontier"), "oracle": gain("oracle")}
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--objects", default=OBJECTS)
    parser.add_argument("--modes", default=MODES)
    parser.add_argument("--cameras", default="side;front-left")
    parser.add_argument("--first", type=int, default=SEED, help="first seed")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    listed = tomllib.loads((ROOT / "sim/gaits/assets/safe_controllers.toml").read_text())["object"]
    safe = {entry["name"]: [controller["name"] for controller in entry["controllers"]] for entry in listed}
    lines = {}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        for name in arguments.objects.split(","):
            first, second, *_ = safe[name]
            words = {"fixed": "fixed=auto", "schedule": f"fixed={first}:6,{second}:6"}
            modes = {words.get(mode, mode): mode for mode in arguments.modes.split(",")}
            folder = out / name
            command = ["evaluate", "--objects", name, "--seed", seed, "--seeds", 1, "--cameras", arguments.cameras, "--jobs", arguments.jobs]
            command += ["--explore", ";".join(modes), "--out", folder]
            result = subprocess.run([arguments.program.resolve(), *map(str, command)], capture_output=True, text=True)
            if result.returncode != 0:
                sys.exit(f"{name}, seed {seed}: {result.stderr.strip()}")
            for line in map(json.loads, (folder / "explore.jsonl").read_text().splitlines()):
                last = line["shape"][-1] if line["shape"] else {"f5": 0.0, "f2": 0.0}
                line |= {"way": modes.get(line["variant"], line["variant"]), "final_f5": last["f5"], "final_f2": last["f2"], "dropped": int(line["dropped"])}
                lines[name, line["seed"], line["cameras"], line["variant"]] = line
            (out / "explore.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines.values()))
            (out / "explore.json").write_text(json.dumps(summary(list(lines.values())), indent=1) + "\n")
            print(name, seed, {line["way"]: round(line["area_f5"], 3) for line in lines.values() if (line["object"], line["seed"]) == (name, seed)}, flush=True)
    print(json.dumps(summary(list(lines.values())), indent=1))


if __name__ == "__main__":
    main()
