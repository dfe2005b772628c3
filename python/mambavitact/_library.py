"""Loads libmujoco of the package `mujoco`, before the native module asks for it."""

import ctypes
import importlib.util
from pathlib import Path

_LIBRARY = "libmujoco.so.3.17.0"


def load() -> None:
    """Load the library. The package `mujoco` itself is not imported."""
    spec = importlib.util.find_spec("mujoco")
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    for folder in folders:
        path = Path(folder) / _LIBRARY
        if path.is_file():
            ctypes.CDLL(str(path))
            return
    raise ImportError(f"{_LIBRARY} is missing: install it with `pip install mujoco==3.17.0`")
