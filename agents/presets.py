"""Configurations by the name of a packaged preset, or by the path of a YAML file; the id that is no driving world."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from lanebound.integrity.core.config import Config, preset_names
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import FILES, load_file, load_preset, nearest

__all__ = ["load_named", "refuse_journey", "require_named"]

C = TypeVar("C", bound=Config)


def require_named(what: str, folder: str, name: str, called: str | None = None) -> str:
    """The name of a preset without its folder.

    Raises
    ------
    ConfigError
        The preset does not exist, or is of another kind than ``called``.
    """
    presets = [preset for preset in preset_names() if preset.startswith(folder)]
    known = [p.removeprefix(folder) for p in presets if called is None or load_preset(p).get("kind") == called]
    short = name.removeprefix(folder)
    if short not in known:
        raise ConfigError(
            f"{what} '{name}' is unknown: {nearest(short, known)} (or the path of a YAML file of your own)"
        )
    return short


def refuse_journey(name: str) -> None:
    """Refuse Journey where a command drives a car: it decides on streets, and has no lanes, sky level or agents.

    Raises
    ------
    InputError
        The name is that of ``lanebound/Journey-v0``.
    """
    if name.removeprefix("lanebound/").partition("-v")[0].lower() == "journey":
        raise InputError(
            f"environment must be a driving world, got {name!r}: make it by gymnasium.make or make_vec "
            "('lanebound/Journey-v0', docs/environments.md#journey), compare its drivers by 'lanebound assess journeys'"
        )


def load_named(
    kind: type[C], what: str, folder: str, name: str, overrides: Mapping[str, Any] | None = None,
    called: str | None = None,
) -> C:  # fmt: skip
    """A configuration by its preset name, with or without ``folder``, or by the path of a YAML file.

    Parameters
    ----------
    what : name of the configuration in messages
    called : ``kind`` in presets of this class; ``what`` by default

    Raises
    ------
    ConfigError
        The preset does not exist, or a value is refused.
    """
    changes = overrides or {}
    if name.endswith(FILES):
        return kind.build(load_file(Path(name), what, called or what), changes)
    return kind.preset(folder + require_named(what, folder, name, called), changes)
