"""Agents by name: controllers that drive on what an observation says, with the interface of stable-baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import NoneType
from typing import TYPE_CHECKING, Any, cast, get_args, get_type_hints

from lanebound.integrity.errors import InputError

if TYPE_CHECKING:
    from lanebound.agents.drivers.base import Driver
    from lanebound.envs.core import DrivingEnv
    from lanebound.integrity.config import Config

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


def make_agent(name: str, env: DrivingEnv, figures: Mapping[str, Any] | None = None) -> Driver:
    """The agent of that name for an environment, made from its spaces and its published index alone.

    The name may also be that of a file or a callable, see :func:`~lanebound.agents.drivers.foreign.open_foreign`.
    ``figures`` change the agent's own configuration, such as ``{"speed_share": 0.5}`` that of ``cautious``.

    Raises
    ------
    InputError
        No agent has that name, it has no such figures, or the environment does not show what it needs.
    """
    if name in AGENTS:
        module, _, maker = AGENTS[name].partition(":")
        make = getattr(import_module(module), maker)
        driver: Driver = make(env, _config_class(name, make).load(dict(figures))) if figures else make(env)
        return driver
    from lanebound.agents.drivers.foreign import is_foreign, open_foreign

    if not is_foreign(name):
        from lanebound.integrity.presets import nearest

        raise InputError(f"agent '{name}' is unknown: {nearest(name, AGENTS)}")
    if figures:
        raise InputError(f"figures must be empty for '{name}', got {sorted(figures)}: only agents of ours have figures")
    return open_foreign(name, env)


def _config_class(name: str, make: Any) -> type[Config]:
    """The class of an agent's figures, as its maker declares it."""
    if not isinstance(make, type):
        for kind in get_args(get_type_hints(make).get("config")):
            if kind is not NoneType:
                return cast("type[Config]", kind)
    raise InputError(f"figures must be empty for '{name}', got some: this agent has none")
