"""Options and arguments that several commands have, and the changes that they make to a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

DEFAULT_FPS = 10
OPTION_OF = {"risks": "--risk"}
"""Options whose names differ from the keys that they set."""


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
EnvIds = Annotated[
    list[str] | None, typer.Option("--env", metavar="ID", help="This id alone; may be repeated. All eight otherwise.")
]
EnvId = Annotated[str, typer.Argument(metavar="ID", help="An environment, as 'lanebound envs' lists them.")]
Faults = Annotated[str | None, typer.Option(help="Instruments fail: none, nominal, stress or one (in each episode).")]
OwnFaults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="KEY=VALUE,...",
        help="A fault of your own in every episode, in place of random ones: kind=spoofing,start_s=5,magnitude_m=3; "
        "may be repeated. Keys: docs/environments.md#faults.",
    ),
]
Fps = Annotated[int | None, typer.Option(min=1, help="Pictures of the film in a second of the drive; 10 by default.")]
Fresh = Annotated[bool, typer.Option("--fresh/--resume", help="Remove the results of an earlier run, or resume it.")]
FullTables = Annotated[bool, typer.Option("--full", help="Print the tables of every cell, with intervals.")]
Jobs = Annotated[int, typer.Option(min=1, help="Parts of the work at a time, a process each.")]
Page = Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose tables are written anew.")]
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
Sky = Annotated[
    str | None, typer.Option(help="Sky: open, suburban, urban, dense, plaza, FILE.csv of record-sky, or FILE.yaml.")
]
Video = Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Film the episodes.")]


def changes(assignments: list[str] | None, **named: Any) -> dict[str, Any]:
    """Values that ``--set`` and other options change.

    Parameters
    ----------
    named : by key, values of options; None for options that are not given

    Raises
    ------
    ConfigError
        An assignment is refused.
    InputError
        An option and an assignment set the same key.
    """
    from lanebound.integrity.core.presets import parse_assignments

    changed = parse_assignments(assignments or [])
    given = {key: value for key, value in named.items() if value is not None}
    for key in given:
        require_one_source(changed, key, OPTION_OF.get(key, f"--{key.replace('_', '-')}"))
    return changed | given


def own_faults(texts: list[str] | None) -> list[dict[str, Any]]:
    """The faults that ``--fault`` names, as ``reset`` takes them.

    Raises
    ------
    ConfigError
        A text is not a list of KEY=VALUE.
    """
    from lanebound.integrity.core.presets import parse_assignments

    return [parse_assignments(text.split(",")) for text in texts or []]


def require_one_source(changed: Mapping[str, Any], path: str, option: str) -> None:
    """Refuse an assignment of ``path`` together with the option that sets it.

    Raises
    ------
    InputError
        Both are given.
    """
    from lanebound.integrity.core.errors import InputError

    value: Any = changed
    for key in path.split("."):
        if not isinstance(value, Mapping) or key not in value:
            return
        value = value[key]
    raise InputError(f"{option} and --set {path}=... must not be given together, got both: leave one of them out")


def film_rate(video: Path | None, fps: int | None) -> int:
    """Pictures of a film in a second.

    Raises
    ------
    InputError
        A rate is given, but no film.
    """
    from lanebound.integrity.core.errors import InputError

    if fps is not None and video is None:
        raise InputError(f"--fps needs --video, got --fps {fps} alone: add --video FILE.mp4, or leave --fps out")
    return DEFAULT_FPS if fps is None else fps
