"""Trains a policy that turns a ball, with PPO of stable-baselines3: pip install "mambavitact[gym]" stable-baselines3

Writes the course of the training to ppo.csv, a line for each update with the columns of `mambavitact hand train`, and the policy to ppo.zip and
vecnormalize.pkl.
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from mambavitact.gym import TurnInHandVectorEnv

CONTROL_HZ = 25


class Environments(VecEnv):
    """The vector environment, as stable-baselines3 expects it.

    The step that begins an episode and ignores its action is one of the steps: it costs nothing, and is one of 500.
    """

    def __init__(self, environments: TurnInHandVectorEnv) -> None:
        self.environments = environments
        super().__init__(environments.num_envs, environments.single_observation_space, environments.single_action_space)
        self.begins = np.zeros(self.num_envs, dtype=bool)
        self.turned_rad = np.zeros(self.num_envs)
        self.sums = np.zeros(4)

    def reset(self) -> Any:
        seed = self._seeds[0]
        self.begins[:], self.turned_rad[:] = False, 0.0
        self._reset_seeds()
        return self.environments.reset(seed=seed)[0]

    def step_async(self, actions: Any) -> None:
        self.actions = actions

    def step_wait(self) -> Any:
        observations, rewards, fell, ended, infos = self.environments.step(self.actions)
        counted = ~self.begins
        turned_rad = infos["turned_rad"] - self.turned_rad
        self.sums += [counted.sum(), rewards[counted].sum(), turned_rad[counted].sum(), fell.sum()]
        self.turned_rad, self.begins = infos["turned_rad"].copy(), fell | ended
        notes: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(self.begins):
            notes[k] = {"terminal_observation": observations[k], "TimeLimit.truncated": bool(ended[k] and not fell[k])}
        return observations, rewards.astype(np.float32), self.begins, notes

    def course(self) -> list[float]:
        """Return reward of a step, rate (rad/s) and falls per minute since the last call."""
        (steps, reward, turned_rad, falls), self.sums = self.sums, np.zeros(4)
        seconds = steps / CONTROL_HZ
        return [reward / steps, turned_rad / seconds, 60 * falls / seconds]

    def close(self) -> None:
        self.environments.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.environments, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(f"{attr_name}: the environments are made in Rust")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise AttributeError(f"{method_name}: the environments are made in Rust")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class Course(BaseCallback):
    """Adds a line to a file after each rollout."""

    def __init__(self, path: Path, environments: Environments) -> None:
        super().__init__()
        self.path, self.environments = path, environments
        self.lines: list[list[float]] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        reward, rate_rad_s, falls = self.environments.course()
        self.lines.append([self.num_timesteps, reward, rate_rad_s, falls])
        print(f"{self.num_timesteps} steps: reward {reward:.3f}, {rate_rad_s:.2f} rad/s, {falls:.1f} falls/min", flush=True)
        with self.path.open("w", newline="") as file:
            csv.writer(file).writerows([("steps", "reward", "rate_rad_s", "falls_per_minute"), *self.lines])


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--object", default="ball", help="the object")
parser.add_argument("--observation", default="sighted", help="the observation")
parser.add_argument("--steps", type=int, default=2_000_000, help="number of steps of all environments together")
parser.add_argument("--environments", type=int, default=64, help="number of environments that step together")
parser.add_argument("--seed", type=int, default=0, help="seed of the training")
parser.add_argument("--out", type=Path, default=Path("."), help="folder for ppo.csv, ppo.zip and vecnormalize.pkl")
arguments = parser.parse_args()

arguments.out.mkdir(parents=True, exist_ok=True)
environments = Environments(
    TurnInHandVectorEnv(
        arguments.environments, object=arguments.object, observation=arguments.observation, physics_hz=150, control_hz=CONTROL_HZ
    )
)
normalised = VecNormalize(environments, gamma=0.99)
# The sizes, steps and passes of `mambavitact hand train`, which has elu for tanh and lets the step size follow the divergence of the policies.
model = PPO(
    "MlpPolicy",
    normalised,
    n_steps=64,
    batch_size=1024,
    n_epochs=5,
    learning_rate=5e-4,
    policy_kwargs={"log_std_init": float(np.log(0.4)), "net_arch": [128, 64]},
    seed=arguments.seed,
    device="cpu",
)
model.learn(arguments.steps, callback=Course(arguments.out / "ppo.csv", environments))
model.save(arguments.out / "ppo.zip")
normalised.save(arguments.out / "vecnormalize.pkl")
