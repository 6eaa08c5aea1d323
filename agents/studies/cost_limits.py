"""Limits of an episode's costs by one rule for every id and sky: what a sound driver keeps in most episodes.

The limit of a cost is the 0.7 quantile of its sums over the episodes of `integrity_aware` on training seeds, rounded up
to one significant digit. A cost whose quantile is 0 has no limit by this rule: an excess is a share of the limit. The
quantile is the smallest sum that at least 70 % of the episodes do not exceed.

The limit in the mean is for learners, which compare a mean: that of the costs without crashes and ends off the road,
and 1 % of the cost of such an end, rounded up likewise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator
from scipy.stats import binom

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.first_episodes import first_episodes
from lanebound.envs import make_config
from lanebound.envs.costs import CAUSES, GROUPS
from lanebound.envs.vector.env import engines
from lanebound.integrity.core.config import Config, Field, deep_merge

__all__ = ["SECTIONS", "CostLimitsConfig", "interval_of_quantile", "limit_by_rule", "tables", "tune_cost_limits"]

Array = NDArray[np.float64]
PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/cost_limits.py",
    "lanebound.agents:studies/first_episodes.py",
)
SECTIONS = ("limits", "quantiles")
OWN = "own"
WHOLE = "cost"
ENDS = ("cost_collision", "cost_off_road")
LEVEL = 0.95  # of intervals


class CostLimitsConfig(Config):
    """All inputs of the study."""

    envs: tuple[str, ...] = Field(
        tuple(name.removeprefix("lanebound/").removesuffix("-v0") for name in engines()),
        min_length=1,
        description="ids, ours without lanebound/",
    )
    skies: tuple[str, ...] = Field((OWN, "urban"), min_length=1, description="presets of the sky; own: that of the id")
    driver: str = Field("integrity_aware", description="a sound driver")
    quantile: float = Field(0.7, gt=0, lt=1, description="share of its episodes that keep a limit [-]")
    ends: float = Field(
        0.01, ge=0, lt=1, description="share of episodes that the limit in the mean lets end in a crash or off the road"
    )
    seeds: int = Field(24, ge=2, le=1000, description="episodes of each id and sky, of training seeds")
    overrides: Mapping[str, Any] = Field({}, description="of the environments' configuration, merged deeply")

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(full_id(name).removeprefix("lanebound/").removesuffix("-v0") for name in names)

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
    fixed = {**config.to_dict(), "envs": None, "skies": None, "places": dict.fromkeys(places, True)}
    source = code_digest(*PACKAGES)
    ResultFolder(out, "cost limits", config.to_dict(), source, fixed=fixed, growing=("places",)).claim()
    found = {
        "config": config.to_dict(),
        "places": run_parts(out, list(places), partial(_of_place, config), jobs, on_progress),
    }
    write_json(out / "results.json", found)
    return found


def _of_place(config: CostLimitsConfig, name: str, advance: Advance) -> dict[str, Any]:
    """Sums over each episode of the whole cost and of each group, and the limits by the rule."""
    env, sky = config.places[name]
    changes = deep_merge(config.overrides, {"sky": sky, "observation": {"form": "flat"}})
    with closing(open_env(full_id(env), changes)) as single:
        made, longest, count = single.config, allotted_s(single) / single.dt_s, config.seeds
    whole, by_cause = np.zeros(count), np.zeros((count, len(CAUSES)))
    for step, (infos, going, _, _) in enumerate(first_episodes(env, changes, config.driver, count)):
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


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """The limits, and the quantiles that they are rounded from."""
    return dict(zip(SECTIONS, (_limits_of(found), _quantiles_of(found)), strict=True))


def _limits_of(found: Mapping[str, Any]) -> Table:
    rows = [
        (
            part["env"], part["sky"], f"{part['cost_limit']:g}", _over(part), f"{part['mean']:.3g}",
            f"{part['ended']}", _limit(part["limit_in_mean"]), *map(_limit, part["limits"].values()),
        )
        for part in found["places"].values()
    ]  # fmt: skip
    today = ("id", "sky", "`cost_limit` today", "episodes over it", "mean", "crashed or off the road")
    return (*today, "limit in the mean", "by quantile: whole", *GROUPS), rows


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
