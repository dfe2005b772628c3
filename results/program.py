"""Runs commands of the program that the scripts of this folder measure."""

import functools
import subprocess
import sys


def caller(program):
    """Returns a function that runs a command, returns its output, and ends the script with the command's words if it fails."""
    return functools.partial(call, program.resolve())


def call(program, *words):
    result = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}: {result.stderr.strip()}")
    return result.stdout
