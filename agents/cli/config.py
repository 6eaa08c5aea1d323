"""``lanebound config``: the presets, and the values that they resolve to."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, Plugins, changes

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, no_args_is_help=True, help="List the presets, or show one with its units.")


FOLDERS = {
    "drivers": "tuned margins of drivers",
    "errors": "overbounds of code errors, for monitors",
    "experiments": "training: lanebound train NAME",
    "monitors": "rules of the context monitor",
    "navigators": "instruments and filters: --set navigator=NAME",
    "sensors": "single instruments, by extends in YAML",
    "services": "positioning services: --set navigator=NAME",
    "skies": "streets and buildings: --sky NAME",
    "studies": "lanebound study NAME, lanebound reproduce urban-drive",
    "suites": "lanebound benchmark NAME",
}
"""What the presets of each folder are for."""


@app.command("list")
def list_presets(
    folder: Annotated[str | None, typer.Argument(metavar="FOLDER", help="Only these, with what each is.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the packaged presets by folder; those of one folder with what each configures.

    Example: lanebound config list services
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import about_preset, load_preset, nearest, preset_names

    names = {name: name.rpartition("/")[0] or "-" for name in preset_names()}
    folders = list(dict.fromkeys(names.values()))
    if folder is not None and folder not in folders:
        raise ConfigError(f"folder '{folder}' is unknown: {nearest(folder, folders)}")
    shown = [name for name, home in names.items() if folder in (None, home)]
    if as_json:
        print_json([
            {"preset": name, "kind": load_preset(name).get("kind"), "about": about_preset(name)} for name in shown
        ])  # fmt: skip
    elif folder is None:
        inside = {home: [name.rpartition("/")[2] for name in shown if names[name] == home] for home in folders}
        rows = [(home, ", ".join(inside[home]), FOLDERS.get(home, "")) for home in folders]
        print_table("Presets", ("folder", "presets", "used by"), rows)
        typer.echo("'lanebound config list FOLDER' says what each is, 'lanebound config show PRESET' prints its keys.")
    else:
        print_table(f"Presets of {folder}", ("preset", "about"), [(name, about_preset(name)) for name in shown])


@app.command("show")
def show(
    preset: Annotated[
        str, typer.Argument(metavar="PRESET", help="As 'lanebound config list' prints it, or a YAML file.")
    ],
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Show the resolved values of a preset: its own, those of the preset that it extends, and defaults.

    Example: lanebound config show studies/urban_drive --set navigator.dt_s=0.2 --json
    """
    from lanebound.agents.cli.kinds import resolve
    from lanebound.agents.cli.output import format_value, print_json, print_table
    from lanebound.integrity.core.config import describe

    kind, config = resolve(preset, changes(assignments))
    entries = describe(config)
    if as_json:
        values: list[dict[str, Any]] = [{**entry._asdict(), "value": _plain(entry.value)} for entry in entries]
        print_json({"preset": preset, "kind": kind, "values": values})
    else:
        rows = ((e.path, f"{format_value(e.value)} {e.unit}".rstrip(), e.description) for e in entries)
        print_table(f"{preset} ({kind})", ("key", "value", "what it is"), rows, numbers=("value",))


def _plain(value: Any) -> Any:
    from pydantic_core import to_jsonable_python

    return to_jsonable_python(value)
