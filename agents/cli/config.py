"""``lanebound config``: the presets, and the values that they resolve to."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, Plugins, changes

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, no_args_is_help=True, help="List the presets, or show one with its units.")


@app.command("list")
def list_presets(as_json: AsJson = False) -> None:
    """List the packaged presets and what each configures.

    Example: lanebound config list --json
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.integrity.core.presets import about_preset, load_preset, preset_names

    found = [
        {"preset": name, "kind": load_preset(name).get("kind"), "about": about_preset(name)} for name in preset_names()
    ]
    if as_json:
        print_json(found)
    else:
        print_table("Presets", ("preset", "kind", "about"), (tuple(row.values()) for row in found))
        typer.echo("'lanebound config show PRESET' prints the keys of one. Its folder may be left out of the name.")


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
