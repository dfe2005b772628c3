#!/usr/bin/env python3
"""Open3D as a tracker of unknown objects: ICP of each frame against its own TSDF volume, on the sequences of render.py.

    peer.py DATA OUT [--only NAME ...] [--variant plane|colour]   writes OUT/NAME/poses/*.txt, mesh.obj and time.txt
    peer.py DATA OUT --tune [--frames N] [--only NAME ...]        chooses the settings on the tuning half; OUT/tuning.jsonl, OUT/settings.json

The chosen settings stand in settings.json beside this program.
Poses are 4 x 4, camera from model, for the frames whose pose is trusted. The model's coordinates are those of the first camera.
"""

import argparse
import dataclasses
import json
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.ndimage import binary_erosion
from score import read_poses, tracking
from suite import SEQUENCES, Recorded

registration = o3d.pipelines.registration
integration = o3d.pipelines.integration
HERE = Path(__file__).parent
FEWEST_POINTS = 50
# Edge of the mapped cube: no object of the suite is longer than 0.26 m, and the first view shows only its front.
VOLUME_M = 0.40
# Points further from the median depth of the mask belong to what lies behind.
REACH_M = 0.20
# Share of fitting points by which a pose must be better for each radian that it is turned further.
TURN_COST = 0.05
AXES = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)]
TURNS = [np.radians(angle) * np.array(axis) / np.linalg.norm(axis) for axis in AXES for angle in (-60.0, -30.0, 30.0, 60.0)]


@dataclass(frozen=True)
class Settings:
    """Settings that --tune chooses."""

    colour: bool = False
    """Coloured ICP in the last pass in place of point-to-plane."""
    voxel_mm: float = 3.0
    """Edge of the cells of the TSDF volume, and of those that thin out the points of a frame."""
    truncation_mm: float = 12.0
    """Truncation of the TSDF volume."""
    erode_px: int = 2
    """Pixels by which the mask is eroded."""
    distance_mm: float = 20.0
    """Greatest distance of two points that correspond in the first of three passes; each further one takes half of it."""
    kernel_mm: float = 5.0
    """Residual beyond which Tukey's loss ignores a point; 0 for least squares."""
    velocity: bool = True
    """The last motion is repeated first; then the last pose is tried, and the last pose moved to the points' centre."""
    relocate: bool = True
    """While lost, turns by 30 and 60 degrees about 13 axes are tried too."""
    geometry: float = 0.968
    """Weight of the geometry in coloured ICP."""
    fitness: float = 0.7
    """Least share of points with a correspondence within 10 mm with which a pose is trusted."""
    every: int = 1
    """A trusted frame of this many is integrated."""


class Slam:
    """Frame-to-model ICP with TSDF integration."""

    def __init__(self, intrinsics, settings):
        self.intrinsics, self.settings = intrinsics, settings
        self.volume = self.model = None
        # Camera from model, the last motion of it, and trusted frames in all.
        self.pose, self.motion, self.trusted, self.lost = np.eye(4), np.eye(4), 0, False

    def image(self, color, depth, mask):
        inside = binary_erosion(mask, iterations=self.settings.erode_px) if self.settings.erode_px else mask
        depth = np.where(inside, depth, 0.0).astype(np.float32)
        if (depth > 0.0).any():
            depth[np.abs(depth - np.median(depth[depth > 0.0])) > REACH_M] = 0.0
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(color)), o3d.geometry.Image(depth), 1.0, 10.0, convert_rgb_to_intensity=False
        )

    def estimate(self, color, depth, mask):
        """Returns the pose of the camera in a frame; None if it is not trusted."""
        image = self.image(color, depth, mask)
        height, width = depth.shape
        k = self.intrinsics
        pinhole = o3d.camera.PinholeCameraIntrinsic(width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        points = o3d.geometry.PointCloud.create_from_rgbd_image(image, pinhole).voxel_down_sample(1e-3 * self.settings.voxel_mm)
        if len(points.points) < FEWEST_POINTS:
            self.lost, self.motion = True, np.eye(4)
            return None
        if self.volume is None:
            # ScalableTSDFVolume of Open3D 0.20 stays empty.
            origin = points.get_center() + [0.0, 0.0, 0.03] - VOLUME_M / 2.0
            cells = round(1e3 * VOLUME_M / self.settings.voxel_mm)
            self.volume = integration.UniformTSDFVolume(
                VOLUME_M, cells, 1e-3 * self.settings.truncation_mm, integration.TSDFVolumeColorType.RGB8, origin
            )
        elif not self.track(points):
            self.lost, self.motion = True, np.eye(4)
            return None
        self.lost = False
        if self.trusted % self.settings.every == 0:
            self.volume.integrate(image, pinhole, self.pose)
            self.model = self.volume.extract_point_cloud().voxel_down_sample(1e-3 * self.settings.voxel_mm)
        self.trusted += 1
        return self.pose

    def track(self, points):
        """Finds the pose from several starts and returns whether it is trusted."""
        moved = self.pose.copy()
        moved[:3, 3] += points.get_center() - (np.asarray(self.model.points) @ self.pose[:3, :3].T + self.pose[:3, 3]).mean(0)
        groups = [[self.motion @ self.pose]] if self.settings.velocity else []
        groups.append([self.pose, moved])
        if self.settings.relocate and self.lost:
            groups = [[self.pose, moved, *(turned(moved, points.get_center(), turn) for turn in TURNS)]]
        for starts in groups:
            # Of poses that fit alike, the one that is turned least.
            best = max((self.align(points, start) for start in starts), key=lambda result: result[0] - TURN_COST * angle(result[1], self.pose))
            if best[0] >= self.settings.fitness:
                # The last motion is unknown after a gap.
                self.motion = np.eye(4) if self.lost else best[1] @ np.linalg.inv(self.pose)
                self.pose = best[1]
                return True
        return False

    def align(self, points, start):
        """Returns the share of points that fit to the model, and the pose, from coarse to fine."""
        found = np.linalg.inv(start)
        try:
            for level in range(3):
                found = self.register(points, 1e-3 * self.settings.distance_mm / 2**level, found, level).transformation
        except RuntimeError:
            # Coloured ICP without a correspondence.
            return 0.0, start
        return registration.evaluate_registration(points, self.model, 0.010, found).fitness, np.linalg.inv(found)

    def register(self, points, distance, start, level):
        criteria = registration.ICPConvergenceCriteria(1e-6, 1e-6, 30)
        if self.settings.colour and level == 2:
            method = registration.TransformationEstimationForColoredICP(self.settings.geometry)
            return registration.registration_colored_icp(points, self.model, distance, start, method, criteria)
        # Wide first passes must not be blind to far points.
        kernel = 1e-3 * self.settings.kernel_mm * 2 ** (2 - level)
        method = registration.TransformationEstimationPointToPlane(*([registration.TukeyLoss(kernel)] if kernel > 0.0 else []))
        return registration.registration_icp(points, self.model, distance, start, method, criteria)

    def mesh(self):
        """Returns the mesh of the volume."""
        mesh = self.volume.extract_triangle_mesh()
        clusters, counts, _ = (np.asarray(values) for values in mesh.cluster_connected_triangles())
        # Specks that noise leaves beside the object.
        mesh.remove_triangles_by_mask(counts[clusters] < 0.05 * counts.max())
        mesh.remove_unreferenced_vertices()
        return mesh


def angle(first, second):
    """Returns the angle between two poses, radians."""
    return float(np.arccos(np.clip((np.trace(first[:3, :3].T @ second[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))


def turned(pose, centre, turn):
    """Turns a pose about a point of the camera's coordinates."""
    motion = np.eye(4)
    motion[:3, :3] = o3d.geometry.get_rotation_matrix_from_axis_angle(turn)
    motion[:3, 3] = centre - motion[:3, :3] @ centre
    return motion @ pose


def run(sequence, settings, folder, frames=None):
    """Tracks a sequence and writes its results."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "poses").mkdir(parents=True)
    slam, spent = Slam(sequence.intrinsics, settings), 0.0
    for name in sequence.names[:frames]:
        frame = sequence.frame(name)
        begun = time.perf_counter()
        pose = slam.estimate(*frame)
        spent += time.perf_counter() - begun
        if pose is not None:
            np.savetxt(folder / "poses" / f"{name}.txt", pose)
    o3d.io.write_triangle_mesh(str(folder / "mesh.obj"), slam.mesh())
    (folder / "time.txt").write_text(f"{spent / len(sequence.names[:frames]):.4f}\n")


# Values beside the default, tried in turns from the first to the last. Coloured ICP begins with the choice for point-to-plane.
GRID = {
    "plane": {"fitness": (0.5, 0.85), "kernel_mm": (0.0,), "distance_mm": (30.0,), "erode_px": (1,), "relocate": (False,), "velocity": (False,)},
    "colour": {"geometry": (0.9,)},
}


def tune(variant, begin, data, out, names, frames):
    """Chooses settings by the mean AUC of ADD over the tuning half, one setting after the other."""
    tried = {}

    def cost(settings):
        if settings not in tried:
            aucs = []
            for name in names:
                sequence = Recorded(data / name)
                run(sequence, settings, out / "trial", frames)
                aucs.append(tracking(sequence, read_poses(out / "trial"), frames)["add_auc"])
            tried[settings] = -float(np.mean(aucs))
            line = {"variant": variant, **dataclasses.asdict(settings), "add_auc": -tried[settings], "each": [round(auc, 1) for auc in aucs]}
            print(json.dumps(line), flush=True)
            with (out / "tuning.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")
        return tried[settings]

    for key, values in GRID[variant].items():
        begin = min([begin, *(dataclasses.replace(begin, **{key: value}) for value in values)], key=cost)
    return begin


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the rendered sequences")
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--only", nargs="+", choices=list(SEQUENCES), default=list(SEQUENCES), metavar="NAME", help="sequences (default: all)")
    parser.add_argument("--variant", choices=list(GRID), default="plane", help="kind of ICP (default plane)")
    parser.add_argument("--tune", action="store_true", help="choose the settings on the tuning half, and stop")
    parser.add_argument("--frames", type=int, help="frames of each sequence (default: all)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.tune:
        names = [name for name in arguments.only if SEQUENCES[name]["half"] == "tuning"]
        best, begin = {}, Settings()
        for variant in GRID:
            begin = tune(variant, dataclasses.replace(begin, colour=variant == "colour"), arguments.data, arguments.out, names, arguments.frames)
            best[variant] = dataclasses.asdict(begin)
        (arguments.out / "settings.json").write_text(json.dumps(best, indent=2) + "\n")
        return
    settings = Settings(**json.loads((HERE / "settings.json").read_text())[arguments.variant])
    for name in arguments.only:
        folder = arguments.out / name
        if not (folder / "time.txt").exists():
            run(Recorded(arguments.data / name), settings, folder, arguments.frames)
            print(f"{name}: {float((folder / 'time.txt').read_text()):.2f} s/frame", flush=True)


if __name__ == "__main__":
    main()
