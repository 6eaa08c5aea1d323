"""Agents by name: controllers that drive on what an observation says, with the interface of stable-baselines3."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from lanebound.integrity.errors import InputError

if TYPE_CHECKING:
    from lanebound.agents.drivers.base import Driver
    from lanebound.envs.core import DrivingEnv

__all__ = ["AGENTS", "make_agent"]

AGENTS = {
    "cruise": "lanebound.agents.drivers.cruise:make_cruise",
    "random": "lanebound.agents.drivers.random:RandomDriver",
}


def make_agent(name: str, env: DrivingEnv) -> Driver:
    """The agent of that name for an environment, made from its spaces and its published index alone.

    Raises
    ------
    InputError
        No agent has that name, or the environment does not show what it needs.
    """
    if name not in AGENTS:
        from lanebound.integrity.presets import nearest

        raise InputError(f"agent '{name}' is unknown: {nearest(name, AGENTS)}")
    module, _, maker = AGENTS[name].partition(":")
    driver: Driver = getattr(import_module(module), maker)(env)
    return driver
