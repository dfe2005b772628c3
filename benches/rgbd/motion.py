"""Motions of object, holder and camera. World: z up, the table is z = 0, the object stands at the origin first."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

HZ = 30.0
STILL_S = 1.0
HIDDEN_S = (4.5, 6.5)
# Time in which a board moves in front of the object, and out again.
PASS_S = 0.5


@dataclass
class Motion:
    """Poses of all frames, and what holds the object."""

    world_from_object: np.ndarray
    world_from_camera: np.ndarray
    holder: str = "none"
    grip: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """How far the holder has closed, 0 (out of the picture) to 1, per frame."""
    cover: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """How far the cover has passed, 0 (not there yet), 1 (before the object) to 2 (gone), per frame."""
    wobble: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Turn of the hand against the camera as a rotation vector, per frame."""


def step(x):
    """Returns a smooth step from 0 at 0 to 1 at 1."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def waves(rng, times, columns, low_hz, high_hz, count=3):
    """Returns smooth random functions of time with about unit amplitude."""
    hz = rng.uniform(low_hz, high_hz, (count, columns))
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, columns))
    parts = np.sin(2.0 * np.pi * hz * times[:, None, None] + phase) * rng.uniform(0.5, 1.0, (count, columns))
    return parts.sum(1) / np.sqrt(0.5 * count)


def look_at(eye, target):
    """Returns the pose of a camera with OpenCV axes."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
    return pose


def away(azimuth, elevation):
    """Returns the direction with an azimuth and elevation, radians."""
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def rotations(rng, times, start, least_deg, most_deg):
    """Returns a turn whose axis and speed change smoothly: per frame between two angles, from a time on."""
    axis = waves(rng, times, 3, 0.05, 0.2)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    speed = waves(rng, times, 1, 0.15, 0.5)[:, 0]
    speed = (speed - speed.min()) / np.ptp(speed)
    angle = np.radians(least_deg + (most_deg - least_deg) * speed) * step((times - start) / 0.7)
    turn, result = Rotation.identity(), []
    for vector in axis * angle[:, None]:
        turn = Rotation.from_rotvec(vector) * turn
        result.append(turn)
    return Rotation.concatenate(result)


def placed(turns, places, centre):
    """Returns poses that turn an object about its centre and put the centre at places."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, :3] = turns.as_matrix()
    poses[:, :3, 3] = places - poses[:, :3, :3] @ centre
    return poses


def limited(places, most_m):
    """Scales a path so that its fastest step has a length."""
    return places * (most_m / np.linalg.norm(np.diff(places, axis=0), axis=1).max())


def make(entry, frames, vertices, shrink=1.0):
    """Returns the motion of a sequence. `shrink` scales the path of the object, for those that would leave the picture."""
    rng = np.random.default_rng([entry["seed"], 1])
    kind = entry["kind"]
    times = np.arange(frames) / HZ
    centre = (vertices.min(0) + vertices.max(0)) / 2.0
    radius = np.linalg.norm(vertices - centre, axis=1).max()
    yaw = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    rest = np.array([0.0, 0.0, centre[2] - vertices[:, 2].min()])
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(entry["elevation_deg"])
    # Towards the camera, to its right, and up.
    near = away(azimuth, 0.0)
    right = np.array([-near[1], near[0], 0.0])
    frame = np.stack([near, right, [0.0, 0.0, 1.0]])

    if kind == "moving_camera":
        # An arc around the object, with a change of direction, and the shake of a hand.
        swing = np.cumsum(np.sin(2.0 * np.pi * 0.09 * times + rng.uniform(-0.3, 0.3)) * step((times - STILL_S) / 0.7))
        away_m = entry["distance_m"] + 0.06 * (waves(rng, times, 1, 0.1, 0.2)[:, 0] - waves(rng, times[:1], 1, 0.1, 0.2)[0, 0]) * step(
            times - STILL_S
        )
        rise = elevation + 0.12 * np.sin(2.0 * np.pi * 0.13 * (times - STILL_S)) * step(times - STILL_S)
        shake = 0.006 * waves(rng, times, 3, 0.8, 2.0)
        target = rest + 0.06 * waves(rng, times, 3, 0.2, 0.45)

        def path(scale):
            eyes = [rest + away_m[k] * away(azimuth + scale * swing[k], rise[k]) + shake[k] for k in range(frames)]
            return np.array([look_at(eye, aim) for eye, aim in zip(eyes, target, strict=True)])

        scale = 0.01
        for _ in range(8):
            moved = np.linalg.norm(np.diff(path(scale)[:, :3, 3], axis=0), axis=1)[60:]
            scale *= 0.010 / moved.mean()
        return Motion(placed(Rotation.concatenate([yaw] * frames), np.tile(rest, (frames, 1)), centre), path(scale))

    lift = radius + 0.04 + rng.uniform(0.0, 0.03)
    start = STILL_S + 0.6
    fastest, low_hz, high_hz = {"fast": (0.0135, 0.5, 1.0), "plain_far": (0.0045, 0.2, 0.4)}.get(kind, (0.0055, 0.25, 0.5))
    if kind == "hidden":
        # The path rests while the object is hidden, and the cover's own move takes its place.
        pace = 1.0 - step((times - HIDDEN_S[0] + 0.4) / 0.4) + step((times - HIDDEN_S[1]) / 0.4)
        clock = np.concatenate([[0.0], np.cumsum(pace[1:]) / HZ])
    else:
        clock = times
    held = kind == "in_hand"
    lifted_from = STILL_S if held else start
    rising = (0.0 if held else 1.0) * step((times - start) / (lift / (0.004 if kind == "fast" else 0.0025) / HZ))
    path = waves(rng, clock, 3, low_hz, high_hz) * [0.5, 1.0, 0.6]
    path = (path - path[0]) * step((clock - lifted_from) / 2.0)[:, None]
    path = shrink * limited(path, fastest)
    hold = rest + [0.0, 0.0, lift]
    # The object must not sink into the table.
    path[:, 2] = np.maximum(path[:, 2], -0.5 * (lift - radius))
    places = (hold if held else rest + rising[:, None] * (hold - rest)) + path @ frame
    if not held:
        places[:, 2] = np.maximum(places[:, 2], rest[2])

    turning = start + (0.0 if held else 0.5)
    if kind in ("picked", "plain_far"):
        # A gripper from above turns about the vertical and tilts.
        yaws = waves(rng, times, 1, 0.1, 0.2, 2)[:, 0]
        tilts = waves(rng, times, 2, 0.12, 0.3, 2)
        begun = step((times - turning) / 1.5)
        yaws, tilts = (yaws - yaws[0]) * begun, (tilts - tilts[0]) * begun[:, None]
        # No tilt beyond 40 degrees, no turn faster than 4 (far: 3) degrees a frame.
        tilts *= np.radians(40.0) / max(1.0, np.linalg.norm(tilts, axis=1).max())
        yaws *= np.radians(160.0) / np.abs(yaws).max()
        most = np.radians(3.0 if kind == "plain_far" else 4.0)
        scale = 1.0
        for _ in range(20):
            turns = Rotation.from_rotvec(np.pad(tilts, ((0, 0), (0, 1)))) * Rotation.from_rotvec(scale * yaws[:, None] * [0.0, 0.0, 1.0])
            if (turns[1:] * turns[:-1].inv()).magnitude().max() <= most:
                break
            scale, tilts = 0.93 * scale, 0.95 * tilts
    else:
        slow, quick = {"fast": (0.5, 9.8), "hidden": (0.5, 2.5), "in_hand": (0.8, 3.8)}[kind]
        turns = rotations(rng, clock, turning, slow, quick)
        if kind == "hidden":
            vectors = np.diff(clock, prepend=0.0) * HZ
            steps = Rotation.concatenate([turns[:1], turns[1:] * turns[:-1].inv()])
            steps = Rotation.from_rotvec(steps.as_rotvec() * vectors[:, None])
            turn, made = Rotation.identity(), []
            for part in steps:
                turn = part * turn
                made.append(turn)
            share = step((times - HIDDEN_S[0] - 0.1) / (HIDDEN_S[1] - HIDDEN_S[0] - 0.3))
            axis = rng.normal(size=3)
            axis *= np.radians(entry["turn_deg"]) / np.linalg.norm(axis)
            turns = Rotation.from_rotvec(share[:, None] * axis) * Rotation.concatenate(made)
            shift = np.array([rng.uniform(-0.05, 0.05), rng.choice([-1, 1]) * rng.uniform(0.10, 0.14), rng.uniform(-0.02, 0.05)])
            places = places + shrink * share[:, None] * (shift @ frame)
    turns = turns * yaw

    middle = (hold if held else 0.35 * rest + 0.65 * hold) if kind != "hidden" else 0.35 * rest + 0.65 * hold + 0.4 * shrink * (shift @ frame)
    camera = look_at(middle + entry["distance_m"] * away(azimuth, elevation), middle)
    holder = "gripper" if kind in ("picked", "plain_far") else "hand"
    grip = np.ones(frames) if held else step((times - 0.3) / (start - 0.3))
    cover = np.zeros(frames)
    if kind == "hidden":
        cover = step((times - HIDDEN_S[0] + PASS_S) / PASS_S) + step((times - HIDDEN_S[1]) / PASS_S)
    wobble = np.radians(18.0) * waves(rng, times, 3, 0.1, 0.4)
    return Motion(placed(turns, places, centre), np.tile(camera, (frames, 1, 1)), holder, grip, cover, wobble)
