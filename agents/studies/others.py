"""Whether broadcasts with recorded errors can be distinguished from those of vehicles that navigate.

Both drive traffic of the same kind, without an ego. A p-value is the share of random exchanges between the two kinds
in which they differ at least as much. In the recorded cities whole episodes are exchanged, whose vehicles share
atmosphere, reference station and outages; in other cities whole cities, since the sky over a road is that of its city.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from lanebound.agents.report.pages import Table
from lanebound.agents.studies.study import stored
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import EPISODE_SEEDS, DrivingEnv
from lanebound.envs.recordings import AWAY_M, EPISODES, SEED, city_of, epochs_of
from lanebound.envs.vector.recorder import Recorder
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator

Array = NDArray[np.float64]
MORE = 3  # times as many cities as were recorded
BINS = 400  # of a marginal, at quantiles of both kinds together
NO_LEVEL_M = 1e4  # in place of a missing level
LAGS_S = (0.5, 2.0)
TURNING, BRAKING, STANDING = 0.1, 1.0, 0.1  # [rad/s], [m/s^2], [m/s]
FEWEST_CITIES = 3  # 84 exchanges of whole cities: a p-value of 0.012 at least


class OthersConfig(Config):
    """What is compared."""

    episodes: int = Field(EPISODES, ge=8, le=EPISODES, description="episodes of each kind")
    seed: int = Field(0, ge=0, description="seeds are drawn from it")
    exchanges: int = Field(999, ge=99, description="random exchanges of a test")


def assess_others(config: OthersConfig, env: EnvConfig, out: Path) -> dict[str, Any]:
    """Drive both kinds in the traffic of ``env``, compare them, and write ``results.json``; returns its data.

    Raises
    ------
    ConfigError
        The vector engine does not drive the world of ``env``.
    InputError
        It has too few cities.
    """
    surrogate = env.replace(perception={"source": "v2v", "others": "surrogate"})
    full, count, seed = env.replace(perception={"source": "v2v", "others": "full"}), config.episodes, config.seed
    own = env.cities.number
    if own < FEWEST_CITIES:
        raise InputError(
            f"cities.count must be {FEWEST_CITIES} or more for a test by city, got {own}: raise it by --set "
            "cities.count"
        )
    spoken, recorded = _of_each_recording(count, 2 * seed + 1)  # other traffic than that of those that navigate
    said = _notes(surrogate, spoken)
    kinds = {"same": (own, range(own)), "other": (MORE * own, range(own, 10**9))}
    tests, hz = _marginals() | {"spread of episodes' mean log level across": _shared}, env.navigation.rate_hz
    tests["correlation of errors across of two vehicles"] = _together
    tests |= {f"autocorrelation of the error across, {lag:g} s": _autocorrelation(lag, hz) for lag in LAGS_S}
    found: dict[str, dict[str, Any]] = {}
    for kind, (cities, allowed) in kinds.items():
        seeds = _seeds_in(cities, allowed, count, 2 * seed)
        navigated, rng = _notes(full.replace(cities={"count": cities}), seeds), named_generator(seed, "others")
        of_full, of_surrogate = np.arange(count), np.arange(count, 2 * count)
        if kind == "other":
            of_full = np.array([city_of(one, cities) for one in seeds])
            of_surrogate = np.array([city_of(SEED + one, own) for one in recorded])
        exchange = _Exchange(np.concatenate([of_full, of_surrogate]), count, config.exchanges, rng)
        found[kind] = {name: test(navigated, said, exchange) for name, test in tests.items()}
    return stored({"config": config.to_dict(), "env": env.to_dict(), "tests": found}, out)


def _seeds_in(cities: int, allowed: Container[int], count: int, seed: int) -> list[int]:
    """Seeds of episodes in some of so many cities."""
    every = range(seed * 10**6, (seed + 1) * 10**6)
    return list(islice((one for one in every if city_of(one, cities) in allowed), count))


def _of_each_recording(count: int, seed: int) -> tuple[list[int], list[int]]:
    """Seeds of episodes with the errors of different recorded ones, and these: none counts twice."""
    found: dict[int, int] = {}
    for one in range(seed * 10**6, (seed + 1) * 10**6):
        episode = int(seeding.np_random(one)[0].integers(EPISODE_SEEDS))
        found.setdefault(int(named_generator(episode, "others").integers(EPISODES)), one)
        if len(found) >= count:
            break
    return list(found.values()), list(found)


def _notes(env: EnvConfig, seeds: Sequence[int]) -> Records:
    """Broadcasts of the others and their errors, (E, K, C) NOTE."""
    single = DrivingEnv(env)
    return Recorder(single, len(seeds), AWAY_M).record(list(seeds), epochs_of(env, single.world))


# Tests


def _marginals() -> dict[str, Any]:
    """Tests of quantities of a vehicle in an epoch."""
    quantities: dict[str, Callable[[Records], Array]] = {
        "error along [m]": lambda n: n["said"]["along_m"],
        "error across [m]": lambda n: n["said"]["across_m"],
        "error of the course [rad]": lambda n: n["said"]["turn_rad"],
        "error of the course in turns [rad]": lambda n: n["said"]["turn_rad"][np.abs(n["move"]["yaw_radps"]) > TURNING],
        "error of the speed [m/s]": lambda n: n["said"]["speed_mps"],
        "error of the speed, braking [m/s]": lambda n: n["said"]["speed_mps"][n["move"]["braking_mps2"] > BRAKING],
        "error of the speed, standing [m/s]": lambda n: n["said"]["speed_mps"][
            np.abs(n["move"]["speed_mps"]) < STANDING
        ],
        "level along [m]": lambda n: np.minimum(n["said"]["pl_at_m"], NO_LEVEL_M),
        "level across [m]": lambda n: np.minimum(n["said"]["pl_ct_m"], NO_LEVEL_M),
        "error over level, along": lambda n: (
            np.abs(n["said"]["along_m"]) / np.minimum(n["said"]["pl_at_m"], NO_LEVEL_M)
        ),
        "error over level, across": lambda n: (
            np.abs(n["said"]["across_m"]) / np.minimum(n["said"]["pl_ct_m"], NO_LEVEL_M)
        ),
    }
    shares: dict[str, Callable[[Records], Any]] = {
        "share of errors beyond a level": _beyond,
        "share of levels across over 1 m": lambda n: n["said"]["pl_ct_m"] > 1.0,
        "share of silent vehicles": lambda n: n["said"]["sends"] == 0,
    }
    of_all: dict[str, Any] = {name: _marginal(of) for name, of in quantities.items()}
    return of_all | {name: _share(of) for name, of in shares.items()}


def _beyond(notes: Records) -> Any:
    """Whether an error exceeds its level."""
    said = notes["said"]
    return np.asarray((np.abs(said["along_m"]) > said["pl_at_m"]) | (np.abs(said["across_m"]) > said["pl_ct_m"]))


def _marginal(quantity: Callable[[Records], Array]) -> Any:
    """The largest distance of two distribution functions (Kolmogorov, Smirnov)."""

    def test(full: Records, surrogate: Records, exchange: _Exchange) -> dict[str, float]:
        values = [quantity(_there(of_episode)) for notes in (full, surrogate) for of_episode in notes]
        every = np.concatenate(values)
        if not every.size:
            return {"difference": 0.0, "p": 1.0, "full": np.nan, "surrogate": np.nan}
        edges = np.append(np.unique(np.quantile(every, np.linspace(0.0, 1.0, BINS + 1))), np.inf)
        counts = np.array([np.histogram(v, edges)[0] for v in values], dtype=np.float64)

        def distance(first: Array, second: Array) -> Any:
            one, other = (np.cumsum(c, -1) / np.maximum(c.sum(-1, keepdims=True), 1.0) for c in (first, second))
            return np.abs(one - other).max(-1)

        medians = [
            float(np.median(np.abs(np.concatenate(v)))) if np.concatenate(v).size else np.nan
            for v in (values[: len(full)], values[len(full) :])
        ]
        return exchange(counts, distance) | {"full": medians[0], "surrogate": medians[1]}

    return test


def _share(event: Callable[[Records], Any]) -> Any:
    """The difference of two shares of the vehicles and epochs."""

    def test(full: Records, surrogate: Records, exchange: _Exchange) -> dict[str, float]:
        of = [event(_there(of_episode)) for notes in (full, surrogate) for of_episode in notes]
        sums = np.array([(e.sum(), e.size) for e in of], dtype=np.float64)
        return _ratio(sums, exchange)

    return test


def _autocorrelation(lag_s: float, hz: float) -> Any:
    """The difference of two autocorrelations of the error across."""
    lag = max(round(lag_s * hz), 1)

    def test(full: Records, surrogate: Records, exchange: _Exchange) -> dict[str, float]:
        sums = []
        for notes in (full, surrogate):
            for of_episode in notes:
                x, key = of_episode["said"]["across_m"].astype(np.float64), of_episode["move"]["key"]
                same = (key[lag:] == key[:-lag]) & (key[lag:] > 0)
                power = 0.5 * (x[lag:] ** 2 + x[:-lag] ** 2)
                sums.append(((x[lag:] * x[:-lag])[same].sum(), power[same].sum()))
        return _ratio(np.array(sums), exchange)

    return test


def _shared(full: Records, surrogate: Records, exchange: _Exchange) -> dict[str, float]:
    """The difference of the standard deviations of episodes' means: what vehicles of an episode share."""
    means = [
        np.log(np.minimum(_there(of_episode)["said"]["pl_ct_m"], NO_LEVEL_M)).mean() if _there(of_episode).size else 0.0
        for notes in (full, surrogate)
        for of_episode in notes
    ]
    sums = np.array([(1.0, m, m * m) for m in means])

    def spread(s: Array) -> Any:
        n, total, square = np.moveaxis(s.sum(-2) if s.ndim > 2 else s, -1, 0)
        return np.sqrt(np.maximum(square / n - (total / n) ** 2, 0.0))

    def difference(first: Array, second: Array) -> Any:
        return np.abs(spread(first) - spread(second))

    both = [float(spread(s.sum(0))) for s in (sums[: len(full)], sums[len(full) :])]
    return exchange(sums, difference) | {"full": both[0], "surrogate": both[1]}


def _ratio(sums: Array, exchange: _Exchange) -> dict[str, float]:
    """The test of a difference of ratios of sums (2 E, 2)."""

    def difference(first: Array, second: Array) -> Any:
        one, other = (s[..., 0] / np.maximum(s[..., 1], 1e-12) for s in (first, second))
        return np.abs(one - other)

    count = exchange.count
    both = [float(s[:, 0].sum() / max(s[:, 1].sum(), 1e-12)) for s in (sums[:count], sums[count:])]
    return exchange(sums, difference) | {"full": both[0], "surrogate": both[1]}


@dataclass(frozen=True)
class _Exchange:
    """A test by random exchanges.

    unit : (2 E,) of each episode, those of the first kind first; whole units are exchanged
    count : E
    """

    unit: NDArray[np.int64]
    count: int
    exchanges: int
    rng: np.random.Generator

    def __call__(self, rows: Array, statistic: Callable[[Array, Array], Any]) -> dict[str, float]:
        """Statistic of the sums of rows (2 E, ...) of the two kinds, and its p-value."""
        first, other = (np.unique(part) for part in (self.unit[: self.count], self.unit[self.count :]))
        shared = np.intersect1d(first, other)
        assert not shared.size, f"units must be of one kind, got {shared}"
        sums = np.array([rows[self.unit == unit].sum(0) for unit in (*first, *other)])
        seen, at_least = float(statistic(sums[: first.size].sum(0), sums[first.size :].sum(0))), 0
        for _ in range(self.exchanges):
            order = self.rng.permutation(len(sums))
            drawn = statistic(sums[order[: first.size]].sum(0), sums[order[first.size :]].sum(0))
            at_least += bool(drawn >= seen - 1e-12)
        return {"difference": seen, "p": (1 + at_least) / (1 + self.exchanges)}


def _together(full: Records, surrogate: Records, exchange: _Exchange) -> dict[str, float]:
    """The difference of the correlations of the errors across of two vehicles at one time."""
    sums = []
    for notes in (full, surrogate):
        for of_episode in notes:
            x = np.where(of_episode["move"]["key"] > 0, of_episode["said"]["across_m"], 0.0).astype(np.float64)
            others, square = (of_episode["move"]["key"] > 0).sum(-1) - 1, (x * x).sum(-1)
            sums.append((((x.sum(-1)) ** 2 - square)[others > 0].sum(), (others * square)[others > 0].sum()))
    return _ratio(np.array(sums), exchange)


def _there(notes: Records) -> Records:
    """Notes (n,) of vehicles; empty slots are left out."""
    found: Records = notes[notes["move"]["key"] > 0]
    return found


def difference_rows(result: dict[str, Any]) -> Table:
    """A row for each test: both kinds, then the p-value, in the recorded cities and in others."""
    same, other = result["tests"]["same"], result["tests"]["other"]

    def shown(value: float) -> str:
        return "-" if value is None or math.isnan(value) else f"{value:.3g}"

    heads = ("quantity", "surrogate", "full, same cities", "full, other cities")
    return heads, [
        (name, shown(t["surrogate"]), *(f"{shown(k[name]['full'])}, p {k[name]['p']:.3f}" for k in (same, other)))
        for name, t in same.items()
    ]
