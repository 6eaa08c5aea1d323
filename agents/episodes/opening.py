"""Environments by the names that people type."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import gymnasium

from lanebound.envs import IDS, DrivingEnv, make_config, wrap
from lanebound.integrity.errors import InputError
from lanebound.integrity.presets import nearest

__all__ = ["full_id", "open_env"]


def full_id(name: str) -> str:
    """The id that a name stands for: itself, or ours without ``lanebound/`` and version, in any case.

    >>> full_id("lanekeeping")
    'lanebound/LaneKeeping-v0'
    >>> full_id("two-way-v0")
    'two-way-v0'

    Raises
    ------
    InputError
        Neither one of ours nor one of highway-env's.
    """
    short = {_short(env_id): env_id for env_id in IDS}
    if _short(name) in short and (name.count("-v") == 0 or name.endswith("-v0")):
        return short[_short(name)]
    if name in gymnasium.registry and not name.startswith("lanebound/"):
        return name
    raise InputError(f"environment '{name}' is unknown: {nearest(name, [*IDS, *(i.split('/')[1] for i in IDS)])}")


def _short(name: str) -> str:
    return name.removeprefix("lanebound/").partition("-v")[0].lower()


def open_env(name: str, overrides: Mapping[str, Any] | None = None, render_mode: str | None = None) -> DrivingEnv:
    """The environment of a name, one of highway-env's wrapped; without Gymnasium's checks round it.

    Raises
    ------
    InputError
        As :func:`full_id`; ConfigError for a value that is refused.
    """
    env_id = full_id(name)
    if env_id not in IDS:
        return wrap(env_id, overrides, render_mode)
    make_config(env_id, overrides)  # refused here in our own words, not Gymnasium's
    made = gymnasium.make(env_id, config=dict(overrides or {}), render_mode=render_mode, disable_env_checker=True)
    return cast(DrivingEnv, made.unwrapped)
