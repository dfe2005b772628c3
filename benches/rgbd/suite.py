"""Sequences of sequences.toml, meshes of the program's store, and files of a sequence."""

import os
import tomllib
from pathlib import Path

import numpy as np
import open3d as o3d
from PIL import Image

HERE = Path(__file__).parent
SUITE = tomllib.loads((HERE / "sequences.toml").read_text())
SEQUENCES = {name: entry for name, entry in SUITE.items() if isinstance(entry, dict) and "kind" in entry}


def store():
    """Returns the folder of the YCB meshes that `mambavitact assets fetch` fills."""
    if "YCB_DIR" in os.environ:
        return Path(os.environ["YCB_DIR"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mambavitact" / "ycb"


def load_mesh(name):
    """Reads the mesh of an object, metres, in the coordinates of its file."""
    path = store() / f"{name}.stl"
    if not path.exists():
        path = store() / name / "google_16k" / "nontextured.stl"
    if not path.exists():
        raise SystemExit(f"{name} is not in {store()}: run `mambavitact assets fetch`")
    mesh = o3d.io.read_triangle_mesh(str(path))
    mesh.merge_close_vertices(1e-6)
    mesh.compute_vertex_normals()
    return mesh


class Recorded:
    """Finished sequence on disk."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.name = self.folder.name
        self.object = (self.folder / "object.txt").read_text().strip()
        self.intrinsics = np.loadtxt(self.folder / "cam_K.txt")
        self.names = sorted(path.stem for path in (self.folder / "depth").glob("*.png"))
        self.poses = np.array([np.loadtxt(self.folder / "annotated_poses" / f"{name}.txt") for name in self.names])

    def frame(self, name):
        """Returns colours, depth in metres and mask of a frame."""
        color = np.asarray(Image.open(self.folder / "rgb" / f"{name}.png"))
        depth = np.asarray(Image.open(self.folder / "depth" / f"{name}.png")).astype(np.float32) * 1e-3
        mask = np.asarray(Image.open(self.folder / "masks" / f"{name}.png")) > 0
        return color, depth, mask
