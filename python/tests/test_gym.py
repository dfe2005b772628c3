"""Environments of Gymnasium."""

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import mambavitact.gym
from mambavitact import ArgumentError, Episode

ID = "mambavitact/TurnInHand-v0"
OBSERVATIONS = ["proprioception", "sighted", "guided", "touch_depth", "touch_images", "cameras", "estimate", "privileged"]


@pytest.fixture(autouse=True)
def no_display() -> Iterator[None]:
    os.environ["SDL_VIDEODRIVER"] = "dummy"
    yield


@pytest.mark.parametrize("observation", [*OBSERVATIONS, ("proprioception", "touch_depth")])
def test_the_checker_of_gymnasium_finds_nothing(observation: str | tuple[str, ...]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(ID, observation=observation, render_mode="rgb_array").unwrapped
        # Rendering is checked once.
        check_env(env, skip_render_check=observation != "proprioception")


def test_an_episode_starts_as_that_of_the_simulator() -> None:
    env = gymnasium.make(ID, object="random:5", observation="privileged", side="right")
    observation, info = env.reset(seed=11)
    episode = Episode("random:5", seed=11, side="right")
    assert info == {"seed": 11}
    palm = np.array([-0.0475, 0.0, 0.0111])
    assert np.abs(observation[:3] - (episode.object_pose[:3, 3] - palm)).max() < 1e-6
    assert np.abs(observation[3:9].reshape(2, 3).T - episode.object_pose[:3, :2]).max() < 1e-6


def test_actions_move_targets_and_rewards_are_the_sum_of_their_parts() -> None:
    env = gymnasium.make(ID, observation=("proprioception", "privileged"), control_hz=20)
    first, _ = env.reset(seed=2)
    action = np.full(16, 0.5, np.float32)
    observation, reward, terminated, truncated, info = env.step(action)
    targets = first["proprioception"][16:32], observation["proprioception"][16:32]
    assert (targets[1] >= targets[0]).all() and (targets[1] > targets[0]).sum() > 8
    parts = [info[name] for name in ("turning", "drift", "place", "posture", "torque", "work", "drop")]
    assert abs(reward - sum(parts)) < 1e-12
    assert abs(info["time_s"] - 1 / 20) < 1e-12
    assert not terminated and not truncated
    with pytest.raises(ArgumentError, match="from -1 to 1, got 2"):
        env.step(np.full(16, 2, np.float32))
    with pytest.raises(ArgumentError, match="NaN"):
        env.step(np.full(16, np.nan, np.float32))
    with pytest.raises(ArgumentError, match=r"shape \(1, 16\), got dtype float32 and shape \(1, 3\)"):
        env.step(np.zeros(3, np.float32))


def test_turning_is_rewarded() -> None:
    # The gait turns the object: its targets, as actions.
    episode = Episode("cube70", seed=4)
    env = gymnasium.make(ID, object="cube70", observation="privileged")
    env.reset(seed=4)
    target, rewards = episode.joint_targets, []
    for _ in range(150):
        episode.step()
        action = np.clip((episode.joint_targets - target) * 24, -1, 1).astype(np.float32)
        target = target + action / 24
        _, _, _, _, info = env.step(action)
        rewards.append(info["turning"])
    assert np.mean(rewards) > 0.2, "the gait turns at about 0.7 rad/s, 1.25 for each"
    assert info["turned_rad"] > 1.5


def test_settings_that_are_wrong_are_named() -> None:
    for settings, message in [
        ({"observation": "smell"}, "unknown observation .*smell.*: choose of proprioception"),
        ({"observation": []}, "at least one"),
        ({"observation": ["privileged", "privileged"]}, "once"),
        ({"control_hz": 7}, "divide 300"),
        ({"physics_hz": 100}, "physics_hz must be 300"),
        ({"duration_s": -1.0}, "duration_s"),
        ({"observation": "cameras", "cameras": ""}, "at least one camera"),
        ({"render_mode": "ansi"}, "render_mode"),
    ]:
        with pytest.raises(ArgumentError, match=message):
            mambavitact.gym.TurnInHandEnv(**settings)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="from 1 to 4096"):
        mambavitact.gym.TurnInHandVectorEnv(0)


def test_a_vector_of_environments_is_that_many_environments() -> None:
    count, steps = 3, 60
    settings: dict[str, Any] = {"object": "cube70", "observation": "privileged", "duration_s": 1.0}
    envs = gymnasium.make_vec(ID, num_envs=count, **settings)
    assert isinstance(envs, mambavitact.gym.TurnInHandVectorEnv)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    singles = [gymnasium.make(ID, **settings) for _ in range(count)]
    observations, _ = envs.reset(seed=20)
    for k, env in enumerate(singles):
        assert np.array_equal(observations[k], env.reset(seed=20 + k)[0])
    rng = np.random.default_rng(0)
    for step in range(steps):
        actions = rng.uniform(-1, 1, (count, 16)).astype(np.float32)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        assert observations in envs.observation_space and rewards.dtype == np.float64
        for k, env in enumerate(singles):
            if step >= 25:
                continue
            one = env.step(actions[k])
            assert np.array_equal(observations[k], one[0])
            assert (rewards[k], terminated[k], truncated[k]) == one[1:4]
            assert infos["turning"][k] == one[4]["turning"] and infos["_turning"][k]
        if step == 24:
            assert truncated.all() and not terminated.any()
        elif step == 25:
            # The step after the end begins the next episode.
            assert not truncated.any() and (rewards == 0).all() and (infos["time_s"] == 0).all()
        elif step in (0, 49):
            assert not truncated.any()
        elif step == 50:
            assert truncated.all()


def test_each_kind_of_observation_fits_its_space_in_a_vector() -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, observation=OBSERVATIONS)
    observations, _ = envs.reset(seed=1)
    assert observations in envs.observation_space
    observations, *_ = envs.step(envs.action_space.sample())
    assert observations in envs.observation_space
    assert envs.render() is None
    pictures: Any = gymnasium.make_vec(ID, num_envs=2, render_mode="rgb_array").render()
    assert [picture.shape for picture in pictures] == [(480, 640, 3)] * 2


DETERMINISM = """
import hashlib, sys
import numpy as np
import mambavitact.gym
envs = mambavitact.gym.TurnInHandVectorEnv(2, observation=("proprioception", "touch_images", "cameras", "estimate"), duration_s=0.12)
digest = hashlib.sha256()
observations, _ = envs.reset(seed=3)
rng = np.random.default_rng(1)
for _ in range(4):
    for array in observations.values():
        digest.update(array.tobytes())
    observations, rewards, *_ = envs.step(rng.uniform(-1, 1, (2, 16)).astype(np.float32))
    digest.update(rewards.tobytes())
print(digest.hexdigest())
"""


def test_the_number_of_threads_does_not_matter() -> None:
    def digest(threads: int) -> str:
        environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
        return subprocess.run(
            [sys.executable, "-P", "-c", DETERMINISM], env=environment, capture_output=True, text=True, check=True
        ).stdout

    first = digest(1)
    assert len(first) == 65
    assert digest(3) == first


def test_memory_stays_flat() -> None:
    def resident_mb() -> float:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096 / 1e6

    envs = mambavitact.gym.TurnInHandVectorEnv(16, duration_s=2.0)
    actions = np.zeros((16, 16), np.float32)

    def play(steps: int) -> None:
        for _ in range(steps):
            envs.step(actions)

    envs.reset(seed=0)
    play(100)
    before = resident_mb()
    # 10,000 steps of environments, with some 190 resets.
    play(625)
    assert resident_mb() - before < 8
