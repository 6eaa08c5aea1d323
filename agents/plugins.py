"""Modules of a user that register kinds of their own when they are imported."""

from __future__ import annotations

from pathlib import Path

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import import_from

__all__ = ["load_plugin"]


def load_plugin(name: str) -> None:
    """Import a module by its name, or by the path of its file; modules of the present folder are found too.

    Its folder stays on the search path, so that worker processes find the module.

    Raises
    ------
    ConfigError
        There is no such module, or it fails to import.
    InputError
        There is no such file, or another module has the name of the file.
    """
    file = Path(name).resolve() if name.endswith(".py") else None
    if file is not None and not file.is_file():
        raise InputError(f"plugin must be a module or the path of its file, got {name}, which does not exist")
    folder, module_name = (Path.cwd(), name) if file is None else (file.parent, file.stem)
    module = import_from(folder, module_name, name)
    if file is not None and Path(module.__file__ or "").resolve() != file:
        raise InputError(
            f"plugin must have a name of its own, got {name}, but {module.__file__} is imported: rename it"
        )
