"""Runs the program on an episode, and reads the recording that it leaves."""

import subprocess
import sys
import tempfile
from pathlib import Path

from mambavitact import Recording

with tempfile.TemporaryDirectory() as folder:
    out = Path(folder) / "out"
    program = [sys.executable, "-m", "mambavitact"]
    subprocess.run([*program, "run", "--object", "cube70", "--duration", "1", "--quiet", "--out", out], check=True)
    recording = Recording(out)
    print(f"{len(recording)} frames of {recording.object}: {recording.status}")
    print(f"symmetric ADD-S: {recording.add_s_mm.mean():.2f} mm on average")
    mesh = recording.mesh(len(recording) - 1)
    images = recording.images(len(recording) - 1)
    assert mesh is not None and images is not None
    print(f"last shape: {len(mesh[0])} vertices; last images: frame {images.frame}, {images.color[0].shape}")
