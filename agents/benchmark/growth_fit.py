"""Growth of protection levels without RTK, measured on training seeds: the figures of GrowthConfig.

The nominal driver drives; the levels are read from its observations. An outage begins with the first decision without
RTK; the gain of a level is counted from the last one on RTK.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.suite import TRAIN
from lanebound.agents.checkpointing.runner import OnProgress, RunProgress, ignore
from lanebound.agents.drivers.base import Reader, StatelessDriver
from lanebound.agents.drivers.horizon import GROWTH_SPEED_MPS, GrowthConfig
from lanebound.agents.drivers.nominal import make_nominal
from lanebound.agents.episodes import drive, open_env

__all__ = ["Decisions", "Gains", "fit_growth", "gains_of", "growth_of", "measure_growth", "most_satellites"]

Array = NDArray[np.float64]

SHOWN = ("integrity.since_rtk", "integrity.pl_at", "integrity.pl_ct", "integrity.corrections_age", "ego.speed")
LONGEST_S = 12.0  # of an outage that counts for the law
HORIZON_S = 4.0  # for which a level on RTK is predicted
SLOWEST_MPS = 1.0  # mean speed of an outage that counts for the law
BINS = 12  # of time, evenly in its logarithm
FEWEST = 30  # outages, and decisions at a number of satellites, that a quantile is taken of
OUT_SHARE = 0.6  # of decisions, where RTK counts as lost


class Decisions(NamedTuple):
    """What a driver saw at its n decisions, (n,) each but the levels.

    Attributes
    ----------
    since_s : time without RTK; level_m : (n, 2) protection levels along and across; age_s : of corrections
    speed_mps : of the ego; satellites : predicted here
    """

    since_s: Array
    level_m: Array
    age_s: Array
    speed_mps: Array
    satellites: Array

    @classmethod
    def of(cls, rows: Array) -> Self:
        """From rows (n, 6) of the values of SHOWN and the satellites."""
        since, at, ct, age, speed, satellites = np.asarray(rows, dtype=np.float64).T
        return cls(since, np.column_stack([at, ct]), age, speed, satellites)

    def take(self, which: NDArray[Any]) -> Self:
        """Some of the decisions, by a mask or by indices."""
        return type(self)(*(column[which] for column in self))

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Whether all values of a decision are finite, (n,)."""
        return np.asarray(np.isfinite(np.column_stack(self)).all(-1))


class Gains(NamedTuple):
    """Gains of the levels in n decisions without RTK.

    Attributes
    ----------
    time_s : (n,) without RTK; level_m : (n, 2) gains along and across since then; speed_mps : (n,) mean since then
    """

    time_s: Array
    level_m: Array
    speed_mps: Array

    def take(self, which: NDArray[Any]) -> Self:
        """Some of the decisions, by a mask or by indices."""
        return type(self)(*(column[which] for column in self))


class _Recorder(StatelessDriver):
    """Records the levels of the observations of another driver."""

    def __init__(self, driver: Any, reader: Reader) -> None:
        self.driver, self.reader = driver, reader
        self.rows: list[list[float]] = []

    def act(self, observation: Any) -> Any:
        nearest = f"road.sky_{self.reader.config.satellites_m[0]:g}m_own"
        self.rows.append([float(self.reader.value(observation, column)) for column in (*SHOWN, nearest)])
        return self.driver.predict(observation)[0]


def measure_growth(
    names: Sequence[str], skies: Sequence[str], seeds: int, on_progress: OnProgress = ignore
) -> tuple[list[Decisions], float]:
    """What the nominal driver sees in ``seeds`` episodes of each id under each sky; the time between decisions [s]."""
    found: list[Decisions] = []
    step_s = 0.0
    for name, sky in product(names, skies):
        env = open_env(name, {"sky": sky})
        step_s = env.dt_s
        for seed in TRAIN[:seeds]:
            recorder = _Recorder(make_nominal(env), Reader(env.config.observation))
            drive(env, recorder, [seed])
            found.append(Decisions.of(np.array(recorder.rows)))
            on_progress(RunProgress(of=len(names) * len(skies) * seeds, done=len(found)))
        env.close()
    return found, step_s


def gains_of(episodes: Sequence[Decisions], rtk_s: float) -> Gains:
    """The gains of all decisions without RTK, since the last one on RTK."""
    gains = []
    for seen in episodes:
        on_rtk = seen.since_s <= rtk_s
        last = np.maximum.accumulate(np.where(on_rtk, np.arange(on_rtk.size), -1))
        now = np.flatnonzero(~on_rtk & (last >= 0) & seen.finite)
        way, then = np.cumsum(seen.speed_mps), last[now]
        mean = (way[now] - way[then]) / (now - then)
        gains.append(Gains(seen.since_s[now], seen.level_m[now] - seen.level_m[then], mean))
    return Gains(*(np.concatenate(columns) for columns in zip(*gains, strict=True)))


def growth_of(gains: Gains) -> tuple[float, Array, Array]:
    """Power p of time, factors (2,) of the medians ``g t^p`` and of the quantiles of nine in ten, along and across [m].

    The medians across are those at GROWTH_SPEED_MPS, to whose share of speed the gains are proportional.
    The power is that of both axes together, by least squares of the logarithms of the medians in bins of time; the
    upper factors are the largest over the bins.
    """
    edges = np.geomspace(0.25, LONGEST_S, BINS + 1)
    gains = gains.take(gains.speed_mps > SLOWEST_MPS)
    share = gains.speed_mps / GROWTH_SPEED_MPS
    scaled = gains.level_m / np.column_stack([np.ones(share.size), share])
    logs, upper = [], []
    for low, high in pairwise(edges):
        chosen = (gains.time_s >= low) & (gains.time_s < high)
        inside = gains.take(chosen)
        if inside.time_s.size >= FEWEST:
            time = float(np.median(inside.time_s))
            logs.append([np.log(time), *np.log(np.maximum(np.median(scaled[chosen], axis=0), 1e-3))])
            upper.append([time, *np.quantile(inside.level_m, 0.9, axis=0)])
    t, medians = np.array(logs)[:, 0], np.array(logs)[:, 1:]
    centred = t - t.mean()
    power = float(np.clip((centred @ (medians - medians.mean(0))).mean() / (centred @ centred), 0.3, 1.0))
    top = np.array(upper)
    return power, np.exp((medians - power * t[:, None]).mean(0)), (top[:, 1:] / top[:, :1] ** power).max(0)


def most_satellites(episodes: Sequence[Decisions], rtk_s: float, link_age_s: float) -> int:
    """The least number of predicted satellites with RTK in two of five decisions and more, while the link holds."""
    since, age, satellites = (
        np.concatenate([getattr(seen, name) for seen in episodes]) for name in ("since_s", "age_s", "satellites")
    )
    known = (age < link_age_s) & (satellites >= 0.0)
    since, satellites = since[known], satellites[known]
    out = [
        count
        for count in np.unique(satellites)
        if (satellites == count).sum() >= FEWEST and (since[satellites == count] > rtk_s).mean() >= OUT_SHARE
    ]
    return int(max(out, default=-1.0)) + 1


def fit_growth(episodes: Sequence[Decisions], step_s: float) -> dict[str, float]:
    """Figures of GrowthConfig from what :func:`measure_growth` found."""
    shipped = GrowthConfig()
    power, median, upper = growth_of(gains_of(episodes, shipped.rtk_s))
    ahead = max(round(HORIZON_S / step_s), 1)
    steady, risen = [], []
    for seen in episodes:
        on_rtk = seen.since_s <= shipped.rtk_s
        steady.append(seen.level_m[on_rtk])
        both = on_rtk[:-ahead] & on_rtk[ahead:]
        risen.append((seen.level_m[ahead:] - seen.level_m[:-ahead])[both].max(-1))
    reset = np.median(np.concatenate(steady), axis=0)
    return {
        "satellites_needed": most_satellites(episodes, shipped.rtk_s, shipped.link_age_s),
        "growth_at_m": round(float(median[0]), 2),
        "growth_ct_m": round(float(median[1]), 2),
        "growth_power": round(power, 2),
        "reset_at_m": round(float(reset[0]), 2),
        "reset_ct_m": round(float(reset[1]), 2),
        "upper_at_m": round(float(upper[0]), 2),
        "upper_ct_m": round(float(upper[1]), 2),
        "spare_m": round(float(np.quantile(np.concatenate(risen), 0.9)), 2),
    }
