#!/usr/bin/env python3
"""Measures `mambavitact run` on real RGB-D sequences that others made.

    real.py SHARED OUT [--program FILE]      SHARED holds ycb_video_10, redkitchen_mug and standing_box; writes OUT/real.json

ycb_video_10    10 frames of YCB-Video: ADD-S of three objects against their poses, which icp_frames.npz takes to the meshes of `assets`
redkitchen_mug  two clips of 7-Scenes: mean error of the mug's place and rotation against the poses of the camera, which are good to 2 cm; its colours
                are not registered to depth. wrong: share of frames, percent, that are certified and more than 40 mm off
standing_box    a box that does not move: how far the last pose is from the first

The frames are linked into OUT, not copied.
"""

import argparse
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import scipy.io

CLIPS = {"short": range(600, 641), "long": range(190, 311)}
OBJECTS = {"009_gelatin_box": 8, "025_mug": 14, "061_foam_brick": 21}
FAR_MM = 40.0


def link(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.is_symlink():
        target.symlink_to(os.path.abspath(source))


def kitchen(shared, folder, frames):
    """Links a clip as rgb/ depth/ masks/ annotated_poses/: the camera moves, its pose is not given."""
    source = shared / "redkitchen_mug"
    scene_from_mug = np.loadtxt(source / "object_in_scene.txt")
    (folder / "annotated_poses").mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "cam_K.txt", [[585, 0, 320], [0, 585, 240], [0, 0, 1]])
    for k in frames:
        name = f"{k:06d}"
        link(source / f"masks/{name}.png", folder / f"masks/{name}.png")
        link(source / f"data/frame-{name}.color.jpg", folder / f"rgb/{name}.jpg")
        link(source / f"data/frame-{name}.depth.png", folder / f"depth/{name}.png")
        scene_from_camera = np.loadtxt(source / f"data/frame-{name}.pose.txt")
        np.savetxt(folder / f"annotated_poses/{name}.txt", np.linalg.inv(scene_from_camera) @ scene_from_mug)


def ycb_video(shared, folder, name, label):
    """Links the frames with a description, and writes the poses of one object for its mesh of `assets`."""
    frames = shared / "ycb_video_10"
    to_mesh = np.load(frames / "icp_frames.npz")
    key = next(key for key in to_mesh if name in key or name[4:] in key)
    (folder / "poses").mkdir(parents=True, exist_ok=True)
    for file in sorted((frames / "data").rglob("*-meta.mat")):
        meta = scipy.io.loadmat(file)
        index = list(meta["cls_indexes"].ravel()).index(label)
        pose = np.vstack([meta["poses"][:, :, index], [0, 0, 0, 1]])
        stem = file.name.removesuffix("-meta.mat")
        np.savetxt(folder / f"poses/{stem}.txt", pose @ np.linalg.inv(to_mesh[key]))
        for image in file.parent.glob(f"{stem}-*.png"):
            link(image, folder / "data" / image.name)
    k, factor = meta["intrinsic_matrix"], float(meta["factor_depth"].ravel()[0])
    (folder / "rgbd.toml").write_text(
        'color = "data/*-color.png"\ndepth = "data/*-depth.png"\nmasks = "data/*-label.png"\nobject_poses = "poses/*.txt"\n'
        f"object = {label}\nintrinsics = [{k[0, 0]}, {k[1, 1]}, {k[0, 2]}, {k[1, 2]}]\ndepth_unit_m = {1 / factor}\n"
    )


def run(program, folder, *words):
    out = folder.with_name(folder.name + "_out")
    subprocess.run([program, "run", "--log", folder, "--modality", "vi", "--out", out, "--overwrite", "--quiet", *words], check=True)
    return out


def matrices(folder):
    return {file.stem: np.loadtxt(file) for file in sorted(folder.glob("*.txt"))}


def degrees(rotation):
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def motion_errors(found, true):
    """Errors of the motion since the first certified frame, millimetres and degrees."""
    first = next(iter(found))
    model_from_object = np.linalg.inv(found[first]) @ true[first]
    for name, pose in found.items():
        estimate = pose @ model_from_object
        yield 1e3 * float(np.linalg.norm(estimate[:3, 3] - true[name][:3, 3])), degrees(estimate[:3, :3].T @ true[name][:3, :3])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shared", type=Path, help="folder of the sequences")
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--program", default="target/release/mambavitact", help="program to measure (default target/release/mambavitact)")
    arguments = parser.parse_args()
    results = {}
    for clip, frames in CLIPS.items():
        folder = arguments.out / f"kitchen_{clip}"
        kitchen(arguments.shared, folder, frames)
        found = matrices(run(arguments.program, folder) / "poses")
        errors = np.array(list(motion_errors(found, matrices(folder / "annotated_poses"))))
        results[f"kitchen_{clip}"] = {
            "mm": errors[:, 0].mean(), "deg": errors[:, 1].mean(), "certified": len(found) / len(frames),
            "wrong": 100 * float((errors[:, 0] > FAR_MM).sum()) / len(frames),
        }
    for name, label in OBJECTS.items():
        folder = arguments.out / name
        ycb_video(arguments.shared, folder, name, label)
        summary = json.loads((run(arguments.program, folder, "--object", name) / "summary.json").read_text())
        results[name] = {"add_s_mm": summary["add_s_mm"]["mean"]}
    box = arguments.out / "box"
    for part in ("rgb", "depth", "masks", "cam_K.txt"):
        link(arguments.shared / "standing_box" / part, box / part)
    poses = list(matrices(run(arguments.program, box) / "poses").values())
    drift = np.linalg.inv(poses[0]) @ poses[-1]
    middle = poses[0][:3, 3]
    results["box"] = {
        "mm": 1e3 * float(np.linalg.norm(poses[-1][:3, 3] - middle)), "deg": degrees(drift[:3, :3]),
    }
    (arguments.out / "real.json").write_text(json.dumps(results, indent=1))
    for name, values in results.items():
        print(name, {key: round(float(value), 3) for key, value in values.items()})


if __name__ == "__main__":
    main()
