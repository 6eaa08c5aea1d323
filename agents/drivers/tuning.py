"""How the cautious driver's constant margins are found: as much harm as the integrity-aware driver does, no less.

Both drive the same training seeds. One number, caution, moves the speed and the gap together; it is halved in on until
the harm is the same: collisions and true departures by the weights of the environment's costs. So what is left between
the two drivers is what integrity tells, not care as such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lanebound.agents.benchmark.seeds import TRAIN
from lanebound.agents.drivers.aware import make_integrity_aware
from lanebound.agents.drivers.base import Driver
from lanebound.agents.drivers.margins import CautiousConfig, make_cautious
from lanebound.agents.episodes import EpisodeLog, drive, open_env, summarise
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.errors import InputError

__all__ = ["Measured", "cautious_at", "measure", "tune_cautious"]

SPEED_SPAN, GAP_SPAN_M = 0.7, 10.0
Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Measured:
    """Means over episodes: harm (weighted collisions and true departures), its parts, speed [m/s]."""

    harm: float
    collision_rate: float
    departure_rate: float
    cost_lane: float
    speed_mps: float
    episodes: int

    def to_dict(self) -> dict[str, float]:
        """Plain data."""
        return asdict(self)


def cautious_at(caution: float) -> CautiousConfig:
    """The margins at a caution between 0 (the nominal driver's) and 1.

    >>> cautious_at(0.0).speed_share
    1.0
    """
    return CautiousConfig(speed_share=1.0 - SPEED_SPAN * caution, gap_m=GAP_SPAN_M * caution)


def measure(env: DrivingEnv, agent: Driver, seeds: Sequence[int], tell: Callable[[int, int], None]) -> Measured:
    """Drive the seeds, one at a time."""
    found, speeds = [], []
    for n, seed in enumerate(seeds):
        log = EpisodeLog()
        drive(env, agent, [seed], [log])
        rows = log.episode(0)
        found.append(summarise(rows))
        speeds.append(float(np.mean([row["speed_mps"] for row in rows])))
        tell(n + 1, len(seeds))
    cost, lane = env.config.cost, [s.costs["cost_lane"] for s in found]
    hit = [s.costs["cost_collision"] for s in found]
    return Measured(
        harm=cost.collision * float(np.mean(hit)) + cost.lane * float(np.mean(lane)),
        collision_rate=float(np.mean([s.collision for s in found])),
        departure_rate=float(np.mean([value > 0.0 for value in lane])),
        cost_lane=float(np.mean(lane)),
        speed_mps=float(np.mean(speeds)),
        episodes=len(found),
    )


def tune_cautious(
    name: str, sky: str, seeds: Sequence[int], halvings: int = 4, tell: Tell = lambda what, done, of: None
) -> dict[str, Any]:
    """The least caution whose harm is that of the integrity-aware driver or less, to ``1 / 2^halvings``.

    Raises
    ------
    InputError
        A seed is none to train on.
    """
    if not seeds or min(seeds) < TRAIN.start or max(seeds) >= TRAIN.stop:
        raise InputError(f"seeds must lie in [{TRAIN.start}, {TRAIN.stop}), got {seeds!r}: others are kept for tests")
    env = open_env(name, {"sky": sky})

    def measured(what: str, agent: Driver) -> Measured:
        return measure(env, agent, seeds, lambda done, of: tell(what, done, of))

    goal = measured("integrity_aware", make_integrity_aware(env))
    low, high, tried = 0.0, 1.0, {}
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        tried[middle] = measured(f"cautious at {middle:g}", make_cautious(env, cautious_at(middle)))
        low, high = (low, middle) if tried[middle].harm <= goal.harm else (middle, high)
    return {
        "environment": name,
        "sky": sky,
        "seeds": [min(seeds), max(seeds)],
        "integrity_aware": goal.to_dict(),
        "tried": {str(key): value.to_dict() for key, value in sorted(tried.items())},
        "caution": high,
        "margins": {key: getattr(cautious_at(high), key) for key in ("speed_share", "gap_m", "lane_m")},
        "matched": high < 1.0,
    }
