"""How the cautious driver's constant margins are found: the fair opponent of the integrity-aware driver.

A benchmark on training seeds: the integrity-aware driver beside a ladder of cautious ones. One number, caution, moves
speed, gap and lane together from the nominal driver's (0) to a third of the speed, 10 m and half a car (1). The least
rung that does no more harm than the integrity-aware driver is taken; where none does as little, the caution of the same
throughput, which unlike mean speed an early end does not raise. It is one line through the margins that there could be,
judged by means over few seeds: other constant margins may do better than the one that is found.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

from lanebound.agents.benchmark.metrics import harm_of, went_off_road
from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.running import run
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.checkpointing.runner import OnProgress, ignore
from lanebound.agents.drivers.margins import CautiousConfig
from lanebound.agents.episodes import open_env
from lanebound.integrity.core.errors import InputError

__all__ = ["LADDER", "Measured", "cautious_at", "choose", "tune_cautious", "tuning_suite"]

SPEED_SPAN, GAP_SPAN_M, LANE_SPAN_M = 0.7, 10.0, 1.0
LADDER = tuple(k / 8 for k in range(9))
GOAL = "integrity_aware"
EPISODE: dict[str, Any] = {}  # of the environments' configuration, changed for all


@dataclass(frozen=True)
class Measured:
    """Means over episodes: harm as the metric of that name, what is in it, throughput and speed [m/s]."""

    harm: float
    collision_rate: float
    off_road_rate: float
    departure_rate: float
    cost_lane: float
    throughput_mps: float
    speed_mps: float
    episodes: int

    @classmethod
    def of(cls, outcomes: list[Outcome]) -> Measured:
        """Of the episodes of one driver.

        Raises
        ------
        InputError
            It failed in one: the others may be the easy ones.
        """
        failed = [o for o in outcomes if o.failed]
        if failed:
            raise InputError(
                f"episodes must all be driven to tune on them, got {len(failed)} of {len(outcomes)} that failed, "
                f"{failed[0].id} among them ({failed[0].message}): mend the driver"
            )
        return cls(
            harm=fmean(map(harm_of, outcomes)),
            collision_rate=fmean(o.collision for o in outcomes),
            off_road_rate=fmean(map(went_off_road, outcomes)),
            departure_rate=fmean(o.lane_departure for o in outcomes),
            cost_lane=fmean(o.costs.get("cost_lane", 0.0) for o in outcomes),
            throughput_mps=fmean(o.throughput_mps or 0.0 for o in outcomes),
            speed_mps=fmean(o.mean_speed_mps or 0.0 for o in outcomes),
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
    """Caution, and by what it is matched: ``harm`` or, where no rung does as little, ``throughput``.

    Between rungs throughput and harm are taken as linear. Throughput need not fall with caution, for crashes lower it:
    of several cautions of the same throughput that of least harm is taken, and without any the rung of the nearest.
    """
    harmless = [caution for caution, found in ladder.items() if found.harm <= goal.harm]
    if harmless:
        return min(harmless), "harm"
    rungs = sorted(ladder.items())
    matching = [match for pair in pairwise(rungs) if (match := _between(goal.throughput_mps, *pair)) is not None]
    if matching:
        return min(matching)[1], "throughput"
    away = [(abs(found.throughput_mps - goal.throughput_mps), found.harm, caution) for caution, found in rungs]
    return min(away)[2], "throughput"


Rung = tuple[float, Measured]


def _between(throughput_mps: float, one: Rung, other: Rung) -> tuple[float, float] | None:
    """Harm and caution between two rungs where throughput is as given; None where it is nowhere between them."""
    (caution, low), (more, high) = one, other
    if (
        not min(low.throughput_mps, high.throughput_mps)
        <= throughput_mps
        <= max(low.throughput_mps, high.throughput_mps)
    ):
        return None
    span = high.throughput_mps - low.throughput_mps
    share = (throughput_mps - low.throughput_mps) / span if span else float(high.harm < low.harm)
    return low.harm + share * (high.harm - low.harm), caution + share * (more - caution)


def tune_cautious(
    name: str,
    sky: str,
    seeds: int,
    folder: Path,
    jobs: int | None = None,
    on_progress: OnProgress = ignore,
) -> dict[str, Any]:
    """Drive the ladder, or what is missing of it in ``folder``, and choose; as plain data.

    Raises
    ------
    InputError
        As :func:`~lanebound.agents.benchmark.running.run`, and a driver failed; ConfigError where there are not so many
        training seeds.
    """
    suite = tuning_suite(name, sky, seeds)
    results = run(suite, folder, jobs, on_progress=on_progress)
    config = open_env(name, {"sky": sky}).config
    goal = _measured(results, GOAL)
    ladder = {caution: _measured(results, _rung(caution)) for caution in LADDER}
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


def _measured(results: Results, agent: str) -> Measured:
    return Measured.of([o for o in results.outcomes if o.agent == agent])
