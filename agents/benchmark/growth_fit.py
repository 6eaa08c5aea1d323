"""Growth of protection levels without RTK, measured on training seeds: the figures of GrowthConfig.

The nominal driver drives; the levels are read from its observations. An outage begins with the first decision without
RTK; the gain of a level is counted from the last one on RTK.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.seeds import TRAIN
from lanebound.agents.checkpointing.runner import OnProgress, RunProgress, ignore
from lanebound.agents.drivers.base import Reader, StatelessDriver
from lanebound.agents.drivers.horizon import GROWTH_SPEED_MPS, GrowthConfig
from lanebound.agents.drivers.nominal import make_nominal
from lanebound.agents.episodes import drive, open_env

__all__ = ["fit_growth", "gains_of", "growth_of", "measure_growth", "most_satellites"]

Array = NDArray[np.float64]

SHOWN = ("integrity.since_rtk", "integrity.pl_at", "integrity.pl_ct", "integrity.corrections_age", "ego.speed")
SINCE, AT, CT, AGE, SPEED, SEEN = range(6)
LONGEST_S = 12.0  # of an outage that counts for the law
HORIZON_S = 4.0  # for which a level on RTK is predicted
SLOWEST_MPS = 1.0  # mean speed of an outage that counts for the law
BINS = 12  # of time, evenly in its logarithm
FEWEST = 30  # outages, and decisions at a number of satellites, that a quantile is taken of
OUT_SHARE = 0.6  # of decisions, where RTK counts as lost


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
) -> tuple[list[Array], float]:
    """What the nominal driver sees in ``seeds`` episodes of each id under each sky; the time between decisions [s].

    Each array (n, 6): time without RTK [s], levels along and across [m], age of corrections [s], speed [m/s],
    satellites predicted.
    """
    found: list[Array] = []
    step_s = 0.0
    for name, sky in product(names, skies):
        env = open_env(name, {"sky": sky})
        step_s = env.dt_s
        for seed in TRAIN[:seeds]:
            recorder = _Recorder(make_nominal(env), Reader(env.config.observation))
            drive(env, recorder, [seed])
            found.append(np.array(recorder.rows))
            on_progress(RunProgress(of=len(names) * len(skies) * seeds, done=len(found)))
        env.close()
    return found, step_s


def gains_of(episodes: Sequence[Array], rtk_s: float) -> Array:
    """Decisions without RTK (n, 4): time without it [s], gains of the levels along and across since then [m], and the
    mean speed since then [m/s]."""
    gains = []
    for rows in episodes:
        on_rtk = rows[:, SINCE] <= rtk_s
        last = np.maximum.accumulate(np.where(on_rtk, np.arange(len(rows)), -1))
        out = ~on_rtk & (last >= 0) & np.isfinite(rows).all(-1)
        way, now = np.cumsum(rows[:, SPEED]), np.flatnonzero(out)
        mean = (way[now] - way[last[now]]) / (now - last[now])
        gains.append(np.column_stack([rows[out, SINCE], rows[out, AT : CT + 1] - rows[last[out], AT : CT + 1], mean]))
    return np.concatenate(gains)


def growth_of(gains: Array) -> tuple[float, Array, Array]:
    """Power p of time, factors (2,) of the medians ``g t^p`` and of the quantiles of nine in ten, along and across [m].

    The medians across are those at GROWTH_SPEED_MPS, to whose share of speed the gains are proportional.
    The power is that of both axes together, by least squares of the logarithms of the medians in bins of time; the
    upper factors are the largest over the bins.
    """
    edges = np.geomspace(0.25, LONGEST_S, BINS + 1)
    gains = gains[gains[:, 3] > SLOWEST_MPS]
    scaled = gains[:, 1:3] / np.column_stack([np.ones(len(gains)), gains[:, 3] / GROWTH_SPEED_MPS])
    logs, upper = [], []
    for low, high in pairwise(edges):
        chosen = (gains[:, 0] >= low) & (gains[:, 0] < high)
        inside = gains[chosen]
        if len(inside) >= FEWEST:
            time = float(np.median(inside[:, 0]))
            logs.append([np.log(time), *np.log(np.maximum(np.median(scaled[chosen], axis=0), 1e-3))])
            upper.append([time, *np.quantile(inside[:, 1:3], 0.9, axis=0)])
    t, medians = np.array(logs)[:, 0], np.array(logs)[:, 1:]
    centred = t - t.mean()
    power = float(np.clip((centred @ (medians - medians.mean(0))).mean() / (centred @ centred), 0.3, 1.0))
    top = np.array(upper)
    return power, np.exp((medians - power * t[:, None]).mean(0)), (top[:, 1:] / top[:, :1] ** power).max(0)


def most_satellites(episodes: Sequence[Array], rtk_s: float, link_age_s: float) -> int:
    """The least number of predicted satellites with RTK in two of five decisions and more, while the link holds."""
    rows = np.concatenate(episodes)
    rows = rows[(rows[:, AGE] < link_age_s) & (rows[:, SEEN] >= 0.0)]
    out = [
        count
        for count in np.unique(rows[:, SEEN])
        if (rows[:, SEEN] == count).sum() >= FEWEST
        and (rows[rows[:, SEEN] == count, SINCE] > rtk_s).mean() >= OUT_SHARE
    ]
    return int(max(out, default=-1.0)) + 1


def fit_growth(episodes: Sequence[Array], step_s: float) -> dict[str, float]:
    """Figures of GrowthConfig from what :func:`measure_growth` found."""
    shipped = GrowthConfig()
    power, median, upper = growth_of(gains_of(episodes, shipped.rtk_s))
    ahead = max(round(HORIZON_S / step_s), 1)
    steady, risen = [], []
    for rows in episodes:
        on_rtk = rows[:, SINCE] <= shipped.rtk_s
        steady.append(rows[on_rtk, AT : CT + 1])
        both = on_rtk[:-ahead] & on_rtk[ahead:]
        risen.append((rows[ahead:, AT : CT + 1] - rows[:-ahead, AT : CT + 1])[both].max(-1))
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
