#!/usr/bin/env python3
"""Measures sweeps and compact logs on this machine.

    results/cluster.py OUT [--program FILE] [--tasks N] [--duration SECONDS] [--logs N]

Plans N tasks (100,000) and asks for their status when 90 % are done; measures the time of a task beside its work, and the size, writing and
reading of a compact log of 30 s; and runs SLAM on logs of SECONDS (10) in FeelSight's layout and on their compact copies. Writes
OUT/cluster.json, and OUT/slam.jsonl with a line per log. Runs that are there already are not made again.
"""

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ["005_tomato_soup_can", "010_potted_meat_can", "017_orange", "061_foam_brick", "054_softball", "rubiks_cube_small", "013_apple",
           "large_dice", "065-g_cups", "random:1000"]
# Each log has its own seed, from this one on.
SEED = 9700
CAMERA = "side"
ROUNDS = 3


class Measurement:
    def __init__(self, arguments):
        self.program, self.out = str(arguments.program.resolve()), arguments.out.resolve()

    def call(self, *words):
        """Runs the program; returns its output, messages, and use of time (wall and CPU, seconds) and memory (MB)."""
        begun = time.monotonic()
        with open(self.out / "output.txt", "w+") as output, open(self.out / "messages.txt", "w+") as messages:
            child = subprocess.Popen([self.program, *map(str, words)], stdout=output, stderr=messages)
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            wall_s = time.monotonic() - begun
            output.seek(0), messages.seek(0)
            text, said = output.read(), messages.read()
        if child.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {said.strip()}")
        return text, said, {"wall_s": wall_s, "cpu_s": usage.ru_utime + usage.ru_stime, "peak_mb": usage.ru_maxrss / 1024}

    def folder(self, name):
        path = self.out / name
        shutil.rmtree(path, ignore_errors=True)
        return path

    def plan(self, name, spec):
        path, sweep = self.out / f"{name}.toml", self.folder(name)
        path.write_text(spec)
        return sweep, self.call("sweep", "plan", path, "--out", sweep)[2]

    def many_tasks(self, tasks):
        """Returns wall time and memory of the plan and of the status of many tasks."""
        sweep, planned = self.plan("many", 'command = "generate"\n[axes]\nobject = ["cube70", "large_dice", "ball", "013_apple"]\n'
                                           f'seed = {{ from = 0, count = {tasks // 4} }}\n')
        names = [json.loads(line)["id"] for line in (sweep / "tasks.jsonl").open() if '"id"' in line]
        version = json.loads((sweep / "plan.json").read_text())["program_version"]
        for name in names[: len(names) * 9 // 10]:
            done = sweep / "done" / name[:2] / name
            done.mkdir(parents=True)
            (done / "manifest.json").write_text(json.dumps({"task": name, "program_version": version, "files": {}}))
        text, _, asked = self.call("sweep", "status", sweep, "--json")
        if json.loads(text)["done"] != len(names) * 9 // 10:
            sys.exit("status does not count the finished tasks")
        shutil.rmtree(sweep)
        return {"tasks": len(names), "plan": planned, "status": asked}

    def overhead(self):
        """Returns the time of a task beside its work, milliseconds."""
        sweep, _ = self.plan("tiny", 'command = "generate"\n[fixed]\nduration = 0.2\nformat = "compact"\n[axes]\nobject = ["cube70"]\n'
                                     "seed = { from = 0, count = 40 }\n")
        text, said, _ = self.call("sweep", "run", sweep)
        shutil.rmtree(sweep)
        found = re.search(r"([0-9.]+) ms per task", text + said)
        if not found:
            sys.exit("sweep run does not say the time of a task beside its work")
        return float(found[1])

    def layouts(self, duration):
        """Returns size, CPU time of writing and frames per second of reading of both layouts, the median of some rounds in turns."""
        found = {layout: [] for layout in ("feelsight", "compact")}
        for _ in range(ROUNDS):
            for layout, rows in found.items():
                folder = self.folder("layout")
                written = self.call("generate", "--object", "large_dice", "--logs", 1, "--duration", duration, "--seed", SEED, "--cameras", CAMERA,
                                    "--format", layout, "--out", folder)[2]
                log = next(folder.glob("*/00"))
                files = [path for path in log.rglob("*") if path.is_file()]
                read = self.call("inspect", log)[2]
                rows.append({"mb": sum(path.stat().st_size for path in files) / 1e6, "files": len(files), "write_cpu_s": written["cpu_s"],
                             "read_per_s": duration * 30 / read["wall_s"], "read_per_cpu_s": duration * 30 / read["cpu_s"]})
                shutil.rmtree(folder)
        return {layout: {key: statistics.median(row[key] for row in rows) for key in rows[0]} for layout, rows in found.items()}

    def slam(self, name, seed, duration):
        """Returns the scores of SLAM on a log and on its compact copy."""
        kept = self.out / "pairs" / f"{name.replace(':', '-')}-{seed}.json"
        if not kept.exists():
            folder, scores = self.folder("pair"), {}
            self.call("generate", "--object", name, "--logs", 1, "--duration", duration, "--seed", seed, "--cameras", CAMERA, "--out", folder)
            log = next(folder.glob("*/00"))
            self.call("convert", log, "--format", "compact", "--out", folder / "compact")
            for layout, source in (("feelsight", log), ("compact", folder / "compact")):
                summary = json.loads(self.call("run", "--log", source, "--json", "--quiet", "--out", folder / "run", "--overwrite")[0])
                scores[layout] = {"f5": summary["f_score"]["5"], "add_s_mm": summary["add_s_mm"]["mean"]}
            shutil.rmtree(folder)
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(scores))
        scores = json.loads(kept.read_text())
        change = {key: scores["compact"][key] - scores["feelsight"][key] for key in ("f5", "add_s_mm")}
        return {"object": name, "seed": seed, **scores, "f5_change": change["f5"], "add_s_change_mm": change["add_s_mm"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--tasks", type=int, default=100_000)
    parser.add_argument("--duration", type=float, default=10)
    parser.add_argument("--logs", type=int, default=10)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    measurement = Measurement(arguments)
    many = measurement.many_tasks(arguments.tasks)
    print(many, flush=True)
    overhead_ms = measurement.overhead()
    print(f"{overhead_ms} ms per task beside its work", flush=True)
    layouts = measurement.layouts(30.0)
    print(layouts, flush=True)
    rows = []
    for k in range(arguments.logs):
        rows.append(measurement.slam(OBJECTS[k % len(OBJECTS)], SEED + k, arguments.duration))
        print(rows[-1], flush=True)
        (arguments.out / "slam.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    (arguments.out / "cluster.json").write_text(json.dumps({
        "many": many, "overhead_ms": overhead_ms, **layouts,
        "write_ratio": layouts["compact"]["write_cpu_s"] / layouts["feelsight"]["write_cpu_s"],
    }) + "\n")


if __name__ == "__main__":
    main()
