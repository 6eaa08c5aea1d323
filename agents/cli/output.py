"""How commands print: a table for people, JSON for programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

__all__ = ["format_value", "print_json", "print_table"]

WIDTH_OF_A_FILE = 100_000  # characters; tables take no more than they need


def format_value(value: Any) -> str:
    """A value as a person reads it: six digits of a float, ``yes``/``no``, ``-`` for nothing."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(format_value, value))
    return str(value)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print rows under a title; columns whose values are numbers are set flush right.

    In a terminal the table fits its width. A file or a pipe has none: each row is one line, however long.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    data = [list(row) for row in rows]
    table = Table(header_style="bold")
    for i, column in enumerate(columns):
        numeric = any(isinstance(row[i], int | float) and not isinstance(row[i], bool) for row in data)
        table.add_column(column, justify="right" if numeric else "left", overflow="fold")
    for row in data:
        table.add_row(*(Text(format_value(value)) for value in row))
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH_OF_A_FILE
    console.print(Text(title, style="italic"))
    console.print(table)


def print_json(data: Any) -> None:
    """Print plain data as JSON; what is infinite or NaN is ``null``."""
    import typer

    from lanebound.agents.plain import to_json_text

    typer.echo(to_json_text(data))
