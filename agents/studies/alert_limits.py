"""Whether alert limits are the largest errors that are safe: the harm of `nominal`, which ignores alerts.

Positions are given and displaced by a constant, along, across and both. Under an error of 95 % of the smallest limit
that the driver has without an error (1 % quantile over decisions), which is hardly ever alerted, harm has to stay
within the cost limit of the id. Under one of 150 % of the median limit it has to exceed it, along and across, else the
limit alerts for nothing. Harm is the cost without `cost_alert`, `cost_hmi` and `cost_lane_integrity`, which a level
causes by itself. Other vehicles are perceived as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.first_episodes import first_episodes
from lanebound.envs.alert_limits import AlertLimit
from lanebound.envs.vector.env import engines
from lanebound.integrity.core.config import Config, Field, deep_merge

__all__ = ["SECTIONS", "AlertLimitsConfig", "assess_alert_limits", "tables"]

Array = NDArray[np.float64]
PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/alert_limits.py",
)
SECTIONS = ("costs", "limits")
ALONE: dict[str, Any] = {
    "perception": {"source": "truth"},
    "faults": "none",
    "sky": "open",
    "cost": {"alert": 0.0, "hmi": 0.0, "lane_integrity": 0.0},
}
DIRECTIONS = {
    "ahead": (1, 0),
    "behind": (-1, 0),
    "right": (0, 1),
    "left": (0, -1),
    "ahead, right": (1, 1),
    "behind, left": (-1, -1),
}
ERRORS = ("below", "above")
ALONG, ACROSS = ("ahead", "behind"), ("right", "left")
LOWEST = 0.01  # quantile over decisions: a limit dips for moments where lanes meet


class AlertLimitsConfig(Config):
    """All inputs of the study."""

    envs: tuple[str, ...] = Field(
        tuple(name.removeprefix("lanebound/").removesuffix("-v0") for name in engines()),
        min_length=1,
        description="ids, ours without lanebound/",
    )
    driver: str = Field("nominal", description="a driver that ignores alerts")
    below: float = Field(0.95, gt=0, description="smaller error over the smallest limit [-]")
    above: float = Field(1.5, gt=0, description="larger error over the median limit [-]")
    seeds: int = Field(32, ge=2, le=1000, description="episodes under each error, of training seeds")

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(full_id(name).removeprefix("lanebound/").removesuffix("-v0") for name in names)


class Drive(NamedTuple):
    """Episodes under one error.

    costs, crashed (n,) of each episode; along, across, aside (m,) of all decisions: both limits, and offset from the
    middle of the lane; alerts: share of the decisions
    """

    costs: Array
    crashed: Array
    alerts: float
    along: Array
    across: Array
    aside: Array


def assess_alert_limits(
    config: AlertLimitsConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive all errors in the ids that are missing; returns the data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or an id or driver does not exist.
    """
    fixed = {**config.to_dict(), "envs": None, "ids": dict.fromkeys(config.envs, True)}
    source = code_digest(*PACKAGES)
    ResultFolder(out, "alert limits", config.to_dict(), source, fixed=fixed, growing=("ids",)).claim()
    found = {
        "config": config.to_dict(),
        "ids": run_parts(out, list(config.envs), partial(_of_id, config), jobs, on_progress),
    }
    write_json(out / "results.json", found)
    return found


def _of_id(config: AlertLimitsConfig, env: str, advance: Advance) -> dict[str, Any]:
    """Costs by kind of limit, share and direction, and quantiles of the limits."""
    found: dict[str, Any] = {}
    total, done = len(AlertLimit) * len(ERRORS) * len(DIRECTIONS), 0
    for kind in AlertLimit:
        bare = _drive(config, env, {"alert_limit": kind.value, "navigation": {"source": "perfect"}})
        lowest, median = ([float(np.quantile(x, q)) for x in (bare.along, bare.across)] for q in (LOWEST, 0.5))
        sizes = dict(zip(ERRORS, ((config.below, lowest), (config.above, median)), strict=True))
        errors: dict[str, Any] = {}
        for size, (share, limit) in sizes.items():
            for name, (at, ct) in DIRECTIONS.items():
                offset = {"offset_at_m": share * at * limit[0], "offset_ct_m": share * ct * limit[1]}
                used = {key: value for key, value in offset.items() if value}
                drive = _drive(config, env, {"alert_limit": kind.value, "navigation": {"source": "offset", **used}})
                errors.setdefault(size, {})[name] = _costs(drive)
                done += 1
                advance(done / total)
        found[kind.value] = {
            "lowest_m": lowest,
            "median_m": median,
            "aside_m": [float(q) for q in np.quantile(bare.aside, (0.5, 0.95, 0.99))],
            "without": _costs(bare),
            "errors": errors,
        }
    with closing(engines()[full_id(env)](1, ALONE)) as envs:
        return {"env": env, "cost_limit": envs.config.cost_limit, "kinds": found}


def _costs(drive: Drive) -> dict[str, float]:
    return {
        "cost": float(drive.costs.mean()),
        "se": float(drive.costs.std(ddof=1) / np.sqrt(drive.costs.size)),
        "crashed": float(drive.crashed.mean()),
        "alerts": drive.alerts,
    }


def _drive(config: AlertLimitsConfig, env: str, changes: Mapping[str, Any]) -> Drive:
    """Episodes of the driver, in the engine all at once."""
    count, given = config.seeds, deep_merge(deep_merge(ALONE, {"observation": {"form": "flat"}}), changes)
    costs, crashed = np.zeros(count), np.zeros(count)
    rows: list[tuple[Array, Array, Array]] = []
    alerts: list[Array] = []
    for infos, going, over, envs in first_episodes(env, given, config.driver, count):
        costs += np.where(going, infos["cost"], 0.0)
        crashed = np.where(going, infos["crashed"], crashed)
        on = going & ~over  # at an end the belief is that of the next episode already
        alerts.append(infos["alert"][going])
        rows.append((infos["al_at_m"][going], infos["al_ct_m"][going], _aside(envs)[on]))
    limits = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Drive(costs, crashed, float(np.concatenate(alerts).mean()), *limits)


def _aside(envs: Any) -> Array:
    return np.asarray(np.abs(envs.engine.episodes.ego["belief"]["lateral_m"]))


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """Costs under errors of each share, the worst direction of each, and the limits."""
    return dict(zip(SECTIONS, (_costs_of(found), _limits_of(found)), strict=True))


def _costs_of(found: Mapping[str, Any]) -> Table:
    """A harm on the wrong side of the cost limit is bold."""
    rows: list[Sequence[str]] = []
    for part in found["ids"].values():
        for kind, of_kind in part["kinds"].items():
            bare, errors, limit = of_kind["without"], of_kind["errors"], part["cost_limit"]
            cells = [part["env"], kind, f"{limit:g}", f"{bare['cost']:.3g} ± {bare['se']:.2g}"]
            name, worst = max(errors["below"].items(), key=lambda item: item[1]["cost"])
            cells += [_cell(worst, worst["cost"] > limit, name), f"{100 * worst['alerts']:.0f} %"]
            for directions in (ALONG, ACROSS):
                name = max(directions, key=lambda direction: errors["above"][direction]["cost"])
                cells.append(_cell(errors["above"][name], errors["above"][name]["cost"] <= limit, name))
            rows.append(cells)
    below, above = (f"{100 * found['config'][size]:g} % of the" for size in ERRORS)
    return (
        ("id", "limits", "cost limit", "no error", f"{below} smallest limit", "alerted", f"{above} median limit, along",
         "the same, across"),
        rows,
    )  # fmt: skip


def _cell(costs: Mapping[str, float], wrong: bool, name: str) -> str:
    mark = "**" if wrong else ""
    return f"{mark}{costs['cost']:.3g} ± {costs['se']:.2g}{mark} ({name})"


def _limits_of(found: Mapping[str, Any]) -> Table:
    rows = [
        (
            part["env"],
            kind,
            *(f"{of_kind['lowest_m'][n]:.2f}, {of_kind['median_m'][n]:.2f}" for n in range(2)),
            f"{of_kind['aside_m'][0]:.2f}, {of_kind['aside_m'][1]:.2f}, {of_kind['aside_m'][2]:.2f}",
        )
        for part in found["ids"].values()
        for kind, of_kind in part["kinds"].items()
    ]
    heads = ("id", "limits", "along [m]: 1 %, median", "across [m]: 1 %, median", "off the middle [m]: 50, 95, 99 %")
    return heads, rows
