"""Compares an export of three logs, as LeRobot loads it, with the logs. Prints one JSON line, and fails if a part differs.

    lerobot.py DIR
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.compute_stats import compute_episode_stats, aggregate_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from PIL import Image

from mambavitact import Log, record_log

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("out", type=Path)
out = parser.parse_args().out
folder = out / "set"
logs = []
for k, name in enumerate(["cube70", "mug", "pear"]):
    place = out / f"log-{k}"
    logs.append(Log(place) if place.exists() else record_log(place, name, seed=k, duration_s=2.0))
if not folder.exists():
    command = [sys.executable, "-m", "mambavitact", "export", "lerobot", *[log.folder for log in logs], "--out", folder]
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)

data = LeRobotDataset("local/mambavitact", root=folder)
# As stored: the data set's own rows, and NumPy's format, have 32 bits.
stored = data.hf_dataset.with_format("arrow")[:]
columns = {key: np.array(stored[key].to_pylist()) for key in ["observation.state", "action", "observation.object_pose", "observation.time_s"]}
camera = logs[0].cameras[0].name


def is_file(shown, file):
    """Returns whether an image is that of a file, decoded by the same library."""
    with Image.open(file) as image:
        return np.array_equal(np.rint(shown.numpy() * 255.0).transpose(1, 2, 0).astype(np.uint8), np.asarray(image))


images, times, poses, joints = [], [], [], []
index = 0
for log in logs:
    for k, frame in enumerate(log):
        row = data[index]
        for finger in ["index", "middle", "ring", "thumb"]:
            images.append(is_file(row[f"observation.images.touch_{finger}"], log.folder / "allegro" / finger / "image" / f"{k}.jpg"))
        images.append(is_file(row[f"observation.images.{camera}"], log.folder / "realsense" / camera / "image" / f"{k}.jpg"))
        times.append(bool(columns["observation.time_s"][index] == frame.time_s))
        poses.append(np.array_equal(columns["observation.object_pose"][index][:3], frame.object_pose[:3, 3]))
        joints.append(np.array_equal(row["observation.state"].numpy(), frame.joints.astype(np.float32)))
        index += 1

# Statistics as LeRobot computes them, from the rows of each episode.
keys = ["observation.state", "action", "observation.object_pose"]
episodes = []
for number in range(len(logs)):
    rows = np.array(stored["episode_index"].to_pylist()) == number
    features = {key: data.features[key] for key in keys}
    episodes.append(compute_episode_stats({key: columns[key][rows] for key in keys}, features))
theirs = aggregate_stats(episodes)
ours = json.loads((folder / "meta/stats.json").read_text())
farthest = max(float(np.abs(np.asarray(ours[key][of]) - theirs[key][of]).max()) for key in keys for of in ["min", "max", "mean", "std"])
result = {
    "frames": len(data),
    "episodes": data.num_episodes,
    "images_differing": images.count(False),
    "numbers_differing": sum(equal.count(False) for equal in [times, poses, joints]),
    "statistics_farthest": farthest,
}
print(json.dumps(result))
if result["images_differing"] or result["numbers_differing"] or len(data) != sum(map(len, logs)) or farthest > 1e-6:
    raise SystemExit(1)
