"""``lanebound agents``, ``envs``, ``monitors`` and ``config``: what there is, and what presets resolve to."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, Plugins, changes
from lanebound.agents.cli.output import format_value, print_json, print_table

if TYPE_CHECKING:
    from lanebound.envs.core import DrivingEnv
    from lanebound.integrity.core.config import Config


def agents(as_json: AsJson = False) -> None:
    """List the agents: what they do, read, do on an alert, and which actions they can command.

    Example: lanebound agents --json
    """
    from lanebound.agents.drivers import ABOUT

    if as_json:
        print_json([{"agent": name, **about._asdict()} for name, about in ABOUT.items()])
        return
    rows = ((name, *about) for name, about in ABOUT.items())
    print_table("Agents", ("agent", "does", "reads", "on an alert", "actions"), rows)
    typer.echo("Levels: protection levels. Actions: spaces that it can command, see 'lanebound envs'.")
    typer.echo("Figures: in a suite, such as 'careful: {agent: cbf, figures: {over: integrity_aware}}'.")
    typer.echo(_tuned())
    typer.echo("Your own: model.zip (Stable-Baselines3), .onnx, .npz, or package.module:callable in place of a name:")
    typer.echo("'lanebound drive ID --agent NAME', 'lanebound benchmark SUITE --agents A,B'.")


def _tuned() -> str:
    """Environments and skies for which the constant margins were tuned."""
    from lanebound.agents.benchmark.untuned import tuned_places
    from lanebound.agents.cli.static import static_table

    names = {
        line["base"]: line["id"].removeprefix("lanebound/").removesuffix("-v0")
        for line in static_table()["environments"]
    }
    fitted = ", ".join(f"{names.get(base, base)} under {sky} skies" for base, sky in tuned_places())
    return f"The margins of cautious were tuned for {fitted or 'no place'}; elsewhere they are untuned."


COLUMNS = ("id", "action_space", "policy_hz", "sky", "cost_limit")  # fit into a terminal of 80 characters


def envs(
    name: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="Show this one: configuration, observation, info, costs.")
    ] = None,
    assignments: Assignments = None,
    plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """List the environments, or show one: its configuration, and every entry of its observation.

    Example: lanebound envs LaneKeeping --set sky=dense --set observation.integrity=blind
    """

    if name is None:
        if assignments:
            from lanebound.integrity.core.errors import InputError

            raise InputError("--set needs an environment, got none: name one, as in 'lanebound envs LaneKeeping'")
        _list(as_json, bool(plugins))
        return
    from lanebound.agents.cli.static import refuse_early

    given = changes(assignments)
    if not plugins:
        refuse_early(name, changes=given)
    from lanebound.agents.episodes.opening import open_env

    env = open_env(name, given)
    if as_json:
        print_json(_details(env))
    else:
        _show(env)


def _list(as_json: bool, more: bool) -> None:
    """List our environments, which is fast, and those of plug-ins, which must be opened for it."""
    from lanebound.agents.cli.static import static_table

    rows = static_table()["environments"] + (_registered() if more else [])
    if as_json:
        print_json(rows)
        return
    print_table("Environments", COLUMNS, map(_short, rows))
    first = rows[0]
    groups = ", ".join(f"{name} {size}" for name, size in first["observation"].items())
    typer.echo(f"Observations: {groups}; flat {first['flat_size']}.")
    typer.echo(f"Navigation at {first['navigation_hz']:g} Hz, dynamics at {first['simulation_hz']} Hz.")
    typer.echo(fill(f"More: {', '.join(name.partition('/')[2] for name in static_table()['more'])}.", 80))
    typer.echo("No driving world: Journey-v0 ('lanebound assess journeys').")
    typer.echo("'lanebound envs ID' shows one whole, with every entry.")


def _registered() -> list[dict[str, Any]]:
    """The entries of environments from outside."""
    from lanebound.agents.cli.static import static_table
    from lanebound.agents.episodes.opening import open_env
    from lanebound.envs import IDS

    known = {row["id"] for row in static_table()["environments"]}
    return [facts(open_env(env_id)) for env_id in IDS if env_id not in known]


def _short(row: dict[str, Any]) -> list[Any]:
    """A row of the table; a box is shown by its shape, as all have the bounds -1 and 1."""
    space = str(row["action_space"]).replace("-1.0, 1.0, (", "").replace("), float32", "")
    return [space if column == "action_space" else row[column] for column in COLUMNS]


def facts(env: DrivingEnv) -> dict[str, Any]:
    """The entry of an environment in the list."""
    from lanebound.envs.observation import group_slices

    c = env.config
    groups = {group: part.stop - part.start for group, part in group_slices(c.observation).items()}
    return {
        "id": c.base if env.spec is None else env.spec.id,
        "base": c.base,
        "action": c.action.value,
        "action_space": str(env.action_space),
        "policy_hz": c.policy_hz,
        "observation": groups,
        "flat_size": sum(groups.values()),
        "simulation_hz": c.simulation_hz,
        "navigation_hz": c.navigation.rate_hz,
        "sky": c.sky,
        "cost_limit": c.cost_limit,
    }


def _details(env: DrivingEnv) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        **facts(env),
        "config": env.config.to_dict(),
        "index": [
            asdict(entry) | {"column": entry.column, "source": _source(entry.source)} for entry in env.observer.index
        ],
        "info": _info(env),
        "cost_weights": env.config.cost.weights,
    }


def _source(source: Any) -> str:
    """The field that an entry shows, or ``module:function``."""
    return source if isinstance(source, str) else f"{source.__module__}:{source.__qualname__}"


def _info(env: DrivingEnv) -> dict[str, str]:
    from lanebound.envs.info import INFO, own_info

    return INFO | own_info(env.config)


def _show(env: DrivingEnv) -> None:
    from lanebound.envs.info import INFO
    from lanebound.integrity.core.config import describe

    about = facts(env)
    del about["observation"]
    print_table(about["id"], ("what", "value"), about.items())
    own = [entry for entry in describe(env.config) if "." not in entry.path]
    print_table("Configuration, without its sections (see --json)", ("key", "value", "unit", "what it is"), _texts(own))
    print_table("Observation", ("flat", "entry", "unit", "scale", "bounds", "meaning"), _index(env))
    print_table("Info", ("key", "meaning"), _info(env).items())
    print_table(
        f"Costs, limit {env.config.cost_limit:g} an episode",
        ("cause", "weight", "unweighted"),
        ((cause, weight, INFO[cause]) for cause, weight in env.config.cost.weights.items()),
    )


def _texts(entries: list[Any]) -> list[tuple[Any, ...]]:
    return [(e.path, getattr(e.value, "value", e.value), e.unit, e.description) for e in entries]


def _index(env: DrivingEnv) -> list[tuple[Any, ...]]:
    return [
        (place, e.column, e.unit or "-", f"{e.scale:.4g}", f"[{e.low:g}, {e.high:g}]", e.meaning)
        for place, e in enumerate(env.observer.index)
    ]


def monitors(as_json: AsJson = False, _plugins: Plugins = None) -> None:
    """List the monitors of the family: source, needs and promise of each one.

    Example: lanebound monitors --json
    """
    from lanebound.integrity.monitoring.family.kinds import FAMILY

    if as_json:
        print_json([
            {"monitor": k.name, "group": k.group, "does": k.summary, "source": k.source, "needs": list(k.needs),
             "promise": k.promise, "config": k.changes}
            for k in FAMILY.values()
        ])  # fmt: skip
        return
    rows = [(k.name, k.summary, k.source, ", ".join(k.needs), k.promise) for k in FAMILY.values()]
    print_table("Monitors", ("monitor", "does", "source", "needs", "promise"), rows)
    typer.echo("Needs: steps are displacements by wheels and gyro or by Doppler, fit is a preset of 'fit-errors'.")
    typer.echo("All on the same epochs: 'lanebound assess monitors --data FOLDER --out DIR', or --sky urban.")


KINDS = {
    "context_rules": "lanebound.integrity.monitoring.context.fuzzy:RuleBase",
    "experiment": "lanebound.agents.learning.experiment:ExperimentConfig",
    "learning_study": "lanebound.agents.studies.learning:LearningStudyConfig",
    "suite": "lanebound.agents.benchmark.suite:SuiteConfig",
    "tuned_caution": "lanebound.agents.drivers.margins:TunedCaution",
    "urban_drive": "lanebound.agents.studies.urban_drive:UrbanDriveConfig",
    "navigator": "lanebound.integrity.navigators.navigator:NavigatorConfig",
    "corrections": "lanebound.integrity.sensors.corrections:CorrectionsConfig",
    "fitted_errors": "lanebound.integrity.monitoring.family.error_classes:FittedErrors",
    "fault_priors": "lanebound.integrity.sensors.campaign:FaultPriors",
    "gnss": "lanebound.integrity.sensors.gnss:GnssConfig",
    "imu": "lanebound.integrity.sensors.imu:ImuConfig",
    "odometer": "lanebound.integrity.sensors.odometer:OdometerConfig",
    "positioning": "lanebound.integrity.positioning.config:PositioningConfig",
    "sky_level": "lanebound.envs.sky.level:SkyLevel",
    "v2v": "lanebound.integrity.sensors.v2v:V2vConfig",
}


def resolve(name: str, overrides: Mapping[str, Any] | None = None) -> tuple[str, Config]:
    """The kind of a preset or a YAML file, and its configuration with ``overrides``.

    Raises
    ------
    ConfigError
        The preset or its kind is unknown, or a value is refused.
    """
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.core.presets import FILES, deep_merge, load_file, load_preset, nearest

    if name.endswith(FILES):
        data = deep_merge(load_file(Path(name), "preset"), overrides or {})
    else:
        _require_no_environment(name)
        data = load_preset(name, overrides)
    kind = data.pop("kind", None)
    if kind is None:
        raise ConfigError(f"preset '{name}' names no kind: add a line such as 'kind: {min(KINDS)}'")
    kind, _, inner = str(kind).partition("/")  # "navigator/filter": a navigator of the kind filter
    if inner:
        data["kind"] = inner
    if kind not in KINDS:
        raise ConfigError(f"kind '{kind}' of preset '{name}' is unknown: {nearest(str(kind), KINDS)}")
    module, _, attribute = KINDS[kind].partition(":")
    model: type[Config] = getattr(import_module(module), attribute)
    return kind, model.load(data)


def _require_no_environment(name: str) -> None:
    """Refuse the name of an environment with a hint to ``lanebound envs``."""
    from lanebound.agents.cli.static import static_table
    from lanebound.integrity.core.errors import ConfigError

    short = name.removeprefix("lanebound/").removesuffix("-v0").lower()
    for row in static_table()["environments"]:
        there = row["id"].removeprefix("lanebound/").removesuffix("-v0")
        if short == there.lower():
            raise ConfigError(f"preset '{name}' is unknown: it is an environment, see 'lanebound envs {there}'")


config = typer.Typer(cls=AdvisingGroup, no_args_is_help=True, help="List the presets, or show one with its units.")


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


@config.command("list")
def list_presets(
    folder: Annotated[str | None, typer.Argument(metavar="FOLDER", help="Only these, with what each is.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the packaged presets by folder; those of one folder with what each configures.

    Example: lanebound config list services
    """
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


@config.command("show")
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
