"""What drivers and policies keep in cities that nothing was tuned on: the shipped ones, in tuned cities and in others.

The episodes of an id have the same seeds in both: the same traffic, hours and sensor noise, and another city. Tuned are
the four cities of the default, in which the policies were trained; test are the 100 of the split ``test``, varied the
same with streets that are drawn too (``cities.vary``), and roads the test cities along other roads, where an id has
roads by number (``world.layout``). The gap is the paired difference from the tuned ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.metrics import Better
from lanebound.agents.benchmark.statistics import Difference, difference, holm
from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.learnt import policies
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.limits import first_episodes
from lanebound.agents.studies.study import claim, parts_of, stored
from lanebound.envs import make_config
from lanebound.envs.rewards import TERMS
from lanebound.integrity.core.config import Config, Field, deep_merge

__all__ = ["SECTIONS", "GeneralisationConfig", "assess_cities", "tables"]

Array = NDArray[np.float64]
PACKAGES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.agents.drivers",
    "lanebound.agents:studies/cities.py",
    "lanebound.agents:studies/limits.py",
)
SECTIONS = ("gap",)
TUNED, CLEAR = "tuned", 0.05  # CLEAR: p-value
CITIES: dict[str, dict[str, Any]] = {
    TUNED: {"split": "train", "count": 4, "vary": False},
    "test": {"split": "test", "count": 100, "vary": False},
    "varied": {"split": "test", "count": 100, "vary": True},
}
ROADS, OTHER_ROADS = "roads", {"layout": 100, "roads": 8}  # roads that nothing was tuned on, one drawn for each drive
JUDGED: dict[str, Better] = {"reward": "higher", "cost": "lower", "available": "higher"}


class GeneralisationConfig(Config):
    """All inputs of the study."""

    envs: tuple[str, ...] = Field(
        ("LaneKeeping", "CarFollowing", "Highway", "Merge", "UrbanCanyon"),
        min_length=1,
        description="ids with an engine, ours without lanebound/",
    )
    drivers: tuple[str, ...] = Field(
        ("integrity_aware", "ppo"), min_length=1, description="names of drivers; ppo: the policy of the package"
    )
    seeds: int = Field(32, ge=2, le=1000, description="episodes of each id and driver, held-out seeds")
    overrides: Mapping[str, Any] = Field({}, description="of the environments' configuration, merged deeply")

    def changes(self, cities: str) -> dict[str, Any]:
        """The configuration of an id in cities of a kind, along other roads where that is the kind."""
        road = {"world": OTHER_ROADS} if cities == ROADS else {}
        given = {"cities": CITIES["test" if cities == ROADS else cities], "observation": {"form": "flat"}, **road}
        return deep_merge(self.overrides, given)


def kinds_of(env: str) -> tuple[str, ...]:
    """The kinds of cities in which an id is driven."""
    with closing(open_env(full_id(env), {"sky": "open", "faults": "none"})) as single:
        world: Any = single.unwrapped.get_wrapper_attr("world")
        roads = "roads" in world.default_config() and "layout" in world.default_config()
    return (*CITIES, ROADS) if roads else tuple(CITIES)


def assess_cities(
    config: GeneralisationConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the ids that are missing; returns the data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or a driver does not exist or cannot drive an id; ConfigError for a value that an
        environment refuses.
    """
    for env in config.envs:  # refusals come before the work
        make_config(full_id(env), config.changes("test"))
        with closing(open_env(full_id(env), config.changes("test"))) as single:
            for driver in config.drivers:
                make_agent(driver, single)
    arrays = [f"lanebound.agents:policies/{file.name}" for file in policies().values()]
    claim(out, "cities", config, (*PACKAGES, *sorted(arrays)), "places", config.envs)
    return stored(
        {"config": config.to_dict(), "envs": parts_of(config, _of_id, config.envs, out, jobs, on_progress)}, out
    )


def _of_id(config: GeneralisationConfig, env: str, advance: Advance) -> dict[str, Any]:
    """Figures of each episode, by driver and kind of cities."""
    found: dict[str, Any] = {driver: {} for driver in config.drivers}
    pairs = [(driver, cities) for cities in kinds_of(env) for driver in config.drivers]
    for done, (driver, cities) in enumerate(pairs, 1):
        found[driver][cities] = _driven(config, env, driver, cities)
        advance(done / len(pairs))
    return found


def _driven(config: GeneralisationConfig, env: str, driver: str, cities: str) -> dict[str, list[float]]:
    """Reward, cost and share of usable decisions of each episode, and whether it succeeds."""
    count = config.seeds
    steps, success, sums = np.zeros(count), np.zeros(count), {name: np.zeros(count) for name in JUDGED}
    for infos, going, over, envs in first_episodes(env, config.changes(cities), driver, count, SPLITS["test"][0]):
        weights = envs.config.reward
        reward = sum(getattr(weights, term) * infos["rewards"][term] for term in TERMS)
        of_step = {"reward": reward, "cost": infos["cost"], "available": infos["available"]}
        for name, values in of_step.items():
            sums[name] += np.where(going, values, 0.0)
        steps += going
        success += going & over & infos["is_success"]
    sums["available"] /= steps
    return {name: values.tolist() for name, values in {**sums, "success": success}.items()}


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """Means of each id and driver by cities, and the gap to the tuned ones with its 95 % interval.

    Bold: clear after Holm's method over the table.
    """
    cases = [(env, driver, part) for env, drivers in found["envs"].items() for driver, part in drivers.items()]
    others = [(at, cities, name) for at, case in enumerate(cases) for cities in list(case[2])[1:] for name in JUDGED]
    gaps = {
        (at, cities, name): difference(
            np.array(cases[at][2][cities][name]), np.array(cases[at][2][TUNED][name]), JUDGED[name]
        )
        for at, cities, name in others
    }
    adjusted = dict(zip(gaps, holm([1.0 if gap.p is None else gap.p for gap in gaps.values()]), strict=True))
    rows = []
    for at, (env, driver, part) in enumerate(cases):
        for cities in part:
            cells = []
            for name in JUDGED:
                unit, key = 100.0 if name == "available" else 1.0, (at, cities, name)
                gap = _shown(gaps[key], unit, adjusted[key] < CLEAR) if key in gaps else ""
                cells += [f"{unit * float(np.mean(part[cities][name])):.3g}", gap]
            success = f"{100.0 * float(np.mean(part[cities]['success'])):.0f}"
            rows.append((env, f"`{driver}`", cities, success, *cells))
    heads = ("id", "driver", "cities", "success [%]", "reward", "gap", "cost", "gap", "available [%]", "gap")
    return {SECTIONS[0]: (heads, rows)}


def _shown(gap: Difference, unit: float, clear: bool) -> str:
    """A difference in another unit with its interval, bold where it is clear."""
    ends = "" if gap.low is None or gap.high is None else f" ({unit * gap.low:+.2g} to {unit * gap.high:+.2g})"
    text = f"{unit * (gap.difference or 0.0):+.2g}{ends}"
    return f"**{text}**" if clear else text
