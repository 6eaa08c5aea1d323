"""Files that are complete or absent, and JSON in them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from lanebound.agents.serialization import to_json_text
from lanebound.integrity.core.errors import InputError

T = TypeVar("T")
JSON_NAMES: dict[type, str] = {dict: "object", list: "array"}


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """A context whose target is a draft file; at the end the draft replaces ``path``, after an error it is removed."""
    draft = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        yield draft
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    os.replace(draft, path)


def write_json(path: Path, data: Any, infinite: bool = False) -> None:
    """Write plain data as JSON; missing folders are made.

    Parameters
    ----------
    infinite : infinity and NaN are written as Python reads them; else as ``null``
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as draft:
        text = json.dumps(data, indent=1) if infinite else to_json_text(data, indent=1)
        draft.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path, kind: type[T]) -> T:
    """Read JSON whose outermost value is of type ``kind``.

    Raises
    ------
    InputError
        The file is not JSON, or holds another type; OSError where it cannot be read.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path} is not JSON ({error}): restore it or choose a new folder") from None
    if not isinstance(found, kind):
        raise InputError(
            f"{path} must hold a JSON {JSON_NAMES[kind]}, got {type(found).__name__}: restore it or choose a new folder"
        )
    return found


def make_folder(path: Path) -> None:
    """Make a folder and test that files can be written there.

    Raises
    ------
    InputError
        The folder cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".{os.getpid()}.probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"out must be a folder that can be written, got {path} ({error}): choose another") from error
