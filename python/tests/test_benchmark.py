"""The benchmark against scores computed by hand, and against `run`."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import OBJECT, run
from numpy.typing import ArrayLike, NDArray

from mambavitact import ArgumentError, Episode, Error, Frame, Log, benchmark
from mambavitact.benchmark import OurSlam, Result, Setup, Suite, SuiteLog

LOG = SuiteLog(OBJECT, seed=3)
SUITE = Suite((LOG,), duration_s=1.0, touch="depth")
# Cheap settings, the same for the command and for Python.
SETTINGS = {"camera_noise": 0, "calibration.refine": "false", "slam.map.first_steps": 30}
OURS = {"calibration.refine": False, "slam.map.first_steps": 30}


class Script:
    """An estimator that follows a script, and keeps all that it receives."""

    def __init__(self, pose: Callable[[int], ArrayLike | None], mesh: benchmark.Mesh | None = None) -> None:
        self.pose, self.shape = pose, mesh
        self.setups: list[Setup] = []
        self.frames: list[Frame] = []

    def __call__(self, setup: Setup) -> "Script":
        self.setups.append(setup)
        return self

    def estimate(self, frame: Frame) -> ArrayLike | None:
        self.frames.append(frame)
        return self.pose(len(self.frames) - 1)

    def mesh(self) -> benchmark.Mesh | None:
        return self.shape


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the logs."""
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def naive(folder: Path) -> Result:
    """An estimator that keeps an arbitrary first pose."""
    pose = np.array([[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
    (result,) = benchmark.run("naive", lambda _: Script(lambda _: pose), SUITE, folder)
    return result


@pytest.fixture(scope="module")
def recorded(naive: Result, folder: Path) -> Log:
    """The log that the naive estimator made."""
    (scene,) = folder.glob("*/*/00/scene.json")
    return Log(scene.parent)


def corners(pose: NDArray[np.float64], half_m: float) -> NDArray[np.float64]:
    """Points on the faces of a cube, moved."""
    line = (np.arange(30) + 0.5) / 15 - 1
    first, second = (grid.ravel() for grid in np.meshgrid(line, line))
    faces = [np.insert(np.stack([first, second], 1), axis, side, axis=1) for axis in range(3) for side in (-1, 1)]
    points: NDArray[np.float64] = half_m * np.concatenate(faces) @ pose[:3, :3].T + pose[:3, 3]
    return points


def test_a_resting_pose_has_the_errors_that_its_definition_gives(naive: Result, recorded: Log) -> None:
    # The mean distance of points on the estimated cube to the surface of the true one, which has a closed form.
    half_m = float(np.abs(Episode(OBJECT).mesh[0]).max())
    poses = recorded.object_poses
    errors = []
    for pose in poses:
        inside = (corners(poses[0], half_m) - pose[:3, 3]) @ pose[:3, :3]
        excess = np.abs(inside) - half_m
        outside = np.linalg.norm(np.maximum(excess, 0), axis=1)
        errors.append(1e3 * np.abs(outside + np.minimum(excess.max(axis=1), 0)).mean())
    assert naive.add_s_mm is not None and naive.frames == len(poses) == 30
    # `score_poses` measures to the nearest of 10,000 points, which lie some 1.7 mm apart.
    assert errors[-1] > 1.0, "the cube moves"
    assert naive.add_s_mm["final"] == pytest.approx(errors[-1], abs=0.6)
    assert naive.add_s_mm["mean"] == pytest.approx(np.mean(errors), abs=0.9)
    assert naive.f_score == {} and naive.frames_without_pose == 0


def test_the_truth_is_exact_and_none_holds_the_last_pose(naive: Result, recorded: Log, folder: Path) -> None:
    truth = recorded.object_poses
    mesh = Episode(OBJECT).mesh
    (known,) = benchmark.run("known", lambda _: Script(lambda k: truth[k], mesh), SUITE, folder)
    assert known.add_s_mm is not None and known.f_score[5] > 0.999 and known.f_score_fine[2] > 0.999
    # The points of both surfaces are the same, but for the rounding of the mesh.
    assert known.add_s_mm["mean"] < 0.01
    # Frames before the first pose have no error; those after it that of the last pose.
    late = Script(lambda k: None if k < 20 or k > 20 else truth[k])
    (held,) = benchmark.run("late", late, SUITE, folder)
    resting = Script(lambda k: truth[20] if k >= 20 else None)
    (same,) = benchmark.run("late", resting, SUITE, folder)
    assert (held.frames_without_pose, same.frames_without_pose) == (29, 20)
    assert held.add_s_mm == same.add_s_mm
    (nothing,) = benchmark.run("nothing", Script(lambda _: None, mesh), SUITE, folder)
    assert nothing.add_s_mm is None and nothing.f_score == {} and nothing.frames_without_pose == 30


def test_ours_has_the_scores_of_the_command_and_beats_the_naive_one(naive: Result, recorded: Log, folder: Path, tmp_path: Path) -> None:
    (ours,) = benchmark.run("ours", lambda setup: OurSlam(setup, OURS), SUITE, folder)
    assert ours.add_s_mm is not None and naive.add_s_mm is not None
    assert ours.rotation_deg is not None and naive.rotation_deg is not None
    assert ours.add_s_mm["mean"] < 0.7 * naive.add_s_mm["mean"]
    words = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    out = tmp_path / "out"
    run("run", "--log", recorded.folder, "--touch-depth", "truth", "--seed", "3", "--out", out, "--quiet", *words)
    summary = json.loads((out / "summary.json").read_text())
    assert ours.frames == summary["frames"] and ours.frames_without_pose == summary["lost_frames"]
    for key in ("mean", "median", "p95", "final"):
        assert ours.add_s_mm[key] == pytest.approx(summary["add_s_mm"][key], abs=1e-3)
        assert ours.rotation_deg[key] == pytest.approx(summary["rotation_deg"][key], abs=1e-3)
    for mm in (1, 2, 5):
        assert ours.f_score[mm] == pytest.approx(summary["f_score"][str(mm)], abs=1e-3)
        assert ours.f_score_fine[mm] == pytest.approx(summary["f_score_fine"][str(mm)], abs=1e-3)

    # Tables for people, and lines for `report`.
    table = benchmark.table([naive, ours])
    assert f"| {LOG} | depth | naive | - | - | {naive.add_s_mm['mean']:.2f} | {naive.rotation_deg['mean']:.1f} | 30 | 0.0 |" in table
    assert f"| mean of 1 | depth | ours | {ours.f_score[2]:.3f} |" in table
    benchmark.write([naive, ours], tmp_path / "lines" / "results.jsonl")
    report = tmp_path / "report.html"
    run("report", tmp_path / "lines", "--out", report)
    text = report.read_text()
    assert "slam · vitac · front-left · naive" in text and "slam · vitac · front-left · ours" in text


@pytest.mark.parametrize(
    ("touch", "has_images", "has_depth"), [("images", True, False), ("depth", False, True), ("none", False, False)]
)
def test_an_estimator_receives_what_sensors_deliver(
    touch: benchmark.Touch, has_images: bool, has_depth: bool, recorded: Log, folder: Path
) -> None:
    script = Script(lambda _: np.eye(4))
    benchmark.run("reader", script, Suite((LOG,), duration_s=1.0, touch=touch), folder)
    (setup,) = script.setups
    assert vars(setup).keys() == {"cameras", "side", "seed", "touch", "untouched"}
    assert [camera.name for camera in setup.cameras] == ["front-left"] and setup.touch == touch
    assert (setup.untouched is not None) == has_images
    for frame, stored in zip(script.frames, recorded, strict=True):
        assert stored.object_pose is not None and frame.object_pose is None
        assert (frame.touch_images is not None) == has_images
        assert (frame.indentation_mm is not None) == (frame.contact is not None) == has_depth
        assert frame.time_s == stored.time_s and np.array_equal(frame.joints, stored.joints)
        assert np.array_equal(frame.depth_m[0], stored.depth_m[0]) and np.array_equal(frame.color[0], stored.color[0])


SCALED = np.diag([1.1, 1.0, 1.0, 1.0])
MIRRORED = np.diag([-1.0, 1.0, 1.0, 1.0])
LAST_ROW = np.eye(4) + np.diag([0, 0, 0, 0.5])


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.full((4, 4), np.nan), "finite numbers"),
        (np.eye(3), r"shape \(4, 4\), got \(3, 3\)"),
        (SCALED, "expected a rotation"),
        (MIRRORED, "expected a rotation"),
        (LAST_ROW, "last row"),
        ("forward", "pose of numbers, got str"),
    ],
)
def test_what_is_no_pose_is_refused_with_the_name_of_the_frame(value: ArrayLike, words: str, naive: Result, folder: Path) -> None:
    wrong = Script(lambda k: value if k == 2 else np.eye(4))
    with pytest.raises(ArgumentError, match=f"cube70, seed 3, front-left, frame 2: .*{words}"):
        benchmark.run("wrong", wrong, SUITE, folder)


def test_other_bad_input_is_named(naive: Result, folder: Path, tmp_path: Path) -> None:
    still = Script(lambda _: np.eye(4), (np.zeros((3, 3)), [[0, 1, 2]]))
    with pytest.raises(ArgumentError, match="cube70, seed 3, front-left: mesh: its surface has no area"):
        benchmark.run("flat", still, SUITE, folder)
    with pytest.raises(ArgumentError, match="at least one SuiteLog"):
        Suite(())
    with pytest.raises(ArgumentError, match="touch: expected images, depth, none, got 'sound'"):
        Suite((LOG,), touch="sound")  # type: ignore[arg-type]
    with pytest.raises(Error, match="cub, seed 0, front-left: the episode cannot be simulated in .*: unknown object .*cube70"):
        benchmark.run("ours", OurSlam, Suite((SuiteLog("cub"),)), tmp_path)
    with pytest.raises(Error, match="cannot be simulated in .*: invalid value .*--duration"):
        benchmark.run("ours", OurSlam, Suite((LOG,), duration_s=-1.0), tmp_path)
    with pytest.raises(ArgumentError, match="name: expected"):
        benchmark.run("", OurSlam, SUITE, folder)


def test_complete_logs_are_used_again(naive: Result, recorded: Log, folder: Path) -> None:
    archive = recorded.folder / "frames.zip"
    before = archive.stat().st_mtime_ns
    benchmark.run("again", Script(lambda _: np.eye(4)), SUITE, folder)
    assert archive.stat().st_mtime_ns == before


def test_the_suites_are_those_of_the_catalogue() -> None:
    suites = benchmark.suites()
    assert {name: len(suite.logs) for name, suite in suites.items()} == {"procedural": 10, "ycb": 10, "tuning": 3}
    known = run("assets", "list")
    for name, suite in suites.items():
        for log in suite.logs:
            assert log.object.startswith("random:") or f"{log.object} " in known
            assert (name == "ycb") == log.object[0].isdigit()
    # No compared log is used for tuning.
    assert not {log.object for log in suites["tuning"].logs} & {log.object for log in suites["procedural"].logs}
