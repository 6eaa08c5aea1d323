"""How the cautious driver's constant margins are found: the fair opponent of the integrity-aware driver.

A benchmark on training seeds: the integrity-aware driver beside a ladder of cautious ones. One number, caution, moves
speed, gap and lane together from the nominal driver's (0) to a third of the speed, 10 m and half a car (1). The least
caution that does no more harm than the integrity-aware driver is taken; where none does as little, that of the same
mean speed. So what is left between the two drivers is what integrity tells, not care as such.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.running import Progress, run
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.drivers.margins import CautiousConfig
from lanebound.agents.episodes import open_env
from lanebound.envs.costs import CostConfig

__all__ = ["LADDER", "Measured", "cautious_at", "choose", "tune_cautious", "tuning_suite"]

SPEED_SPAN, GAP_SPAN_M, LANE_SPAN_M = 0.7, 10.0, 1.0
LADDER = tuple(k / 8 for k in range(9))
GOAL = "integrity_aware"
EPISODE: dict[str, Any] = {}  # of the environments' configuration, changed for all


@dataclass(frozen=True)
class Measured:
    """Means over episodes: harm (weighted crashes, ends off the road and true departures), its parts, speed [m/s]."""

    harm: float
    collision_rate: float
    departure_rate: float
    cost_lane: float
    speed_mps: float
    episodes: int

    @classmethod
    def of(cls, outcomes: list[Outcome], cost: CostConfig) -> Measured:
        """Of the episodes of one driver."""
        lane = float(np.mean([o.costs.get("cost_lane", 0.0) for o in outcomes]))
        ends = [
            sum(getattr(cost, k) * o.costs.get(f"cost_{k}", 0.0) for k in ("collision", "off_road")) for o in outcomes
        ]
        return cls(
            harm=float(np.mean(ends)) + cost.lane * lane,
            collision_rate=float(np.mean([o.collision for o in outcomes])),
            departure_rate=float(np.mean([o.lane_departure for o in outcomes])),
            cost_lane=lane,
            speed_mps=float(np.mean([o.mean_speed_mps for o in outcomes])),
            episodes=len(outcomes),
        )


def cautious_at(caution: float) -> CautiousConfig:
    """The margins at a caution between 0 (the nominal driver's) and 1.

    >>> cautious_at(0.0).speed_share
    1.0
    """
    return CautiousConfig(
        speed_share=1.0 - SPEED_SPAN * caution, gap_m=GAP_SPAN_M * caution, lane_m=LANE_SPAN_M * caution
    )


def tuning_suite(name: str, sky: str, seeds: int) -> SuiteConfig:
    """The integrity-aware driver and the ladder, on the first training seeds."""
    ladder = {_rung(caution): {"agent": "cautious", "figures": _margins(caution)} for caution in LADDER}
    return SuiteConfig.load(
        {
            "title": f"caution as harmless as integrity, {name} {sky}",
            "envs": [name],
            "skies": [sky],
            "agents": {GOAL: GOAL, **ladder},
            "reference": GOAL,
            "seeds": {"split": "train", "count": seeds},
            "overrides": EPISODE,
        }
    )


def choose(goal: Measured, ladder: dict[float, Measured]) -> tuple[float, str]:
    """Caution, and by what it is matched: ``harm`` or, where no rung does as little, ``speed``.

    >>> fast, slow = Measured(9.0, 0.0, 1.0, 9.0, 10.0, 1), Measured(4.0, 0.0, 1.0, 4.0, 6.0, 1)
    >>> choose(Measured(5.0, 0.0, 1.0, 5.0, 9.0, 1), {0.0: fast, 1.0: slow})
    (1.0, 'harm')
    >>> choose(Measured(3.0, 0.0, 1.0, 3.0, 9.0, 1), {0.0: fast, 1.0: slow})
    (0.25, 'speed')
    """
    harmless = [caution for caution, found in ladder.items() if found.harm <= goal.harm]
    if harmless:
        return min(harmless), "harm"
    by_speed = sorted((found.speed_mps, caution) for caution, found in ladder.items())
    speeds, cautions = zip(*by_speed, strict=True)
    return float(np.interp(goal.speed_mps, speeds, cautions)), "speed"


def tune_cautious(
    name: str,
    sky: str,
    seeds: int,
    folder: Path,
    jobs: int | None = None,
    told: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, Any]:
    """Drive the ladder, or what is missing of it in ``folder``, and choose; as plain data.

    Raises
    ------
    InputError
        As :func:`~lanebound.agents.benchmark.running.run`; ConfigError where there are not so many training seeds.
    """
    suite = tuning_suite(name, sky, seeds)
    results = run(suite, folder, jobs, told=told)
    config = open_env(name, {"sky": sky}).config
    cost = config.cost
    goal = _measured(results, GOAL, cost)
    ladder = {caution: _measured(results, _rung(caution), cost) for caution in LADDER}
    caution, matched = choose(goal, ladder)
    return {
        "environment": suite.envs[0],
        "base": config.base,
        "sky": sky,
        "seeds": [suite.seeds.seeds[0], suite.seeds.seeds[-1]],
        GOAL: asdict(goal),
        "ladder": {str(rung): asdict(found) for rung, found in ladder.items()},
        "caution": caution,
        "matched": matched,
        "figures": _margins(caution),
    }


def _rung(caution: float) -> str:
    return f"caution_{caution:g}"


def _margins(caution: float) -> dict[str, float]:
    config = cautious_at(caution)
    return {name: round(getattr(config, name), 4) for name in ("speed_share", "gap_m", "lane_m")}


def _measured(results: Results, agent: str, cost: CostConfig) -> Measured:
    return Measured.of([o for o in results.outcomes if o.agent == agent and not o.failed], cost)
