"""Measures the closed loop of a simulated robot and a run that drives it, two processes over the loopback, beside the same starts as `run` alone.

usage: loop.py --program PROGRAM [--starts 10] [--duration 30] [--speed 0.15] [--object cube70] [--kills 0] [--json FILE]

Prints what was kept and turned, and the F-score of each start; and how soon one notices that the other was killed. ROS_PYTHON names a Python with
rclpy, which then records the commands as a third process.
"""

import argparse
import csv
import json
import math
import os
import pathlib
import random
import signal
import statistics
import subprocess
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOPIC = "/allegro_hand_position_controller/commands"
# How long a start may take, seconds for each simulated one: a loaded machine.
PATIENCE_S = 60

parser = argparse.ArgumentParser()
parser.add_argument("--program", required=True)
parser.add_argument("--starts", type=int, default=10)
parser.add_argument("--first-seed", type=int, default=0)
parser.add_argument("--duration", type=float, default=30.0)
parser.add_argument("--speed", type=float, default=0.15)
parser.add_argument("--object", default="cube70")
parser.add_argument("--controller", default="auto")
parser.add_argument("--kills", type=int, default=0)
parser.add_argument("--domain", type=int, default=61)
parser.add_argument("--json", type=pathlib.Path, help="file for one JSON object with the figures")
arguments = parser.parse_args()
program = str(pathlib.Path(arguments.program).resolve())
folder = pathlib.Path(tempfile.mkdtemp(prefix="ros_loop."))
head = f"""[ros]
domain = {arguments.domain}
addresses = ["127.0.0.1"]
reliable = true
sim_time = true
truth = "/truth"
"""
text = (ROOT / "app/ros/rigs/allegro_v4.toml").read_text()
(folder / "rig.toml").write_text(text.replace("[ros]\n", head, 1))


class Program:
    """A process whose messages are kept with the time at which they came."""

    def __init__(self, line):
        self.process = subprocess.Popen(
            [program, *line.split()], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines = []
        self.printed = ""
        self.threads = [threading.Thread(target=self.read), threading.Thread(target=self.take)]
        for thread in self.threads:
            thread.start()

    def read(self):
        for line in self.process.stderr:
            self.lines.append((time.monotonic(), line.strip()))

    def take(self):
        self.printed = self.process.stdout.read()

    def said(self, words, since=0.0):
        return next((at for at, line in self.lines if words in line and at >= since), None)

    def wait_for(self, words, seconds, since=0.0):
        end = time.monotonic() + seconds
        while self.said(words, since) is None and time.monotonic() < end and self.process.poll() is None:
            time.sleep(0.01)
        time.sleep(0.05)
        return self.said(words, since)

    def end(self, number, seconds=PATIENCE_S):
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for thread in self.threads:
            thread.join()


def simulate(seed, duration):
    return Program(
        f"simulate --ros rig.toml --object {arguments.object} --controller {arguments.controller} --seed {seed}"
        f" --duration {duration} --speed {arguments.speed} --json"
    )


def drive():
    return Program(
        f"run --ros rig.toml --drive --object {arguments.object} --controller {arguments.controller} --out live --overwrite --quiet"
    )


def turned(out):
    """Returns the angle about the vertical from the true poses of a run, radians."""
    angle, last = 0.0, None
    with (folder / out / "trajectory.csv").open() as file:
        for row in csv.DictReader(file):
            if not row["true_qw"]:
                continue
            w, x, y, z = (float(row[f"true_q{axis}"]) for axis in "wxyz")
            now = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            if last is not None:
                angle += (now - last + math.pi) % (2 * math.pi) - math.pi
            last = now
    return angle


def f5(out):
    summary = json.loads((folder / out / "summary.json").read_text())
    return (summary.get("f_score") or {}).get("5", float("nan")), summary


def check_limits(commands):
    """Returns the greatest step; fails if a target leaves the widest range of an Allegro's joints."""
    steps = [abs(a - b) for before, after in zip(commands, commands[1:]) for a, b in zip(before, after)]
    assert all(-0.5 <= angle <= 1.8 and math.isfinite(angle) for command in commands for angle in command)
    return max(steps, default=0.0)


def start(seed):
    recorder = None
    if python := os.environ.get("ROS_PYTHON"):
        environment = dict(
            os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST"
        )
        recorder = subprocess.Popen(
            [python, str(ROOT / "tests/ros/hear_commands.py"), str(folder / "commands.json"), TOPIC], env=environment
        )
    robot, run = simulate(seed, arguments.duration), drive()
    try:
        robot.process.wait(PATIENCE_S * arguments.duration)
    finally:
        robot.end(signal.SIGINT)
        run.end(signal.SIGINT)
    outcome = json.loads(robot.printed)
    score, summary = f5("live")
    row = {
        "seed": seed,
        "kept": outcome["end"]["reason"] == "completed",
        "turned": turned("live"),
        "f5": score,
        "frames": summary["frames"],
        "late": summary["live"]["late"],
        "stops": len(summary["live"]["commands"]["stops"]),
        "ms": summary["live"]["latency_ms"]["median"],
    }
    if recorder:
        recorder.send_signal(signal.SIGINT)
        recorder.wait()
        row["step"] = check_limits(json.loads((folder / "commands.json").read_text()))
    alone = Program(
        f"run --object {arguments.object} --side right --controller {arguments.controller} --seed {seed}"
        f" --duration {arguments.duration} --out alone --overwrite --quiet"
    )
    alone.process.wait()
    alone.end(signal.SIGINT)
    score, summary = f5("alone")
    row |= {"alone_kept": summary["simulated_s"] >= arguments.duration - 0.1, "alone_turned": turned("alone"), "alone_f5": score}
    return row


def kill(number, choice):
    """Kills one of both after a random time; returns how long the other needed to say so, in seconds of its clock."""
    robot, run = simulate(number, 600.0), drive()
    try:
        assert robot.wait_for("the first command has come", PATIENCE_S) is not None, (robot.lines, run.lines)
        time.sleep(choice.uniform(0.0, 8.0))
        is_robot = choice.random() < 0.5
        killed, other = (robot, run) if is_robot else (run, robot)
        begun = time.monotonic()
        killed.process.kill()
        words = ("the hand holds",) if is_robot else ("no command for 0.5 s",)
        at = other.wait_for(words[0], PATIENCE_S, begun)
        assert at is not None, other.lines
        # The robot counts in its own clock, which is slower by the speed, and slower still while its writers wait for a dead reader: an upper
        # bound. The driver notices in real time that /clock stands.
        return is_robot, (at - begun) * (1.0 if is_robot else arguments.speed)
    finally:
        robot.end(signal.SIGKILL)
        run.end(signal.SIGKILL)


figures = {}
if arguments.starts:
    print("| seed | kept | turned, rad | F@5 | frames | late | stops | stamp to pose, ms | alone: kept | turned | F@5 |")
    print("|---|---|---|---|---|---|---|---|---|---|---|", flush=True)
    rows = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.starts):
        row = start(seed)
        rows.append(row)
        print(
            f"| {seed} | {row['kept']} | {row['turned']:.2f} | {row['f5']:.3f} | {row['frames']} | {row['late']} | {row['stops']} | "
            f"{row['ms']:.0f} | {row['alone_kept']} | {row['alone_turned']:.2f} | {row['alone_f5']:.3f} |",
            flush=True,
        )
    kept = sum(row["kept"] for row in rows)
    ratio = statistics.mean(row["turned"] for row in rows) / statistics.mean(row["alone_turned"] for row in rows)
    difference = statistics.mean(row["f5"] - row["alone_f5"] for row in rows)
    figures = {
        "kept": kept / len(rows),
        "turned": ratio,
        "f5": difference,
        "f5_error": statistics.stdev(row["f5"] - row["alone_f5"] for row in rows) / len(rows) ** 0.5 if len(rows) > 1 else None,
        "step": max((row.get("step", 0.0) for row in rows), default=None),
    }
    print(f"\nkept {kept} of {len(rows)}; turned {ratio:.2f} of `run` alone; F@5 differs by {difference:+.3f} on average")
    if "step" in rows[0]:
        print(f"greatest step of a target that a third process saw: {max(row['step'] for row in rows):.4f} rad")
if arguments.kills:
    choice = random.Random(1)
    times = [kill(number, choice) for number in range(arguments.kills)]
    for is_robot, key, name in [
        (True, "robot_killed", "robot killed, driver says so"),
        (False, "driver_killed", "driver killed, robot says so"),
    ]:
        of = [seconds for was_robot, seconds in times if was_robot == is_robot]
        if of:
            figures |= {key: len(of), f"{key}_median_s": statistics.median(of), f"{key}_longest_s": max(of)}
            print(f"{name}: {len(of)} times, median {statistics.median(of):.2f} s, longest {max(of):.2f} s")
if arguments.json:
    arguments.json.write_text(json.dumps(figures))
