#!/usr/bin/env python3
"""Renders the sequences of sequences.toml with Open3D's rays, and puts noise on them.

    render.py OUT [--only NAME ...]     writes OUT/NAME/; finished folders are skipped

A sequence has rgb/, depth/ (millimetres), masks/, annotated_poses/ (4 x 4, object to camera, OpenCV axes), cam_K.txt, object.txt and seen.txt: per
frame the share of the object's pixels that nothing hides.
"""

import argparse
import os
import shutil
import time
from pathlib import Path

import numpy as np
from motion import make
from PIL import Image
from scene import HEIGHT, INTRINSICS, OBJECT, WIDTH, View
from sensor import Sensor
from suite import SEQUENCES, SUITE, load_mesh

# Pixels between the object and the edge of the picture.
MARGIN_PX = 12


def fitting(entry, mesh):
    """Returns the motion with the longest path that keeps the object in the picture."""
    vertices = np.asarray(mesh.vertices)[::20]
    for shrink in 0.93 ** np.arange(30):
        motion = make(entry, SUITE["frames"], np.asarray(mesh.vertices), shrink)
        poses = np.linalg.inv(motion.world_from_camera) @ motion.world_from_object
        points = np.einsum("fij,nj->fni", poses[:, :3, :3], vertices) + poses[:, None, :3, 3]
        pixels = points @ INTRINSICS.T
        pixels = pixels[..., :2] / pixels[..., 2:]
        if pixels.min() > MARGIN_PX and (pixels.max((0, 1)) < np.array([WIDTH, HEIGHT]) - MARGIN_PX).all():
            return motion
    raise SystemExit(f"the object of {entry['object']} leaves the picture: increase distance_m")


def render(name, out):
    """Writes one sequence; the folder gets its name when it is complete."""
    entry, begun = SEQUENCES[name], time.monotonic()
    mesh = load_mesh(entry["object"])
    motion = fitting(entry, mesh)
    view, sensor = View(entry, motion, mesh), Sensor(entry["seed"], SUITE["frames"])
    folder = out / f"{name}.part"
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("rgb", "depth", "masks", "annotated_poses"):
        (folder / part).mkdir(parents=True)
    np.savetxt(folder / "cam_K.txt", INTRINSICS)
    (folder / "object.txt").write_text(entry["object"] + "\n")
    shares = []
    for k in range(SUITE["frames"]):
        color, depth, cosine, mirror, labels, shadow, alone = view.frame(k)
        shares.append((labels == OBJECT).sum() / max(alone, 1))
        images = {
            "rgb": sensor.color(color, k),
            "depth": sensor.depth(depth, color, cosine, mirror, shadow),
            "masks": 255 * sensor.mask(labels).astype(np.uint8),
        }
        for part, image in images.items():
            Image.fromarray(image).save(folder / part / f"{k:06}.png", compress_level=1)
        np.savetxt(folder / "annotated_poses" / f"{k:06}.txt", np.linalg.inv(motion.world_from_camera[k]) @ motion.world_from_object[k])
    np.savetxt(folder / "seen.txt", shares, fmt="%.4f")
    os.replace(folder, out / name)
    print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the sequences")
    parser.add_argument(
        "--only", nargs="+", choices=list(SEQUENCES), default=list(SEQUENCES), metavar="NAME", help="sequences to render (default: all)"
    )
    arguments = parser.parse_args()
    for name in arguments.only:
        if not (arguments.out / name).exists():
            render(name, arguments.out)


if __name__ == "__main__":
    main()
