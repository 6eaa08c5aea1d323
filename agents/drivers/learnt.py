"""Policies that were learnt, as arrays: small networks from flat observations to actions; some come with the package.

``lanebound train`` learns one, ``lanebound export DIR --out FILE.npz`` writes it in this form: for each layer n the
arrays ``weight_n`` (outputs, inputs) and ``bias_n``, tanh between layers; of the entries of the observation, in their
order, ``columns`` (names) and ``scales``; and ``discrete``, whether the outputs are a value of each discrete action, or
a continuous action.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, in_a_row
from lanebound.envs.core import DrivingEnv
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.errors import InputError

__all__ = ["LearntDriver", "make_ppo", "open_arrays", "policies", "require_sight", "sight"]

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
        whole = in_a_row(observation)
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


def policies() -> dict[str, Traversable]:
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
    return _fitting(there[base], "'ppo'", f" in {base}", env)


def open_arrays(path: Path, env: DrivingEnv) -> LearntDriver:
    """The policy in a file that ``lanebound export`` wrote.

    Raises
    ------
    InputError
        It cannot be read, or was learnt with other observations or actions.
    """
    return _fitting(path, f"agent {path}", "", env)


def sight(config: ObservationConfig) -> dict[str, NDArray[Any]]:
    """What a policy of flat observations must find as it was when it learnt: names and scales of the entries."""
    shown = entries(config)
    return {
        "columns": np.array([entry.column for entry in shown]),
        "scales": np.array([entry.scale for entry in shown]),
    }


def require_sight(learnt: Mapping[str, Any], history: int, told: str, env: DrivingEnv) -> None:
    """Refuse an environment whose observations are others than a policy ``learnt`` with; ``told`` says which it is.

    Raises
    ------
    InputError
        Entries, their scales or the number of observations differ.
    """
    config = env.config.observation
    other = [key for key, value in sight(config).items() if not np.array_equal(value, learnt[key])]
    if other or config.history != history:
        remembered = "no history" if history == 1 else f"a history of {history}"
        raise InputError(
            f"{told} with an observation of its own ({len(learnt['columns'])} entries, {remembered}), "
            f"got another of {len(entries(config))} ({', '.join(other) or 'history'} differ): "
            "leave 'observation' as it was there"
        )


def _fitting(file: Traversable, name: str, where: str, env: DrivingEnv) -> LearntDriver:
    """The policy in a file, where it was learnt with the observations and actions of an environment."""
    learnt, layers = _read(file, name)
    require_sight(learnt, 1, f"{name} was learnt{where}", env)
    outputs, discrete = layers[-1][1].size, bool(learnt["discrete"])
    if (spaces.flatdim(env.action_space), isinstance(env.action_space, spaces.Discrete)) != (outputs, discrete):
        remedy = "leave 'action' as it was there" if where else "drive an id that has it, or learn a policy here"
        raise InputError(
            f"{name} was learnt{where} with actions {_space(outputs, discrete)}, got an environment that takes "
            f"{_taken(env.action_space)}: {remedy} (see 'lanebound envs')"
        )
    return LearntDriver(layers, discrete)


def _space(outputs: int, discrete: bool) -> str:
    """The actions that a policy was learnt with, as :func:`_taken` names them."""
    return f"Discrete({outputs})" if discrete else f"Box({outputs},)"


def _taken(space: spaces.Space[Any]) -> str:
    """A space of actions as ``lanebound envs`` shows it."""
    return f"Box{space.shape}" if isinstance(space, spaces.Box) else str(space)


def _read(file: Traversable, name: str) -> tuple[dict[str, NDArray[Any]], list[tuple[Array, Array]]]:
    """What a policy sees, and its layers."""
    try:
        with file.open("rb") as stream, np.load(stream) as data:
            learnt = {key: data[key] for key in (*sight(ObservationConfig()), "discrete")}
            count = sum(array.startswith("weight_") for array in data.files)
            layers = [(_numbers(data[f"weight_{n}"]), _numbers(data[f"bias_{n}"])) for n in range(count)]
    except (OSError, ValueError, TypeError, LookupError, AttributeError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(f"{name} must be as 'lanebound export' writes it, got {error}: export it anew") from None
    wide = learnt["columns"].size
    for n, (weight, bias) in enumerate(layers):
        if (
            weight.shape != (bias.size, wide)
            or bias.ndim != 1
            or not (np.isfinite(weight).all() and np.isfinite(bias).all())
        ):
            raise InputError(
                f"weight_{n} and bias_{n} of {name} must be finite, (m, {wide}) and (m,), got {weight.shape} and "
                f"{bias.shape}: export it anew"
            )
        wide = len(bias)
    if not layers:
        raise InputError(f"{name} must hold layers weight_0, bias_0, ..., got none: export it anew")
    return learnt, layers


def _numbers(array: NDArray[Any]) -> Array:
    return np.asarray(array, dtype=np.float32)
