"""``lanebound envs``: the environments; of one its configuration, observation, info and costs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.options import AsJson, Assignments, Plugins, changes

if TYPE_CHECKING:
    from lanebound.envs.core import DrivingEnv

__all__ = ["envs", "facts"]

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
    from lanebound.agents.cli.output import print_json

    if name is None:
        if assignments:
            from lanebound.integrity.core.errors import InputError

            raise InputError("--set needs an environment, got none: name one, as in 'lanebound envs LaneKeeping'")
        _list(as_json, bool(plugins))
        return
    from lanebound.agents.cli.early import refuse_early

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
    from lanebound.agents.cli.output import print_json, print_table
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
    typer.echo(f"More: {', '.join(name.partition('/')[2] for name in static_table()['more'])}.")
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
    from lanebound.agents.cli.output import print_table
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
