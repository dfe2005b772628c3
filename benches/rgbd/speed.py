#!/usr/bin/env python3
"""Measures speed and memory of `mambavitact run` on long sequences.

    speed.py DATA OUT [--program FILE]      DATA holds the sequences of render.py; writes OUT/speed.json

Takes the 60 frames in a row of DATA/SEQUENCE whose masks are largest, and shows them forwards and backwards until there are 1,000, 5,000 and
10,000 frames, which are linked, not copied.

  pixels               pixels of the object, mean
  frames_per_second    of 1,000 frames, with all masks, from the summary of the run
  memory_mb            most memory of the run of 5,000 frames and of 10,000; growth_mb is the difference
"""

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image
from real import link, run

SEQUENCE = "picked_cracker"
STRETCH = 60
COUNTS = {"short": 1000, "half": 5000, "long": 10_000}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the sequences")
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--program", default="target/release/mambavitact", help="program to measure (default target/release/mambavitact)")
    arguments = parser.parse_args()
    source = arguments.data / SEQUENCE
    masks = sorted((source / "masks").iterdir())
    pixels = np.array([np.count_nonzero(Image.open(mask)) for mask in masks])
    means = np.convolve(pixels, np.ones(STRETCH) / STRETCH, "valid")
    first = int(means.argmax())
    # Forwards, and backwards without both ends.
    period = [*range(first, first + STRETCH), *range(first + STRETCH - 2, first, -1)]
    summaries = {}
    for length, count in COUNTS.items():
        folder = arguments.out / f"speed_{length}"
        link(source / "cam_K.txt", folder / "cam_K.txt")
        for k in range(count):
            for part in ("rgb", "depth", "masks"):
                name = masks[period[k % len(period)]].name
                link(source / part / name, folder / part / f"{k:06d}.png")
        summaries[length] = json.loads((run(arguments.program, folder) / "summary.json").read_text())
    memory_mb = {length: summary["peak_memory_mb"] for length, summary in summaries.items()}
    result = {
        "pixels": float(means.max()),
        "frames_per_second": summaries["short"]["frames_per_second"],
        "memory_mb": memory_mb,
        "growth_mb": memory_mb["long"] - memory_mb["half"],
    }
    (arguments.out / "speed.json").write_text(json.dumps(result, indent=1))
    print(result)


if __name__ == "__main__":
    main()
