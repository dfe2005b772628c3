#!/usr/bin/env python3
"""Measures each network at the paper's size: memory of a training, and frames/s of the whole pipeline.

    results/paper_networks.py OUT [--program FILE] [--seconds S] [--networks NAME,...]

Each network is trained for two steps of 8 images of 240 x 320, and then drives a simulated run of S seconds (default: 4; 0: no run). Two steps
teach nothing: the runs show the time that the network costs, not its accuracy (see paper_trainings.py). Writes OUT/paper_networks.jsonl, a
line per network. The program needs the feature `train`.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NETWORKS = ("vit", "mamba", "robust_mamba", "swin", "convnext", "default")
TRAINING = """[training]
seed = 1
validate_every = 2
validation_images = 2
stages = [{ size = [320, 240], batch = 8, steps = 2 }]

[training.optimiser]
learning_rate = 1e-4
warm_up = 1
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--networks", type=lambda names: names.split(","), default=NETWORKS)
    arguments = parser.parse_args()
    program, out = arguments.program.resolve(), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "short.toml").write_text(TRAINING)

    def peak_mb(*words):
        """Runs a command, and returns the most memory that it used, megabytes."""
        process = subprocess.Popen([program, *map(str, words)], stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        if status != 0:
            sys.exit(f"{' '.join(map(str, words))}: exit status {status}")
        return usage.ru_maxrss / 1024

    lines = []
    for network in arguments.networks:
        trained, run = out / network, out / f"run-{network}"
        for folder in (trained, run):
            shutil.rmtree(folder, ignore_errors=True)
        memory_mb = peak_mb("touch", "train", "--network", network, "--config", out / "short.toml", "--out", trained)
        weights = trained / "last.safetensors"
        line = {"network": network, "memory_mb": memory_mb}
        if arguments.seconds > 0:
            peak_mb("run", "--quiet", "--duration", arguments.seconds, "--weights", weights, "--out", run)
            line["frames_per_second"] = json.loads((run / "summary.json").read_text())["frames_per_second"]
        lines.append(line)
        print(line, flush=True)
    (out / "paper_networks.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


if __name__ == "__main__":
    main()
