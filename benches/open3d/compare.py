#!/usr/bin/env python3
"""Compares our SLAM with Open3D's ICP and TSDF integration on the same ten logs, with unknown and with known shapes.

    compare.py OUT [--duration S]          writes OUT/results.jsonl, OUT/summary.json and OUT/open3d/*.ply; `first_second_mm` is ADD-S after a second
    compare.py OUT --tune [--duration S]   chooses the settings of Open3D on the three logs of the suite `tuning`; OUT/tuning.jsonl, OUT/settings.json

The chosen settings stand in settings.json beside this program. All start alike: the first pose ties the model to the object for unknown
shapes, and is the true one for known shapes. An estimator that reports no pose keeps its last one in the scores.
"""

import argparse
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
from estimators import KnownShape, Settings, Slam

from mambavitact import Episode, Log, benchmark

# Touch is ours alone: the frames that Open3D receives have none.
VARIANTS = {
    "open3d-plane": (Slam, Settings()),
    "open3d-colour": (Slam, Settings(colour=True)),
    "open3d-known": (KnownShape, Settings()),
}
# Values of each setting beside the default, tried in turns from the first to the last. Coloured ICP begins with the choice for point-to-plane.
GRID = {
    "open3d-plane": {"velocity": (0.0,), "distance_mm": (5.0, 20.0), "kernel_mm": (0.0,), "truncation_mm": (12.0,)},
    "open3d-colour": {"geometry": (0.99, 0.999, 0.9997), "distance_mm": (5.0, 20.0)},
    "open3d-known": {"velocity": (0.0,), "distance_mm": (20.0,), "kernel_mm": (0.0,)},
}
OURS = {"ours-vitac": "images", "ours-vi": "none"}


def logs():
    """Returns the ten episodes: five of procedural objects, two of them random, and five of YCB objects, with both cameras."""
    suites = benchmark.suites()
    return suites["procedural"].logs[2:7] + suites["ycb"].logs[:5]


def recorded(folder, duration_s):
    """Returns the log in a folder of one episode, in which `benchmark.run` keeps a log of each duration."""
    return Log(next(folder.glob(f"*_{duration_s:g}/*/00/scene.json")).parent)


def outside(name, settings, log, duration_s, out, keep=None):
    """Runs a pipeline of Open3D on an episode."""
    kind = VARIANTS[name][0]
    folder = out / "logs" / str(log)
    made = []

    def factory(setup):
        if kind is Slam:
            made.append(Slam(setup, settings))
        else:
            made.append(KnownShape(setup, settings, Episode(log.object).mesh, recorded(folder, duration_s).object_poses[0]))
        return made[0]

    result = benchmark.run(name, factory, benchmark.Suite((log,), duration_s, "none"), folder)[0]
    if keep is not None and kind is Slam:
        keep.parent.mkdir(parents=True, exist_ok=True)
        o3d.io.write_triangle_mesh(str(keep), made[0].volume.extract_triangle_mesh())
    return result


def ours(name, log, touch, duration_s, folder):
    """Runs our SLAM on an episode."""
    return benchmark.run(name, benchmark.OurSlam, benchmark.Suite((log,), duration_s, touch), folder)[0]


def ours_known(name, log, modality, duration_s, out):
    """Runs our tracker with the true shape by the command, and returns a line of the table."""
    run = out / "known" / name / str(log)
    command = [sys.executable, "-m", "mambavitact", "run", "--log", recorded(out / "logs" / str(log), duration_s).folder, "--mode", "pose"]
    command += ["--modality", modality, "--object", log.object, "--init", "truth", "--out", run, "--json"]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{log}: {done.stderr.strip()}")
    summary = json.loads(done.stdout)
    return {"variant": name, "object": log.object, "cameras": log.cameras, "add_s_mm": summary["add_s_mm"]}


def tune(name, begin, duration_s, out):
    """Chooses settings by the mean of ADD-S over the three tuning logs, one setting after the other."""
    tried = {}

    def cost(settings):
        if settings not in tried:
            results = [outside(name, settings, log, duration_s, out) for log in benchmark.suites()["tuning"].logs]
            tried[settings] = float(np.mean([result.add_s_mm["mean"] for result in results]))
            f5 = [result.f_score[5] for result in results if result.f_score]
            line = {"variant": name, **dataclasses.asdict(settings), "add_s_mm": tried[settings], "f5": float(np.mean(f5)) if f5 else None}
            print(json.dumps(line), flush=True)
            with (out / "tuning.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")
        return tried[settings]

    for key, values in GRID[name].items():
        begin = min([begin, *(dataclasses.replace(begin, **{key: value}) for value in values)], key=cost)
    return begin


def summary(lines):
    """Returns means with standard errors, and the differences of ours to theirs with those of paired logs. Of unknown shapes, theirs is the variant
    with the lower ADD-S of each log, `open3d-best`."""

    def add_s_mm(line):
        return line["add_s_mm"]["mean"]

    def values(name, score):
        wanted = [variant for variant, (kind, _) in VARIANTS.items() if kind is Slam] if name == "open3d-best" else [name]
        of = {log.object: [line for line in lines if line["object"] == log.object and line["variant"] in wanted] for log in logs()}
        read = add_s_mm if score == "add_s_mm" else lambda line: line.get("f_score", {}).get(int(score[1:]), 0.0)
        return np.array([read(min(of[log.object], key=add_s_mm)) for log in logs()])

    def shown(numbers):
        return {"mean": float(numbers.mean()), "standard_error": float(numbers.std(ddof=1) / np.sqrt(len(numbers)))}

    result = {"logs": len(logs()), "means": {}, "differences": {}}
    for name in dict.fromkeys(line["variant"] for line in lines):
        scores, other = (["add_s_mm"], "open3d-known") if "known" in name else (["f2", "f5", "add_s_mm"], "open3d-best")
        result["means"][name] = {score: shown(values(name, score)) for score in scores}
        if name.startswith("ours"):
            result["differences"][name] = {s: shown(values(name, s) - values(other, s)) for s in scores}
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for logs and results")
    parser.add_argument("--tune", action="store_true", help="choose the settings of Open3D on the tuning logs, and stop")
    parser.add_argument("--duration", type=float, default=8.0, help="seconds of each log (default 8)")
    arguments = parser.parse_args()
    out, duration_s = arguments.out, arguments.duration
    out.mkdir(parents=True, exist_ok=True)
    if arguments.tune:
        best = {}
        for name, (_, begin) in VARIANTS.items():
            if begin.colour:
                begin = dataclasses.replace(Settings(**best["open3d-plane"]), colour=True)
            best[name] = dataclasses.asdict(tune(name, begin, duration_s, out))
        (out / "settings.json").write_text(json.dumps(best, indent=2) + "\n")
        return
    settings = json.loads(Path(__file__).with_name("settings.json").read_text())
    lines = []
    with (out / "results.jsonl").open("w") as file:
        for log in logs():
            folder = out / "logs" / str(log)
            found = []
            for name, touch in OURS.items():
                result, first = (ours(name, log, touch, seconds, folder) for seconds in (duration_s, 1.0))
                found.append({**result.line(), "first_second_mm": first.add_s_mm["final"]})
            for name in VARIANTS:
                keep = out / "open3d" / f"{name} {log.object}.ply"
                found.append(outside(name, Settings(**settings[name]), log, duration_s, out, keep).line())
            found += [ours_known(f"ours-known-{modality}", log, modality, duration_s, out) for modality in ("vitac", "vi")]
            for line in found:
                file.write(json.dumps(line) + "\n")
                f5 = line.get("f_score", {}).get(5)
                print(f"{log}: {line['variant']}: ADD-S {line['add_s_mm']['mean']:.2f} mm" + (f", F@5 {f5:.3f}" if f5 else ""), flush=True)
            file.flush()
            lines += found
    whole = summary(lines)
    (out / "summary.json").write_text(json.dumps(whole, indent=2) + "\n")
    print(json.dumps(whole))


if __name__ == "__main__":
    main()
