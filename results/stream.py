#!/usr/bin/env python3
"""Measures how many frames/s `touch predict` reads from a video, beside the images/s of the network alone.

    results/stream.py OUT [--program FILE] [--frames N]

The video shows a real DIGIT as its camera delivers it: 320 x 240 pixels, lying, MJPEG. Both are measured three times in turns; the medians count.
Writes OUT/stream.json. Needs ffmpeg.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/mambavitact")
    parser.add_argument("--frames", type=int, default=1200)
    arguments = parser.parse_args()
    program, out = arguments.program.resolve(), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    images, video = ROOT.parent / "shared/real_digit/dd", out / "lying.avi"
    subprocess.run(
        ["ffmpeg", "-nostdin", "-y", "-loglevel", "error", "-stream_loop", "-1", "-framerate", "60", "-i", images / "%03d_img.png"]
        + ["-frames:v", str(arguments.frames), "-vf", "transpose=1", "-c:v", "mjpeg", "-q:v", "2", video],
        check=True,
    )
    subprocess.run(
        ["ffmpeg", "-nostdin", "-y", "-loglevel", "error", "-i", images / "untouched.png", "-vf", "transpose=1", out / "lying.png"], check=True
    )
    threads = os.cpu_count()
    predict = [program, "touch", "predict", "--video", video, "--untouched", out / "lying.png"]
    bench = [program, "bench", "networks", "--networks", "default", "--input", "240x320", "--batch", "16", "--threads", str(threads), "--json"]
    frames, engine = [], []
    for _ in range(3):
        said = subprocess.run(predict, check=True, capture_output=True, text=True).stdout
        frames.append(float(re.search(r"(\d+) frames/s", said).group(1)))
        rows = json.loads(subprocess.run(bench, check=True, capture_output=True, text=True).stdout)
        engine.append(max(row["images_per_second"] for row in rows))
    read, computed = statistics.median(frames), statistics.median(engine)
    result = {"frames_per_second": read, "engine_images_per_second": computed, "share": read / computed, "threads": threads}
    (out / "stream.json").write_text(json.dumps(result) + "\n")
    print(result)


if __name__ == "__main__":
    main()
