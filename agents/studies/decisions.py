"""Where a level decides: navigators and drivers in many ids, on the same roads, traffic, sky and errors.

Each case is an id, a navigator and a driver, on held-out seeds in the vector engine. ``integrity_aware`` reads levels
and alerts; speed, gap and steering of ``level_scaled`` follow the size of levels. ``clock`` and ``clock_scaled`` are
the same drivers with the median level at the time since RTK, ``fixed`` and ``fixed_scaled`` with the median level at
any time; both medians are those of ``nominal`` on training seeds of the id and navigator. ``nominal`` ignores all of
them. Levels are better than a clock or one level where they do less harm, or have less cost of causes that do
not depend on levels, at equal throughput.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator, model_validator

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.metrics import HARM_OF_AN_END, Better
from lanebound.agents.benchmark.statistics import VERDICT_SEEDS, Difference, difference, estimate, holm
from lanebound.agents.benchmark.suite import SPLITS, Split
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.clock import AGES_S, AXES
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.report.pages import Table
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.limits import first_episodes
from lanebound.agents.studies.study import claim, parts_of, stored
from lanebound.envs import make_config
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.angles_kernel import ROUNDING_M
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import InputError

__all__ = ["DRIVERS", "SECTIONS", "DecisionsConfig", "assess_decisions", "tables"]

Array = NDArray[np.float64]
PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/decisions.py",
    "lanebound.agents:studies/limits.py",
)
SECTIONS = ("decides", "position", "outcome", "causes", "spread")
SCALED = "level_scaled"
TWINS: dict[str, tuple[str, str]] = {
    "integrity_aware": ("fixed", "clock"),
    SCALED: ("fixed_scaled", "clock_scaled"),
}
"""Agents that read levels, and the names of the same agent with one level and with a clock."""
DRIVERS: dict[str, str] = {"nominal": "nominal"} | {
    name: agent
    for reads, twins in TWINS.items()
    for name, agent in zip((*twins, reads), (twins[1], twins[1], reads), strict=True)
}
"""Agents of the study, by their names in it."""
SENSE: dict[str, Better] = {"harm": "lower", "true_cost": "lower", "throughput_mps": "higher"}
JUDGED = tuple(SENSE)
TRUE = ("collision", "off_road", "lane", "conflict", "speeding", "route", "gore", "overcharge", "undercharge")
"""Causes that do not depend on levels or alerts: a cost of these is no verdict on who reads them."""
EQUAL = 0.95  # of the throughput of the clock: from here on it counts as equal, chosen
SUMS = ("cost", "available", "alert", "wrong_road", "hmi_share", "speed_mps")
ENDS = (("success", "is_success"), ("lost", "lost"), ("crashed", "crashed"), ("off_road", "off_road"))


class DecisionsConfig(Config):
    """All inputs of the study."""

    envs: tuple[str, ...] = Field(
        ("LaneKeeping", "CarFollowing", "Highway", "Merge", "Roundabout", "Intersection", "Racetrack", "UrbanCanyon",
         "WorkZone", "Guidance", "Tolling"),
        min_length=1, description="ids with an engine, ours without lanebound/",
    )  # fmt: skip
    navigators: Mapping[str, Any] = Field(
        {
            "RTK": "navigators/consumer",
            "RTK, DFMC": "services/rtk_dfmc",
            "DGPS": "services/dgps",
            "SBAS L1": "services/sbas_l1",
            "DFMC": "services/sbas_dfmc",
            "PPP": "services/ppp",
            "IBPL": "navigators/codes_ibpl",
            "IMM": "navigators/imm_s4",
            "context": "navigators/codes_context",
        },
        min_length=1,
        description="values of navigator, by the name in the tables",
    )
    drivers: tuple[str, ...] = Field(tuple(DRIVERS), min_length=1, description="agents of the study")
    split: Split = Field("test", description="seeds that are driven")
    seeds: int = Field(100, ge=2, le=1000, description="episodes of each case, under consecutive seeds of the split")
    skip: int = Field(0, ge=0, description="number of first seeds of the split to leave out")
    fitted: int = Field(24, ge=2, le=1000, description="training episodes of each id and navigator, for the medians")
    quantile: float = Field(0.5, gt=0, lt=1, description="of the levels of nominal that one level and a clock have [-]")
    scaled: Mapping[str, Any] = Field({}, description=f"figures of {SCALED} and its twins, such as fill")
    overrides: Mapping[str, Any] = Field({}, description="of the environments' configuration, merged deeply")

    @field_validator("drivers")
    @classmethod
    def _drivers_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in DRIVERS:
                raise InputError(f"drivers must be of {', '.join(DRIVERS)}, got '{name}': correct it")
        return names

    @model_validator(mode="after")
    def _medians_are_of_other_drives(self) -> Self:
        # A clock whose medians are of the drives that are judged would know them.
        if self.split == "train" and self.skip < self.fitted:
            raise InputError(
                f"skip must be >= fitted = {self.fitted} with split 'train', got {self.skip}: the medians are of the "
                "first training seeds; raise it"
            )
        return self

    @property
    def places(self) -> dict[str, tuple[str, str]]:
        """Id and navigator of each part, by its name."""
        pairs = product(self.envs, self.navigators)
        return {f"{env}-{navigator}".replace(" ", "_").replace(",", ""): (env, navigator) for env, navigator in pairs}

    def changes_of(self, navigator: str) -> dict[str, Any]:
        """The configuration of an id with a navigator."""
        return deep_merge(self.overrides, {"navigator": self.navigators[navigator], "observation": {"form": "flat"}})


def assess_decisions(
    config: DecisionsConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the ids and navigators that are missing; returns the data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or a driver does not exist; ConfigError for a value that an environment refuses.
    """
    for env, navigator in config.places.values():  # refusals come before the work
        make_config(full_id(env), config.changes_of(navigator))
    claim(out, "decisions", config, PACKAGES, "navigators", list(config.places))
    places = parts_of(config, _of_place, list(config.places), out, jobs, on_progress)
    return stored({"config": config.to_dict(), "places": places}, out)


def _of_place(config: DecisionsConfig, name: str, advance: Advance) -> dict[str, Any]:
    """Figures of each driver's episodes in an id with a navigator."""
    env, navigator = config.places[name]
    changes = config.changes_of(navigator)
    with closing(open_env(full_id(env), changes)) as single:
        longest, dt_s, weights = allotted_s(single), single.dt_s, single.config.cost.weights
    level_m, spread = _levels(env, changes, config.fitted, config.quantile)
    fixed = {"age_s": [0.0], **{f"pl_{axis}_m": [level_m[axis][-1]] for axis in AXES}}
    by_clock = {"age_s": list(AGES_S), **{f"pl_{axis}_m": level_m[axis][:-1] for axis in AXES}}
    stands = all(by_clock[f"pl_{axis}_m"] == len(AGES_S) * level_m[axis][-1:] for axis in AXES)  # without RTK it does
    found: dict[str, Any] = {}
    one_level = {clock: name for name, clock in TWINS.values()}
    for done, driver in enumerate(config.drivers):
        if stands and (same := one_level.get(driver)) in found:
            found[driver] = found[same]
            continue
        figures: dict[str, Any] = fixed if driver in one_level.values() else by_clock if driver in one_level else {}
        if driver in TWINS[SCALED] or driver == SCALED:
            figures = {**config.scaled, **figures}
        part = _driven(config, env, changes, driver, figures)
        steps = np.array(part.pop("steps"))
        part["time_s"] = (dt_s * steps).tolist()
        taken = np.where(part["success"], dt_s * steps, np.maximum(longest, dt_s * steps))
        part["throughput_mps"] = (np.array(part["speed_mps"]) * dt_s * steps / taken).tolist()
        causes = np.array(part.pop("causes"))
        weighed = causes * [weights[cause] for cause in CAUSES]
        part["true_cost"] = weighed[:, [CAUSES.index(f"cost_{cause}") for cause in TRUE]].sum(axis=1).tolist()
        ended = np.array(part["crashed"]) + causes[:, CAUSES.index("cost_off_road")] > 0.0
        part["harm"] = (HARM_OF_AN_END * ended + causes[:, CAUSES.index("cost_lane")]).tolist()
        part["causes"] = dict(zip(CAUSES, weighed.mean(axis=0).tolist(), strict=True))
        found[driver] = part
        advance((done + 1) / len(config.drivers))
    return {"env": env, "navigator": navigator, "levels": by_clock, "fixed": fixed, "spread": spread, "drivers": found}


def _driven(
    config: DecisionsConfig, env: str, changes: Mapping[str, Any], driver: str, figures: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Sums of each episode of a driver, and its levels and errors at all decisions."""
    count, first = config.seeds, SPLITS[config.split][0] + config.skip
    causes, steps = np.zeros((count, len(CAUSES))), np.zeros(count)
    sums, ends = {name: np.zeros(count) for name in SUMS}, {name: np.zeros(count) for name, _ in ENDS}
    levels, errors = [], []
    for infos, going, over, _ in first_episodes(env, changes, DRIVERS[driver], count, first, figures):
        last, steps = going & over, steps + going
        causes += np.where(going[:, None], infos["costs"], 0.0)
        for name in SUMS:
            sums[name] += np.where(going, infos[name], 0.0)
        for name, of in ENDS:
            ends[name] += last & infos[of]
        levels.append(infos["pl_ct_m"][going])
        errors.append(np.abs(infos["err_ct_m"][going]))
    level, error = np.concatenate(levels), np.concatenate(errors)
    shares = {name: (values if name == "cost" else values / steps).tolist() for name, values in sums.items()}
    return {
        "steps": steps.tolist(),
        **{name: values.tolist() for name, values in ends.items()},
        **shares,
        "causes": causes.tolist(),
        "level_m": finite_or_none(np.quantile(level, [0.5, 0.95], method="inverted_cdf").tolist()),
        "error_m": np.quantile(error, [0.5, 0.95, 1.0]).tolist(),
        "beyond": int(np.count_nonzero(error > level + ROUNDING_M)),
        "decisions": int(level.size),
    }


def _levels(
    env: str, changes: Mapping[str, Any], count: int, quantile: float
) -> tuple[dict[str, list[float]], list[tuple[float, ...]]]:
    """A quantile of the levels of ``nominal`` on training seeds at each of ``AGES_S``, and at any time; their spread.

    The spread has a row for each age that occurred: the age, the number of decisions, quartiles of PL_CT, and the
    median and 95 % quantile of the error across. A level counts as its observation shows it: missing ones, and those
    above the scale, as the scale. An age that did not occur has the level between those of its neighbours.
    """
    ages: list[Array] = []
    errors: list[Array] = []
    levels: dict[str, list[Array]] = {axis: [] for axis in AXES}
    for infos, going, over, envs in first_episodes(env, changes, "nominal", count):
        on, reader = going & ~over, Reader(envs.config.observation)  # after an end the belief is of the next start
        belief = _belief(envs)
        ages.append(np.minimum(belief["since_rtk_s"], reader.scale("integrity.since_rtk"))[on])
        errors.append(np.abs(infos["err_ct_m"][on]))
        for axis in AXES:
            levels[axis].append(np.minimum(infos[f"pl_{axis}_m"], reader.scale(f"integrity.pl_{axis}"))[on])
    age, grid = np.concatenate(ages), np.array(AGES_S)
    nearest = np.digitize(age, 0.5 * (grid[1:] + grid[:-1]))
    there = np.unique(nearest)
    found = {}
    for axis in AXES:
        level = np.concatenate(levels[axis])
        at_age = [float(np.quantile(level[nearest == i], quantile)) for i in there]
        found[axis] = [*np.interp(grid, grid[there], at_age).tolist(), float(np.quantile(level, quantile))]
    level, error = np.concatenate(levels["ct"]), np.concatenate(errors)
    spread = [
        (
            AGES_S[i],
            float(np.count_nonzero(nearest == i)),
            *np.quantile(level[nearest == i], (0.25, 0.5, 0.75)).tolist(),
            *np.quantile(error[nearest == i], (0.5, 0.95)).tolist(),
        )
        for i in there.tolist()
    ]
    return found, spread


def _belief(envs: Any) -> Any:
    return envs.engine.episodes.ego["belief"]


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """Where a level decides; positions, ends and causes of costs; how much levels vary at equal age of RTK."""
    made = (_decided(found), _positions(found), _outcomes(found), _causes(found), _spread(found))
    return dict(zip(SECTIONS, made, strict=True))


def _each(found: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    for place in found["places"].values():
        yield place["env"], place["navigator"], place["drivers"]


def _decided(found: Mapping[str, Any]) -> Table:
    """Harm and true cost of each driver at its throughput, and whether levels are better than one level and a clock."""
    pairs = [
        (reads, rival)
        for reads, twins in TWINS.items()
        for rival in twins
        if {reads, rival} <= set(found["config"]["drivers"])
    ]
    changes = {
        (place, pair, key): difference(np.array(drivers[pair[0]][key]), np.array(drivers[pair[1]][key]), SENSE[key])
        for place, (_, _, drivers) in enumerate(_each(found))
        for pair in pairs
        for key in JUDGED
    }
    # Where no drive differs p is 1, and the comparison counts: which ones differ is not known before the drives.
    adjusted = holm([1.0 if change.p is None else change.p for change in changes.values()])
    sign = {at: _sign(change, p) for (at, change), p in zip(changes.items(), adjusted, strict=True)}
    rows = []
    for place, (env, navigator, drivers) in enumerate(_each(found)):
        available = f"{100.0 * np.mean(drivers[found['config']['drivers'][0]]['available']):.3g}"
        verdicts = []
        for pair in pairs:
            harm, cost, speed = (sign[place, pair, key] for key in JUDGED)
            verdict = _verdict(min(harm, cost), max(harm, cost), speed, _pace(*(drivers[name] for name in pair)))
            verdicts.append(f"{verdict}{_shown(changes[place, pair, JUDGED[0]])}")
        rows.append((env, navigator, available, *(_harm_at(part) for part in drivers.values()), *verdicts))
    heads = ("id", "navigator", "available [%]", *(f"`{name}`" for name in found["config"]["drivers"]))
    return (*heads, *(f"`{reads}` against `{rival}`, difference of harm" for reads, rival in pairs)), rows


def _shown(change: Difference) -> str:
    """The difference of the harm with its 95 % interval; nothing where no drive differs."""
    if change.difference is None or change.low is None:
        return ""
    return f"; {change.difference:.2g} ({change.low:.2g} to {change.high:.2g})"


def _sign(change: Difference, p: float) -> int:
    """-1 or 1 for a difference that is clearly below or above 0, with an adjusted p-value; else 0."""
    if change.difference is None or p > 0.05 or change.n < VERDICT_SEEDS:
        return 0
    return 1 if change.difference > 0.0 else -1


def _verdict(least: int, most: int, speed: int, pace: float) -> str:
    """Of a driver against another: least and largest sign of harm and true cost, and that of the throughput."""
    if least < 0 and most <= 0:
        return "better" if pace >= EQUAL else f"safer, {100.0 * (1.0 - pace):.0f} % slower"
    if most > 0 and least >= 0:
        return "worse" if pace <= 1.0 / EQUAL else f"less safe, {100.0 * (pace - 1.0):.0f} % faster"
    if speed != 0 and least == 0 == most and not EQUAL <= pace <= 1.0 / EQUAL:
        return f"{100.0 * abs(pace - 1.0):.0f} % {'faster' if speed > 0 else 'slower'}"
    return "-" if least == most else "mixed"


def _pace(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> float:
    """Throughput over that of another driver."""
    return _throughput(ours) / max(_throughput(theirs), 1e-9)


def _harm_at(part: Mapping[str, Any]) -> str:
    """Harm, true cost and throughput."""
    return f"{np.mean(part['harm']):.3g}, {np.mean(part['true_cost']):.3g} at {_throughput(part):.3g}"


def _throughput(part: Mapping[str, Any]) -> float:
    """Mean over episodes [m/s]."""
    return float(np.mean(part["throughput_mps"]))


def _positions(found: Mapping[str, Any]) -> Table:
    """Of the first driver."""
    rows = []
    for env, navigator, drivers in _each(found):
        part = drivers[found["config"]["drivers"][0]]
        level = " / ".join("none" if value is None else f"{value:.3g}" for value in part["level_m"])
        error = " / ".join(f"{value:.2g}" for value in part["error_m"])
        shares = [f"{100.0 * np.mean(part[key]):.3g}" for key in ("available", "wrong_road", "hmi_share")]
        rows.append((env, navigator, level, error, f"{part['beyond']} of {part['decisions']}", *shares))
    heads = ("id", "navigator", "PL across, 50 / 95 % [m]", "error across, 50 / 95 / 100 % [m]", "error beyond PL",
             "available [%]", "wrong road [%]", "HMI [%]")  # fmt: skip
    return heads, rows


def _outcomes(found: Mapping[str, Any]) -> Table:
    rows = []
    for env, navigator, drivers in _each(found):
        for driver, part in drivers.items():
            counts = [f"{sum(part[name]):.0f}" for name, _ in ENDS]
            costs = estimate(np.array(part["cost"]), bounds=(0.0, np.inf))
            interval = "" if costs.low is None else f" ({costs.low:.2g} to {costs.high:.2g})"
            alert = f"{100.0 * np.mean(part['alert']):.3g}"
            time, speed = np.mean(part["time_s"]), np.mean(part["throughput_mps"])
            rows.append((env, navigator, f"`{driver}`", *counts, f"{time:.0f}", f"{speed:.3g}",
                         f"{np.mean(part['harm']):.3g}", f"{costs.mean:.3g}{interval}", alert))  # fmt: skip
    heads = ("id", "navigator", "driver", *(name.replace("_", " ") for name, _ in ENDS), "time [s]",
             "throughput [m/s]", "harm", "cost, 95 % interval", "alert [%]")  # fmt: skip
    return heads, rows


def _causes(found: Mapping[str, Any]) -> Table:
    """Weighted costs by cause, of the causes that occur."""
    parts = [
        (env, nav, driver, part["causes"]) for env, nav, drivers in _each(found) for driver, part in drivers.items()
    ]
    shown = [cause for cause in CAUSES if any(causes[cause] for *_, causes in parts)]
    rows = [(env, nav, f"`{driver}`", *(f"{causes[c]:.2g}" for c in shown)) for env, nav, driver, causes in parts]
    return ("id", "navigator", "driver", *(c.removeprefix("cost_") for c in shown)), rows


def _spread(found: Mapping[str, Any]) -> Table:
    """Levels of `nominal` on training seeds by the time since RTK, and errors."""
    rows = [
        (place["env"], place["navigator"], f"{age:g}", f"{count:.0f}", f"{median:.2g} ({low:.2g} to {high:.2g})",
         f"{error:.2g} / {most:.2g}")
        for place in found["places"].values()
        for age, count, low, median, high, error, most in place["spread"]
    ]  # fmt: skip
    heads = ("id", "navigator", "since RTK [s]", "decisions", "PL across, median and quartiles [m]",
             "error across, 50 / 95 % [m]")  # fmt: skip
    return heads, rows
