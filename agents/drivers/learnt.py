"""Trained policies as arrays: small networks from flat observations to actions; one for each id is in the package.

``lanebound train`` trains one, ``lanebound export DIR --out FILE.npz`` writes it in this form: for each layer n the
arrays ``weight_n`` (outputs, inputs) and ``bias_n``, tanh between layers; ``columns`` (names) and ``scales`` of the
observation entries in the order of the inputs; and ``discrete``, whether the outputs are a value of each discrete
action, or a continuous action. A policy selects its entries by name (:mod:`.inputs`).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver, in_a_row
from lanebound.agents.drivers.inputs import PolicyInputs
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["LearntDriver", "make_ppo", "open_arrays", "policies"]

Array = NDArray[np.float32]


class LearntDriver(StatelessDriver):
    """Applies the network without noise; gives the same result for one observation and for a batch.

    Parameters
    ----------
    layers : weights (outputs, inputs) and biases (outputs,) from the first layer on
    discrete : whether the index of the largest output is the action; else the outputs are the action within [-1, 1]
    select : gives the inputs (..., n) of the network for an observation
    """

    def __init__(
        self,
        layers: list[tuple[Array, Array]],
        discrete: bool = False,
        select: Callable[[Observation], Array] = in_a_row,
    ) -> None:
        self._layers, self._discrete, self._select = layers, discrete, select

    def act(self, observation: Observation) -> NDArray[Any]:
        """The action (..., A), or (...) of discrete ones, for an observation (..., n) or a dict of its groups."""
        whole = self._select(observation)
        found = np.stack([self._outputs(row) for row in whole.reshape(-1, whole.shape[-1])])
        found = found.reshape(*whole.shape[:-1], -1)
        if self._discrete:
            return np.asarray(found.argmax(axis=-1))
        return np.clip(found, np.float32(-1.0), np.float32(1.0))

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
        There is none, the environment does not show an entry that it needs, or takes other actions.
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
        It cannot be read, the environment does not show an entry that it needs, or takes other actions.
    """
    return _fitting(path, f"agent {path}", "", env)


def _fitting(file: Traversable, name: str, where: str, env: DrivingEnv) -> LearntDriver:
    """The policy in a file for an environment that shows its entries and takes its actions."""
    learnt, layers = _read(file, name)
    inputs = PolicyInputs(tuple(learnt["columns"].tolist()), tuple(learnt["scales"].tolist()))
    selection = inputs.select_from(env.config.observation, name)
    outputs, discrete = layers[-1][1].size, bool(learnt["discrete"])
    if (spaces.flatdim(env.action_space), isinstance(env.action_space, spaces.Discrete)) != (outputs, discrete):
        remedy = "leave 'action' as it was there" if where else "drive an id that has it, or learn a policy here"
        raise InputError(
            f"{name} was learnt{where} with actions {_space(outputs, discrete)}, got an environment that takes "
            f"{_taken(env.action_space)}: {remedy} (see 'lanebound envs')"
        )
    return LearntDriver(layers, discrete, selection.flat)


def _space(outputs: int, discrete: bool) -> str:
    """The actions that a policy was learnt with, as :func:`_taken` names them."""
    return f"Discrete({outputs})" if discrete else f"Box({outputs},)"


def _taken(space: spaces.Space[Any]) -> str:
    """A space of actions as ``lanebound envs`` shows it."""
    return f"Box{space.shape}" if isinstance(space, spaces.Box) else str(space)


def _read(file: Traversable, name: str) -> tuple[dict[str, NDArray[Any]], list[tuple[Array, Array]]]:
    """The arrays of a policy that describe its inputs and actions, and its layers."""
    try:
        with file.open("rb") as stream, np.load(stream) as data:
            learnt = {key: data[key] for key in ("columns", "scales", "discrete")}
            count = sum(array.startswith("weight_") for array in data.files)
            layers = [(_numbers(data[f"weight_{n}"]), _numbers(data[f"bias_{n}"])) for n in range(count)]
    except (OSError, ValueError, TypeError, LookupError, AttributeError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(f"{name} must be as 'lanebound export' writes it, got {error}: export it anew") from None
    wide = learnt["columns"].size
    if learnt["columns"].ndim != 1 or learnt["scales"].shape != (wide,) or learnt["scales"].dtype.kind != "f":
        raise InputError(f"columns and scales of {name} must be (n,) names and numbers, got others: export it anew")
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
