"""Refusals at the command line in one form: field, bound, value and remedy; exit code 2, no traceback."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import typer
from typer.core import TyperGroup

SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


class AdvisingGroup(TyperGroup):
    """A group of commands whose errors, its own and those of typer, are printed as one line of advice each."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the program and exit with its code; errors of typer get the form of this package."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        try:
            sys.exit(super().main(args, prog_name, complete_var, False, windows_expand_args, **extra) or 0)
        except typer.Abort:
            typer.echo("interrupted: nothing is kept", err=True)
            sys.exit(130)
        except Exception as error:
            if not hasattr(error, "format_message"):  # not typer's; its classes cannot be named in every version
                raise
            _say(explain(error))
            sys.exit(getattr(error, "exit_code", 2))

    def invoke(self, ctx: Any) -> Any:
        """Run a command; an InputError becomes a message on standard error and exit code 2."""
        try:
            return super().invoke(ctx)
        except ValueError as error:
            from lanebound.integrity.core.errors import InputError

            if not isinstance(error, InputError):
                raise
            folder = sys.modules.get("lanebound.agents.checkpointing.folder")
            if folder is not None:
                folder.ResultFolder.release_begun()
            _say(str(error))
            raise typer.Exit(2) from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is asked for, or an InputError that offers the nearest."""
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            from lanebound.integrity.core.errors import InputError

            raise InputError(f"command '{args[0]}' is unknown: {_nearest(args[0], self.list_commands(ctx))}")
        found = super().resolve_command(ctx, args)
        _require_no_opposites(found[1], found[2])
        return found


def _require_no_opposites(command: Any, args: Sequence[str]) -> None:
    """Refuse the two names of a switch together, such as ``--fresh --resume``: the last one would win."""
    for parameter in getattr(command, "params", ()):
        on = [name for name in getattr(parameter, "opts", ()) if name in args]
        off = [name for name in getattr(parameter, "secondary_opts", ()) if name in args]
        if on and off:
            from lanebound.integrity.core.errors import InputError

            raise InputError(f"{on[0]} and {off[0]} must not be given together, got both: leave one of them out")


def explain(error: Any) -> str:
    """An error of typer in the form ``field bound, got value: remedy``; "" for a request of help."""
    kind, context = type(error).__name__, getattr(error, "ctx", None)
    if kind == "NoArgsIsHelpError":
        return ""
    see_help = f"see '{context.command_path if context is not None else 'lanebound'} --help'"
    if kind == "NoSuchOption":
        return f"option '{error.option_name}' is unknown: {_nearest(error.option_name, _options(context))}"
    name = _name(getattr(error, "param", None))
    if kind == "MissingParameter" and name:
        return f"{name} is required, got nothing: add it, {see_help}"
    findings = getattr(error.__cause__, "errors", None)
    if findings is not None and name:
        return f"{name} must {_demand(findings()[0])}: correct that value, {see_help}"
    message = error.format_message().rstrip(".")
    return f"{message[:1].lower()}{message[1:]}: {see_help}"


def _demand(finding: Mapping[str, Any]) -> str:
    """Bound and value of an error of pydantic: ``be >= 1, got 0``."""
    bounds = [f"{SIGNS[key]} {limit:g}" for key, limit in finding.get("ctx", {}).items() if key in SIGNS]
    wanted = " and ".join(bounds) or str(finding["msg"]).removeprefix("Input should be ").partition(",")[0]
    return f"be {wanted}, got {finding['input']}"


def _name(parameter: Any) -> str:
    """An option by its long form, an argument as the help shows it."""
    if parameter is None:
        return ""
    if parameter.param_type_name == "option":
        return max(parameter.opts, key=len, default="")
    return str(parameter.metavar or parameter.name)


def _options(context: Any) -> Sequence[str]:
    """The long options of a command."""
    parameters = context.command.get_params(context) if context is not None else ()
    return [name for p in parameters for name in getattr(p, "opts", ()) if name.startswith("--")]


def _nearest(word: str, known: Sequence[str]) -> str:
    from lanebound.integrity.core.presets import nearest

    return nearest(word, known)


def _say(text: str) -> None:
    for line in text.splitlines():
        typer.echo(f"error: {line}", err=True)
