"""Options and arguments that several commands have, and the changes that they make to a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = [
    "AsJson", "Assignments", "Budget", "Cores", "EnvId", "Faults", "Fps", "Fresh", "FullTables", "Jobs", "Plugins",
    "Seed", "Sky", "Video", "changes",
]  # fmt: skip


def _load(names: list[str] | None) -> list[str] | None:
    """Import plug-ins before a command looks at its other options."""
    if names:
        from lanebound.agents.plugins import load_plugins

        load_plugins(names)
    return names


AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Assignments = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a value; may be repeated.")
]
Budget = Annotated[float | None, typer.Option(min=0.0, metavar="HOURS", help="Start no part of the work after that.")]
Cores = Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")]
EnvId = Annotated[str, typer.Argument(metavar="ID", help="An environment, as 'lanebound envs' lists them.")]
Faults = Annotated[str | None, typer.Option(help="How often instruments fail: none, nominal or stress.")]
Fps = Annotated[int, typer.Option(min=1, help="Pictures of the film in a second of the drive.")]
Fresh = Annotated[bool, typer.Option("--fresh/--resume", help="Remove the results of an earlier run, or resume it.")]
FullTables = Annotated[bool, typer.Option("--full", help="Print the tables of every cell, with intervals.")]
Jobs = Annotated[int, typer.Option(min=1, help="Parts of the work at a time, a process each.")]
Plugins = Annotated[
    list[str] | None,
    typer.Option(
        "--plugin",
        metavar="FILE.py",
        callback=_load,
        is_eager=True,
        help="File or module of your own that registers extensions; may be repeated.",
    ),
]
"""The option itself loads the plug-ins: most commands do not read its value."""
Seed = Annotated[int, typer.Option(min=0, help="Seed of the first episode; each next one has the next.")]
Sky = Annotated[str | None, typer.Option(help="Sky: open, suburban, urban, dense, a file of record-sky, or FILE.yaml.")]
Video = Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Film the episodes.")]


def changes(assignments: list[str] | None, **named: Any) -> dict[str, Any]:
    """Values that ``--set`` and other options change; an option of its own, where it is given, wins."""
    from lanebound.integrity.core.presets import parse_assignments

    return parse_assignments(assignments or []) | {key: value for key, value in named.items() if value is not None}
