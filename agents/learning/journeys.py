"""Learning of journeys by MaskablePPO, with the vector environment as one of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from lanebound.agents.drivers.base import Starts, States
from lanebound.envs.journeys.env import VectorJourney
from lanebound.integrity.core.errors import InputError

__all__ = ["JourneyVecEnv", "LearntJourney", "train_journeys"]

SHOWN = "cost", "time_s", "unusable_s"
NETWORK = [128, 128]
PPO_OPTIONS: dict[str, Any] = {
    "n_steps": 32, "batch_size": 2048, "n_epochs": 4, "gamma": 1.0, "gae_lambda": 0.95, "learning_rate": 5e-4,
    "ent_coef": 0.003, "policy_kwargs": {"net_arch": NETWORK}, "device": "cpu",
}  # fmt: skip
ENVS = 256


class JourneyVecEnv(VecEnv):
    """N journeys for Stable-Baselines3; an ended one restarts at once.

    Parameters
    ----------
    num_envs, config : as for ``gymnasium.make_vec``
    """

    def __init__(self, num_envs: int, config: Mapping[str, Any] | None = None) -> None:
        self.envs = VectorJourney(num_envs, config, AutoresetMode.SAME_STEP)
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)
        self._actions: NDArray[Any] = np.zeros(0)
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, np.int64)

    def reset(self) -> Any:
        """Begin a journey in every environment, under the seeds of ``seed``."""
        observations, _ = self.envs.reset(seed=self._seeds if self._seeds[0] is not None else None)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carry them out; at the end of a journey its info holds return and length as ``VecMonitor`` gives them."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        over = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        found: list[dict[str, Any]] = [{"cost": cost} for cost in infos["cost"].tolist()]
        for row in np.flatnonzero(over).tolist():
            final = infos["final_info"]
            found[row] |= {name: float(final[name][row]) for name in SHOWN}
            found[row]["terminal_observation"] = infos["final_obs"][row]
            found[row]["TimeLimit.truncated"] = bool(truncated[row])
            found[row]["episode"] = {"r": float(self._returns[row]), "l": int(self._lengths[row]), "t": 0.0}
        self._returns[over], self._lengths[over] = 0.0, 0
        return observations, rewards.astype(np.float32), over, found

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute that all journeys share, once for each index."""
        value = None if attr_name == "render_mode" else getattr(self.envs, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: journeys share their attributes."""
        raise InputError(f"{attr_name} must be set by the configuration, got {value!r}")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """``action_masks``, one for each index."""
        if method_name != "action_masks":
            raise InputError(f"method must be action_masks, got {method_name!r}")
        masks = self.envs.action_masks()
        return [masks[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No journey is wrapped."""
        return [False for _ in self._get_indices(indices)]


class Masks(Protocol):
    """An environment of journeys, or N of them."""

    def action_masks(self) -> NDArray[np.bool_]:
        """Which actions are valid."""


class LearntJourney:
    """A policy of MaskablePPO with the interface of a driver.

    Parameters
    ----------
    path : of the model
    env : whose masks it takes
    """

    def __init__(self, path: Path, env: Masks) -> None:
        from sb3_contrib import MaskablePPO

        self._model = MaskablePPO.load(path, device="cpu")
        self._env = env

    def act(self, observation: Any) -> Any:
        """The most probable valid action for an observation, or one for each of a batch."""
        return self._model.predict(observation, action_masks=self._env.action_masks(), deterministic=True)[0]

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """As a driver."""
        return self.act(observation), state


def train_journeys(
    config: Mapping[str, Any], steps: int, seed: int, path: Path, on_step: Callable[[float], None] = lambda share: None
) -> None:
    """Train MaskablePPO and write the model.

    config : of the environment
    on_step : told the share of the steps that is done
    """
    from sb3_contrib import MaskablePPO

    from lanebound.agents.learning.training import one_thread

    env = JourneyVecEnv(ENVS, config)

    def told(local: dict[str, Any], _: dict[str, Any]) -> bool:
        on_step(min(local["self"].num_timesteps / steps, 1.0))
        return True

    with one_thread():
        model = MaskablePPO("MlpPolicy", env, seed=seed, **PPO_OPTIONS)
        model.learn(steps, callback=told)
    model.save(path)
    env.close()
