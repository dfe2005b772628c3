"""Environments for Gymnasium. Importing this module registers `mambavitact/TurnInHand-v0`.

    import gymnasium
    import mambavitact.gym

    env = gymnasium.make("mambavitact/TurnInHand-v0", object="cube70")
    envs = gymnasium.make_vec("mambavitact/TurnInHand-v0", num_envs=8)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ._native import Environments
from .errors import ArgumentError

__all__ = ["TurnInHandEnv", "TurnInHandVectorEnv"]

_ID = "mambavitact/TurnInHand-v0"
_PICTURES_PER_SECOND = 25

Observation = Any
"""An array for one kind of observation, else a dictionary of arrays."""


def _make(
    count: int,
    autoreset: bool,
    object: str,
    observation: str | Sequence[str],
    rig: str,
    side: str | None,
    control_hz: int,
    physics_hz: int,
    duration_s: float,
    cameras: str,
    randomise: bool,
) -> Environments:
    names = [observation] if isinstance(observation, str) else list(observation)
    return Environments(
        object,
        count,
        names,
        rig=rig,
        side=side,
        control_hz=control_hz,
        physics_hz=physics_hz,
        duration_s=duration_s,
        cameras=cameras,
        randomise=randomise,
        autoreset=autoreset,
    )


def _observation_space(environments: Environments, observation: str | Sequence[str]) -> spaces.Space[Any]:
    boxes: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(low, high, tuple(shape), np.dtype(dtype).type)
        for name, shape, dtype, low, high in environments.spaces
    }
    return boxes[observation] if isinstance(observation, str) else spaces.Dict(boxes)


def _action_space(environments: Environments) -> spaces.Box:
    return spaces.Box(-1.0, 1.0, (environments.joints,), np.float32)


def _actions(actions: Any) -> Any:
    """Refuse actions outside [-1, 1], which the simulator would clip."""
    array = np.asarray(actions)
    if array.dtype.kind in "fiu" and array.size and np.isfinite(array).all() and np.abs(array).max() > 1.0:
        raise ArgumentError(f"action: expected numbers from -1 to 1, got {np.abs(array).max():g}")
    return array


class TurnInHandEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """The hand turns an object about the palm's normal.

    Action: float32, one number per joint (16 of an Allegro) from -1 to 1, the change of each joint's target by up to 1/24 rad, `control_hz` times a second.

    Observation, by `observation`, a name or a sequence of names (then a dictionary):

    - `proprioception`: float32 (96,) of an Allegro: angles and targets of the last three instants, -1 to 1 over each joint's range
    - `sighted`: float32 (117,) of an Allegro: `proprioception`, then of the same instants the position of the object from the palm's centre
      (tenths of a metre, with the errors and the delay of an estimate) and the force on each pad (N)
    - `guided`: float32 (165,) of an Allegro: `sighted`, then of the same instants where the gait that suits the object aims, -1 to 1. The action then
      corrects this gait, by up to 0.2 rad, instead of moving the hand alone
    - `touch_depth`: float32 (4, 320, 240) of an Allegro: true indentation on each pad, millimetres
    - `touch_images`: uint8 (4, 320, 240, 3) of an Allegro: image of each touch sensor
    - `cameras`: uint8 (cameras, 480, 640, 3): colours of each camera
    - `estimate`: float32 (11,): position (m, from the palm's centre) and first two columns of the rotation of the object
      by the SLAM that runs inside, its confidence, and 1 while it trusts the pose
    - `privileged`: float32 (25,): the truth: position and rotation as above, velocity, angular velocity, force on each
      pad, friction of gel and links, mass, offset of the centre of mass

    The reward is the sum of `turning`, `drift`, `place`, `posture`, `torque`, `work` and `drop`; `info` holds these parts, the
    time `time_s` and the angle `turned_rad`. An episode is terminated when the object falls off the hand and truncated
    after `duration_s`. `reset(seed=n)` plays the start that `mambavitact simulate --seed n` plays.

    Parameters: `object` is a name that `mambavitact assets list` shows, `random:SEED` or the path of a mesh; `rig`
    is a name that `mambavitact rigs` lists or the path of a hand file; `side`, left or right, is that of the Allegro; `control_hz` divides `physics_hz`, the
    integration steps per second: 300 as in a run, or 150, which is faster; `cameras` are places such as "front-left,top-down"; `randomise` draws start
    and physics. `render_mode` is rgb_array (480 x 640 pixels) or human, which needs pygame.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": _PICTURES_PER_SECOND}

    def __init__(
        self,
        *,
        object: str = "cube70",
        observation: str | Sequence[str] = "proprioception",
        rig: str = "allegro_digit",
        side: str | None = None,
        control_hz: int = 25,
        physics_hz: int = 300,
        duration_s: float = 20.0,
        cameras: str = "front-left",
        randomise: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ArgumentError(f"render_mode: expected rgb_array, human or None, got {render_mode!r}")
        self._environments = _make(
            1, False, object, observation, rig, side, control_hz, physics_hz, duration_s, cameras, randomise
        )
        self._is_single = isinstance(observation, str)
        self.observation_space = _observation_space(self._environments, observation)
        self.action_space: spaces.Space[Any] = _action_space(self._environments)
        self.render_mode = render_mode
        self._screen: Any = None

    def _observation(self, arrays: list[NDArray[Any]]) -> Observation:
        if self._is_single:
            return arrays[0][0]
        names = (space[0] for space in self._environments.spaces)
        return {name: array[0] for name, array in zip(names, arrays, strict=True)}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with this seed, or with one drawn from the last."""
        super().reset(seed=seed)
        start = int(self.np_random.integers(2**63)) if seed is None else seed
        observation = self._observation(self._environments.reset([start]))
        if self.render_mode == "human":
            self._show()
        return observation, {"seed": start}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the joints' targets and simulate until the next action is due."""
        outcome = self._environments.step(_actions(action)[None])
        arrays, rewards, terminated, truncated, parts, progress = outcome
        info: dict[str, Any] = {
            name: float(part) for name, part in zip(Environments.reward_names, parts[0], strict=True)
        }
        info["time_s"], info["turned_rad"] = (float(value) for value in progress[0])
        if self.render_mode == "human":
            self._show()
        return (
            self._observation(arrays),
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            info,
        )

    def render(self) -> Any:
        """Return a picture, uint8 (480, 640, 3); None with render_mode human, which shows each step by itself."""
        return self._environments.picture(0) if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        try:
            import pygame
        except ImportError as error:
            message = 'render_mode="human" needs pygame: pip install "mambavitact[window]"'
            raise gymnasium.error.DependencyNotInstalled(message) from error
        picture = self._environments.picture(0)
        if self._screen is None:
            pygame.init()
            pygame.display.set_caption("mambavitact")
            self._screen = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
        pygame.event.pump()
        pygame.surfarray.blit_array(self._screen, picture.swapaxes(0, 1))
        pygame.display.flip()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._screen is not None:
            import pygame

            pygame.quit()
            self._screen = None


class TurnInHandVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Many environments like `TurnInHandEnv`, stepped by Rust on all cores, without further processes.

    Actions are float32 (num_envs, joints). The parts of the reward stand in `infos` as arrays. The step after the end of an
    episode starts the next one and ignores its action (`AutoresetMode.NEXT_STEP`). With `reset(seed=n)`, environment k
    starts with seed n + k. Results do not depend on the number of cores.
    """

    metadata = {
        "render_modes": ["rgb_array"],
        "render_fps": _PICTURES_PER_SECOND,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        object: str = "cube70",
        observation: str | Sequence[str] = "proprioception",
        rig: str = "allegro_digit",
        side: str | None = None,
        control_hz: int = 25,
        physics_hz: int = 300,
        duration_s: float = 20.0,
        cameras: str = "front-left",
        randomise: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ArgumentError(f"render_mode: expected rgb_array or None, got {render_mode!r}")
        self._environments = _make(
            num_envs, True, object, observation, rig, side, control_hz, physics_hz, duration_s, cameras, randomise
        )
        self._is_single = isinstance(observation, str)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space = _observation_space(self._environments, observation)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.single_action_space = _action_space(self._environments)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _observations(self, arrays: list[NDArray[Any]]) -> Observation:
        if self._is_single:
            return arrays[0]
        names = (space[0] for space in self._environments.spaces)
        return dict(zip(names, arrays, strict=True))

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start all episodes anew."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        drawn = [int(value) for value in self.np_random.integers(2**63, size=self.num_envs)]
        if isinstance(seed, int):
            seeds = [seed + k for k in range(self.num_envs)]
        elif seed is None:
            seeds = drawn
        else:
            if len(seed) != self.num_envs:
                raise ArgumentError(f"seed: expected {self.num_envs} seeds, got {len(seed)}")
            seeds = [other if one is None else one for one, other in zip(seed, drawn, strict=True)]
        return self._observations(self._environments.reset(seeds)), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Step all environments."""
        outcome = self._environments.step(_actions(actions))
        arrays, rewards, terminated, truncated, parts, progress = outcome
        infos: dict[str, Any] = {}
        columns = [*zip(Environments.reward_names, parts.T, strict=True)]
        columns += [("time_s", progress[:, 0]), ("turned_rad", progress[:, 1])]
        for name, values in columns:
            infos[name] = values
            infos[f"_{name}"] = np.ones(self.num_envs, dtype=np.bool_)
        return self._observations(arrays), rewards, terminated, truncated, infos

    def render(self) -> Any:
        """Return a picture of each environment, uint8 (480, 640, 3)."""
        if self.render_mode is None:
            return None
        return tuple(self._environments.picture(k) for k in range(self.num_envs))


def _register() -> None:
    if _ID not in gymnasium.registry:
        gymnasium.register(
            _ID,
            entry_point="mambavitact.gym:TurnInHandEnv",
            vector_entry_point="mambavitact.gym:TurnInHandVectorEnv",
        )


_register()
