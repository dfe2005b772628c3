"""Shared by the tests: the program that Cargo built, and a short log."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

import mambavitact

ROOT = Path(__file__).resolve().parents[2]
OBJECT = "cube70"


def run(*arguments: str | Path) -> str:
    """Run the program that Cargo built, and return its output."""
    program = os.environ.get("MAMBAVITACT", str(ROOT / "target/debug/mambavitact"))
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_json(*arguments: str | Path) -> dict[str, Any]:
    """Run the program, and return the object that it prints."""
    result: dict[str, Any] = json.loads(run(*arguments, "--json"))
    return result


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> mambavitact.Log:
    """A log of one second, written from Python."""
    folder = tmp_path_factory.mktemp("log") / "00"
    return mambavitact.record_log(folder, OBJECT, seed=3, duration_s=1.0)
