"""What arms come to in a place: a training is one draw of an arm, however many episodes its policy drives.

Trainings are few, so intervals and tests are Student's, which takes their means for normal; a share that is the same in
all trainings has the interval of Clopper and Pearson over the episodes. All trainings of a place are judged on the same
episodes, in the cities that they were learnt in: the intervals tell of learning anew, not of driving elsewhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import estimate, holm, student_ends, student_p

__all__ = ["PRIMARY", "SHOWN", "adjust", "means_of", "summarise"]

SHOWN = ("return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput")
"""Metrics that are summed up, by their names in the benchmark."""
PRIMARY = ("return", "cost", "harm")
"""Those whose differences between arms are tested together, by Holm's method."""
RATES = ("over_cost_limit", "collision", "off_road", "lane_departure")

Array = NDArray[np.float64]


def summarise(parts: Sequence[Mapping[str, Any]], arms: Mapping[str, str | None]) -> dict[str, Any]:
    """Of each arm the mean over its trainings with a 95 % interval, and its paired difference from another (or None).

    Trainings with the same seed are paired. ``parts`` are the finished trainings of a place, each with its ``arm``,
    ``seed``, ``limit`` of an episode's cost and ``episodes`` as :func:`~.evaluation.drive_all` has them; ``kept``
    counts those whose episodes cost at most that limit in the mean.
    """
    episodes = sum(len(part["episodes"]) for part in parts) // max(len(parts), 1)
    kept = Counter(part["arm"] for part in parts if _means(part["episodes"])["cost"] <= part["limit"])
    by_arm = {arm: {part["seed"]: _means(part["episodes"]) for part in parts if part["arm"] == arm} for arm in arms}
    return {
        "arms": {
            arm: {
                "seeds": sorted(trainings),
                "kept": kept[arm],
                "means": {key: _estimate(trainings, key, episodes * len(trainings)) for key in SHOWN},
                "less": {other: _differences(trainings, by_arm[other])} if (other := arms[arm]) is not None else {},
            }
            for arm, trainings in by_arm.items()
            if trainings
        }
    }


def means_of(results: Results) -> dict[str, dict[str, float]]:
    """Means over the episodes of drivers that are not learnt, by their names."""
    return {
        cell.agent: {key: mean for key in SHOWN if (mean := cell.metrics[key].mean) is not None}
        for cell in results.cells
    }


def _means(episodes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of a policy over its episodes."""
    return {key: float(np.mean([row[key] for row in episodes])) for key in SHOWN}


def _estimate(trainings: Mapping[int, Mapping[str, Any]], key: str, episodes: int) -> dict[str, Any]:
    """Mean over trainings with its 95 % interval; None where there is one training."""
    values = _column(trainings, key)
    low, high = student_ends(values)
    if key in RATES and values.size > 1 and np.ptp(values) == 0.0:
        pooled = np.arange(episodes) < round(float(values[0]) * episodes)
        found = estimate(pooled.astype(np.float64), rate=True)
        low, high = found.low, found.high
    return {"mean": float(values.mean()), "low": low, "high": high, "n": int(values.size)}


def _column(trainings: Mapping[int, Mapping[str, Any]], key: str) -> Array:
    return np.array([trainings[seed][key] for seed in sorted(trainings)])


def _differences(ours: Mapping[int, Mapping[str, Any]], theirs: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """Of each metric, over the seeds that both have; ``p`` of no difference."""
    both, out = sorted(ours.keys() & theirs.keys()), {}
    for key in SHOWN:
        gap = np.array([ours[seed][key] - theirs[seed][key] for seed in both])
        low, high = student_ends(gap)
        out[key] = {"difference": float(gap.mean()) if both else None, "low": low, "high": high, "n": len(both),
                    "p": student_p(gap) if gap.size > 1 else None}  # fmt: skip
    return out


def adjust(places: Sequence[Mapping[str, Any]]) -> None:
    """Write ``p_holm`` beside each ``p`` of the PRIMARY metrics, adjusted for all places, arms and these metrics."""
    tests = [
        less[key]
        for place in places
        for arm in place["arms"].values()
        for less in arm["less"].values()
        for key in PRIMARY
        if less[key]["p"] is not None
    ]
    for test, p in zip(tests, holm([test["p"] for test in tests]), strict=True):
        test["p_holm"] = p
