"""Episodes against `simulate` and `generate`."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from conftest import OBJECT, run, run_json

from mambavitact import ArgumentError, Episode, Log, record_log


def test_a_gait_plays_the_episode_of_simulate() -> None:
    episode = Episode(OBJECT, seed=3, duration_s=2.0)
    while episode.step():
        pass
    expected = run_json("simulate", "--object", OBJECT, "--seed", "3", "--duration", "2")
    assert (episode.time_s, episode.turned_rad) == (expected["survived_s"], expected["turned_rad"])
    assert episode.end == "completed"
    assert not episode.step(), "nothing moves after the end"
    assert episode.time_s == 2.0


def test_a_restored_episode_continues_bit_for_bit() -> None:
    episode = Episode(OBJECT, seed=5)
    for _ in range(30):
        episode.step()
    state = episode.save()

    def play() -> list[np.ndarray]:
        poses = []
        for k in range(40):
            # Half by the gait, half by targets.
            episode.step(None if k % 2 else episode.joints + 0.02)
            poses.append(episode.object_pose)
        return poses

    first = play()
    episode.restore(state)
    assert np.array_equal(first, play())
    assert len({pose.tobytes() for pose in first}) == 40, "the object moves"


def test_targets_move_the_joints() -> None:
    episode = Episode(OBJECT, seed=1, randomise=False)
    before = episode.joints
    targets = before + np.where(np.arange(16) % 4 == 0, 0.0, 0.1)
    for _ in range(10):
        assert episode.step(targets)
    assert np.array_equal(episode.joint_targets, targets)
    assert np.abs(episode.joints - before)[1:4].min() > 0.05
    assert episode.joint_velocities.shape == (16,)
    assert episode.object_velocity.shape == (6,)


def test_observations_are_those_of_a_log(log: Log) -> None:
    episode = Episode(OBJECT, seed=3, camera_noise=0.0)
    # A log's frames come 10 steps apart.
    frames = list(log)
    assert len(frames) == len(log) == 30
    for frame in frames:
        seen = episode.observe()
        assert np.array_equal(seen.joints, frame.joints)
        assert seen.time_s == frame.time_s
        # Masks are stored without loss, depths in steps; colours are JPEG.
        assert seen.contact is not None and frame.contact is not None
        assert np.array_equal(seen.contact, frame.contact)
        assert np.abs(seen.depth_m[0] - frame.depth_m[0]).max() < 1e-4
        assert seen.touch_images is not None and frame.touch_images is not None
        assert np.abs(seen.touch_images.astype(float) - frame.touch_images).mean() < 3
        assert seen.object_pose is not None and frame.object_pose is not None
        assert np.abs(seen.object_pose - frame.object_pose).max() < 1e-9
        episode.step(steps=10)
    assert any(frame.contact is not None and frame.contact.any() for frame in frames), "something touches"


def test_a_log_from_python_is_that_of_generate(log: Log, tmp_path: Path) -> None:
    run("generate", "--object", OBJECT, "--logs", "1", "--seed", "3", "--duration", "1", "--out", tmp_path / "set")
    other = tmp_path / "set" / OBJECT / "00"
    files = sorted(path.relative_to(other) for path in other.rglob("*") if path.is_file())
    assert len(files) > 100
    ours = Path(log.folder)
    assert all((ours / file).read_bytes() == (other / file).read_bytes() for file in files)


@pytest.mark.parametrize("camera_noise", [-1.0, float("nan"), 101.0])
def test_a_log_with_impossible_noise_is_refused(tmp_path: Path, camera_noise: float) -> None:
    with pytest.raises(ArgumentError, match="camera_noise: expected 0 to 100"):
        record_log(tmp_path / "log", OBJECT, camera_noise=camera_noise)
    assert not (tmp_path / "log").exists()


def test_frames_by_index_are_those_in_order(log: Log) -> None:
    third = list(log)[2]
    frame = log[2]
    assert np.array_equal(frame.depth_m[0], third.depth_m[0])
    assert frame.touch_images is not None and third.touch_images is not None
    assert np.array_equal(frame.touch_images, third.touch_images)
    assert log[-1].time_s == log.times_s[-1]
    with pytest.raises(IndexError, match="30 frames"):
        log[30]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"object": "cub"}, "cube70"),
        ({"side": "both"}, "side: expected left or right, got 'both'|side: expected left or right, got \"both\""),
        ({"gait": "walk"}, "unknown gait"),
        ({"cameras": "nowhere"}, "unknown camera"),
        ({"duration_s": float("nan")}, "duration_s"),
        ({"camera_noise": -1.0}, "camera_noise"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Episode(**{"object": OBJECT, **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("targets", "came"),
    [
        (np.zeros((16, 1)), r"shape \(16, 1\)"),
        (np.zeros(16, dtype=bool), "dtype bool"),
        (np.zeros(16, dtype=complex), "dtype complex128"),
        (np.full(16, np.nan), "NaN"),
        (["a"] * 16, "dtype <U1"),
        (np.full(16, np.inf), "infinity"),
    ],
)
def test_wrong_arrays_are_named(targets: object, came: str) -> None:
    episode = Episode(OBJECT)
    with pytest.raises(ArgumentError, match=f"targets: expected .*{came}"):
        episode.step(targets)  # type: ignore[arg-type]
    assert episode.time_s == 0.0


def test_targets_of_another_hand_are_refused() -> None:
    with pytest.raises(ArgumentError, match="the hand has 16 joints, got 15"):
        Episode(OBJECT).step(np.zeros(15))


def test_order_and_type_of_numbers_do_not_matter() -> None:
    episode, other = Episode(OBJECT), Episode(OBJECT)
    targets = np.linspace(-0.1, 0.3, 32, dtype=np.float32)[::2]
    episode.step(targets)
    other.step(targets.astype(float).tolist())
    assert np.array_equal(episode.joints, other.joints)


def test_a_state_of_another_object_is_refused() -> None:
    episode = Episode(OBJECT, seed=1)
    for other in (Episode("random:1", seed=1), Episode(OBJECT, seed=2), Episode(OBJECT, seed=1, side="right")):
        with pytest.raises(ArgumentError, match="another object, seed or configuration"):
            episode.restore(other.save())
    episode.restore(Episode(OBJECT, seed=1).save())


def test_a_learnt_policy_plays(tmp_path: Path) -> None:
    zeros = np.zeros((16, 32), np.float32).tobytes() + np.zeros(16, np.float32).tobytes()
    tensors = {
        "layers.0.weight": {"dtype": "F32", "shape": [16, 32], "data_offsets": [0, 2048]},
        "layers.0.bias": {"dtype": "F32", "shape": [16], "data_offsets": [2048, 2112]},
    }
    header = json.dumps(tensors).encode()
    policy = tmp_path / "policy.safetensors"
    policy.write_bytes(struct.pack("<Q", len(header)) + header + zeros)
    joints = [f"{finger}_{k}" for finger in ("index", "middle", "ring", "thumb") for k in range(4)]
    policy.with_suffix(".toml").write_text(
        f"joint_names = {json.dumps(joints)}\njoint_stiffness = 3.0\njoint_damping = 0.1\n"
        f"default_joint_pos = {[0.0] * 12 + [0.3, 0.0, 0.0, 0.0]}\naction = 'incremental'\naction_scale = 0.04\n"
        "observation_names = ['joint_pos_target_unit']\nobservation_terms_scale = 1.0\n"
        "observation_terms_clip = [-1.0, 1.0]\nobservation_terms_history_length = 1\ncontrol_hz = 50\n"
        "start = 'suited'\nactivation = 'elu'\nnormaliser = 'none'\n"
    )
    ends = []
    for _ in range(2):
        episode = Episode("cube70", seed=3, gait=str(policy), duration_s=0.4)
        while episode.step():
            pass
        ends.append(episode.joints)
    assert episode.gait == str(policy)
    np.testing.assert_array_equal(ends[0], ends[1])
    with pytest.raises(ArgumentError, match="nothing.safetensors"):
        Episode("cube70", gait="nothing.safetensors")
