"""Environments by short names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, cast

import gymnasium

from lanebound.agents.presets import refuse_journey
from lanebound.envs import IDS, DrivingEnv, make_config, wrap
from lanebound.envs.ids import every_id
from lanebound.envs.navigation import NavigationConfig
from lanebound.integrity.core.config_errors import below
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["full_id", "naming", "open_env"]


def full_id(name: str) -> str:
    """The id of a name: an id, or one of lanebound without ``lanebound/`` and version, in upper or lower case.

    >>> full_id("lanekeeping")
    'lanebound/LaneKeeping-v0'
    >>> full_id("two-way-v0")
    'two-way-v0'

    Raises
    ------
    InputError
        Neither an id of lanebound nor of highway-env, or the one of journeys.
    """
    refuse_journey(name)
    short = {_short(env_id): env_id for env_id in every_id()}
    if _short(name) in short and (name.count("-v") == 0 or name.endswith("-v0")):
        return short[_short(name)]
    if name in gymnasium.registry and not name.startswith("lanebound/"):
        return name
    known = (env_id.partition("/")[2] for env_id in IDS)
    raise InputError(f"environment '{name}' is unknown: {nearest(name.removeprefix('lanebound/'), known)}")


def _short(name: str) -> str:
    return name.removeprefix("lanebound/").partition("-v")[0].lower()


def open_env(name: str, overrides: Mapping[str, Any] | None = None, render_mode: str | None = None) -> DrivingEnv:
    """The environment of a name, wrapped where it is one of highway-env, without Gymnasium's checks.

    Raises
    ------
    InputError
        As :func:`full_id`; ConfigError for a value that is refused.
    """
    env_id = full_id(name)
    if env_id not in every_id():
        return wrap(env_id, overrides, render_mode)
    make_config(env_id, overrides)  # refused here, before Gymnasium changes the message
    try:
        made = gymnasium.make(env_id, config=dict(overrides or {}), render_mode=render_mode, disable_env_checker=True)
    except ConfigError as error:
        raise ConfigError(_in_full(str(error), (overrides or {}).get("navigator", {}))) from None
    return cast(DrivingEnv, made.unwrapped)


@contextmanager
def naming(sources: Mapping[str, Mapping[str, Any]]) -> Iterator[None]:
    """In this context refusals of an environment name the full path of the key in the user's configuration.

    Parameters
    ----------
    sources : by path, the mappings merged into the environment's configuration; the first with the key is named

    >>> with naming({"overrides": {"duraton_s": 5}}):
    ...     raise ConfigError("duraton_s is not a known key: did you mean 'duration_s'?")
    Traceback (most recent call last):
    lanebound.integrity.core.errors.ConfigError: overrides.duraton_s is not ...: did you mean 'overrides.duration_s'?
    """
    try:
        yield
    except ConfigError as error:
        lines = [_from_source(line, sources) for line in str(error).splitlines()]
        raise ConfigError("\n".join(lines)) from None


def _from_source(line: str, sources: Mapping[str, Mapping[str, Any]]) -> str:
    path = line.split()[0].rstrip(":").split(".") if line.split() else []
    source = next((name for name, given in sources.items() if _has(given, path)), "")
    return below(source, line) if source else line


def _has(given: Any, path: Sequence[str]) -> bool:
    """Whether nested mappings hold a path, or a value that is no mapping before its end."""
    for place, key in enumerate(path):
        if not isinstance(given, Mapping):
            return place > 0
        if key not in given:
            return False
        given = given[key]
    return bool(path)


def _in_full(message: str, given: Mapping[str, Any]) -> str:
    """The refusal of a navigator with the full paths of the overrides ``given`` for it.

    >>> _in_full("rate_hz is not a known key: known are dt_s, risk", {"rate_hz": -5})
    "navigator.rate_hz is not a known key: did you mean 'navigation.rate_hz'?"
    """
    lines = []
    for line in message.splitlines():
        key = line.split()[0]
        if key in given and key in NavigationConfig.model_fields and "is not a known key" in line:
            line = f"navigator.{key} is not a known key: did you mean 'navigation.{key}'?"
        elif key.partition(".")[0] in given:
            line = below("navigator", line)
        lines.append(line)
    return "\n".join(lines)
