"""Writes a log of an episode, and reads it back."""

import tempfile
from pathlib import Path

from mambavitact import Log, record_log

with tempfile.TemporaryDirectory() as folder:
    record_log(Path(folder) / "00", "random:3", seed=4, duration_s=1.0, cameras="front-left,top-down")
    log = Log(Path(folder) / "00")
    print(f"{len(log)} frames of {log.object} ({log.side} hand) from {[camera.name for camera in log.cameras]}")
    for number, frame in enumerate(log):
        if number % 10 == 0:
            assert frame.contact is not None and frame.object_pose is not None
            touching = frame.contact.any(axis=(1, 2))
            print(f"{frame.time_s:.2f} s: fingers that touch {touching}, object at {frame.object_pose[:3, 3].round(3)} m")
