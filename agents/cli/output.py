"""Output of commands: tables and JSON."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

from lanebound.agents.serialization import counted

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from lanebound.agents.report.pages import Table

__all__ = ["counted", "format_value", "open_console", "print_json", "print_table", "show_study"]

WIDTH_OF_A_FILE = 100  # characters, where COLUMNS gives no other
NARROW = 12  # characters of a column, at which text can still be read
LONG_WORD = 24  # characters; longer ones may be broken


def format_value(value: Any) -> str:
    """A value as text: six digits of a float, ``yes``/``no``, ``-`` for None."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, list | tuple):
        return ", ".join(map(format_value, value))
    return str(value)


def open_console() -> Console:
    """Standard output; a file or a pipe has the width COLUMNS, or one that is easy to read."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        console.width = WIDTH_OF_A_FILE
    return console


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], numbers: Collection[str] = ()
) -> None:
    """Print rows under a title; columns of numbers, and those in ``numbers``, are aligned to the right.

    The table fits the width of the terminal. Long text is wrapped, but the first column and heads are never broken:
    where they leave no room the table is wider.
    """
    from rich.table import Table
    from rich.text import Text

    data = [list(row) for row in rows]
    texts = [[format_value(value) for value in row] for row in data]
    table, console = Table(header_style="bold"), open_console()
    least = [_least_width(c, (row[i] for row in texts), i == 0) for i, c in enumerate(columns)]
    most = [_least_width(c, (row[i] for row in texts), True) for i, c in enumerate(columns)]
    widths = _fitted(least, most, columns, console.width)
    for i, (column, width) in enumerate(zip(columns, widths, strict=True)):
        numeric = column in numbers or any(
            isinstance(row[i], int | float) and not isinstance(row[i], bool) for row in data
        )
        justify: Literal["left", "right"] = "right" if numeric else "left"
        table.add_column(Text(column), justify=justify, overflow="fold", no_wrap=i == 0, width=width)
    for row in texts:
        table.add_row(*map(Text, row))
    console.width = max(console.width, sum(widths) + 3 * len(widths) + 1)
    console.print(Text(title, style="italic"))
    console.print(table)


def _least_width(head: str, texts: Iterable[str], whole: bool = False) -> int:
    """Least width of a column without breaks in its head and its words (but very long ones), or ``whole`` texts."""
    words = (len(word) for text in texts for word in ((text,) if whole else text.split()))
    return max([*map(len, head.split("\n")), *(length for length in words if whole or length <= LONG_WORD)])


def _fitted(least: Sequence[int], most: Sequence[int], columns: Sequence[str], room: int) -> list[int]:
    """Widths of columns that fit.

    Where the least widths do not fit, the widest columns but the first are narrowed down to a readable width. Free
    space goes to the columns with the smallest share of their largest width.
    """
    fitted, spare = list(least), room - sum(least) - 3 * len(least) - 1
    for i in sorted(range(1, len(fitted)), key=lambda i: -fitted[i]):
        given = max(0, min(-spare, fitted[i] - max(_least_width(columns[i], ()), NARROW)))
        fitted[i] -= given
        spare += given
    for _ in range(spare):
        short = [i for i, width in enumerate(fitted) if width < most[i]]
        if not short:
            break
        fitted[min(short, key=lambda i: fitted[i] / most[i])] += 1
    return fitted


def show_study(found: Any, tables: Mapping[str, Table], out: Path, page: Path | None, as_json: bool) -> None:
    """Write the tables of a study into its page if there is one, and print them, or its data, and where these are."""
    import typer

    from lanebound.agents.report.pages import fill

    if page is not None:
        fill(page, tables)
    if as_json:
        print_json(found)
        return
    for title, (heads, rows) in tables.items():
        if rows:  # a short run may leave a table empty
            print_table(title, heads, rows)
    typer.echo(f"results.json: {out}")


def print_json(data: Any) -> None:
    """Print plain data as JSON; infinity and NaN are ``null``."""
    import typer

    from lanebound.agents.serialization import to_json_text

    typer.echo(to_json_text(data))
