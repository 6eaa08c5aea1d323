"""Configurations that go by a name when packaged, and by the path of a YAML file otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from lanebound.integrity.config import Config, preset_names
from lanebound.integrity.errors import ConfigError
from lanebound.integrity.presets import nearest, parse_yaml

__all__ = ["load_named"]

C = TypeVar("C", bound=Config)


def load_named(kind: type[C], what: str, folder: str, name: str, overrides: Mapping[str, Any] | None = None) -> C:
    """A configuration of a class by its name below ``folder``, or by the path of its YAML file.

    Parameters
    ----------
    what : it is called in messages

    Raises
    ------
    ConfigError
        There is none, or a value is refused.
    """
    changes = overrides or {}
    if name.endswith((".yaml", ".yml")):
        try:
            data = parse_yaml(Path(name).read_text(encoding="utf-8"), name)
        except OSError as error:
            raise ConfigError(
                f"{what} must be a file that can be read, got {name} ({error}): correct the path"
            ) from None
        if isinstance(data, Mapping):
            data = {key: value for key, value in data.items() if key != "kind"}
        return kind.build(data, changes)
    known = [preset.removeprefix(folder) for preset in preset_names() if preset.startswith(folder)]
    if name not in known:
        raise ConfigError(
            f"{what} '{name}' is unknown: {nearest(name, known)} (or the path of a YAML file of your own)"
        )
    return kind.preset(folder + name, changes)
