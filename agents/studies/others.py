"""Whether other vehicles that speak with recorded errors can be told from those that navigate.

Both drive traffic of the same kind, without an ego. Those that navigate do so in cities that were not recorded.
Vehicles of an episode share atmosphere, reference station and outages, so episodes are what tests exchange: a p-value
is the share of random exchanges of whole episodes between the two kinds in which they differ at least as much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from lanebound.agents.checkpointing.files import write_json
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import EPISODE_SEEDS, DrivingEnv
from lanebound.envs.recordings import AWAY_M, EPISODES, epochs_of
from lanebound.envs.vector.recorder import Recorder
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator

__all__ = ["OthersConfig", "assess_others", "difference_rows"]

Array = NDArray[np.float64]
BINS = 400  # of a marginal, at quantiles of both kinds together
NO_LEVEL_M = 1e4  # in place of a missing level
LAGS_S = (0.5, 2.0)


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
    """
    full = env.replace(perception={"source": "v2v", "others": "full"}, layouts=2 * env.layouts)
    surrogate = env.replace(perception={"source": "v2v", "others": "surrogate"})
    new, count = _in_new_cities(env.layouts, config.episodes, config.seed), config.episodes
    said = {"full": _notes(full, new), "surrogate": _notes(surrogate, _of_each_recording(count, config.seed))}
    rng, hz = named_generator(config.seed, "others"), env.navigation.rate_hz
    later = {f"autocorrelation of the error across, {lag:g} s": _autocorrelation(lag, hz) for lag in LAGS_S}
    tests = {**_marginals(), "spread of episodes' mean log level across": _shared, **later}
    found = {name: test(said["full"], said["surrogate"], config.exchanges, rng) for name, test in tests.items()}
    result = {"config": config.to_dict(), "env": env.to_dict(), "tests": found}
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "results.json", result)
    return result


def _in_new_cities(layouts: int, count: int, seed: int) -> list[int]:
    """Seeds of episodes in cities ``layouts`` to ``2 layouts - 1``."""
    found: list[int] = []
    for one in range(seed * 10**6, (seed + 1) * 10**6):
        episode = int(seeding.np_random(one)[0].integers(EPISODE_SEEDS))
        if named_generator(episode, "scene").integers(2 * layouts) >= layouts:
            found.append(one)
        if len(found) == count:
            break
    return found


def _of_each_recording(count: int, seed: int) -> list[int]:
    """Seeds of episodes in which the others speak as in different recorded ones: else some would count twice."""
    found: dict[int, int] = {}
    for one in range(seed * 10**6, (seed + 1) * 10**6):
        episode = int(seeding.np_random(one)[0].integers(EPISODE_SEEDS))
        found.setdefault(int(named_generator(episode, "others").integers(EPISODES)), one)
        if len(found) >= count:
            break
    return list(found.values())


def _notes(env: EnvConfig, seeds: Sequence[int]) -> Records:
    """What the others have said, (E, K, C) NOTE."""
    single = DrivingEnv(env)
    return Recorder(single, len(seeds), AWAY_M).record(list(seeds), epochs_of(env, single.world))


# Tests


def _marginals() -> dict[str, Any]:
    """Tests of quantities of a vehicle in an epoch."""
    quantities: dict[str, Callable[[Records], Array]] = {
        "error along [m]": lambda s: np.abs(s["along_m"]),
        "error across [m]": lambda s: np.abs(s["across_m"]),
        "error of the heading [rad]": lambda s: np.abs(s["turn_rad"]),
        "error of the speed, relative": lambda s: np.abs(s["scale"]),
        "level along [m]": lambda s: np.minimum(s["pl_at_m"], NO_LEVEL_M),
        "level across [m]": lambda s: np.minimum(s["pl_ct_m"], NO_LEVEL_M),
        "error over level, along": lambda s: np.abs(s["along_m"]) / np.minimum(s["pl_at_m"], NO_LEVEL_M),
        "error over level, across": lambda s: np.abs(s["across_m"]) / np.minimum(s["pl_ct_m"], NO_LEVEL_M),
    }
    shares: dict[str, Callable[[Records], Array]] = {
        "share of errors beyond a level": _beyond,
        "share of levels across over 1 m": lambda s: s["pl_ct_m"] > 1.0,
        "share of silent vehicles": lambda s: s["sends"] == 0,
    }
    of_all: dict[str, Any] = {name: _marginal(of) for name, of in quantities.items()}
    return of_all | {name: _share(of) for name, of in shares.items()}


def _beyond(said: Records) -> Array:
    """Whether an error exceeds its level."""
    return np.asarray((np.abs(said["along_m"]) > said["pl_at_m"]) | (np.abs(said["across_m"]) > said["pl_ct_m"]))


def _marginal(quantity: Callable[[Records], Array]) -> Any:
    """The largest distance of two distribution functions (Kolmogorov, Smirnov)."""

    def test(full: Records, surrogate: Records, exchanges: int, rng: np.random.Generator) -> dict[str, float]:
        values = [quantity(_there(of_episode)) for notes in (full, surrogate) for of_episode in notes]
        edges = np.unique(np.quantile(np.concatenate(values), np.linspace(0.0, 1.0, BINS + 1)))
        counts = np.array([np.histogram(v, edges)[0] for v in values], dtype=np.float64)

        def distance(first: Array, second: Array) -> Any:
            one, other = (np.cumsum(c, -1) / np.maximum(c.sum(-1, keepdims=True), 1.0) for c in (first, second))
            return np.abs(one - other).max(-1)

        medians = [float(np.median(np.concatenate(v))) for v in (values[: len(full)], values[len(full) :])]
        return _exchanged(counts, len(full), distance, exchanges, rng) | {"full": medians[0], "surrogate": medians[1]}

    return test


def _share(event: Callable[[Records], Array]) -> Any:
    """The difference of two shares of the vehicles and epochs."""

    def test(full: Records, surrogate: Records, exchanges: int, rng: np.random.Generator) -> dict[str, float]:
        of = [event(_there(of_episode)) for notes in (full, surrogate) for of_episode in notes]
        sums = np.array([(e.sum(), e.size) for e in of], dtype=np.float64)
        return _ratio(sums, len(full), exchanges, rng)

    return test


def _autocorrelation(lag_s: float, hz: float) -> Any:
    """The difference of two autocorrelations of the error across."""
    lag = max(round(lag_s * hz), 1)

    def test(full: Records, surrogate: Records, exchanges: int, rng: np.random.Generator) -> dict[str, float]:
        sums = []
        for notes in (full, surrogate):
            for of_episode in notes:
                x, key = of_episode["said"]["across_m"].astype(np.float64), of_episode["key"]
                same = (key[lag:] == key[:-lag]) & (key[lag:] > 0)
                power = 0.5 * (x[lag:] ** 2 + x[:-lag] ** 2)
                sums.append(((x[lag:] * x[:-lag])[same].sum(), power[same].sum()))
        return _ratio(np.array(sums), len(full), exchanges, rng)

    return test


def _shared(full: Records, surrogate: Records, exchanges: int, rng: np.random.Generator) -> dict[str, float]:
    """The difference of the standard deviations of episodes' means: what vehicles of an episode share."""
    means = [
        np.log(np.minimum(_there(of_episode)["pl_ct_m"], NO_LEVEL_M)).mean() if (of_episode["key"] > 0).any() else 0.0
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
    return _exchanged(sums, len(full), difference, exchanges, rng) | {"full": both[0], "surrogate": both[1]}


def _ratio(sums: Array, count: int, exchanges: int, rng: np.random.Generator) -> dict[str, float]:
    """The test of a difference of ratios of sums (2 E, 2)."""

    def difference(first: Array, second: Array) -> Any:
        one, other = (s[..., 0] / np.maximum(s[..., 1], 1e-12) for s in (first, second))
        return np.abs(one - other)

    both = [float(s[:, 0].sum() / max(s[:, 1].sum(), 1e-12)) for s in (sums[:count], sums[count:])]
    return _exchanged(sums, count, difference, exchanges, rng) | {"full": both[0], "surrogate": both[1]}


def _exchanged(
    rows: Array, count: int, statistic: Callable[[Array, Array], Any], exchanges: int, rng: np.random.Generator
) -> dict[str, float]:
    """Statistic of the sums of the first ``count`` rows and of the others, and its p-value under exchanges of rows."""
    seen = float(statistic(rows[:count].sum(0), rows[count:].sum(0)))
    at_least = 0
    for _ in range(exchanges):
        order = rng.permutation(len(rows))
        at_least += statistic(rows[order[:count]].sum(0), rows[order[count:]].sum(0)) >= seen - 1e-12
    return {"difference": seen, "p": (1 + at_least) / (1 + exchanges)}


def _there(notes: Records) -> Records:
    """What vehicles have said, (n,) SAID; empty slots are left out."""
    said: Records = notes["said"][notes["key"] > 0]
    return said


def difference_rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """A row for each test: both kinds, difference and p-value."""
    return [
        (name, f"{t['full']:.4g}", f"{t['surrogate']:.4g}", f"{t['difference']:.3g}", f"{t['p']:.3f}")
        for name, t in result["tests"].items()
    ]
