"""Limits of alerts and of costs, from drives of a driver on training seeds in the vector engine.

Whether alert limits are the largest errors that are safe: the harm of `nominal`, which ignores alerts. Positions are
given and displaced by a constant, along, across and both. Under an error of 95 % of the smallest limit
that the driver has without an error (1 % quantile over decisions), which is hardly ever alerted, harm has to stay
within the cost limit of the id. Under one of 150 % of the median limit it has to exceed it, along and across, else the
limit alerts for nothing. Harm is the cost without `cost_alert`, `cost_hmi` and `cost_lane_integrity`, which a level
causes by itself. Other vehicles are perceived as they are.

Limits of an episode's costs by one rule for every id and sky: what a sound driver keeps in most episodes. The limit of
a cost is the 0.7 quantile of its sums over the episodes of `integrity_aware` on training seeds, rounded up
to one significant digit. A cost whose quantile is 0 has no limit by this rule: an excess is a share of the limit. The
quantile is the smallest sum that at least 70 % of the episodes do not exceed.

The limit in the mean is for learners, which compare a mean: that of the costs without crashes and ends off the road,
and 1 % of the cost of such an end, rounded up likewise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator
from scipy.stats import binom

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.study import claim, parts_of, stored
from lanebound.envs import make_config
from lanebound.envs.alert_limits import AlertLimit
from lanebound.envs.batch.infos import as_ended
from lanebound.envs.costs import CAUSES, GROUPS
from lanebound.envs.ids import has_engine, preset_of
from lanebound.envs.vector.env import VectorDrivingEnv, engine_class, engines
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import InputError

Array = NDArray[np.float64]


class Decision(NamedTuple):
    """A step of N environments.

    Attributes
    ----------
    infos : arrays (N,), those of the end where an episode ends with the step
    going : (N,), whether the first episode had not ended before the step; what others drive is not counted
    over : (N,), whether an episode ends with the step
    envs : the environments after the step
    """

    infos: dict[str, Any]
    going: NDArray[np.bool_]
    over: NDArray[np.bool_]
    envs: VectorDrivingEnv


def first_episodes(
    env: str, config: Mapping[str, Any], driver: str, count: int, first_seed: int = SPLITS["train"][0],
    figures: Mapping[str, Any] | None = None,
) -> Iterator[Decision]:  # fmt: skip
    """All steps until ``count`` episodes have ended, under consecutive seeds.

    Parameters
    ----------
    env : id, ours without lanebound/, in the engine
    config : changes of its preset
    first_seed : by default the first training seed
    figures : of the driver, see :func:`~lanebound.agents.drivers.make_agent`

    Raises
    ------
    InputError
        The id has no engine, there is no such driver, or it cannot drive there; ConfigError for the configuration.
    """
    preset = preset_of(full_id(env))
    if preset is None or not has_engine(preset):
        raise InputError(f"envs must be ids with an engine, got '{env}': choose among {', '.join(engines())}")
    kind = engine_class(preset)
    with closing(kind(count, config, "SameStep")) as envs, closing(kind.KIND(config)) as single:
        agent: Any = make_agent(driver, single, figures)
        observations, _ = envs.reset(seed=first_seed)
        going, state, start = np.ones(count, dtype=np.bool_), None, np.ones(count, dtype=np.bool_)
        while going.any():
            actions, state = agent.predict(observations, state=state, episode_start=start, deterministic=True)
            observations, _, terminated, truncated, infos = envs.step(actions)
            start = terminated | truncated
            yield Decision(as_ended(infos, start), going, start, envs)
            going = going & ~start


PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/limits.py",
)
ALERT_SECTIONS = ("costs", "limits")
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


def _short(name: str) -> str:
    """An id as it is given and shown: ours without lanebound/ and version."""
    return full_id(name).removeprefix("lanebound/").removesuffix("-v0")


class LimitsConfig(Config):
    """Ids whose limits are looked at."""

    envs: tuple[str, ...] = Field(
        tuple(map(_short, engines())), min_length=1, description="ids, ours without lanebound/"
    )

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(map(_short, names))


class AlertLimitsConfig(LimitsConfig):
    """All inputs of the study of alert limits."""

    driver: str = Field("nominal", description="a driver that ignores alerts")
    below: float = Field(0.95, gt=0, description="smaller error over the smallest limit [-]")
    above: float = Field(1.5, gt=0, description="larger error over the median limit [-]")
    seeds: int = Field(32, ge=2, le=1000, description="episodes under each error, of training seeds")


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
    claim(out, "alert limits", config, PACKAGES, "ids", config.envs)
    ids = parts_of(config, _of_id, list(config.envs), out, jobs, on_progress)
    return stored({"config": config.to_dict(), "ids": ids}, out)


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


def alert_tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """Costs under errors of each share, the worst direction of each, and the limits."""
    return dict(zip(ALERT_SECTIONS, (_costs_of(found), _alert_limits_of(found)), strict=True))


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


def _alert_limits_of(found: Mapping[str, Any]) -> Table:
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


COST_SECTIONS = ("limits", "quantiles")
OWN = "own"
WHOLE = "cost"
ENDS = ("cost_collision", "cost_off_road")
LEVEL = 0.95  # of intervals


class CostLimitsConfig(LimitsConfig):
    """All inputs of the study of cost limits."""

    skies: tuple[str, ...] = Field((OWN, "urban"), min_length=1, description="presets of the sky; own: that of the id")
    driver: str = Field("integrity_aware", description="a sound driver")
    quantile: float = Field(0.7, gt=0, lt=1, description="share of its episodes that keep a limit [-]")
    ends: float = Field(
        0.01, ge=0, lt=1, description="share of episodes that the limit in the mean lets end in a crash or off the road"
    )
    seeds: int = Field(24, ge=2, le=1000, description="episodes of each id and sky, under consecutive seeds")
    first_seed: int = Field(
        SPLITS["train"][0], ge=0, description="first of them: a training seed for limits, a held-out one to try a limit"
    )
    overrides: Mapping[str, Any] = Field({}, description="of the environments' configuration, merged deeply")

    @property
    def places(self) -> dict[str, tuple[str, str]]:
        """Id and sky of each part, by its name; an id whose own sky is named too has one part of it."""
        pairs = [(env, make_config(full_id(env)).sky if sky == OWN else sky) for env in self.envs for sky in self.skies]
        return {f"{env}-{sky.replace('/', '.')}": (env, sky) for env, sky in pairs}


def limit_by_rule(sums: Sequence[float], quantile: float) -> float | None:
    """The limit of a cost whose sums over episodes are given; None where the quantile is 0.

    >>> limit_by_rule([0.0, 0.4, 1.2, 1.8], 0.7), limit_by_rule([0.0, 0.0, 0.0, 9.0], 0.7)
    (2.0, None)
    """
    return _rounded_up(float(np.quantile(sums, quantile, method="inverted_cdf")))


def _rounded_up(limit: float) -> float | None:
    """To one significant digit; None for 0."""
    if limit <= 0.0:
        return None
    digit = 10.0 ** math.floor(math.log10(limit))
    return float(f"{math.ceil(limit / digit - 1e-9) * digit:.1g}")  # 1e-9: 0.3 / 0.1 is more than 3


def tune_cost_limits(
    config: CostLimitsConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the ids and skies that are missing; returns the data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or an id or driver does not exist; ConfigError where an id refuses a value.
    """
    places = config.places
    for env, sky in places.values():  # refusals come before the work
        make_config(full_id(env), {**config.overrides, "sky": sky})
    claim(out, "cost limits", config, PACKAGES, "places", list(places))
    parts = parts_of(config, _of_place, list(places), out, jobs, on_progress)
    return stored({"config": config.to_dict(), "places": parts}, out)


def _of_place(config: CostLimitsConfig, name: str, advance: Advance) -> dict[str, Any]:
    """Sums over each episode of the whole cost and of each group, and the limits by the rule."""
    env, sky = config.places[name]
    changes = deep_merge(config.overrides, {"sky": sky, "observation": {"form": "flat"}})
    with closing(open_env(full_id(env), changes)) as single:
        made, longest, count = single.config, allotted_s(single) / single.dt_s, config.seeds
    whole, by_cause = np.zeros(count), np.zeros((count, len(CAUSES)))
    for step, (infos, going, _, _) in enumerate(first_episodes(env, changes, config.driver, count, config.first_seed)):
        whole += np.where(going, infos["cost"], 0.0)
        by_cause += np.where(going[:, None], infos["costs"], 0.0)
        advance(min(step / longest, 1.0))
    weights = np.array([weight * (cause in ENDS) for cause, weight in made.cost.weights.items()])
    mean = float(np.mean(whole - by_cause @ weights) + config.ends * weights.max())
    sums = {WHOLE: whole, **{group: by_cause @ made.cost.weights_of(group) for group in GROUPS}}
    return {
        "env": env,
        "sky": sky,
        "cost_limit": made.cost_limit,
        "mean": float(whole.mean()),
        "ended": int(np.count_nonzero(by_cause @ weights)),
        "limit_in_mean": _rounded_up(mean),
        "sums": {key: values.tolist() for key, values in sums.items()},
        "limits": {key: limit_by_rule(values.tolist(), config.quantile) for key, values in sums.items()},
    }


def cost_tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """The limits, and the quantiles that they are rounded from."""
    return dict(zip(COST_SECTIONS, (_limits_of(found), _quantiles_of(found)), strict=True))


def _limits_of(found: Mapping[str, Any]) -> Table:
    rows = [
        (
            part["env"], part["sky"], f"{part['cost_limit']:g}", _over(part), _mean(part),
            f"{part['ended']}", _limit(part["limit_in_mean"]), *map(_limit, part["limits"].values()),
        )
        for part in found["places"].values()
    ]  # fmt: skip
    today = ("id", "sky", "`cost_limit` today", "episodes over it", "mean", "crashed or off the road")
    return (*today, "limit in the mean", "by quantile: whole", *GROUPS), rows


def _mean(part: Mapping[str, Any]) -> str:
    """The mean cost and its standard error."""
    costs = np.array(part["sums"][WHOLE])
    return f"{part['mean']:.3g} ± {costs.std(ddof=1) / np.sqrt(costs.size):.2g}"


def _over(part: Mapping[str, Any]) -> str:
    return f"{100.0 * np.mean(np.array(part['sums'][WHOLE]) > part['cost_limit']):.0f} %"


def _limit(limit: float | None) -> str:
    return "-" if limit is None else f"{limit:g}"


def _quantiles_of(found: Mapping[str, Any]) -> Table:
    quantile = found["config"]["quantile"]
    rows = []
    for part in found["places"].values():
        cells = [_quantile(sums, quantile) for sums in part["sums"].values()]
        rows.append((part["env"], part["sky"], *cells))
    return ("id", "sky", "whole", *GROUPS), rows


def _quantile(sums: Sequence[float], quantile: float) -> str:
    """A quantile with its interval by order statistics; of few episodes it has no upper end."""
    if not any(sums):
        return "0"
    value = float(np.quantile(sums, quantile, method="inverted_cdf"))
    low, high = interval_of_quantile(sums, quantile)
    return f"{value:.3g} ({low:.2g} to {'?' if high == math.inf else f'{high:.2g}'})"


def interval_of_quantile(values: Sequence[float], quantile: float) -> tuple[float, float]:
    """A 95 % interval of a quantile of values >= 0, by order statistics (binomial ranks); inf without an upper end.

    >>> interval_of_quantile(range(1, 25), 0.7)
    (12, 21)
    """
    ordered, count = sorted(values), len(values)
    low, high = (int(binom.ppf(p, count, quantile)) for p in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL))
    return ordered[low - 1] if low else 0.0, ordered[high] if high < count else math.inf
