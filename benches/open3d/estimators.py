"""Pipelines of Open3D as estimators of `mambavitact.benchmark`: ICP with a TSDF volume for unknown shapes, ICP against the true mesh for known ones.

All use the first camera, the labels of our own segmentation, and no touch.
"""

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from mambavitact import segment

registration = o3d.pipelines.registration
integration = o3d.pipelines.integration

# From a camera that looks along -z to one that looks along z, as Open3D's.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
OBJECT = 255
FEWEST_POINTS = 50
# Edge of the cube around the first points in which a shape is mapped: no object of the hand is longer than 0.13 m.
VOLUME_M = 0.24


@dataclass(frozen=True)
class Settings:
    """Settings that `compare.py --tune` chooses."""

    colour: bool = False
    """Coloured ICP in place of point-to-plane."""
    voxel_mm: float = 2.0
    """Edge of the cells of the TSDF volume, and of those that thin out the points of a frame."""
    truncation_mm: float = 8.0
    """Truncation of the TSDF volume."""
    distance_mm: float = 10.0
    """Greatest distance of two points that correspond; a second pass takes a third of it."""
    kernel_mm: float = 3.0
    """Residual beyond which Tukey's loss ignores a point; 0 for least squares. Not for coloured ICP, which has its own weights."""
    velocity: float = 1.0
    """Share of the last motion that the prediction repeats."""
    geometry: float = 0.968
    """Weight of the geometry in coloured ICP."""
    fitness: float = 0.5
    """Least share of points with a correspondence with which a pose is trusted."""


class View:
    """The camera's points of the object."""

    def __init__(self, setup, settings):
        self.camera, self.side, self.settings = setup.cameras[0], setup.side, settings
        k = self.camera.intrinsics
        self.pinhole = o3d.camera.PinholeCameraIntrinsic(self.camera.width, self.camera.height, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        self.camera_from_world = FLIP @ np.linalg.inv(self.camera.pose)

    def image(self, frame):
        """Returns colours and depth of the object alone."""
        depth = frame.depth_m[0].copy()
        depth[segment(self.camera, depth, frame.joints, self.side) != OBJECT] = 0.0
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(frame.color[0])),
            o3d.geometry.Image(depth),
            depth_scale=1.0,
            depth_trunc=10.0,
            convert_rgb_to_intensity=False,
        )

    def points(self, image):
        """Returns the points of the object in the world, thinned out."""
        points = o3d.geometry.PointCloud.create_from_rgbd_image(image, self.pinhole, self.camera_from_world)
        return points.voxel_down_sample(1e-3 * self.settings.voxel_mm)


class Tracker:
    """Poses of a frame by ICP, from the pose that the last motion predicts."""

    def __init__(self, settings, pose):
        self.settings, self.pose, self.motion = settings, pose, np.eye(4)

    def step(self, points, model):
        """Returns whether the points fit to the model, and moves the pose if so."""
        predicted = share(self.motion, self.settings.velocity) @ self.pose
        if len(points.points) >= FEWEST_POINTS:
            model_from_world = np.linalg.inv(predicted)
            for divisor in (1.0, 3.0):
                found = self.register(points, model, 1e-3 * self.settings.distance_mm / divisor, model_from_world)
                if found is None:
                    break
                model_from_world = found.transformation
            # The first distance decides about trust, so that the settings of the second do not.
            fit = registration.evaluate_registration(points, model, 1e-3 * self.settings.distance_mm, model_from_world)
            if found is not None and fit.fitness >= self.settings.fitness:
                pose = np.linalg.inv(model_from_world)
                self.motion, self.pose = pose @ np.linalg.inv(self.pose), pose
                return True
        self.motion = np.eye(4)
        return False

    def register(self, points, model, distance, start):
        """Returns the result of ICP; None without correspondences of colour."""
        criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, 30)
        if self.settings.colour:
            method = registration.TransformationEstimationForColoredICP(self.settings.geometry)
            try:
                return registration.registration_colored_icp(points, model, distance, start, method, criteria)
            except RuntimeError:
                return None
        kernel = self.settings.kernel_mm
        method = registration.TransformationEstimationPointToPlane(*([registration.TukeyLoss(1e-3 * kernel)] if kernel > 0.0 else []))
        return registration.registration_icp(points, model, distance, start, method, criteria)


class Slam:
    """Frame-to-model ICP with TSDF integration. The model's coordinates are those of the world in the first frame."""

    def __init__(self, setup, settings):
        self.view, self.settings, self.tracker, self.volume = View(setup, settings), settings, None, None

    def estimate(self, frame):
        image = self.view.image(frame)
        points = self.view.points(image)
        if self.tracker is None:
            if len(points.points) < FEWEST_POINTS:
                return None
            self.tracker = Tracker(self.settings, np.eye(4))
            # ScalableTSDFVolume of Open3D 0.20 stays empty.
            self.volume = integration.UniformTSDFVolume(
                VOLUME_M,
                round(1e3 * VOLUME_M / self.settings.voxel_mm),
                1e-3 * self.settings.truncation_mm,
                integration.TSDFVolumeColorType.RGB8,
                origin=points.get_center() - VOLUME_M / 2.0,
            )
        elif not self.tracker.step(points, self.volume.extract_point_cloud()):
            return None
        self.volume.integrate(image, self.view.pinhole, self.view.camera_from_world @ self.tracker.pose)
        return self.tracker.pose

    def mesh(self):
        if self.volume is None:
            return None
        mesh = self.volume.extract_triangle_mesh()
        clusters, counts, _ = (np.asarray(values) for values in mesh.cluster_connected_triangles())
        if len(counts) == 0:
            return None
        # Specks that noise leaves beside the object.
        mesh.remove_triangles_by_mask(counts[clusters] < 0.05 * counts.max())
        mesh.remove_unreferenced_vertices()
        return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


class KnownShape:
    """ICP against points of the true mesh, from the true pose in the first frame."""

    def __init__(self, setup, settings, mesh, first_pose):
        self.view, self.first_pose, self.tracker, self.settings = View(setup, settings), first_pose, None, settings
        vertices, faces = mesh
        surface = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(vertices.astype(float)), o3d.utility.Vector3iVector(faces.astype(np.int32))
        )
        surface.compute_triangle_normals()
        o3d.utility.random.seed(setup.seed)
        self.model = surface.sample_points_uniformly(50_000, use_triangle_normal=True)

    def estimate(self, frame):
        if self.tracker is None:
            self.tracker = Tracker(self.settings, self.first_pose)
            return self.first_pose
        return self.tracker.pose if self.tracker.step(self.view.points(self.view.image(frame)), self.model) else None

    def mesh(self):
        return None


def share(motion, part):
    """Returns a part of a rigid motion."""
    if part == 0.0:
        return np.eye(4)
    if part == 1.0:
        return motion
    result = np.eye(4)
    turn = o3d.geometry.get_rotation_matrix_from_axis_angle
    cosine = np.clip((np.trace(motion[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)
    axis = np.array([motion[2, 1] - motion[1, 2], motion[0, 2] - motion[2, 0], motion[1, 0] - motion[0, 1]])
    length = np.linalg.norm(axis)
    result[:3, :3] = turn(axis * (np.arccos(cosine) * part / length if length > 1e-12 else 0.0))
    result[:3, 3] = part * motion[:3, 3]
    return result
