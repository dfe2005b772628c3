"""Publishes a simulated log over rclpy, and compares the live estimate with that of `run --log`; prints a JSON line for each rate.

usage: replay.py --program PROGRAM [--object cube70] [--duration 10] [--hz 30,15]

Needs NumPy and Pillow; ROS_PYTHON names a Python with rclpy, in which tests/ros/peer.py publishes. Frames hold colours and depth of 640 x 480,
four touch images and joint angles. The publisher, the estimate and the rest of the machine share its cores.
"""

import argparse
import json
import os
import pathlib
import pickle
import signal
import subprocess
import tempfile

import numpy as np
from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
FINGERS = ["index", "middle", "ring", "thumb"]
CAMERA = "side"
DOMAIN = 63
SETUP = f"""[ros]
domain = {DOMAIN}
addresses = ["127.0.0.1"]
rig = "allegro_digit"
camera = "{CAMERA}"
depth = "/camera/depth/image_raw"
color = "/camera/color/image_raw"
camera_info = "/camera/depth/camera_info"
joints = "/joint_states"
truth = "/truth"

[ros.touch]
""" + "".join(f'{pad} = "/touch/{pad}/image_raw"\n' for pad in FINGERS)

parser = argparse.ArgumentParser()
parser.add_argument("--program", required=True)
parser.add_argument("--object", default="cube70")
parser.add_argument("--duration", type=float, default=10.0)
parser.add_argument("--hz", default="30,15")
arguments = parser.parse_args()
program = str(pathlib.Path(arguments.program).resolve())
folder = pathlib.Path(tempfile.mkdtemp(prefix="ros_replay."))


def quaternion(rotation):
    """Returns x, y, z and w of a rotation matrix: the eigenvector of the greatest eigenvalue (Bar-Itzhack 2000)."""
    r = rotation
    k = np.zeros((4, 4))
    k[:3, :3] = r + r.T - np.trace(r) * np.eye(3)
    k[:3, 3] = k[3, :3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    k[3, 3] = np.trace(r)
    return np.linalg.eigh(k)[1][:, -1].tolist()


def unpack(log, to):
    """Writes a log as the messages that peer.py publishes."""
    to.mkdir()
    data = pickle.loads((log / "data.pkl").read_bytes())
    lens = data["realsense"][CAMERA]["intrinsics"]
    archive = np.load(log / "realsense" / CAMERA / "depth.npz")
    # Stamps are names; the publisher's own take their place.
    names = [str(10**9 + int(1e9 * time_s)) for time_s in data["time"]]
    for number, name in enumerate(names):
        depth_m = -archive["depth"][number] * archive["depth_scale"]
        np.round(1e3 * depth_m).astype("<u2").tofile(to / f"{name}.depth")
        image = Image.open(log / "realsense" / CAMERA / "image" / f"{number}.jpg").convert("RGB")
        (to / f"{name}.rgb").write_bytes(image.tobytes())
        for finger in FINGERS:
            image = Image.open(log / "allegro" / finger / "image" / f"{number}.jpg").convert("RGB")
            (to / f"{name}.{finger}").write_bytes(image.tobytes())
    size = [data["digit_info"]["intrinsics"][side] for side in "wh"]
    sequence = {
        "width": lens["w"],
        "height": lens["h"],
        "k": [lens["fx"], 0, lens["cx"], 0, lens["fy"], lens["cy"], 0, 0, 1],
        "names": names,
        "touch": {finger: size for finger in FINGERS},
        "joints": {
            "names": [f"{finger}_{k}" for finger in FINGERS for k in range(4)],
            "positions": np.asarray(data["allegro"]["joint_state"]).tolist(),
        },
        "truth": [pose[:3, 3].tolist() + quaternion(pose[:3, :3]) for pose in data["object"]["pose"]],
    }
    (to / "sequence.json").write_text(json.dumps(sequence))


def run(*words):
    subprocess.run([program, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def replayed(hz):
    """Returns the summary of a live run, and the number of frames that were sent."""
    live = subprocess.Popen(
        [program, "run", "--ros", "ros.toml", "--object", arguments.object, "--out", f"live{hz}", "--quiet"],
        cwd=folder,
        stderr=subprocess.DEVNULL,
    )
    environment = dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    peer = [os.environ["ROS_PYTHON"], str(ROOT / "tests/ros/peer.py"), "messages", "heard.json", "--hz", str(hz)]
    subprocess.run(peer, cwd=folder, env=environment, check=True)
    live.send_signal(signal.SIGINT)
    live.wait()
    summary = json.loads((folder / f"live{hz}" / "summary.json").read_text())
    return summary, json.loads((folder / "heard.json").read_text())["sent"]


run("generate", "--object", arguments.object, "--logs", "1", "--duration", str(arguments.duration), "--cameras", CAMERA, "--out", "set")
log = folder / "set" / arguments.object / "00"
unpack(log, folder / "messages")
(folder / "ros.toml").write_text(SETUP)
run("run", "--log", str(log), "--set", "camera_noise=0", "--out", "of_log", "--quiet")
of_log = json.loads((folder / "of_log" / "summary.json").read_text())
for hz in map(float, arguments.hz.split(",")):
    summary, sent = replayed(hz)
    live = summary["live"]
    row = {
        "hz": hz,
        "sent": sent,
        "used": live["frames"],
        "paired": (live["frames"] + live["late"]) / sent,
        "received": min(topic["received"] for topic in live["topics"]) / sent,
        # Of each topic, what was received and what is said to be lost should be what was sent.
        "unaccounted": max(abs(sent - topic["received"] - topic["lost"]) for topic in live["topics"]) / sent,
        "add_s_mm": summary["add_s_mm"]["mean"],
        "add_s_mm_of_log": of_log["add_s_mm"]["mean"],
        "latency_periods": live["latency_ms"]["median"] * 1e-3 * hz,
    }
    print(json.dumps(row), flush=True)
