"""Tables of Markdown pages that commands write: each stands between ``<!-- NAME -->`` and ``<!-- end of NAME -->``."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from lanebound.integrity.core.errors import InputError

Table = tuple[Sequence[str], Sequence[Sequence[Any]]]
"""Heads of the columns, and rows."""


def require_page(path: Path, names: Iterable[str]) -> None:
    """Refuse a page that lacks a place for a table, before anything is measured.

    Raises
    ------
    InputError
        It cannot be read, or has no such place.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"page must be a file that can be read, got {path} ({error}): correct the path") from None
    for name in names:
        begin, end = _marks(name)
        if not 0 <= text.find(begin) < text.find(end):
            raise InputError(f"page must have the lines {begin} and {end}, got {path} without: add them")


def fill(path: Path, tables: Mapping[str, Table]) -> None:
    """Write tables into their places in a page.

    Raises
    ------
    InputError
        As :func:`require_page`.
    """
    require_page(path, tables)
    text = path.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = _marks(name)
        head, _, rest = text.partition(begin)
        text = f"{head}{begin}\n\n{text_of(*table)}\n\n{end}{rest.partition(end)[2]}"
    path.write_text(text, encoding="utf-8")


def text_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows))


def csv_of(table: Table) -> str:
    """A table as comma-separated values, for a file."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows([table[0], *table[1]])
    return text.getvalue()


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name} -->", f"<!-- end of {name} -->"
