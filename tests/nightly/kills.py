#!/usr/bin/env python3
"""Kills commands at random moments, and starts two of them on one target; then looks for lost and corrupt files.

    tests/nightly/kills.py [--program FILE] [--kills N] [--pairs N] [--seed N] [--only COMMAND] [--out FILE]

The commands take turns. Before each, a file of the user lies beside the target, and often an earlier result with another file of the user in it.
Afterwards,
- every byte that was there is still there (lost);
- every file with a final name is whole: the program reads it, or its format and checksum are right (corrupt);
- the same command works or is refused in one line of words; of two commands one works (unclear).

Prints a JSON object per command to standard output, or to --out; ends with 1 if anything is wrong.
"""

import argparse
import csv
import json
import math
import os
import random
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import tomllib
import zlib
from pathlib import Path

OBJECT = "rubiks_cube_small"
LIMIT_S = 120
"""A command that takes longer hangs."""
TRAINING = """
[network]
name = "default"
widths = [8, 8, 12, 16]
depth = 2
state = 4
[data]
sensors = 4
objects = { train = ["mug", "large_dice", "ball"], validate = ["pear"] }
[training]
seed = 3
validate_every = 2
validation_images = 2
stages = [{ size = [80, 64], batch = 2, steps = 8 }]
[training.optimiser]
learning_rate = 1e-2
warm_up = 2
average = 0.9
"""
# {run} is the folder of a finished run, {log} a log, {mcap} its export, {config} the file with the training above.
COMMANDS = {
    "generate": f"generate --object {OBJECT} --logs 2 --duration 0.3 --cameras side --jobs 1 --out target",
    "run": f"run --object {OBJECT} --touch-depth truth --duration 0.3 --cameras side --quiet --out target",
    "evaluate": f"evaluate --objects {OBJECT} --seeds 2 --duration 0.3 --modes pose --out target",
    "touch data": "touch data --objects mug --images 12 --out target",
    "touch train": "touch train --network default --config {config} --out target",
    "hand tune": f"hand tune --object {OBJECT} --axis -y --generations 3 --starts 1 --duration 0.5 --scored-starts 1 --out target.toml",
    "hand grasps": "hand grasps --object ball --tries 60 --out target.toml",
    "mesh": "mesh --run {run} --out target.ply",
    "export": "export mcap {log} --out target.mcap",
    "import": "import {mcap} --out target",
    "report": "report {run} --films 1 --out target.html",
    "view": "view --run {run} --record target.gif --every 1 --size 320x240",
}


def words_of(command, shared):
    """Returns the arguments of a command, with the inputs that `prepare` made."""
    log = shared / "logs" / OBJECT / "00"
    return COMMANDS[command].format(run=shared / "run", log=log, config=shared / "training.toml", mcap=shared / "log.mcap").split()


class Trial:
    """A folder in which a command is disturbed."""

    def __init__(self, program, shared, command, earlier):
        self.program, self.command = program, command
        self.folder = Path(tempfile.mkdtemp(prefix="kills-"))
        self.words = words_of(command, shared)
        self.target = self.folder / next(word for word in self.words if word.startswith("target"))
        if earlier:
            shutil.copytree(shared / "earlier" / command, self.folder, dirs_exist_ok=True)
            if self.target.is_dir():
                (self.target / "my notes.txt").write_text("mine, in the folder\n")
        (self.folder / "notes.txt").write_text("mine\n")
        self.before = contents(self.folder)
        if self.target.is_file():
            # Without it the command would end at once. The file must stay whole until there is another.
            self.words.append("--overwrite")
            del self.before[self.target.name]
        self.faults, self.said = [], ""

    def start(self):
        pipe = subprocess.PIPE
        return subprocess.Popen([self.program, *self.words], cwd=self.folder, stdout=pipe, stderr=pipe, text=True)

    def end(self, process):
        """Returns whether a command worked; notes an end without words."""
        try:
            _, said = process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            self.faults.append(("unclear", "hangs"))
            return False
        lines = [line for line in said.splitlines() if not line.lstrip().startswith("WARN")]
        in_words = process.returncode == 1 and len(lines) == 1 and lines[0].startswith("ERROR ")
        if process.returncode != 0 and not in_words:
            self.faults.append(("unclear", f"ended with {process.returncode}: {said[:300]}"))
        self.said = said.strip()
        return process.returncode == 0

    def inspect(self):
        """Looks for files that were lost, and reads those with a final name."""
        after = contents(self.folder)
        for path, data in self.before.items():
            # Its folder may have been moved, and tables grow.
            if not after.get(path, b"").startswith(data) and data not in after.values():
                self.faults.append(("lost", path))
        for path, data in after.items():
            problem = self.problem(self.folder / path, data)
            if problem:
                self.faults.append(("corrupt", f"{path}: {problem}"))

    def reads(self, *words):
        result = subprocess.run([self.program, *map(str, words)], cwd=self.folder, capture_output=True, text=True, timeout=LIMIT_S)
        return None if result.returncode == 0 else result.stderr.strip()[:300]

    def problem(self, path, data):
        """Returns what is wrong with a file, or None. The program reads what it has a reader for."""
        match path.suffix:
            case ".safetensors":
                return seal_problem(data)
            case ".png":
                return png_problem(data)
            case ".gif":
                return None if data[:4] == b"GIF8" and data[-1:] == b"\x3b" else "the film has no end"
            case ".mcap":
                return None if data.endswith(b"\x89MCAP0\r\n") else "it has no end"
            case ".npy":
                return npy_problem(data)
            case ".ply" | ".obj":
                return self.reads("score", "--mesh", path, "--truth", OBJECT, "--frame", "object")
            case ".svg":
                return None if data.rstrip().endswith(b"</svg>") else "it has no end"
            case ".pkl":
                return self.reads("inspect", path.parent)
        try:
            match path.name:
                case "summary.json":
                    return self.reads("score", "--run", path.parent)
                case "about.json":
                    picture = self.folder / ".picture.png"
                    problem = self.reads("view", "--run", path.parent.parent, "--record", picture, "--size", "200x200")
                    picture.unlink(missing_ok=True)
                    # A run that was killed before its first frame has no picture.
                    return None if problem and "contain a frame yet" in problem else problem
            match path.suffix:
                case ".json":
                    json.loads(data)
                case ".jsonl":
                    # The last line may have been cut off, which readers know.
                    for line in data.decode().splitlines()[:-1]:
                        json.loads(line)
                case ".toml":
                    tomllib.loads(data.decode())
                case ".csv":
                    rows = list(csv.reader(data.decode().splitlines()))
                    # As above.
                    if len({len(row) for row in rows[:-1]}) > 1:
                        return "its rows differ in length"
        except ValueError as error:
            return str(error)
        return None


def contents(folder):
    """Returns the bytes of the files below a folder; hidden ones are locks and partial files."""
    found = {}
    for path in folder.rglob("*"):
        parts = path.relative_to(folder).parts
        if path.is_file() and not any(part.startswith(".") for part in parts) and "running" not in parts:
            found["/".join(parts)] = path.read_bytes()
    return found


def seal_problem(data):
    """Returns what is wrong with a safetensors file with a checksum."""
    beginning = b'{"__metadata__":{"checksum":"'
    (length,) = struct.unpack("<Q", data[:8]) if len(data) > 8 else (0,)
    digits = slice(8 + len(beginning), 8 + len(beginning) + 8)
    if not data[8:].startswith(beginning):
        return "it has no checksum"
    checksum = zlib.crc32(data[: digits.start] + b"0" * 8 + data[digits.stop :])
    json.loads(data[8 : 8 + length])
    return None if data[digits] == f"{checksum:08x}".encode() else "its checksum is wrong"


def png_problem(data):
    """Returns what is wrong with the chunks of a PNG file."""
    at, pixels = 8, b""
    while data[at + 4 : at + 8] != b"IEND":
        (length,) = struct.unpack(">I", data[at : at + 4].ljust(4, b"\0"))
        chunk = data[at + 4 : at + 8 + length]
        if len(chunk) < 4 + length or zlib.crc32(chunk).to_bytes(4, "big") != data[at + 8 + length : at + 12 + length]:
            return "a chunk is damaged"
        pixels += chunk[4:] if chunk[:4] == b"IDAT" else b""
        at += 12 + length
    try:
        zlib.decompress(pixels)
    except zlib.error as error:
        return str(error)
    return None


def npy_problem(data):
    """Returns what is wrong with an array of f4 in NumPy's format."""
    (length,) = struct.unpack("<H", data[8:10].ljust(2, b"\0"))
    shape = re.search(rb"'shape': \(([0-9, ]*)\)", data[10 : 10 + length])
    if not shape:
        return "it has no header"
    count = math.prod(int(side) for side in re.findall(rb"[0-9]+", shape[1]))
    return None if len(data) == 10 + length + 4 * count else "it has another length than its header says"


def kill(trial, chance, duration_s):
    """Kills a command at a random moment, and starts it again. Returns whether it was still running; else the moment is drawn again."""
    process = trial.start()
    time.sleep(chance.uniform(0, duration_s))
    process.kill()
    process.communicate()
    was_running = process.returncode == -9
    trial.inspect()
    # A film or mesh that was finished is not replaced, which the command says.
    if not trial.end(trial.start()) and not trial.target.exists():
        trial.faults.append(("unclear", f"neither a result nor a way out: {trial.said}"))
    trial.inspect()
    return was_running


def pair(trial, chance, _):
    """Starts a command twice."""
    first = trial.start()
    time.sleep(chance.uniform(0, 0.3))
    second = trial.start()
    worked = [trial.end(first), trial.end(second)]
    existed = trial.target.name in {path.split("/")[0] for path in trial.before}
    if not any(worked) and not existed:
        trial.faults.append(("unclear", f"neither of two works: {trial.said}"))
    trial.inspect()
    return True


def prepare(program, folder, commands):
    """Makes a finished run, and an earlier result of each command. Returns the duration of each command, seconds."""
    (folder / "training.toml").write_text(TRAINING)
    words = COMMANDS["run"].replace("--out target", "--out").split()
    subprocess.run([program, *words, folder / "run"], check=True, capture_output=True)
    words = COMMANDS["generate"].replace("--logs 2", "--logs 1").replace("--out target", "--out").split()
    subprocess.run([program, *words, folder / "logs"], check=True, capture_output=True)
    subprocess.run([program, *words_of("export", folder)[:-1], folder / "log.mcap"], check=True, capture_output=True)
    durations = {}
    has_training = "needs a program built" not in subprocess.run(
        [program, "touch", "train", "--help"], check=True, capture_output=True, text=True
    ).stdout
    for command in commands:
        if command == "touch train" and not has_training:
            continue
        place = folder / "earlier" / command
        place.mkdir(parents=True)
        words = words_of(command, folder)
        begun = time.monotonic()
        subprocess.run([program, *words], cwd=place, check=True, capture_output=True)
        durations[command] = time.monotonic() - begun
    return durations


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parents[2]
    parser.add_argument("--program", type=Path, default=root / "target/debug/mambavitact")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=COMMANDS)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    program = arguments.program.resolve()
    for name in ("MAMBAVITACT_LOG", "YCB_DIR", "YCB_ARCHIVE"):
        os.environ.pop(name, None)
    shared = Path(tempfile.mkdtemp(prefix="kills-shared-"))
    results, is_wrong = {}, False
    try:
        # Those whose turn it will be.
        turns = list(COMMANDS)[: max(arguments.kills, arguments.pairs)]
        durations = prepare(program, shared, [arguments.only] if arguments.only else turns)
        commands = list(durations)
        for kind, disturb, count in (("kill", kill, arguments.kills), ("pair", pair, arguments.pairs)):
            done = 0
            for number in range(10 * count):
                if done == count:
                    break
                command = commands[done % len(commands)]
                chance = random.Random(f"{arguments.seed} {kind} {number}")
                trial = Trial(program, shared, command, earlier=chance.random() < 0.5)
                row = results.setdefault((command, kind), {
                    "command": command, "kind": kind, "trials": 0, "lost": 0, "corrupt": 0, "unclear": 0, "faults": 0,
                })
                was_disturbed = disturb(trial, chance, durations[command])
                done += was_disturbed
                row["trials"] += was_disturbed
                for fault, words in trial.faults:
                    row[fault] += 1
                    row["faults"] += 1
                    is_wrong = True
                    print(f"{command}, {kind} {number}: {fault}: {words} ({trial.folder})", file=sys.stderr)
                if not trial.faults:
                    shutil.rmtree(trial.folder)
    finally:
        shutil.rmtree(shared)
    text = "".join(json.dumps(row) + "\n" for row in results.values())
    arguments.out.write_text(text) if arguments.out else print(text, end="")
    return int(is_wrong)


if __name__ == "__main__":
    sys.exit(main())
