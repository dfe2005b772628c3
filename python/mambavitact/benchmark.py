"""Compares estimators of pose and shape on the same frames. `suites()` names sets of logs that `run` simulates.

    from mambavitact import benchmark

    suite = benchmark.suites()["procedural"]
    results = benchmark.run("ours", benchmark.OurSlam, suite, "logs")
    results += benchmark.run("mine", MyEstimator, suite, "logs")
    print(benchmark.table(results))
    benchmark.write(results, "results.jsonl")      # `mambavitact report` reads the folder of this file

An estimator receives a `Setup` once and then every frame of a log. It never receives the true pose or the true shape.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._native import Camera, Episode, Frame, Log, Slam, TouchNetwork, score, score_poses, version
from .errors import ArgumentError, Error, FileError

__all__ = ["Estimator", "OurSlam", "Result", "Setup", "Suite", "SuiteLog", "run", "suites", "table", "write"]

Touch = Literal["images", "depth", "none"]
"""The data of the fingers: images of the DIGITs, the true indentation of the gels, or nothing."""

Mesh = tuple[ArrayLike, ArrayLike]
"""Vertices (N, 3), metres, and faces (M, 3), indices of vertices."""

_TOUCH = ("images", "depth", "none")
_SHOWN_MM = (2, 5)
# As `mambavitact` checks poses.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Setup:
    """The knowledge of an estimator before the first frame."""

    cameras: list[Camera]
    """Intrinsics and extrinsics of the cameras, in the order of the images of a frame."""
    side: str
    """Hand: left or right."""
    seed: int
    """Seed for an estimator that draws random numbers."""
    touch: Touch
    """The data of the fingers."""
    untouched: NDArray[np.uint8] | None
    """Image of each DIGIT without contact, uint8 (4, 320, 240, 3), with touch `images`; otherwise None."""


class Estimator(Protocol):
    """Estimates pose and shape of one object, frame by frame."""

    def estimate(self, frame: Frame) -> ArrayLike | None:
        """Return the pose (4, 4) in a frame.

        The pose takes coordinates of `mesh` to the world. The first pose ties these coordinates to the true object, so
        that any choice of them is as good as another. None means that no pose is known. Before the first pose, such a
        frame has no error. Later it has the error of the last pose.
        """
        ...

    def mesh(self) -> Mesh | None:
        """Return the shape after the last frame: vertices (N, 3) in metres and faces (M, 3). None if it is unknown."""
        ...


class OurSlam:
    """Our own SLAM as an estimator. `settings` are keys and values as of `mambavitact run --set`."""

    def __init__(self, setup: Setup, settings: Mapping[str, Any] | None = None) -> None:
        """Start without knowledge of the object."""
        self._slam = Slam(
            setup.cameras,
            side=setup.side,
            seed=setup.seed,
            modality="vi" if setup.touch == "none" else "vitac",
            network=TouchNetwork.of_runs() if setup.touch == "images" else None,
            untouched=setup.untouched,
            settings=settings or {},
        )

    def estimate(self, frame: Frame) -> NDArray[np.float64] | None:
        """Return the pose; None while the object is lost or not yet seen."""
        estimate = self._slam.observe(frame)
        return estimate.pose if estimate.is_tracking else None

    def mesh(self) -> Mesh | None:
        """Return the shape; None if nothing was seen."""
        mesh = self._slam.mesh()
        return mesh if mesh is not None and len(mesh[1]) > 0 else None


@dataclass(frozen=True)
class SuiteLog:
    """An episode of a suite."""

    object: str
    """A name that `mambavitact assets list` shows, or `random:SEED`."""
    seed: int = 0
    """Seed of the episode: `mambavitact simulate --seed` plays it."""
    cameras: str = "front-left"
    """Places of cameras with commas between, as of `mambavitact generate --cameras`."""

    def __str__(self) -> str:
        """Return words that name the episode."""
        return f"{self.object}, seed {self.seed}, {self.cameras}"


@dataclass(frozen=True)
class Suite:
    """A fixed set of episodes, of which estimators receive the same frames."""

    logs: tuple[SuiteLog, ...]
    """The episodes."""
    duration_s: float = 30.0
    """Longest duration of an episode, seconds. An episode ends earlier if the object falls."""
    touch: Touch = "images"
    """The data of the fingers."""

    def __post_init__(self) -> None:
        """Refuse a suite that cannot be run."""
        if not self.logs:
            raise ArgumentError("logs: expected at least one SuiteLog, got none")
        if self.touch not in _TOUCH:
            raise ArgumentError(f"touch: expected {', '.join(_TOUCH)}, got {self.touch!r}")


def suites() -> dict[str, Suite]:
    """Return the suites of this package.

    - `procedural`: ten episodes that need no download. The camera `side` sees little, because the fingers hide the object.
    - `ycb`: ten episodes with YCB objects, which are downloaded.
    - `tuning`: three other episodes. Choose the settings of an estimator by these, and by no result of the other suites.
    """
    sides = ("front-left", "side")
    procedural = ("cube70", "large_dice", "soup_can", "pear", "bell_pepper", *(f"random:{seed}" for seed in range(1000, 1005)))
    ycb = (
        "077_rubiks_cube",
        "005_tomato_soup_can",
        "016_pear",
        "010_potted_meat_can",
        "013_apple",
        "061_foam_brick",
        "065-g_cups",
        "055_baseball",
        "015_peach",
        "017_orange",
    )

    def of(objects: Sequence[str], seed: int) -> Suite:
        # Both cameras see objects of both kinds.
        return Suite(tuple(SuiteLog(name, seed, sides[k % len(sides)]) for k, name in enumerate(objects)))

    return {
        "procedural": of(procedural, 0),
        "ycb": of(ycb, 0),
        "tuning": of(("rubiks_cube_small", "random:0", "random:1"), 100),
    }


@dataclass(frozen=True)
class Result:
    """Scores of an estimator on an episode, as `mambavitact evaluate` defines them."""

    estimator: str
    """Name of the estimator."""
    log: SuiteLog
    """The episode."""
    touch: Touch
    """The data of the fingers."""
    settings: str
    """SHA-256 of the settings of the frames, hexadecimal: results with the same one can be compared."""
    frames: int
    """Number of frames."""
    frames_without_pose: int
    """Number of frames for which the estimator returned None."""
    f_score: dict[int, float] = field(default_factory=dict)
    """F-score of the shape by threshold in millimetres, from 10,000 points; empty without a shape."""
    f_score_fine: dict[int, float] = field(default_factory=dict)
    """The same from 100,000 points."""
    add_s_mm: dict[str, float] | None = None
    """One-directional ADD-S, millimetres: mean, median, p95 and final; None if the estimator returned no pose."""
    rotation_deg: dict[str, float] | None = None
    """Angle between the estimated and the true rotation, degrees, likewise."""
    frames_per_second: float = 0.0
    """Speed of `estimate`."""

    def line(self) -> dict[str, Any]:
        """Return the result as a line of the tables that `mambavitact evaluate` writes."""
        return {
            "object": self.log.object,
            "seed": self.log.seed,
            "cameras": self.log.cameras,
            "mode": "slam",
            "modality": "vi" if self.touch == "none" else "vitac",
            "variant": self.estimator,
            "settings": self.settings,
            "frames": self.frames,
            "f_score": self.f_score,
            "f_score_fine": self.f_score_fine,
            "add_s_mm": self.add_s_mm,
            "rotation_deg": self.rotation_deg,
            "lost_frames": self.frames_without_pose,
            "frames_per_second": self.frames_per_second,
        }


def run(
    name: str,
    estimator_factory: Callable[[Setup], Estimator],
    suite: Suite,
    folder: str | os.PathLike[str],
) -> list[Result]:
    """Run an estimator on all episodes of a suite, and score it.

    `name` names the estimator in tables. `estimator_factory` makes one from a `Setup`, anew for each episode. `folder`
    keeps the logs: one that is complete there is used again. A log of 30 s takes some 110 MB.
    """
    if not name:
        raise ArgumentError("name: expected a name of the estimator, got an empty one")
    results = []
    for number, log in enumerate(suite.logs, 1):
        place = f"{number}/{len(suite.logs)} {log}"
        _show(f"{place}: simulating")
        recorded = _recorded(log, suite.duration_s, Path(folder))
        results.append(_result(name, estimator_factory, suite, log, recorded, place))
    _show("")
    return results


def table(results: Sequence[Result]) -> str:
    """Return the results as a table in Markdown, with the means of each estimator at the end."""
    head = "| episode | touch | estimator | F@2 | F@5 | ADD-S, mm | rotation, degrees | frames | without pose | frames/s |"
    rows = [head, "|---|---|---|" + "---:|" * 7]
    order = {log: k for k, log in reversed([*enumerate(result.log for result in results)])}
    for result in sorted(results, key=lambda result: order[result.log]):
        rows.append(_row(str(result.log), [result]))
    for kind in dict.fromkeys((result.touch, result.estimator) for result in results):
        of_kind = [result for result in results if (result.touch, result.estimator) == kind]
        rows.append(_row(f"mean of {len(of_kind)}", of_kind))
    return "\n".join(rows) + "\n"


def write(results: Sequence[Result], file: str | os.PathLike[str]) -> None:
    """Write the results as JSON lines, in a folder that is made if it is missing.

    `mambavitact report` reads the tables in a folder whose names end in .jsonl.
    """
    path = Path(file)
    # The file appears under its name only when it is complete.
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_text("".join(json.dumps(result.line()) + "\n" for result in results))
        unfinished.replace(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def _recorded(log: SuiteLog, duration_s: float, folder: Path) -> Log:
    """Return the log of an episode, simulated by the program unless it is complete."""
    # Another version may simulate other frames.
    words = f"{version()} {log.object} {log.seed} {log.cameras} {duration_s:g}"
    out = folder / re.sub(r"[^\w.-]+", "_", words)
    # Touch and depth have the noise of sensors.
    # Suites stay the same when a policy learns to move their objects.
    arguments = ["--controller=suited", "--logs=1", "--noise=full", "--format=compact", f"--object={log.object}", f"--seed={log.seed}"]
    arguments += [f"--cameras={log.cameras}", f"--duration={duration_s}", f"--out={out}"]
    command = [sys.executable, "-m", "mambavitact", "generate", *arguments]
    # The program of this package is started, also where the current folder has modules of the same names.
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    found = [scene.parent for scene in out.glob("*/00/scene.json")]
    if done.returncode != 0:
        # Of the program, or of its reader of arguments.
        errors = re.findall(r"^(?:ERROR |error: )(.*)$", done.stderr, re.MULTILINE)
        raise Error(f"{log}: the episode cannot be simulated in {out}: {' '.join(errors) or done.stderr.strip()}")
    if len(found) != 1:
        raise Error(f"{log}: {out} contains {len(found)} logs instead of one: remove it")
    return Log(found[0])


def _result(
    name: str,
    factory: Callable[[Setup], Estimator],
    suite: Suite,
    log: SuiteLog,
    recorded: Log,
    place: str,
) -> Result:
    untouched = Episode(log.object).untouched() if suite.touch == "images" else None
    estimator = factory(Setup(recorded.cameras, recorded.side, log.seed, suite.touch, untouched))
    poses: list[NDArray[np.float64]] = []
    first = without_pose = 0
    spent_s = 0.0
    for number, frame in enumerate(recorded):
        sensed = _sensed(frame, suite.touch)
        begun = time.perf_counter()
        value = estimator.estimate(sensed)
        spent_s += time.perf_counter() - begun
        if value is not None:
            first = number if not poses else first
            poses.append(_checked(value, f"{log}, frame {number}"))
        else:
            without_pose += 1
            poses += poses[-1:]
        if number % 10 == 0:
            _show(f"{place}: {name}, frame {number} of {len(recorded)}")
    true_poses = recorded.object_poses[first:]
    result: dict[str, Any] = {}
    if poses:
        result = _scores(np.array(poses), true_poses, estimator.mesh(), log)
    return Result(
        estimator=name,
        log=log,
        touch=suite.touch,
        settings=hashlib.sha256(f"{version()} {suite.duration_s:g} {suite.touch}".encode()).hexdigest(),
        frames=len(recorded),
        frames_without_pose=without_pose,
        frames_per_second=len(recorded) / spent_s if spent_s > 0.0 else 0.0,
        **result,
    )


def _sensed(frame: Frame, touch: Touch) -> Frame:
    """Return the sensors' data of a frame, and nothing else of the log."""
    pressed: dict[str, Any] = {}
    if touch == "images":
        pressed = {"touch_images": frame.touch_images}
    elif touch == "depth":
        pressed = {"indentation_mm": frame.indentation_mm, "contact": frame.contact}
    return Frame(frame.time_s, frame.joints, depth_m=frame.depth_m, color=frame.color, **pressed)


def _checked(value: ArrayLike, place: str) -> NDArray[np.float64]:
    """Refuse an invalid pose."""
    try:
        pose = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{place}: expected a pose of numbers, got {type(value).__name__}") from error
    if pose.shape != (4, 4):
        raise ArgumentError(f"{place}: expected a pose of shape (4, 4), got {pose.shape}")
    if not np.isfinite(pose).all():
        raise ArgumentError(f"{place}: expected a pose of finite numbers, got one with NaN or infinity")
    if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise ArgumentError(f"{place}: expected a pose with the last row 0 0 0 1, got {pose[3]}")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise ArgumentError(f"{place}: expected a rotation in the upper left 3 x 3 part of the pose, got {rotation.tolist()}")
    # The nearest rotation, so that products remain poses.
    left, _, right = np.linalg.svd(rotation)
    pose[:3, :3] = left @ right
    return pose


def _inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a pose, with a last row that is exactly 0 0 0 1."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def _scores(
    poses: NDArray[np.float64], true_poses: NDArray[np.float64], mesh: Mesh | None, log: SuiteLog
) -> dict[str, Any]:
    """Return the scores of poses and shape."""
    # A choice of coordinates, made once, at the first pose.
    gauge = _inverse(true_poses[0]) @ poses[0]
    estimated = poses @ _inverse(gauge)
    errors_mm, _ = score_poses(estimated, true_poses, log.object)
    turns = np.swapaxes(true_poses[:, :3, :3], 1, 2) @ estimated[:, :3, :3]
    # From the sine and the cosine of the angle, so that small ones are exact.
    sines = np.linalg.norm(turns - np.swapaxes(turns, 1, 2), axis=(1, 2)) / np.sqrt(8.0)
    angles_deg = np.degrees(np.arctan2(sines, (np.trace(turns, axis1=1, axis2=2) - 1.0) / 2.0))
    result: dict[str, Any] = {"add_s_mm": _statistics(errors_mm), "rotation_deg": _statistics(angles_deg)}
    if mesh is not None:
        try:
            report = score(mesh, log.object, _inverse(true_poses[-1]) @ poses[-1])
        except ArgumentError as error:
            raise ArgumentError(f"{log}: {error}") from error
        for key, part in (("f_score", "original"), ("f_score_fine", "fine")):
            result[key] = {round(row["threshold_mm"]): row["f"] for row in report[part]["scores"]}
    return result


def _statistics(errors: NDArray[np.float64]) -> dict[str, float]:
    """Return mean, median, p95 and the last of the errors of a run."""
    return {
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "p95": float(np.quantile(errors, 0.95)),
        "final": float(errors[-1]),
    }


def _row(words: str, results: Sequence[Result]) -> str:
    """Return a line of the table: the means of some results of one estimator."""

    def mean(values: Sequence[float | None], digits: int) -> str:
        known = [value for value in values if value is not None]
        # As in `evaluate`: where one result lacks a value, there is no mean.
        return f"{np.mean(known):.{digits}f}" if len(known) == len(values) else "-"

    add_s = [None if result.add_s_mm is None else result.add_s_mm["mean"] for result in results]
    rotation = [None if result.rotation_deg is None else result.rotation_deg["mean"] for result in results]
    cells = [words, results[0].touch, results[0].estimator]
    cells += [mean([result.f_score.get(mm) for result in results], 3) for mm in _SHOWN_MM]
    cells += [mean(add_s, 2), mean(rotation, 1)]
    cells += [f"{np.mean([result.frames for result in results]):.0f}"]
    cells += [f"{np.mean([result.frames_without_pose for result in results]):.1f}"]
    cells += [f"{np.mean([result.frames_per_second for result in results]):.1f}"]
    return "| " + " | ".join(cells) + " |"


def _show(words: str) -> None:
    """Show the progress, where a person can see it."""
    if sys.stderr.isatty():
        print(f"\r\033[K{words}", end="", file=sys.stderr, flush=True)
