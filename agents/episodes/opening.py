"""Environments by the names that people type."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import gymnasium

from lanebound.envs import IDS, DrivingEnv, make_config, wrap
from lanebound.envs.navigation import NavigationConfig
from lanebound.integrity.errors import ConfigError, InputError
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
    try:
        made = gymnasium.make(env_id, config=dict(overrides or {}), render_mode=render_mode, disable_env_checker=True)
    except ConfigError as error:
        raise ConfigError(_in_full(str(error), (overrides or {}).get("navigator", {}))) from None
    return cast(DrivingEnv, made.unwrapped)


def _in_full(message: str, given: Mapping[str, Any]) -> str:
    """What a navigator refuses of the overrides ``given`` for it, with their whole path.

    >>> _in_full("rate_hz is not a known key: known are dt_s, risk", {"rate_hz": -5})
    "navigator.rate_hz is not a known key: did you mean 'navigation.rate_hz'?"
    """
    lines = []
    for line in message.splitlines():
        key = line.split()[0]
        if key in given and key in NavigationConfig.model_fields and "is not a known key" in line:
            line = f"{key} is not a known key: did you mean 'navigation.{key}'?"
        lines.append(f"navigator.{line}" if key.partition(".")[0] in given else line)
    return "\n".join(lines)
