"""Tuning of the constant margins of the cautious driver, a fair opponent of the integrity-aware driver.

A benchmark on training seeds: the integrity-aware driver and a ladder of cautious ones. One number, caution, changes
speed, gap and lane together from those of the nominal driver (0) to a third of the speed, 10 m and half a car (1). The
result is the least caution with no more harm than the integrity-aware driver; where there is none, the caution with the
same throughput, which an early end does not raise, unlike mean speed. This is one line through all possible margins,
evaluated by means over few seeds: other constant margins may be better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import run
from lanebound.agents.checkpointing.runner import OnProgress, ignore
from lanebound.agents.drivers.margins import CautiousConfig
from lanebound.agents.episodes import open_env
from lanebound.integrity.core.errors import InputError

__all__ = ["LADDER", "cautious_at", "choose", "measured", "tune_cautious", "tuning_suite"]

Means = dict[str, float]
Rung = tuple[float, Means]

SPEED_SPAN, GAP_SPAN_M, LANE_SPAN_M = 0.7, 10.0, 1.0
LADDER = tuple(k / 8 for k in range(9))
GOAL = "integrity_aware"
MEASURED = ("harm", "collision", "off_road", "lane_departure", "cost_lane", "throughput", "mean_speed")
EPISODE: dict[str, Any] = {}  # of the environments' configuration, changed for all


def measured(outcomes: Sequence[Outcome]) -> Means:
    """Means of MEASURED over the episodes of one driver, and the number of ``episodes``.

    Raises
    ------
    InputError
        It failed in an episode: the others may be the easy ones.
    """
    failed = [o for o in outcomes if o.failed]
    if failed:
        raise InputError(
            f"episodes must all be driven to tune on them, got {len(failed)} of {len(outcomes)} that failed, "
            f"{failed[0].id} among them ({failed[0].message}): mend the driver"
        )
    found = {key: fmean(metric_named(key).take(o) or 0.0 for o in outcomes) for key in MEASURED}
    return found | {"episodes": len(outcomes)}


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


def choose(goal: Means, ladder: Mapping[float, Means]) -> tuple[float, str]:
    """Caution, and the metric that it matches: ``harm`` or, where no rung has so little, ``throughput``.

    Between rungs throughput and harm are linear. Throughput need not fall with caution, because crashes lower it: of
    several cautions with the same throughput the one with the least harm is taken, and without any the nearest rung.
    """
    harmless = [caution for caution, found in ladder.items() if found["harm"] <= goal["harm"]]
    if harmless:
        return min(harmless), "harm"
    rungs = sorted(ladder.items())
    matching = [match for pair in pairwise(rungs) if (match := _between(goal["throughput"], *pair)) is not None]
    if matching:
        return min(matching)[1], "throughput"
    away = [(abs(found["throughput"] - goal["throughput"]), found["harm"], caution) for caution, found in rungs]
    return min(away)[2], "throughput"


def _between(throughput: float, one: Rung, other: Rung) -> tuple[float, float] | None:
    """Harm and caution between two rungs at a throughput; None where it does not lie between them."""
    (caution, low), (more, high) = one, other
    ends = low["throughput"], high["throughput"]
    if not min(ends) <= throughput <= max(ends):
        return None
    span = ends[1] - ends[0]
    share = (throughput - ends[0]) / span if span else float(high["harm"] < low["harm"])
    return low["harm"] + share * (high["harm"] - low["harm"]), caution + share * (more - caution)


def tune_cautious(
    name: str, sky: str, seeds: int, folder: Path, jobs: int | None = None, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing episodes of the ladder in ``folder``, and choose; as plain data.

    Raises
    ------
    InputError
        As :func:`~lanebound.agents.benchmark.work.run`, and a driver failed; ConfigError where there are not so many
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
        GOAL: goal,
        "ladder": {str(rung): found for rung, found in ladder.items()},
        "caution": caution,
        "matched": matched,
        "figures": _margins(caution),
    }


def _rung(caution: float) -> str:
    return f"caution_{caution:g}"


def _margins(caution: float) -> dict[str, float]:
    config = cautious_at(caution)
    return {name: round(getattr(config, name), 4) for name in ("speed_share", "gap_m", "lane_m")}


def _measured(results: Results, agent: str) -> Means:
    return measured([o for o in results.outcomes if o.agent == agent])
