"""Refusals at the command line: what is wrong and what to do, exit code 2, no traceback."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

__all__ = ["AdvisingGroup"]


class AdvisingGroup(TyperGroup):
    """A group of commands whose input errors are printed as advice."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; an InputError becomes a message on standard error and exit code 2."""
        try:
            return super().invoke(ctx)
        except ValueError as error:
            from lanebound.integrity.errors import InputError

            if not isinstance(error, InputError):
                raise
            for line in str(error).splitlines():
                typer.echo(f"error: {line}", err=True)
            raise typer.Exit(2) from None
