#!/usr/bin/env python3
"""Checks rendered sequences against their truth, and draws a contact sheet.

    check.py DATA OUT.png [--only NAME ...]

Prints for each sequence

  off      median and 90th percentile of the distance between the points of depth and mask and the mesh at the true pose, mm
  holes    share of the mask without depth
  pixels   least and median number of pixels of the mask
  strays   greatest share of the mask that lies more than 2 pixels outside the mesh's outline
  bare     greatest share of the outline that lies more than 2 pixels outside the mask, of frames in which nothing hides the object
  seen     5th percentile and median of the seen share of the object while it is not hidden, and the share of frames in which it is hidden
  z        least and greatest distance, m
  margin   pixels between the object and the edge of the picture
  step     median and greatest step of a frame, mm; turn: the same in degrees

The mesh is projected by its points; rays have no part in it.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from score import sampled
from suite import SEQUENCES, Recorded, load_mesh

EVERY = 10
SHOWN = 6


def check(sequence):
    """Prints the figures of a sequence and returns its row of the contact sheet."""
    mesh = load_mesh(sequence.object)
    samples, vertices = sampled(mesh, 100_000), np.asarray(mesh.vertices)
    tree = cKDTree(samples)
    centre = (vertices.min(0) + vertices.max(0)) / 2.0
    k, seen = sequence.intrinsics, np.loadtxt(sequence.folder / "seen.txt")
    off, holes, count, strays, bare, margin, tiles = [], [], [], [], [], np.inf, []
    for index in range(0, len(sequence.names), EVERY):
        color, depth, mask = sequence.frame(sequence.names[index])
        pose = sequence.poses[index]
        pixels = (vertices @ pose[:3, :3].T + pose[:3, 3]) @ k.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        margin = min(margin, pixels.min(), mask.shape[1] - pixels[:, 0].max(), mask.shape[0] - pixels[:, 1].max())
        # Where the mesh is in the picture, from its points alone.
        shape = (samples @ pose[:3, :3].T + pose[:3, 3]) @ k.T
        u, v = np.clip(np.rint(shape[:, :2] / shape[:, 2:]).astype(int).T, 0, np.array(mask.shape[::-1])[:, None] - 1)
        silhouette = np.zeros_like(mask)
        silhouette[v, u] = True
        if mask.any():
            strays.append((mask & ~binary_dilation(silhouette, iterations=2)).sum() / mask.sum())
        if seen[index] > 0.99:
            bare.append((silhouette & ~binary_dilation(mask, iterations=2)).sum() / silhouette.sum())
        inner = binary_erosion(mask, iterations=3)
        v, u = np.nonzero(inner & (depth > 0.0))
        if len(v):
            z = depth[v, u].astype(float)
            points = np.stack([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], 1)
            off.append(tree.query((points - pose[:3, 3]) @ pose[:3, :3])[0])
            holes.append(1.0 - len(v) / inner.sum())
        count.append(mask.sum())
        if index % (len(sequence.names) // SHOWN) == 0:
            lower = np.repeat((np.clip(depth / 2.0, 0.0, 1.0) * 255).astype(np.uint8)[..., None], 3, 2)
            lower[mask] = (lower[mask] * [0.4, 1.0, 0.4]).astype(np.uint8)
            lower[depth == 0.0] = [60, 0, 0]
            edge = mask & ~binary_erosion(mask)
            upper = color.copy()
            upper[edge] = [0, 255, 0]
            tiles.append(np.concatenate([upper, lower])[::2, ::2])
    off = 1e3 * np.concatenate(off)
    places = sequence.poses[:, :3, :3] @ centre + sequence.poses[:, :3, 3]
    steps = 1e3 * np.linalg.norm(np.diff(places, axis=0), axis=1)
    turns = Rotation.from_matrix(sequence.poses[:, :3, :3])
    turns = np.degrees((turns[1:] * turns[:-1].inv()).magnitude())
    visible = seen[seen > 0.0]
    figures = {
        "off": f"{np.median(off):.2f} {np.percentile(off, 90):.2f}",
        "holes": f"{np.mean(holes):.3f}",
        "pixels": f"{min(count):5} {int(np.median(count)):5}",
        "strays": f"{np.max(strays):.4f}",
        "bare": f"{np.max(bare, initial=0.0):.4f}",
        "seen": f"{np.percentile(visible, 5):.2f} {np.median(visible):.2f} hidden {np.mean(seen == 0.0):.2f}",
        "z": f"{places[:, 2].min():.2f} {places[:, 2].max():.2f}",
        "margin": f"{margin:3.0f}",
        "step": f"{np.median(steps[60:]):4.1f} {steps.max():4.1f}",
        "turn": f"{np.median(turns[60:]):4.2f} {turns.max():4.2f}",
    }
    print(f"{sequence.name:16}" + "".join(f" {key} {value} " for key, value in figures.items()), flush=True)
    sheet = Image.fromarray(np.concatenate(tiles, 1))
    ImageDraw.Draw(sheet).text((6, 4), sequence.name, fill="white")
    return np.asarray(sheet)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the rendered sequences")
    parser.add_argument("sheet", type=Path, help="picture to write")
    parser.add_argument("--only", nargs="+", choices=list(SEQUENCES), default=list(SEQUENCES), metavar="NAME", help="sequences (default: all)")
    arguments = parser.parse_args()
    rows = [check(Recorded(arguments.data / name)) for name in arguments.only if (arguments.data / name).exists()]
    Image.fromarray(np.concatenate(rows)).save(arguments.sheet)


if __name__ == "__main__":
    main()
