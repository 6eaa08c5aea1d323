"""Results of the arms of a study in a place: a training is one draw of an arm, for any number of episodes.

Trainings are few, so intervals and tests are Student's, which assume normal means; a share that is equal in all
trainings has the interval of Clopper and Pearson over all episodes, as if all had different seeds. All trainings of a
place are evaluated on the same episodes, in the cities of their training: the intervals describe a repeated training,
not other cities.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import estimate, holm, student_ends, student_p, within

__all__ = ["PRIMARY", "SHOWN", "adjust", "higher", "kept_oftener", "means_of", "spread", "summarise", "tested"]

SHOWN = ("return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput")
"""Metrics of the summary, by their names in the benchmark."""
PRIMARY = ("return", "cost", "harm")
"""Metrics whose differences between arms are tested together, by Holm's method."""
RATES = ("over_cost_limit", "collision", "off_road", "lane_departure")

Array = NDArray[np.float64]


def summarise(parts: Sequence[Mapping[str, Any]], arms: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Means of each arm over its trainings with 95 % intervals, and paired differences from other arms.

    Trainings with the same seed are paired. ``parts`` are the finished trainings of a place, each with its ``arm``,
    ``seed``, ``limit`` of an episode's cost and ``episodes`` of :func:`~.evaluation.drive_all`; ``kept`` is the number
    of those within the limit (:func:`keeps`).
    """
    episodes = sum(len(part["episodes"]) for part in parts) // max(len(parts), 1)
    kept = Counter(part["arm"] for part in parts if keeps(part))
    by_arm = {arm: {part["seed"]: _means(part["episodes"]) for part in parts if part["arm"] == arm} for arm in arms}
    return {
        "arms": {
            arm: {
                "seeds": sorted(trainings),
                "kept": kept[arm],
                "means": {key: _estimate(trainings, key, episodes * len(trainings)) for key in SHOWN},
                "less": {other: _differences(trainings, by_arm[other]) for other in arms[arm]},
            }
            for arm, trainings in by_arm.items()
            if trainings
        }
    }


def keeps(part: Mapping[str, Any]) -> bool:
    """Whether the mean cost of a training's episodes is at most its limit."""
    return _means(part["episodes"])["cost"] <= float(part["limit"])


def kept_oftener(parts: Sequence[Mapping[str, Any]], arms: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Trainings of arms within the cost limit, in all places together, and ``p`` of no difference (McNemar, exact).

    Trainings with the same place and seed are paired: ``n`` pairs; ``first`` and ``second`` within the limit, and
    ``first_alone`` and ``second_alone`` where the other is not.
    """
    by_arm = {arm: {(p["env"], p["sky"], p["seed"]): keeps(p) for p in parts if p["arm"] == arm} for arm in arms}
    out = []
    for arm, others in arms.items():
        for other in others:
            ours, theirs = by_arm[arm], by_arm[other]
            pairs = [(ours[key], theirs[key]) for key in sorted(ours.keys() & theirs.keys())]
            alone, against = pairs.count((True, False)), pairs.count((False, True))
            out.append({
                "arm": arm, "other": other, "n": len(pairs),
                "first": sum(first for first, _ in pairs), "second": sum(second for _, second in pairs),
                "first_alone": alone, "second_alone": against,
                "p": float(binomtest(alone, alone + against).pvalue) if alone + against else 1.0,
            })  # fmt: skip
    return out


def higher(parts: Sequence[Mapping[str, Any]], arm: str, other: str, key: str = "return") -> tuple[int, int, int, int]:
    """Comparison of a metric of two arms, trainings with the same place and seed paired.

    Returns (pairs where the first is higher, pairs, places where its mean is higher, places).
    """
    ours, theirs = (
        {(p["env"], p["sky"], p["seed"]): _means(p["episodes"])[key] for p in parts if p["arm"] == name}
        for name in (arm, other)
    )
    gaps: dict[tuple[str, str], list[float]] = {}
    for place in sorted(ours.keys() & theirs.keys()):
        gaps.setdefault(place[:2], []).append(ours[place] - theirs[place])
    above = [gap > 0.0 for of in gaps.values() for gap in of]
    return sum(above), len(above), sum(sum(of) > 0.0 for of in gaps.values()), len(gaps)


def means_of(results: Results) -> dict[str, dict[str, float]]:
    """Means over the episodes of packaged drivers, by name."""
    return {
        cell.agent: {key: mean for key in SHOWN if (mean := cell.metrics[key].mean) is not None}
        for cell in results.cells
    }


def _means(episodes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means of a policy over its episodes."""
    return {key: float(np.mean([row[key] for row in episodes])) for key in SHOWN}


def _estimate(trainings: Mapping[int, Mapping[str, Any]], key: str, episodes: int) -> dict[str, Any]:
    """Mean over trainings with its 95 % interval; None where there is one training."""
    values = _column(trainings, key)
    low, high = within(student_ends(values), metric_named(key).bounds)
    if key in RATES and values.size > 1 and np.ptp(values) == 0.0:
        pooled = np.arange(episodes) < round(float(values[0]) * episodes)
        found = estimate(pooled.astype(np.float64), rate=True)
        low, high = found.low, found.high
    return {"mean": float(values.mean()), "low": low, "high": high, "n": int(values.size)}


def _column(trainings: Mapping[int, Mapping[str, Any]], key: str) -> Array:
    return np.array([trainings[seed][key] for seed in sorted(trainings)])


def _differences(ours: Mapping[int, Mapping[str, Any]], theirs: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """Differences of each metric over common seeds; ``p`` of no difference."""
    both, out = sorted(ours.keys() & theirs.keys()), {}
    for key in SHOWN:
        gap = np.array([ours[seed][key] - theirs[seed][key] for seed in both])
        low, high = student_ends(gap)
        out[key] = {"difference": float(gap.mean()) if both else None, "low": low, "high": high, "n": len(both),
                    "p": student_p(gap) if gap.size > 1 else None}  # fmt: skip
    return out


def adjust(
    places: Sequence[Mapping[str, Any]], kept: Sequence[Mapping[str, Any]], families: Mapping[str, str]
) -> dict[str, int]:
    """Write ``p_holm`` beside each ``p`` of the PRIMARY metrics and of the limit; returns the numbers of tests.

    Tests of arms of a family are adjusted together, for all places and metrics.
    """
    tests: dict[str, list[Any]] = {}
    for place in places:
        for arm, found in place["arms"].items():
            of = tests.setdefault(families[arm], [])
            of += [less[key] for less in found["less"].values() for key in PRIMARY if less[key]["p"] is not None]
    for row in kept:
        if row["n"]:
            tests.setdefault(families[row["arm"]], []).append(row)
    for of in tests.values():
        for test, p in zip(of, holm([test["p"] for test in of]), strict=True):
            test["p_holm"] = p
    return {family: len(of) for family, of in tests.items()}


def spread(estimate: Mapping[str, Any]) -> str:
    """A mean with its interval as text."""
    low, high = estimate["low"], estimate["high"]
    return f"{estimate['mean']:.3g}" + ("" if low is None else f" [{low:.3g}, {high:.3g}]")


def tested(found: Mapping[str, Any]) -> str:
    """A difference with its interval and adjusted p as text; "" without common seeds."""
    if found["difference"] is None:
        return ""
    p = found.get("p_holm")
    return spread({**found, "mean": found["difference"]}) + ("" if p is None else f", p {p:.2g}")
