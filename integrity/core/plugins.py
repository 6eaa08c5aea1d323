"""Names of things that users register from outside: ``name``, or ``package.module:name`` to import their module first.

Environments and configurations take the second form too, as the ids of Gymnasium do: it holds in worker processes and
on the command line, where nothing else imports the module.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping
from typing import TypeVar

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import nearest

__all__ = ["bare_name", "find"]

T = TypeVar("T")


def bare_name(name: str) -> str:
    """The name without its module, which is imported; modules in the current folder are found too.

    Raises
    ------
    ConfigError
        The module cannot be imported.
    """
    module, colon, rest = name.rpartition(":")
    if not colon:
        return name
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)
    try:
        importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(f"{name!r} must name a module that can be imported, got {error}: correct it") from error
    return rest


def find(name: str, table: Mapping[str, T], what: str) -> T:
    """The entry of a table, or ConfigError with the way to register one."""
    bare = bare_name(name)
    if bare in table:
        return table[bare]
    known = ", ".join(table) or "none"
    raise ConfigError(f"{what} must be among {known}, got {name!r}: {unknown(bare, table)}")


def unknown(name: str, known: Mapping[str, object]) -> str:
    """What to do about an unknown name."""
    advice = nearest(name, known)
    how = f"import the module that registers it, or write 'package.module:{name}'"
    return f"{advice}, or {how}" if advice.startswith("did you mean") else how
