"""Compares an estimator of your own with ours on two short logs."""

import tempfile

import numpy as np
from numpy.typing import NDArray

from mambavitact import Frame, benchmark


class Resting:
    """Says that the object rests where it was, and knows no shape."""

    def __init__(self, setup: benchmark.Setup) -> None:
        print(f"{len(setup.cameras)} cameras, {setup.side} hand, touch: {setup.touch}")

    def estimate(self, frame: Frame) -> NDArray[np.float64]:
        # Any pose will do: the first one ties your coordinates to the true object.
        return np.eye(4)

    def mesh(self) -> None:
        return None


logs = (benchmark.SuiteLog("cube70", seed=3), benchmark.SuiteLog("random:3", seed=4, cameras="side"))
suite = benchmark.Suite(logs, duration_s=1.0, touch="depth")
# A suite of the package is benchmark.suites()["procedural"]. Keep its logs in a folder of your own.
with tempfile.TemporaryDirectory() as folder:
    results = benchmark.run("resting", Resting, suite, folder)
    results += benchmark.run("ours", benchmark.OurSlam, suite, folder)
print(benchmark.table(results))
