"""Plug-ins: modules of a user that register extensions when they are imported, in this process and in its workers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import import_from

__all__ = ["load_plugins", "loaded_plugins"]

_loaded: dict[str, str | None] = {}


def loaded_plugins() -> dict[str, str | None]:
    """What :func:`load_plugins` imported, in order, with the files; worker processes import the same."""
    return dict(_loaded)


def load_plugins(names: Iterable[str]) -> None:
    """Import modules by their names, or by the paths of their files; modules of the present folder are found too.

    Their folders stay on the search path, so that worker processes find the modules.

    Raises
    ------
    ConfigError
        There is no such module, or it fails to import.
    InputError
        There is no such file, or another module has the name of the file.
    """
    for name in names:
        file = Path(name).resolve() if name.endswith(".py") else None
        if file is not None and not file.is_file():
            raise InputError(f"plugin must be a module or the path of its file, got {name}, which does not exist")
        folder, module_name = (Path.cwd(), name) if file is None else (file.parent, file.stem)
        module = import_from(folder, module_name, name)
        if file is not None and Path(module.__file__ or "").resolve() != file:
            raise InputError(
                f"plugin must have a name of its own, got {name}, but {module.__file__} is imported: rename it"
            )
        _loaded[name if file is None else str(file)] = module.__file__
