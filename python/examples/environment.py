"""Steps one environment, then sixteen at once."""

import gymnasium
import numpy as np

import mambavitact.gym  # registers the environment

env = gymnasium.make("mambavitact/TurnInHand-v0", observation=("proprioception", "touch_depth"))
observation, info = env.reset(seed=0)
print({name: array.shape for name, array in observation.items()}, info)
for _ in range(10):
    observation, reward, terminated, truncated, parts = env.step(env.action_space.sample())
print(f"reward {reward:.3f}:", {name: round(value, 3) for name, value in parts.items()})

envs = gymnasium.make_vec("mambavitact/TurnInHand-v0", num_envs=16, object="random:1")
envs.reset(seed=0)
total = np.zeros(16)
for _ in range(100):
    outcome = envs.step(envs.action_space.sample())
    total += outcome[1]
print(f"random actions earn {total.mean():.1f} in 4 s; the module is {mambavitact.gym.__name__}")
