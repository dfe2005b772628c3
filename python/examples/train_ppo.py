"""Trains a policy that turns a cube, with PPO of stable-baselines3: pip install "mambavitact[gym]" stable-baselines3

Writes the mean reward of finished episodes to ppo.csv, one line for each rollout, and the policy to ppo.zip.
"""

import argparse
import csv
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import mambavitact.gym  # noqa: F401  registers the environment


class Curve(BaseCallback):
    """Adds a line to a file after each rollout."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.lines: list[tuple[int, float, float]] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        episodes = self.model.ep_info_buffer
        if not episodes:
            return
        reward = float(np.mean([episode["r"] for episode in episodes]))
        turned = float(np.mean([episode["turned_rad"] for episode in episodes]))
        self.lines.append((self.num_timesteps, reward, turned))
        print(f"{self.num_timesteps:8d} steps: reward {reward:8.1f}, turned by {turned:6.2f} rad", flush=True)
        with self.path.open("w", newline="") as file:
            csv.writer(file).writerows([("steps", "reward", "turned_rad"), *self.lines])


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--object", default="cube70", help="the object")
parser.add_argument("--steps", type=int, default=300_000, help="number of steps of all environments together")
parser.add_argument("--seed", type=int, default=0, help="seed of the training")
parser.add_argument("--out", type=Path, default=Path("."), help="folder for ppo.csv and ppo.zip")
arguments = parser.parse_args()

environments = make_vec_env(
    "mambavitact/TurnInHand-v0",
    n_envs=8,
    seed=arguments.seed,
    env_kwargs={"object": arguments.object, "duration_s": 10.0},
    monitor_kwargs={"info_keywords": ("turned_rad",)},
)
model = PPO(
    "MlpPolicy",
    environments,
    n_steps=512,
    batch_size=512,
    n_epochs=5,
    learning_rate=5e-4,
    policy_kwargs={"log_std_init": -1.0},
    seed=arguments.seed,
    device="cpu",
)
model.learn(arguments.steps, callback=Curve(arguments.out / "ppo.csv"))
model.save(arguments.out / "ppo.zip")
