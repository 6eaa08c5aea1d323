"""Refusals before the slow imports of a command: names that can be checked against static lists."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lanebound.agents.drivers import AGENTS, unknown_agent

__all__ = ["FAULTS", "SKIES", "refuse_early"]

FILES = (".zip", ".onnx", ".npz", ".csv", ".yaml", ".yml")
SKIES = ("open", "suburban", "urban", "dense")
FAULTS = ("none", "nominal", "stress")


def refuse_early(
    env: str | None = None,
    agent: str | None = None,
    sky: str | None = None,
    faults: str | None = None,
    changes: Mapping[str, Any] | None = None,
) -> None:
    """Refuse the name of an environment, agent, sky or level of faults that cannot exist; a file is checked later.

    ``changes`` of an environment's configuration are refused for unknown keys and numbers out of bounds.

    An environment with a module (``package:id``) or with a version may be registered elsewhere, and passes.

    Raises
    ------
    InputError
        As the command itself would raise it later.
    """
    if env is not None:
        _require_env(env)
    if agent is not None and agent not in AGENTS and not agent.endswith(FILES) and ":" not in agent:
        raise unknown_agent(agent)
    if sky is not None and not sky.endswith(FILES) and "/" not in sky:
        _require("sky", sky, SKIES, ", or a file", " (files: .csv of 'lanebound record-sky', .yaml of your own)")
    if changes:
        from lanebound.agents.cli.keys import refuse_keys

        refuse_keys("environment", changes)
    if faults is not None:
        _require("faults", faults, FAULTS)


def _require_env(name: str) -> None:
    from lanebound.agents.cli.listing import LISTING
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.core.presets import nearest

    ids = [row["id"].partition("/")[2] for row in LISTING]
    short = name.removeprefix("lanebound/")
    ours = name != short or "-v" not in name
    if ours and ":" not in name and short.partition("-v")[0].lower() not in {i.partition("-v")[0].lower() for i in ids}:
        raise InputError(f"environment '{name}' is unknown: {nearest(short, ids)}")


def _require(what: str, name: str, known: tuple[str, ...], also: str = "", how: str = "") -> None:
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import nearest

    if name not in known:
        raise ConfigError(f"{what} must be one of {', '.join(known)}{also}, got {name!r}: {nearest(name, known)}{how}")
