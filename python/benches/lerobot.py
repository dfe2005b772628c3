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
    subprocess.run([str(word) for word in command], check=True)

data = LeRobotDataset("local/mambavitact", root=folder)
camera = logs[0].cameras[0].name
images, times, poses, joints = [], [], [], []
index = 0
for log in logs:
    for k, frame in enumerate(log):
        row = data[index]
        index += 1
        for finger in ["index", "middle", "ring", "thumb"]:
            with Image.open(log.folder / "allegro" / finger / "image" / f"{k}.jpg") as file:
                wanted = np.asarray(file)
            shown = row[f"observation.images.touch_{finger}"].numpy()
            images.append(np.array_equal(np.rint(shown * 255.0).transpose(1, 2, 0).astype(np.uint8), wanted))
        shown = np.rint(row[f"observation.images.{camera}"].numpy() * 255.0).transpose(1, 2, 0).astype(np.uint8)
        images.append(np.array_equal(shown, frame.color[0]))
        times.append(float(row["observation.time_s"]) == frame.time_s)
        poses.append(np.array_equal(row["observation.object_pose"].numpy()[:3], frame.object_pose[:3, 3]))
        joints.append(np.array_equal(row["observation.state"].numpy(), frame.joints.astype(np.float32)))

# Statistics as LeRobot computes them, from the rows of each episode.
keys = ["observation.state", "action", "observation.object_pose"]
episodes = []
for number in range(len(logs)):
    rows = data.hf_dataset.with_format("numpy").filter(lambda row: row["episode_index"] == number)
    features = {key: data.features[key] for key in keys}
    episodes.append(compute_episode_stats({key: np.stack(rows[key]) for key in keys}, features))
theirs = aggregate_stats(episodes)
ours = json.loads((folder / "meta/stats.json").read_text())
farthest = max(float(np.abs(np.asarray(ours[key][of]) - theirs[key][of]).max()) for key in keys for of in ["min", "max", "mean", "std"])
result = {
    "frames": len(data),
    "episodes": data.num_episodes,
    "images_equal": all(images),
    "times_equal": all(times),
    "poses_equal": all(poses),
    "joints_equal": all(joints),
    "statistics_farthest": farthest,
}
print(json.dumps(result))
if not (all(images + times + poses + joints) and len(data) == sum(map(len, logs)) and farthest < 1e-6):
    raise SystemExit(1)
