"""The estimator, scores and recordings against `run` and `score`."""

import csv
from pathlib import Path

import numpy as np
import pytest
from conftest import OBJECT, run, run_json
from PIL import Image

from mambavitact import ArgumentError, Camera, Episode, FileError, Frame, Log, Recording, Slam, TouchNetwork, score, score_poses, segment

# Cheap settings of perception and estimator, the same for the command and for Python.
SETTINGS = {"slam.map.first_steps": 30}
# The command adds noise to the true depth of a log.
COMMAND = ("--set", "camera_noise=0", "--seed", "7", "--quiet", *(f"--set={key}={value}" for key, value in SETTINGS.items()))


@pytest.fixture(scope="module")
def folder(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run on the log."""
    out = tmp_path_factory.mktemp("run") / "out"
    run("run", "--log", log.folder, "--touch-depth", "truth", "--out", out, *COMMAND)
    return out


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "trajectory.csv").open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def poses(rows: list[dict[str, str]], prefix: str) -> np.ndarray:
    result = np.tile(np.eye(4), (len(rows), 1, 1))
    for pose, row in zip(result, rows, strict=True):
        w, x, y, z = (float(row[f"{prefix}q{axis}"]) for axis in "wxyz")
        pose[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        pose[:3, 3] = [float(row[f"{prefix}{axis}_m"]) for axis in "xyz"]
    return result


def assert_same(log: Log, slam: Slam, expected: list[dict[str, str]]) -> None:
    """Compare estimates on the frames of a log with the rows of a run."""
    estimates = [slam.observe(frame) for frame in log]
    assert len(estimates) == len(expected) == 30
    # The command's poses lead from the true object's frame, to which the first estimate ties the model.
    gauge = np.linalg.inv(log.object_poses[0]) @ estimates[0].pose
    ours = np.array([estimate.pose @ np.linalg.inv(gauge) for estimate in estimates])
    # The file rounds.
    assert np.abs(ours - poses(expected, "")).max() < 2e-6
    for estimate, row in zip(estimates, expected, strict=True):
        assert abs(estimate.confidence - float(row["confidence"])) < 1e-4
        assert estimate.state == row["state"]
        assert abs(estimate.time_s - float(row["time_s"])) < 1e-5


def test_the_estimates_with_the_network_are_those_of_the_command(log: Log, tmp_path: Path) -> None:
    run("run", "--log", log.folder, "--out", tmp_path / "out", *COMMAND)
    slam = Slam(log.cameras, seed=7, network=TouchNetwork.of_runs(), settings=SETTINGS)
    assert_same(log, slam, rows(tmp_path / "out"))


def test_the_estimates_are_those_of_the_command(log: Log, folder: Path) -> None:
    slam = Slam(log.cameras, seed=7, settings=SETTINGS)
    assert_same(log, slam, rows(folder))

    mesh = slam.mesh()
    assert mesh is not None
    vertices, faces = mesh
    assert vertices.dtype == np.float32 and faces.dtype == np.uint32 and faces.max() < len(vertices)
    # The field is zero on the mesh but for the cells of the mesh, and its gradient is that of its values.
    distances = slam.distances(vertices)
    assert distances is not None and np.median(np.abs(distances)) < 5e-4
    points = vertices[::50]
    result = slam.distances_and_gradients(points)
    assert result is not None
    values, gradients = result
    same = slam.distances(points)
    assert same is not None and np.array_equal(values, same)
    step = 2e-4
    for axis in range(3):
        moved = np.eye(3)[axis] * step
        above, below = slam.distances(points + moved), slam.distances(points - moved)
        assert above is not None and below is not None
        slope = (above - below) / (2 * step)
        assert np.median(np.abs(slope - gradients[:, axis])) < 0.1


def test_scores_are_those_of_the_command(log: Log, folder: Path) -> None:
    report = run_json("score", "--mesh", folder / "mesh.ply", "--truth", OBJECT)
    assert score(folder / "mesh.ply", OBJECT) == report["shape"]
    trajectory = rows(folder)
    one_directional, symmetric = score_poses(poses(trajectory, ""), poses(trajectory, "true_"), OBJECT)
    report = run_json("score", "--run", folder)
    assert abs(one_directional.mean() - report["pose"]["add_s_mm"]["mean"]) < 1e-3
    assert abs(symmetric.mean() - report["pose"]["add_s_symmetric_mm"]["mean"]) < 1e-3


def test_a_recording_is_read(log: Log, folder: Path) -> None:
    recording = Recording(folder)
    assert (len(recording), recording.object, recording.seed, recording.status) == (30, OBJECT, 7, "finished")
    assert np.abs(recording.poses - poses(rows(folder), "")).max() < 1e-5
    assert np.abs(recording.true_poses - log.object_poses).max() < 1e-6
    assert recording.confidence.min() >= 0 and len(recording.states) == 30
    assert np.isfinite(recording.add_s_mm).all()
    images = recording.images(29)
    assert images is not None and images.frame == 27
    assert images.color[0].ndim == 3 and images.depth_m[0].ndim == 2
    mesh = recording.mesh(29)
    assert mesh is not None and mesh[0].shape[1] == 3
    assert not recording.refresh()
    with pytest.raises(ArgumentError, match="index: expected less than 30"):
        recording.images(30)
    with pytest.raises(FileError, match="no recording"):
        Recording(folder.parent)


def test_labels_are_the_true_ones_but_for_edges(log: Log) -> None:
    camera, frame = log.cameras[0], log[5]
    with Image.open(log.folder / "realsense" / camera.name / "seg" / "5.jpg") as image:
        true = np.asarray(image)
    labels = segment(camera, frame.depth_m[0], frame.joints, log.side)
    assert labels.shape == true.shape and set(np.unique(labels)) == {0, 64, 127, 255}
    assert (labels == 255).sum() > 0.7 * (true > 191).sum()
    assert (true[labels == 255] > 191).mean() > 0.99
    with pytest.raises(ArgumentError, match=r"depth_m: expected an array of dtype float32 and shape \(480, 640\)"):
        segment(camera, frame.depth_m[0][1:], frame.joints)


def test_masks_and_labels_may_be_given(log: Log) -> None:
    camera, settings = log.cameras[0], {"calibration.refine": False, "slam.map.first_steps": 10}
    frame = log[5]
    with Image.open(log.folder / "realsense" / camera.name / "seg" / "5.jpg") as image:
        labels = np.asarray(image)

    def pose(**given: list[np.ndarray]) -> np.ndarray:
        slam = Slam(log.cameras, settings=settings)
        return slam.observe(Frame(frame.time_s, frame.joints, depth_m=frame.depth_m, **given)).pose

    by_mask, by_labels = pose(masks=[labels == 255]), pose(labels=[labels])
    assert np.linalg.norm(by_mask[:3, 3] - by_labels[:3, 3]) < 0.002 and not np.array_equal(by_labels, pose())
    with pytest.raises(ArgumentError, match="masks or labels, not both"):
        pose(masks=[labels == 255], labels=[labels])
    with pytest.raises(ArgumentError, match="masks: expected one per depth image"):
        pose(masks=[labels == 255, labels == 255])
    with pytest.raises(ArgumentError, match=r"labels\[0\]: expected 0 .*, got 9"):
        pose(labels=[np.full_like(labels, 9)])
    with pytest.raises(ArgumentError, match="label image is 640 x 479 pixels; 640 x 480 expected"):
        pose(masks=[labels[1:] == 255])
    with pytest.raises(ArgumentError, match="there are no labels"):
        Slam(log.cameras, settings=settings | {"segmentation.labels": "given"}).observe(frame)


def test_cameras_alone_track_an_object_by_its_masks(log: Log) -> None:
    camera = log.cameras[0]
    slam = Slam(log.cameras, rig="none", settings={"slam.map.first_steps": 40})
    poses = []
    for k, frame in enumerate(log):
        with Image.open(log.folder / "realsense" / camera.name / "seg" / f"{k}.jpg") as image:
            mask = np.asarray(image) > 191
        estimate = slam.observe(Frame(frame.time_s, [], depth_m=frame.depth_m, color=frame.color, masks=[mask]))
        poses.append(estimate.pose)
        assert estimate.is_tracking and estimate.confidence > 0.8
        assert estimate.deviation_m is not None and 0 < estimate.deviation_m < 0.02
        assert estimate.deviation_deg is not None and 0 < estimate.deviation_deg <= 180
    true = [frame.object_pose for frame in log if frame.object_pose is not None]
    moved = np.linalg.inv(poses[0]) @ poses[-1], np.linalg.inv(true[0]) @ true[-1]
    assert abs(np.trace(moved[0][:3, :3]) - np.trace(moved[1][:3, :3])) < 0.1
    assert slam.mesh() is not None


def test_the_first_mask_is_carried_into_later_frames(log: Log) -> None:
    slam = Slam(log.cameras, rig="none", settings={"slam.map.first_steps": 40})
    tracked = []
    for k, frame in enumerate(log):
        with Image.open(log.folder / "realsense" / log.cameras[0].name / "seg" / f"{k}.jpg") as image:
            masks = [np.asarray(image) > 191] if k == 0 else []
        estimate = slam.observe(Frame(frame.time_s, [], depth_m=frame.depth_m, color=frame.color, masks=masks))
        tracked.append(estimate.is_tracking)
    assert np.mean(tracked) > 0.9


def test_frames_come_in_the_order_of_their_times(log: Log) -> None:
    slam = Slam([], modality="tac")
    slam.observe(Frame(1.0, np.zeros(16)))
    with pytest.raises(ArgumentError, match="does not come after that of 1 s"):
        slam.observe(Frame(0.5, np.zeros(16)))


def test_touch_alone_and_the_network_serve(log: Log) -> None:
    frames = list(log)
    untouched = Episode(OBJECT).untouched()
    slam = Slam([], modality="tac", network=TouchNetwork(), untouched=untouched, settings={"slam.map.first_steps": 10})
    states = {slam.observe(frame).state for frame in frames}
    assert "tracking" in states
    empty = Slam([], modality="tac")
    assert empty.observe(Frame(0.0, np.zeros(16))).state == "waiting"
    assert empty.mesh() is None and empty.distances(np.zeros((1, 3))) is None


def test_wrong_arguments_are_named(log: Log) -> None:
    joints = np.zeros(16)
    with pytest.raises(ArgumentError, match="did you mean slam.map.batch"):
        Slam([], settings={"slam.map.batsh": 3})
    with pytest.raises(ArgumentError, match="mesh_cell_mm has no effect here"):
        Slam([], settings={"mesh_cell_mm": 2.0})
    with pytest.raises(ArgumentError, match="modality: expected vitac, vi or tac"):
        Slam([], modality="audio")
    with pytest.raises(ArgumentError, match="3 x 2 pixels|640 x 480"):
        Slam(log.cameras).observe(Frame(0.0, joints, depth_m=[np.ones((2, 3))]))
    with pytest.raises(ArgumentError, match=r"depth_m\[1\]: expected finite"):
        Frame(0.0, joints, depth_m=[np.ones((2, 3)), np.full((2, 3), np.nan)])
    with pytest.raises(ArgumentError, match=r"depth_m\[0\]: expected .*shape \(N, N\), got .*shape \(2, 3, 1\)"):
        Frame(0.0, joints, depth_m=[np.ones((2, 3, 1))])
    with pytest.raises(ArgumentError, match="time_s"):
        Frame(float("nan"), joints)
    with pytest.raises(ArgumentError, match="both indentation_mm and contact"):
        Frame(0.0, joints, contact=np.zeros((4, 320, 240), bool))
    with pytest.raises(ArgumentError, match="contact: expected an array of dtype bool"):
        Frame(0.0, joints, contact=np.zeros((4, 320, 240)), indentation_mm=np.zeros((4, 320, 240)))
    with pytest.raises(ArgumentError, match="no touch images"):
        Slam([], network=TouchNetwork()).observe(Frame(0.0, joints))
    with pytest.raises(ArgumentError, match="focal lengths"):
        Camera("a", 3, 2, np.zeros((3, 3)), np.eye(4))
    with pytest.raises(ArgumentError, match="pose is"):
        Camera("a", 3, 2, np.eye(3), -np.eye(4))
    with pytest.raises(ArgumentError, match="points: expected"):
        Slam([]).distances(np.zeros((3, 2)))
    with pytest.raises(ArgumentError, match=r"true_poses: expected .* \(2, 4, 4\), got .*\(1, 4, 4\)"):
        score_poses(np.tile(np.eye(4), (2, 1, 1)), np.eye(4)[None], OBJECT)
    with pytest.raises(FileError):
        Log("missing")
