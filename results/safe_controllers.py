#!/usr/bin/env python3
"""Finds for each object the controllers between which the hand can change without a drop, by physics alone.

    results/safe_controllers.py OUT [--program FILE] [--objects NAME,...] [--first NAME] [--starts N]

First pairs: the controller that `auto` chooses, or --first, and each tumble or roll, in turns of 5 s, 30 s long, five starts. Those that drop the object more than
once are left out. Then a single change after 4 s, 30 s long, 30 starts, because an explorer may stay with a controller; at most one in twenty may end with a drop.
Then sequences of each pair: 30 s of changes every 4 to 6 s, N starts (default: 20), of which at most one in twenty may end with a drop; of each axis the fastest
such controller stays. Last, random sequences of all that stay: while more than one in twenty starts ends with a drop,
the controller that most often dropped the object is left out. All starts are starts of the search. Writes OUT/pairs.jsonl and OUT/sets.jsonl, and OUT/safe_controllers.toml, which belongs in sim/gaits/assets. The same command continues after
an interruption.
"""

import argparse
import collections
import json
import random
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OTHERS = "tumble_back tumble_ball tumble_ball_forth tumble_brick tumble_can roll_ball roll_ball_back roll_cube".split()
# The first seed of the search.
SEED = 20000
SECONDS = 30.0
PAIR_STARTS = 5
STAY_STARTS = 30
LEAST_KEPT = 0.95
# A slower controller shows little, rad/s.
SLOWEST_RAD_S = 0.25
SIDES = {"+x": (0, -1), "-x": (0, 1), "+y": (1, 1), "-y": (1, -1), "+z": (2, -1), "-z": (2, 1)}


class Program:
    def __init__(self, path):
        self.path = path

    def __call__(self, *words):
        result = subprocess.run([self.path, *map(str, words)], capture_output=True, text=True)
        return result.stdout if result.returncode == 0 else None

    def simulate(self, name, controller, seed, seconds=SECONDS):
        text = self("simulate", "--object", name, "--controller", controller, "--duration", seconds, "--seed", seed, "--json")
        return text and json.loads(text)


def read(path):
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def kept(seconds):
    return sum(s >= SECONDS - 0.1 for s in seconds) / len(seconds)


def play_pairs(program, name, begins_with, path):
    """Returns the pairs of an object; none if it is refused."""
    first = program.simulate(name, begins_with, SEED, 0.1)
    if first is None:
        return []
    auto, pairs = first["gait"], [row for row in read(path) if row["object"] == name]
    for other in OTHERS:
        if any(row["second"] == other for row in pairs):
            continue
        row = {"object": name, "first": auto, "second": other, "survived_s": []}
        # Two drops are enough to know.
        while len(row["survived_s"]) < PAIR_STARTS and sum(s < SECONDS - 0.1 for s in row["survived_s"]) < 2:
            played = program.simulate(name, f"{auto}:5,{other}:5", SEED + len(row["survived_s"]))
            row["survived_s"].append(played["survived_s"])
        pairs.append(row)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
    return pairs


def rates(program, name, controllers, axes, out):
    """Returns the shape of an object, and the net rate of each controller about its axis."""
    survey = out / "survey.jsonl"
    survey.unlink(missing_ok=True)
    program("hand", "survey", "--object", name, "--controller", ",".join(controllers), "--starts", 3, "--seed", SEED, "--out", survey)
    rates = {}
    for row in read(survey):
        index, sign = SIDES[axes[row["controller"]]]
        turned = sum(sign * net[index] for net in row["net_rad"])
        rates[row["controller"]] = round(max(turned / sum(row["survived_s"]), 0.0), 2)
        shape = row["shape"]
    return shape, rates


def play_stays(program, name, first, second):
    """Returns the seconds of starts that change once and stay with the second controller."""
    words = f"{first}:4,{second}:{SECONDS - 4}"
    return [program.simulate(name, words, SEED + 2100 + k)["survived_s"] for k in range(STAY_STARTS)]


def play_sequences(program, name, controllers, starts):
    """Returns the seconds of each start, up to one drop too many, and how often each controller dropped the object."""
    survived, blamed = [], collections.Counter()
    for k in range(starts):
        if blamed.total() > (1 - LEAST_KEPT) * starts + 0.01:
            break
        chances, current, parts, ends_s = random.Random(SEED + 100 + k), controllers[0], [], 0.0
        while ends_s < SECONDS:
            seconds = round(chances.uniform(4, 6), 2)
            parts.append((current, seconds))
            ends_s += seconds
            current = chances.choice([c for c in controllers if c != current])
        played = program.simulate(name, ",".join(f"{c}:{s}" for c, s in parts), SEED + 100 + k)
        survived.append(played["survived_s"])
        if survived[-1] < SECONDS - 0.1:
            time_s = 0.0
            for controller, seconds in parts:
                time_s += seconds
                if survived[-1] < time_s:
                    blamed[controller] += 1
                    break
    return survived, blamed


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--objects", help="default: the whole catalogue")
    parser.add_argument("--first", default="auto", help="controller with which episodes begin")
    parser.add_argument("--starts", type=int, default=20)
    arguments = parser.parse_args()
    program, out = Program(arguments.program.resolve()), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    axes = {line.split()[0]: line.split()[1] for line in program("controllers").splitlines() if not line.startswith("FILE")}
    listed = [line.split()[0] for line in program("assets", "list").splitlines() if "downloaded" in line or "procedural" in line]
    done = {row["object"]: row for row in read(out / "sets.jsonl")}
    for name in arguments.objects.split(",") if arguments.objects else listed:
        if name in done:
            continue
        pairs = [row for row in play_pairs(program, name, arguments.first, out / "pairs.jsonl") if kept(row["survived_s"]) >= 1 - 1 / PAIR_STARTS]
        if not pairs:
            continue
        auto = pairs[0]["first"]
        shape, rate = rates(program, name, [auto] + [row["second"] for row in pairs], axes, out)
        # The fastest of each axis with which the pair survives.
        controllers, survived = [auto], []
        for row in sorted(pairs, key=lambda row: -rate[row["second"]]):
            second = row["second"]
            if rate[second] < SLOWEST_RAD_S or axes[second] in [axes[c] for c in controllers]:
                continue
            if kept(play_stays(program, name, auto, second)) < LEAST_KEPT:
                continue
            seconds, _ = play_sequences(program, name, [auto, second], arguments.starts)
            if kept(seconds) >= LEAST_KEPT:
                controllers.append(second)
                survived = seconds
        while len(controllers) > 2:
            survived, blamed = play_sequences(program, name, controllers, arguments.starts)
            if kept(survived) >= LEAST_KEPT:
                break
            # The first controller stays, because episodes begin with it.
            controllers.remove(max(controllers[1:], key=lambda controller: blamed[controller]))
        if len(controllers) == 2:
            survived, _ = play_sequences(program, name, controllers, arguments.starts)
        if rate[auto] < SLOWEST_RAD_S:
            controllers = [auto]
        size = [round(shape[key], 1) for key in ("length_mm", "width_mm", "height_mm")]
        row = {"object": name, "size_mm": size, "fill": round(shape["fill"], 3), "kept": kept(survived) if len(controllers) > 1 else None,
               "controllers": {controller: rate[controller] for controller in controllers}}
        done[name] = row
        with (out / "sets.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(row, flush=True)
    text = "# Controllers between which changes keep the object. Made by results/safe_controllers.py on starts of the search.\n"
    for name, row in sorted(done.items()):
        if len(row["controllers"]) < 2:
            continue
        text += f'\n[[object]]\nname = "{name}"\nsize_mm = {row["size_mm"]}\nfill = {row["fill"]}\ncontrollers = [\n'
        text += "".join(f'    {{ name = "{c}", rate_rad_s = {r:.2f} }},\n' for c, r in row["controllers"].items()) + "]\n"
    (out / "safe_controllers.toml").write_text(text)


if __name__ == "__main__":
    sys.exit(main())
