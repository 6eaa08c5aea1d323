"""Policies that were learnt and come along with the package: small networks from flat observations to actions.

``lanebound train`` learns one, ``lanebound export DIR --out FILE.npz`` writes it in this form: for each layer n the
arrays ``weight_n`` (outputs, inputs) and ``bias_n``, tanh between layers, and ``columns``, the names of the entries of
the observation in their order. Outputs are a continuous action, or a value of each discrete one.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from io import BytesIO
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.errors import InputError

__all__ = ["LearntDriver", "make_ppo", "policies"]

Array = NDArray[np.float32]
States = tuple[NDArray[Any], ...] | None


class LearntDriver:
    """Does what the network says, without noise; the same for one observation and for a batch.

    Parameters
    ----------
    layers : weights (outputs, inputs) and biases (outputs,) from the first layer on
    discrete : whether the output of the largest value is the action; else they are the action within [-1, 1]
    """

    def __init__(self, layers: list[tuple[Array, Array]], discrete: bool = False) -> None:
        self._layers, self._discrete = layers, discrete

    def predict(
        self,
        observation: Observation,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], States]:
        """The action (..., A), or (...) of discrete ones, for an observation (..., n) or a dict of its groups."""
        whole = _in_a_row(observation)
        found = np.stack([self._outputs(row) for row in whole.reshape(-1, whole.shape[-1])])
        found = found.reshape(*whole.shape[:-1], -1)
        if self._discrete:
            return found.argmax(axis=-1), state
        return np.clip(found, np.float32(-1.0), np.float32(1.0)), state

    def _outputs(self, row: Array) -> Array:
        for weight, bias in self._layers[:-1]:
            row = np.tanh(weight @ row + bias)
        weight, bias = self._layers[-1]
        outputs: Array = weight @ row + bias
        return outputs


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
    discrete = isinstance(env.action_space, spaces.Discrete)
    if (spaces.flatdim(env.action_space),) != layers[-1][1].shape:
        raise InputError(
            f"'ppo' was learnt in {base} with actions of its own, got {env.action_space}: leave 'action' as it is"
        )
    return LearntDriver(layers, discrete)
