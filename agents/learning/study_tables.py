"""What arms come to in a place: a training is one draw of an arm, however many episodes its policy drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.metrics import METRICS
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import difference, estimate

__all__ = ["SHOWN", "means_of", "summarise"]

SHOWN = ("return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput")
"""Metrics that are summed up, by their names in the benchmark."""

Array = NDArray[np.float64]


def summarise(parts: Sequence[Mapping[str, Any]], arms: Sequence[str], reference: str) -> dict[str, Any]:
    """Of each arm the mean over its trainings with a 95 % interval, and its paired difference from the reference.

    Trainings with the same seed are paired. ``parts`` are the finished trainings of a place, each with its ``arm``,
    ``seed`` and ``episodes`` as :func:`~.evaluation.drive_all` has them.
    """
    by_arm = {arm: {part["seed"]: _means(part["episodes"]) for part in parts if part["arm"] == arm} for arm in arms}
    return {
        "arms": {
            arm: {
                "seeds": sorted(trainings),
                "means": {key: estimate(_column(trainings, key)).to_dict() for key in SHOWN},
                "less_reference": _differences(trainings, by_arm[reference]) if arm != reference else {},
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


def _column(trainings: dict[int, dict[str, float]], key: str) -> Array:
    return np.array([row[key] for _, row in sorted(trainings.items()) if key in row])


def _differences(ours: dict[int, dict[str, float]], theirs: dict[int, dict[str, float]]) -> dict[str, Any]:
    """Of each metric, over the seeds that both have."""
    better = {metric.key: metric.better for metric in METRICS}
    out = {}
    for key in SHOWN:
        both = [seed for seed in sorted(ours.keys() & theirs.keys()) if key in ours[seed] and key in theirs[seed]]
        a, b = (np.array([rows[seed][key] for seed in both]) for rows in (ours, theirs))
        found = difference(a, b, better[key])
        out[key] = {name: getattr(found, name) for name in ("difference", "low", "high", "n", "p")}
    return out
