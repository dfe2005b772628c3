#!/usr/bin/env python3
"""Measures how far the scores of a run move when its log goes through an export and an import.

    results/roundtrip.py OUT [--program FILE] [--duration S]

Three logs are exported as MCAP and as data set of LeRobot and imported again. Writes OUT/roundtrip.json: the scores of the runs on each log, and
the greatest differences of F-score at 5 mm and of ADD-S to those on the original logs.
"""

import argparse
import json
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ("cube70", "pear", "random:1002")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--duration", type=float, default=10.0)
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)

    def run(*words):
        return subprocess.run([str(arguments.program.resolve()), *map(str, words)], check=True, capture_output=True, text=True).stdout

    rows = []
    for number, name in enumerate(OBJECTS):
        place = out / str(number)
        run("generate", "--object", name, "--logs", 1, "--noise", "full", "--duration", arguments.duration, "--out", place / "set")
        log = next((place / "set").glob("*/00"))
        run("export", "mcap", log, "--out", place / "log.mcap")
        run("import", place / "log.mcap", "--out", place / "mcap")
        run("export", "lerobot", log, "--exact-depth", "--out", place / "lerobot-set")
        run("import", place / "lerobot-set", "--out", place / "lerobot")
        row = {"object": name}
        for kind, folder in (("original", log), ("mcap", place / "mcap"), ("lerobot", place / "lerobot")):
            summary = json.loads(run("run", "--log", folder, "--out", place / f"run-{kind}", "--quiet", "--json"))
            row[kind] = {"f5": summary["f_score"]["5"], "add_s_mm": summary["add_s_mm"]["mean"]}
        print(json.dumps(row), flush=True)
        rows.append(row)
    farthest = {
        kind: {score: max(abs(row[kind][score] - row["original"][score]) for row in rows) for score in ("f5", "add_s_mm")}
        for kind in ("mcap", "lerobot")
    }
    (out / "roundtrip.json").write_text(json.dumps({"logs": rows, "farthest": farthest}, indent=1) + "\n")
    print(json.dumps(farthest))


if __name__ == "__main__":
    main()
