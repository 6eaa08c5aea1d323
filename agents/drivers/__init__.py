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
    "cautious": "lanebound.agents.drivers.margins:make_cautious",
    "cbf": "lanebound.agents.drivers.barrier:make_cbf",
    "cruise": "lanebound.agents.drivers.cruise:make_cruise",
    "idm": "lanebound.agents.drivers.cruise:make_idm",
    "integrity_aware": "lanebound.agents.drivers.aware:make_integrity_aware",
    "lqr": "lanebound.agents.drivers.cruise:make_lqr",
    "mpc": "lanebound.agents.drivers.mpc:make_mpc",
    "nominal": "lanebound.agents.drivers.nominal:make_nominal",
    "oracle": "lanebound.agents.drivers.nominal:make_oracle",
    "random": "lanebound.agents.drivers.random:RandomDriver",
    "rss": "lanebound.agents.drivers.margins:make_rss",
    "stanley": "lanebound.agents.drivers.cruise:make_stanley",
    "stop_on_alert": "lanebound.agents.drivers.stop:make_stop_on_alert",
}


def make_agent(name: str, env: DrivingEnv) -> Driver:
    """The agent of that name for an environment, made from its spaces and its published index alone.

    The name may also be that of a file or a callable, see :func:`~lanebound.agents.drivers.foreign.open_foreign`.

    Raises
    ------
    InputError
        No agent has that name, or the environment does not show what it needs.
    """
    if name not in AGENTS:
        from lanebound.agents.drivers.foreign import is_foreign, open_foreign

        if is_foreign(name):
            return open_foreign(name, env)
        from lanebound.integrity.presets import nearest

        raise InputError(f"agent '{name}' is unknown: {nearest(name, AGENTS)}")
    module, _, maker = AGENTS[name].partition(":")
    driver: Driver = getattr(import_module(module), maker)(env)
    return driver
