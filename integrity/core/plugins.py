"""Names of things that users register from outside: ``name``, or ``package.module:name`` to import their module first.

Environments and configurations take the second form too, as the ids of Gymnasium do: it holds in worker processes and
on the command line, where nothing else imports the module.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import TypeVar

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import nearest

__all__ = ["bare_name", "find", "find_in", "import_from"]

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
    import_from(Path.cwd(), module, name)
    return rest


def import_from(folder: Path, module: str, name: str) -> ModuleType:
    """A module, found also in ``folder``, which stays on the search path; messages call it ``name``.

    Raises
    ------
    ConfigError
        The module cannot be imported, for whatever reason.
    """
    find_in(folder)
    try:
        return importlib.import_module(module)
    except Exception as error:
        frames = [frame for frame in extract_tb(error.__traceback__)[1:] if not frame.filename.startswith("<frozen")]
        where = f" at {frames[-1].filename}:{frames[-1].lineno}" if frames[1:] else ""
        raise ConfigError(
            f"{name!r} must name a module that can be imported, got {type(error).__name__}: {error}{where}: correct "
            "the name or the module"
        ) from error


def find_in(folder: Path) -> None:
    """Modules in ``folder`` can be imported from now on, after all others of the same name."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


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
