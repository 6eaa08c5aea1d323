"""Drivers of ``lanebound/Journey-v0`` in test cities, a learnt one among them, and the fast engine beside full drives.

MaskablePPO learns in training cities on the fast engine, with the objective of the integrity-aware driver. Then each
driver makes the same journeys through test cities under the whole navigator, and again on the fast engine, with many
draws of the sky. Two drivers choose a route whatever they meet: on these the spread of the draws is compared with what
the navigator met. Intervals are by city.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.drivers.journeys import JOURNEY_DRIVERS
from lanebound.agents.studies.journeys import interval, stated
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.envs.journeys.config import JourneyConfig
from lanebound.envs.journeys.engine import Journeys
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.journeys.planner import WEIGHT

Array = NDArray[np.float64]

PACKAGES = (
    "lanebound.integrity", "lanebound.agents.drivers", "lanebound.agents.learning", "lanebound.agents.studies",
    "lanebound.envs.journeys", "lanebound.envs.sky",
)  # fmt: skip
PPO, MODEL, LEARNER = "ppo", "ppo.zip", "learner"
DRIVERS = (*JOURNEY_DRIVERS, PPO)
FIXED = "shortest", "fastest"  # whose routes do not depend on what is met
MET = "time_s", "unusable_s"
BAND = 0.05, 0.95


class JourneyDriversConfig(Config):
    """Test cities, journeys, draws of the fast engine, and what the learner gets."""

    cities: int = Field(20, ge=1, le=100, description="test cities, the first ones")
    journeys: int = Field(10, ge=2, le=1000, description="in each city")
    draws: int = Field(64, ge=2, le=4096, description="of the sky, for each journey on the fast engine")
    seed: int = Field(401, ge=0, description="of journeys, skies and the learner")
    steps: int = Field(400_000, ge=1, description="decisions from which MaskablePPO learns")
    train_cities: int = Field(8, ge=1, le=64, description="training cities of the learner, the first ones")


def assess_journeys(
    config: JourneyDriversConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Train and drive what is missing; writes ``results.json`` and ``ppo.zip``, returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "journey drivers", config, PACKAGES)
    parts_of(config, partial(train_part, out), [LEARNER], out, 1, on_progress)
    names = [str(k) for k in range(config.cities)]
    parts = parts_of(config, partial(drive_part, out), names, out, jobs, on_progress)
    return stored({"config": config.to_dict(), **summary([parts[name] for name in names])}, out)


def train_part(out: Path, config: JourneyDriversConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Train the learner."""
    from lanebound.agents.learning.journeys import train_journeys

    env = {"cities": {"count": config.train_cities}, "reward": {"unusable": WEIGHT}}
    train_journeys(env, config.steps, config.seed, out / MODEL, advance)
    return {"steps": config.steps}


def drive_part(
    out: Path, config: JourneyDriversConfig, name: str, advance: Advance = ignore
) -> dict[str, dict[str, Any]]:
    """The journeys of one city: what each driver met under the navigator (J, 2), and on the fast engine (J, D, 2)."""
    city = int(name)
    rng = named_generator([config.seed, city], "journeys")
    seeds = rng.integers(2**32, size=config.journeys).tolist()
    skies = rng.integers(2**32, size=(config.journeys, config.draws)).tolist()
    found: dict[str, dict[str, Any]] = {}
    for k, driver in enumerate(DRIVERS):
        met = {}
        for mode, each in (("full", [[seed] for seed in seeds]), ("fast", skies)):
            env = JourneyConfig.load({
                "cities": {"split": "test", "count": config.cities}, "realised": mode, "reward": {"unusable": WEIGHT},
            })  # fmt: skip
            rows = [(seed, sky) for seed, own in zip(seeds, each, strict=True) for sky in own]
            met[mode] = travelled(env, driver, city, rows, out / MODEL).reshape(config.journeys, -1, len(MET))
        found[driver] = {"full": met["full"][:, 0].tolist(), "fast": np.round(met["fast"], 3).tolist()}
        advance((k + 1) / len(DRIVERS))
    return found


def travelled(config: JourneyConfig, driver: str, city: int, rows: Sequence[tuple[int, int]], model: Path) -> Array:
    """Time and unusable time (n, 2) [s] of journeys in a city under a driver; rows: seeds of tasks and of skies."""
    journeys = Journeys(config, len(rows))
    for row, (seed, sky) in enumerate(rows):
        journeys.seed(row, seed, sky)
    journeys.begin(range(len(rows)), city)
    if driver == PPO:
        from lanebound.agents.learning.journeys import LearntJourney

        decides: Any = LearntJourney(model, journeys)
    else:
        decides = JOURNEY_DRIVERS[driver](journeys, config)
    while journeys.running.any():
        journeys.step(decides.act(journeys.observe()), journeys.running)
    return np.stack([journeys.state[name] for name in MET], -1)


def summary(cities: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means by driver, differences to two of them, and the fast engine beside the navigator."""
    full = {d: np.array([city[d]["full"] for city in cities]) for d in DRIVERS}  # (C, J, 2)
    fast = {d: np.array([city[d]["fast"] for city in cities]) for d in DRIVERS}  # (C, J, D, 2)
    rows = []
    for driver in DRIVERS:
        own = full[driver]
        row: dict[str, Any] = {"driver": driver} | dict(zip(MET, own.mean((0, 1)).tolist(), strict=True))
        row["cost_s"] = float(_cost(own).mean())
        row["fast"] = dict(zip(MET, fast[driver].mean((0, 1, 2)).tolist(), strict=True))
        row["fast"]["cost_s"] = float(_cost(fast[driver]).mean())
        for name, other in (("less_shortest", "shortest"), ("less_aware", "integrity_aware")):
            row[name] = {m: interval((own - full[other])[..., j].mean(1), np.mean) for j, m in enumerate(MET)}
            row[name]["cost_s"] = interval((_cost(own) - _cost(full[other])).mean(1), np.mean)
            row[name]["fast_cost_s"] = interval((_cost(fast[driver]) - _cost(fast[other])).mean((1, 2)), np.mean)
        row["fast_less_full"] = {
            m: interval((fast[driver].mean(2) - own)[..., j].mean(1), np.mean) for j, m in enumerate(MET)
        }
        rows.append(row)
    return {
        "cities": len(cities),
        "journeys": int(np.prod(full[DRIVERS[0]].shape[:2])),
        "draws": int(fast[DRIVERS[0]].shape[2]),
        "drivers": rows,
        "spread": [_spread(driver, full[driver][..., 1], fast[driver][..., 1]) for driver in FIXED],
    }


def _cost(met: Array) -> Array:
    """Time and weighted time without a usable position, (..., 2) -> (...,) [s]."""
    return np.asarray(met[..., 0] + WEIGHT * met[..., 1])


def _spread(driver: str, full: Array, fast: Array) -> dict[str, Any]:
    """The time without a position of the navigator (C, J), in the distribution of the draws (C, J, D)."""
    off, inner = full - fast.mean(2), fast.std(2, ddof=1)
    low, high = np.quantile(fast, BAND, axis=2)
    parts = np.stack([(off**2).mean(1), (inner**2).mean(1)], -1)
    return {
        "driver": driver,
        "residual_s": float(np.sqrt((off**2).mean())),
        "draws_s": float(np.sqrt((inner**2).mean())),
        "ratio": interval(parts, lambda rows: np.sqrt(rows[:, 1].mean() / rows[:, 0].mean())),
        "within": interval(((full >= low) & (full <= high)).mean(1), np.mean),
        "correlation": float(np.corrcoef(full.ravel(), fast.mean(2).ravel())[0, 1]),
    }


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    rows = result["drivers"]
    yield (
        f"{result['journeys']} journeys in {result['cities']} test cities under the navigator; cost: time + "
        f"{WEIGHT:g} x unusable time",
        (
            (
                "driver", "time s", "unusable s", "cost s", "unusable less shortest s", "cost less shortest s",
                "cost less integrity_aware s", "the same, fast engine s",
            ),
            [
                (
                    row["driver"], f"{row['time_s']:.0f}", f"{row['unusable_s']:.1f}", f"{row['cost_s']:.0f}",
                    *(stated(row["less_shortest"][m], 1.0, "") for m in ("unusable_s", "cost_s")),
                    *(stated(row["less_aware"][m], 1.0, "") for m in ("cost_s", "fast_cost_s")),
                )
                for row in rows
            ],
        ),
    )  # fmt: skip
    yield (
        f"The fast engine, {result['draws']} draws of each journey",
        (
            ("driver", "time s", "unusable s", "time less full s", "unusable less full s"),
            [
                (
                    row["driver"], f"{row['fast']['time_s']:.0f}", f"{row['fast']['unusable_s']:.1f}",
                    *(stated(row["fast_less_full"][m], 1.0, "") for m in MET),
                )
                for row in rows
            ],
        ),
    )  # fmt: skip
    yield (
        "Spread of the time without a usable position on given routes",
        (
            ("driver", "navigator about the mean of draws s", "draws s", "ratio", "in the band of 90 %", "correlation"),
            [
                (
                    one["driver"], f"{one['residual_s']:.1f}", f"{one['draws_s']:.1f}",
                    "{:.2f} ({:.2f} .. {:.2f})".format(*one["ratio"]), stated(one["within"], 100.0, " %"),
                    f"{one['correlation']:.2f}",
                )
                for one in result["spread"]
            ],
        ),
    )  # fmt: skip
