"""Agents from elsewhere: checkpoints of stable-baselines3, networks in files, and what a Python module makes.

Checkpoints and modules run code: open only those that you trust.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from gymnasium import spaces

from lanebound.agents.drivers.base import Driver, Starts, StatelessDriver, States
from lanebound.agents.drivers.inputs import INPUTS, PolicyInputs, Selection
from lanebound.agents.drivers.learnt import open_arrays
from lanebound.agents.drivers.origin import inputs_in, normalization_in, report_elsewhere
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import find_in, import_from
from lanebound.integrity.core.presets import nearest

__all__ = [
    "MODELS",
    "FunctionDriver",
    "OnnxDriver",
    "SelectingDriver",
    "is_foreign",
    "load_checkpoint",
    "onnx_session",
    "open_foreign",
    "require_foreign",
]

MODELS = (".zip", ".onnx", ".npz")
ALGORITHMS = {
    "cost_gae_lambda": "lanebound.agents.learning.ppo_lagrangian:PPOLagrangian",
    "cost_gamma": "lanebound.agents.learning.sac_lagrangian:SACLagrangian",
    "clip_range": "stable_baselines3:PPO",
    "policy_delay": "stable_baselines3:TD3",
    "target_entropy": "stable_baselines3:SAC",
    "exploration_fraction": "stable_baselines3:DQN",
    "gae_lambda": "stable_baselines3:A2C",
}
"""What a checkpoint must hold to be of an algorithm, the first that fits; it does not name its own."""
CONTRIB = {
    "RecurrentActorCritic": "sb3_contrib:RecurrentPPO",
    "MaskableActorCritic": "sb3_contrib:MaskablePPO",
    "top_quantiles_to_drop_per_net": "sb3_contrib:TQC",
    "n_quantiles": "sb3_contrib:QRDQN",
    "cg_max_steps": "sb3_contrib:TRPO",
}


def is_foreign(name: str) -> bool:
    """Whether a name is that of a file or of something in a module."""
    return name.endswith(MODELS) or ":" in name


def require_foreign(name: str) -> None:
    """Refuse what is not there, before any time is spent; nothing is run.

    Raises
    ------
    InputError
        There is no such file or module, a checkpoint is damaged, or what it takes is not installed.
    """
    if name.endswith(MODELS):
        if not Path(name).is_file():
            raise InputError(f"agent must be a file that exists, got {name}: correct the path")
        if name.endswith(".onnx"):
            _runtime()
        if name.endswith(".zip"):
            _described(name, _changed(name))
        return
    from importlib.util import find_spec

    find_in(Path.cwd())
    module, _, attribute = name.partition(":")
    try:
        found = find_spec(module)
    except (ImportError, ValueError):
        found = None
    if found is None:
        raise InputError(f"agent '{name}' must name a module that can be imported, got '{module}': correct the name")
    there = _names_in(found.origin)
    if there is not None and attribute not in there:
        raise InputError(
            f"agent '{name}' must name a callable of {module}, got '{attribute}', which is not there: "
            f"{nearest(attribute, sorted(there))}"
        )


def _names_in(source: str | None) -> set[str] | None:
    """Names that a module's source binds at its top level, modules apart; None where the source does not show them."""
    if source is None or not source.endswith(".py"):
        return None
    try:
        body = ast.parse(Path(source).read_text(encoding="utf-8")).body
    except (OSError, SyntaxError, ValueError):
        return None
    found: set[str] = set()
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            continue  # a module is no callable
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            found |= {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
        elif not isinstance(node, ast.Expr):
            return None  # names may be bound within it
    return None if found & {"*", "__getattr__"} else found


def open_foreign(name: str, env: DrivingEnv) -> Driver:
    """The agent of a file or a module.

    ``model.zip`` is a checkpoint of stable-baselines3 (or sb3-contrib), ``model.onnx`` or ``model.npz`` a network, and
    ``package.module:callable`` is called with the environment and returns an object with ``predict``, or a function
    from observations to actions.

    Raises
    ------
    InputError
        It is not there, or is made for other observations or actions.
    """
    require_foreign(name)
    if name.endswith(MODELS):
        report_elsewhere(name, env.config.base)
    if name.endswith(".zip"):
        return _checkpoint(name, env)
    if name.endswith(".onnx"):
        return OnnxDriver(onnx_session(Path(name)), env)
    if name.endswith(".npz"):
        return open_arrays(Path(name), env)
    return _called(name, env)


# Checkpoints of stable-baselines3


def _checkpoint(path: str, env: DrivingEnv) -> Driver:
    model: Any = load_checkpoint(Path(path))
    trained, shown = model.observation_space, env.observation_space
    if not _alike(model.action_space, env.action_space):
        raise _unlike(path, "actions", model.action_space, env.action_space)
    _require_bounds(path, model.action_space, env.action_space)
    config = env.config.observation
    inputs = inputs_in(Path(path)) or PolicyInputs.of(config)
    selection = inputs.select_from(config, f"agent {path}")
    if not _alike(trained, here := _as_taken(trained, selection)):
        raise _unlike(path, "observations", trained, here)
    statistics = normalization_in(Path(path), model)
    if statistics is None and selection.is_whole and type(trained) is type(shown):
        driver: Driver = model
        return driver
    select = selection.grouped if isinstance(trained, spaces.Dict) else selection.flat
    return SelectingDriver(model, select if statistics is None else lambda seen: statistics.apply(select(seen)))


def _as_taken(trained: spaces.Space[Any], selection: Selection) -> spaces.Space[Any]:
    """The observations that a selection gives, in the form that a policy takes: groups, or one vector."""
    sizes = selection.sizes
    groups = spaces.Dict({group: spaces.Box(-np.inf, np.inf, (size,), np.float32) for group, size in sizes.items()})
    return groups if isinstance(trained, spaces.Dict) else spaces.flatten_space(groups)


def _unlike(path: str, what: str, trained: spaces.Space[Any], here: spaces.Space[Any]) -> InputError:
    return InputError(
        f"agent {path} must be trained on these {what}, {_shape(here)}, got {_shape(trained)}: "
        "choose the environment that it was trained in"
    )


class SelectingDriver:
    """A driver that takes other observations than those of the environment: its entries are selected first."""

    def __init__(self, driver: Driver, select: Callable[[Any], Any]) -> None:
        self.driver, self.select = driver, select

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The action of that driver for its entries."""
        return self.driver.predict(self.select(observation), state, episode_start, deterministic)


def load_checkpoint(path: Path) -> Any:
    """The model of a checkpoint of Stable-Baselines3 or sb3-contrib, whose algorithm follows from what it holds.

    Raises
    ------
    InputError
        It is damaged, of an unknown algorithm, or needs a package that is not installed.
    """
    return _model(str(path), _changed(str(path)))


@lru_cache(maxsize=4)
def _model(path: str, changed: int) -> Any:
    """A cached model: policies hold no state between decisions."""
    module, _, name = _algorithm(path, _described(path, changed)).partition(":")
    try:
        return getattr(import_module(module), name).load(path, device="cpu")
    except ImportError:
        raise InputError(f"agent {path} needs the package {module}, got none: install it") from None


@lru_cache(maxsize=4)
def _described(path: str, changed: int) -> dict[str, Any]:
    """What a checkpoint says of itself; a damaged one is refused."""
    try:
        with ZipFile(path) as archive:
            if damaged := archive.testzip():
                raise BadZipFile(f"{damaged} is damaged")
            data: dict[str, Any] = json.loads(archive.read("data"))
    except (BadZipFile, KeyError, ValueError, OSError) as error:
        raise InputError(
            f"agent must be a checkpoint of stable-baselines3, got {path} ({error}): save it anew"
        ) from None
    return data


def _algorithm(path: str, data: dict[str, Any]) -> str:
    policy = str(data.get("policy_class", {}))
    for table, there in ((CONTRIB, "sb3_contrib" in policy), (ALGORITHMS, True)):
        for mark, algorithm in table.items():
            if there and (mark in data or mark in policy):
                return algorithm
    raise InputError(f"agent must be of a known algorithm, got {path}: write a module with a function that loads it")


def _alike(trained: spaces.Space[Any], here: spaces.Space[Any]) -> bool:
    if isinstance(trained, spaces.Dict) and isinstance(here, spaces.Dict):
        return set(trained) == set(here) and all(trained[key].shape == here[key].shape for key in here)
    if isinstance(trained, spaces.Discrete) and isinstance(here, spaces.Discrete):
        return bool(trained.n == here.n)
    return type(trained) is type(here) and trained.shape == here.shape


def _require_bounds(path: str, trained: spaces.Space[Any], here: spaces.Space[Any]) -> None:
    """Refuse a policy whose actions have another scale, as after training in a wrapper that rescales them."""
    if not (isinstance(trained, spaces.Box) and isinstance(here, spaces.Box)):
        return
    if not (np.allclose(trained.low, here.low) and np.allclose(trained.high, here.high)):
        bounds = "[{:g}, {:g}]"
        raise InputError(
            f"agent {path} must give actions in {bounds.format(here.low.min(), here.high.max())}, got a policy for "
            f"{bounds.format(trained.low.min(), trained.high.max())}: it was trained in a wrapper like RescaleAction; "
            "train it without, or drive it by your own MODULE:FUNCTION, which rescales"
        )


def _shape(space: spaces.Space[Any]) -> str:
    """What matters of a space, in a few words."""
    if isinstance(space, spaces.Dict):
        return ", ".join(f"{key} {part.shape}" for key, part in space.items())
    return str(space) if isinstance(space, spaces.Discrete) else f"{type(space).__name__} {space.shape}"


# ONNX


class OnnxDriver(StatelessDriver):
    """A network in an ONNX file: inputs named like the groups of the observation, or one for flat observations.

    The metadata of a file of 'lanebound export' hold the names of its observation entries; a file without them takes
    all entries in the order of the environment.

    Its first output is the action, or for discrete actions a value of each, of which the largest counts. Continuous
    actions are clipped into their space.

    Parameters
    ----------
    session : of onnxruntime

    Raises
    ------
    InputError
        Its inputs are not those of the environment, or its output is for other actions.
    """

    def __init__(self, session: Any, env: DrivingEnv) -> None:
        self.session, self.space = session, env.action_space
        self.inputs = [item.name for item in session.get_inputs()]
        text = session.get_modelmeta().custom_metadata_map.get(INPUTS)
        config = env.config.observation
        inputs = PolicyInputs.of(config) if text is None else PolicyInputs.from_json(text, "the ONNX agent")
        self._selection = inputs.select_from(config, "the ONNX agent")
        sizes = self._selection.sizes
        self._named = set(self.inputs) == set(sizes)
        if not self._named and len(self.inputs) != 1:
            raise InputError(
                f"an ONNX agent must take {', '.join(sizes)}, or one, got {', '.join(self.inputs)}: rename its inputs"
            )
        for item in session.get_inputs():
            wide, given = sizes[item.name] if self._named else inputs.size, item.shape[-1]
            if isinstance(given, int) and given != wide:
                raise InputError(
                    f"an ONNX agent must take {wide} numbers here, got {given}: choose the environment that it was "
                    "made for"
                )
        answer = session.get_outputs()[0]
        of = int(self.space.n) if isinstance(self.space, spaces.Discrete) else spaces.flatdim(self.space)
        answers = answer.shape[-1] if len(answer.shape) > 1 else None  # a code of an action is one number
        if isinstance(answers, int) and answers not in ({of, 1} if "int" in answer.type else {of}):
            raise InputError(
                f"an ONNX agent must answer with {of} numbers here, got {answers}: "
                "choose the environment that it was made for"
            )

    def act(self, observation: Any) -> Any:
        """The action for one observation."""
        select = self._selection
        parts = select.grouped(observation) if self._named else {self.inputs[0]: select.flat(observation)}
        given = {name: np.asarray(parts[name], dtype=np.float32)[None] for name in self.inputs}
        found = np.asarray(self.session.run(None, given)[0])[0]
        if isinstance(self.space, spaces.Discrete):
            return np.asarray(found if found.dtype.kind in "iu" else np.argmax(found))
        assert isinstance(self.space, spaces.Box)
        return np.clip(found, self.space.low, self.space.high).astype(np.float32)  # NaN stays NaN


def onnx_session(path: Path) -> Any:
    """The session of onnxruntime for a network.

    Raises
    ------
    InputError
        The file is no network, or the package is missing.
    """
    return _session(str(path), _changed(str(path)))


@lru_cache(maxsize=4)
def _session(path: str, changed: int) -> Any:
    runtime = _runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has many kinds of them, without a common one of its own
        raise InputError(f"agent must be an ONNX network, got {path} ({error}): export it anew") from None


def _runtime() -> Any:
    try:
        return import_module("onnxruntime")
    except ImportError:
        raise InputError("an ONNX agent needs the package onnxruntime, got none: pip install onnxruntime") from None


# Python


class FunctionDriver(StatelessDriver):
    """A function from observations to actions as a driver."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.function = function

    def act(self, observation: Any) -> Any:
        """The action by the function."""
        return self.function(observation)


def _called(name: str, env: DrivingEnv) -> Driver:
    module, _, attribute = name.partition(":")
    make = getattr(import_from(Path.cwd(), module, name), attribute, None)
    if not callable(make):
        raise InputError(f"agent '{name}' must name a callable of {module}, got {make!r}: correct the name")
    _require_taking(make, name, env)
    agent = make(env)
    if not hasattr(agent, "predict") and not callable(agent):
        raise InputError(f"agent '{name}' must return an object with predict or a function, got {agent!r}: return one")
    driver: Driver = agent if hasattr(agent, "predict") else FunctionDriver(agent)
    return driver


def _require_taking(make: Callable[..., Any], name: str, env: DrivingEnv) -> None:
    """Refuse what cannot be called with the environment alone."""
    try:
        found = signature(make)
    except (TypeError, ValueError):  # Python knows none of it
        return
    try:
        found.bind(env)
    except TypeError as error:
        taken = f"{name.rpartition(':')[2]}{found} ({error})"
        raise InputError(
            f"agent '{name}' must be callable with the environment, got {taken}: give it one argument"
        ) from None


def _changed(path: str) -> int:
    """When a file was changed last: another version of it is another model."""
    return Path(path).stat().st_mtime_ns
