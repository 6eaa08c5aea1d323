"""What arms come to in a place: a training is one draw of an arm, however many episodes its policy drives."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.metrics import METRICS
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import difference, estimate

__all__ = ["SHOWN", "summarise"]

SHOWN = ("return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput")
"""Metrics of the benchmark that are summed up."""

Array = NDArray[np.float64]


def summarise(results: Results, arms: Sequence[str], reference: str, beside: Sequence[str]) -> dict[str, Any]:
    """Of each arm the mean over its trainings with a 95 % interval, and its paired difference from the reference.

    Trainings with the same seed are paired. The drivers beside them have no trainings: theirs are means over episodes.
    """
    means = {agent: _means(results, agent) for agent in (cell.agent for cell in results.cells)}
    found: dict[str, Any] = {"arms": {}, "beside": {agent: means[agent] for agent in beside if agent in means}}
    by_arm = {arm: _trainings(means, arm) for arm in arms}
    for arm, trainings in by_arm.items():
        if trainings:
            found["arms"][arm] = {
                "seeds": sorted(trainings),
                "means": {key: estimate(_column(trainings, key)).to_dict() for key in SHOWN},
                "less_reference": _differences(trainings, by_arm[reference]) if arm != reference else {},
            }
    return found


def _means(results: Results, agent: str) -> dict[str, float]:
    """Means of an agent over its episodes."""
    cell = next(cell for cell in results.cells if cell.agent == agent)
    return {key: mean for key in SHOWN if (mean := cell.metrics[key].mean) is not None}


def _trainings(means: dict[str, dict[str, float]], arm: str) -> dict[int, dict[str, float]]:
    """Means of the trainings of an arm by their seeds."""
    named = {agent: re.fullmatch(re.escape(arm) + r"-(\d+)", agent) for agent in means}
    return {int(match[1]): means[agent] for agent, match in named.items() if match}


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
