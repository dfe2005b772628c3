#!/usr/bin/env python3
"""Measures the report of many runs: benches/report/measure.py PROGRAM [RUNS]

Makes folders of RUNS runs (1,000) of one real run, whose figures are varied, and the report of them. Prints a line of JSON: the seconds to
make it, its size in MB, the seconds until Chromium shows it, and how often per second the shapes turn, with WebGL on the CPU and without
WebGL.
"""

import json
import os
import random
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from browser import Browser

OBJECTS = ["cube70", "ball70", "can66", "mug", "box", "prism", "cone", "ring", "egg", "bottle"]


def vary(home, run, count):
    """Makes folders of runs with other objects, seeds and errors; large files are linked."""
    summary = json.load(open(f"{run}/summary.json"))
    lines = open(f"{run}/trajectory.csv").read().splitlines()
    at = lines[0].split(",").index("add_s_mm")
    rows = [line.split(",") for line in lines[1:]]
    draw = random.Random(0)
    for k in range(count):
        folder = f"{home}/runs/{k:05}"
        os.makedirs(f"{folder}/recording")
        factor = draw.lognormvariate(0, 0.5)
        for name in os.listdir(f"{run}/recording"):
            os.link(f"{run}/recording/{name}", f"{folder}/recording/{name}")
        for name in ["mesh.ply", "config.toml"]:
            os.link(f"{run}/{name}", f"{folder}/{name}")
        varied = dict(summary, object=OBJECTS[k % len(OBJECTS)], seed=k // len(OBJECTS))
        varied["add_s_mm"] = {key: value and value * factor for key, value in summary["add_s_mm"].items()}
        varied["f_score"] = {key: value ** factor for key, value in summary["f_score"].items()}
        json.dump(varied, open(f"{folder}/summary.json", "w"))
        with open(f"{folder}/trajectory.csv", "w") as file:
            print(lines[0], file=file)
            for row in rows:
                print(",".join([*row[:at], str(float(row[at]) * factor), *row[at + 1 :]]), file=file)


def turning(path, part):
    """Opens the page, turns the shapes for three seconds, and returns the seconds to open and the pictures per second."""
    browser = Browser(size=(1280, 900))
    try:
        opened = browser.open(path, part)
        browser.run("document.querySelector('#shapes').scrollIntoView(); document.querySelector('#turn').click()")
        browser.frames(10)
        before, begun = browser.run("view.painted"), time.monotonic()
        time.sleep(3)
        rate = (browser.run("view.painted") - before) / (time.monotonic() - begun)
        painter = browser.run("view.painter.constructor.name")
        assert not browser.errors, browser.errors
        return opened, rate, painter
    finally:
        browser.close()


def main():
    program, count = os.path.abspath(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    with tempfile.TemporaryDirectory(prefix="report-") as home:
        run = [program, "run", "--object", "cube70", "--duration", "10", "--quiet", "--out", f"{home}/run"]
        subprocess.run(run, check=True, stderr=subprocess.DEVNULL)
        vary(home, f"{home}/run", count)
        page = f"{home}/report.html"
        begun = time.monotonic()
        subprocess.run([program, "report", f"{home}/runs", "--out", page], check=True, stdout=sys.stderr)
        figures = {"runs": count, "made_s": round(time.monotonic() - begun, 2), "mb": round(os.path.getsize(page) / 1e6, 2)}
        for part in ["", "#plain"]:
            opened_s, rate, painter = turning(page, part)
            figures[painter] = {"opened_s": round(opened_s, 2), "pictures_per_s": round(rate, 1)}
        print(json.dumps(figures))


main()
