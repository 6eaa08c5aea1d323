"""Policies that were learnt and come along with the package: small networks from flat observations to actions.

``lanebound train`` learns one, ``lanebound export DIR --out FILE.npz`` writes it in this form: for each layer n the
arrays ``weight_n`` (outputs, inputs) and ``bias_n``, tanh between layers, and ``columns``, the names of the entries of
the observation in their order.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.errors import InputError

__all__ = ["LearntDriver", "make_ppo", "policies"]

Array = NDArray[np.float32]
States = tuple[NDArray[Any], ...] | None


class LearntDriver:
    """Does what the network says, within [-1, 1] and without noise; the same for one observation and for a batch.

    Parameters
    ----------
    layers : weights (outputs, inputs) and biases (outputs,) from the first layer on
    """

    def __init__(self, layers: list[tuple[Array, Array]]) -> None:
        self._layers = layers

    def predict(
        self,
        observation: Observation,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], States]:
        """The action (..., A) for an observation (..., n), or a dict of its groups."""
        whole = _in_a_row(observation)
        rows = [self._action(row) for row in whole.reshape(-1, whole.shape[-1])]
        return np.stack(rows).reshape(*whole.shape[:-1], -1), state

    def _action(self, row: Array) -> Array:
        for weight, bias in self._layers[:-1]:
            row = np.tanh(weight @ row + bias)
        weight, bias = self._layers[-1]
        action: Array = np.clip(weight @ row + bias, np.float32(-1.0), np.float32(1.0))
        return action


def _in_a_row(observation: Observation) -> Array:
    """The groups of a dict one after another, which is the flat form."""
    if isinstance(observation, Mapping):
        return np.concatenate([np.asarray(part, dtype=np.float32) for part in observation.values()], axis=-1)
    return np.asarray(observation, dtype=np.float32)


def policies() -> dict[str, Any]:
    """The files that come along, by the world that each was learnt in."""
    folder = resources.files("lanebound.agents") / "policies"
    return {file.name.removesuffix(".npz"): file for file in folder.iterdir() if file.name.endswith(".npz")}


def make_ppo(env: DrivingEnv) -> LearntDriver:
    """The policy that comes along for the world of an environment.

    Raises
    ------
    InputError
        There is none, or it was learnt with other observations or actions.
    """
    there = policies()
    base = env.config.base
    if base not in there:
        raise InputError(
            f"'ppo' was learnt in {', '.join(sorted(there))}, got {base}: learn a policy there, by 'lanebound train'"
        )
    with np.load(BytesIO(there[base].read_bytes())) as data:
        columns = tuple(data["columns"].tolist())
        count = sum(name.startswith("weight_") for name in data.files)
        layers = [(data[f"weight_{n}"], data[f"bias_{n}"]) for n in range(count)]
    config = env.config.observation
    if Reader(config).columns != columns or config.history != 1:
        raise InputError(
            f"'ppo' was learnt in {base} with the observation of its own ({len(columns)} entries, no history), "
            "got another: leave 'observation' as it is there"
        )
    if env.action_space.shape != layers[-1][1].shape:
        raise InputError(
            f"'ppo' was learnt in {base} with actions of its own, got {env.action_space}: leave 'action' as it is"
        )
    return LearntDriver(layers)
