"""The algorithms by name: made for an experiment; refusals name the setting."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.learning.constraints import group_limits
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["CLASSES", "class_of", "make_model", "require_known"]

CLASSES = {
    Algorithm.PPO: "stable_baselines3:PPO",
    Algorithm.SAC: "stable_baselines3:SAC",
    Algorithm.RECURRENT_PPO: "sb3_contrib:RecurrentPPO",
    Algorithm.PPO_LAGRANGIAN: "lanebound.agents.learning.ppo_lagrangian:PPOLagrangian",
    Algorithm.SAC_LAGRANGIAN: "lanebound.agents.learning.sac_lagrangian:SACLagrangian",
}
REFUSALS = (TypeError, ValueError, AssertionError, AttributeError, LookupError, RuntimeError, MemoryError)
MOST_SHOWN = 60  # characters of a value in a message


def class_of(algorithm: Algorithm) -> Any:
    """The class of an algorithm.

    Raises
    ------
    InputError
        Its package is missing.
    """
    module, _, name = CLASSES[algorithm].partition(":")
    try:
        return getattr(import_module(module), name)
    except ImportError:
        raise InputError(
            f"algorithm {algorithm} needs the package {module}, got none: pip install {module.replace('_', '-')}"
        ) from None


def require_known(experiment: ExperimentConfig) -> None:
    """Raise InputError for a setting that the algorithm does not take, or a device that this machine does not have."""
    built_on = class_of(experiment.algorithm).__mro__
    taken = (p for one in built_on for p in inspect.signature(one.__init__).parameters.values())
    known = {p.name for p in taken if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)} - {"self"}
    for name in experiment.settings:
        if name not in known:
            raise InputError(
                f"settings.{name} must be one that {experiment.algorithm} takes, got one it does not: "
                f"{nearest(name, known)}"
            )
    device = experiment.settings.get("device", "cpu")
    if str(device).startswith("cuda") and not torch.cuda.is_available():  # stable-baselines3 would take cpu silently
        raise InputError(f"settings.device must be one of this machine, got {device!r} without CUDA: use cpu or auto")


def make_model(experiment: ExperimentConfig, env: VecEnv, logs: str | None) -> BaseAlgorithm:
    """The untrained model of an experiment.

    Raises
    ------
    InputError
        The algorithm refuses a setting.
    """
    try:
        return _made(experiment, env, logs, experiment.settings)
    except InputError:
        raise
    except REFUSALS as error:
        name, value = _culprit(experiment, env)
        raise InputError(
            f"{name} must suit {experiment.algorithm} and {experiment.env}, got {_shown(value)} "
            f"({_first_line(error)}): see stable-baselines3"
        ) from None


def _made(experiment: ExperimentConfig, env: VecEnv, logs: str | None, settings: Mapping[str, Any]) -> BaseAlgorithm:
    ours: dict[str, Any] = {"seed": experiment.seed, "device": "cpu", "tensorboard_log": logs}
    if experiment.algorithm.constrained:
        groups = group_limits(experiment.env_config)
        ours |= {"cost_limit": experiment.limit(), "cost_limits": groups, "multiplier": experiment.multiplier}
    policy = "MlpLstmPolicy" if experiment.algorithm is Algorithm.RECURRENT_PPO else "MlpPolicy"
    found: BaseAlgorithm = class_of(experiment.algorithm)(policy, env, **{**ours, **settings})
    return found


def _culprit(experiment: ExperimentConfig, env: VecEnv) -> tuple[str, Any]:
    """Path and value of the setting without which the algorithm can be made; all settings where there is none."""
    for path, value, others in _each_left_out("settings", experiment.settings):
        try:
            _made(experiment, env, None, others)
        except REFUSALS:
            continue
        return path, value
    return "settings", dict(experiment.settings)


def _each_left_out(path: str, settings: Mapping[str, Any]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Every setting with its path and value, and the settings without it; nested ones first."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            for inner, found, rest in _each_left_out(f"{path}.{name}", value):
                yield inner, found, {**settings, name: rest}
        yield f"{path}.{name}", value, {key: kept for key, kept in settings.items() if key != name}


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).strip().partition("\n")[0]
