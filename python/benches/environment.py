"""Measures what Python costs: size of the wheel, time of the import, steps of the vector environment against Rust's own loop.

Both loops run in turns in this process, with the same actions, so that other load on the machine meets both. Prints one
JSON object. Install the package first, built for release: pip install ./python
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from mambavitact.gym import TurnInHandVectorEnv

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--wheel", type=Path, help="the wheel, whose size is printed (made by: pip wheel --no-deps ./python)")
parser.add_argument("--environments", type=int, default=64, help="number of environments")
parser.add_argument("--steps", type=int, default=200, help="steps of each of them per turn")
parser.add_argument("--turns", type=int, default=5, help="turns; the best of each loop counts")
arguments = parser.parse_args()


def import_s() -> float:
    """Return the best of five times to import the package, without that of the interpreter's own start."""

    def start(text: str) -> float:
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", text], check=True)
        return time.perf_counter() - begun

    return min(start("import mambavitact") - start("pass") for _ in range(5))


def rates(observation: str, count: int, steps: int, physics_hz: int = 300) -> dict[str, float]:
    """Return environment steps per second of both loops, the best of all turns."""
    envs = TurnInHandVectorEnv(count, observation=observation, physics_hz=physics_hz)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, count, 16)).astype(np.float32)
    rust, python = [], []
    for _ in range(arguments.turns):
        # The same episodes for both.
        envs.reset(seed=0)
        rust.append(envs._environments.time_steps(actions))
        envs.reset(seed=0)
        begun = time.perf_counter()
        for row in actions:
            envs.step(row)
        python.append(time.perf_counter() - begun)
    each = {"python": steps * count / min(python), "rust": steps * count / min(rust)}
    return {**each, "share": each["python"] / each["rust"]}


result: dict[str, Any] = {"cores": os.cpu_count(), "import_s": round(import_s(), 3)}
if arguments.wheel:
    result["wheel_mb"] = round(arguments.wheel.stat().st_size / 1e6, 1)
result["proprioception_steps_per_s"] = rates("proprioception", arguments.environments, arguments.steps)
# Half as many integration steps, with which policies are trained.
result["training_steps_per_s"] = rates("proprioception", arguments.environments, arguments.steps, physics_hz=150)
depth = rates("touch_depth", min(arguments.environments, 16), max(arguments.steps // 10, 1))
result["touch_depth_images_per_s"] = {"python": 4 * depth["python"], "rust": 4 * depth["rust"], "share": depth["share"]}
print(json.dumps(result, indent=1))
