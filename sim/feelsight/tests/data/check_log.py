"""Reads the synthetic log of the tests as other people's programs do: check_log.py LOG OBJECT_POSE_0 (16 numbers)."""
import os
import pickle
import sys
import zipfile

import numpy as np

log, pose = sys.argv[1], np.array(sys.argv[2].split(), dtype=float).reshape(4, 4)
with open(os.path.join(log, "data.pkl"), "rb") as file:
    data = pickle.load(file)

assert set(data) == {"time", "object", "allegro", "digit_info", "realsense"}, data.keys()
n = len(data["time"])
assert n == 5 and data["time"][0] == 0 and abs(data["time"][-1] - 4 / 30) < 1e-12
assert data["object"]["name"] == "ball" and data["object"]["mesh"] == "procedural ball"
poses = np.array(data["object"]["pose"])
assert poses.shape == (n, 4, 4) and poses.dtype == np.float64
assert np.abs(poses[0] - pose).max() < 1e-15
assert data["allegro"]["base_pose"].shape == (4, 4)
joints = np.asarray(data["allegro"]["joint_state"])
assert joints.shape == (n, 16) and abs(joints[2, 5] - (0.2 + 0.15 + 0.04)) < 1e-12
assert len(data["allegro"]["finger_poses"]) == n and data["allegro"]["finger_poses"][0].shape == (4, 4, 4)
# A fresh array may be written to: loaders change their arrays.
data["allegro"]["base_pose"][0, 0] += 0.0

digit = data["digit_info"]
assert digit["intrinsics"] == {"w": 240, "h": 320, "fx": 277.1281292, "fy": 277.1281292, "cx": 120.0, "cy": 160.0}
assert type(digit["intrinsics"]["w"]) is int and digit["cam_dist"] == -0.022 and digit["depth_scale"] == 33333.33334

for camera, (w, h) in {"front-left": (64, 48), "top-down": (40, 30)}.items():
    info = data["realsense"][camera]
    assert info["pose"].ndim == 2 and info["depth_scale"] == 1.0
    assert (info["intrinsics"]["w"], info["intrinsics"]["h"]) == (w, h)
    path = os.path.join(log, "realsense", camera, "depth.npz")
    assert zipfile.ZipFile(path).testzip() is None
    archive = np.load(path, fix_imports=True, encoding="latin1")
    assert set(archive.files) == {"depth", "depth_scale"}
    depth = archive["depth"].astype(np.float32) * archive["depth_scale"]
    assert depth.shape == (n, h, w) and archive["depth"].dtype == np.float32 and archive["depth_scale"].shape == ()
    row, column = np.mgrid[:h, :w]
    for i in range(n):
        true = -(0.3 + 1e-4 * (row * 7 % 11) + 1e-5 * (column + i))
        true[:10] = 0
        assert np.abs(depth[i] - true).max() < 1e-7
    assert not np.signbit(depth[:, :10]).any()
    for kind in ("image", "seg"):
        assert len(os.listdir(os.path.join(log, "realsense", camera, kind))) == n
print("ok")
