"""Summary of the bounding study: rates with intervals, failures of the published forms, rare risks.

The epochs of a geometry share its biases and its level, so that the spread between geometries limits the accuracy of a
rate: intervals are the exact ones of the count, widened where that spread is larger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.bounding import clopper_pearson
from lanebound.integrity.assessment.exceedance import STRATA
from lanebound.integrity.assessment.importance import DRAWN, mean_and_deviation
from lanebound.integrity.assessment.measurement_model import Form
from lanebound.integrity.monitoring.risk import upper_quantile

__all__ = ["PLACES", "rate_of", "rate_over", "summarise"]

Array = NDArray[np.float64]
Row = Mapping[str, Any]

CONFIDENCE = 0.95
AXES = ("along", "across", "either")
SIGMAS = 3.0  # of an importance estimate, beyond which it disagrees


def _octant(row: Row) -> str:
    """The heading: along East or North, or between them."""
    away = abs((float(row["heading_deg"]) + 45.0) % 90.0 - 45.0)
    return "heading within 22.5 deg of an axis" if away < 22.5 else "heading between the axes"


def _size(row: Row) -> str:
    """The class of the number of satellites."""
    n = int(row["satellites"])
    return "up to 15 satellites" if n <= 15 else "16 to 25 satellites" if n <= 25 else "26 satellites and more"


PLACES: dict[str, Callable[[Row], str]] = {
    "all": lambda row: "all",
    "bias": lambda row: f"biases up to {row['bias_share']:g} sigma",
    "size": _size,
    "heading": _octant,
    "worst": lambda row: f"biases worst {row['worst']}",
}
"""Groupings of cases: functions from a case to the name of its group."""


def rate_of(events: int, trials: int) -> dict[str, Any]:
    """A rate with its exact interval; None without trials."""
    if trials == 0:
        return {"events": events, "trials": 0, "rate": None, "low": None, "high": None}
    low, high = clopper_pearson(events, trials, CONFIDENCE)
    return {"events": events, "trials": trials, "rate": events / trials, "low": low, "high": high}


def rate_over(events: Array, trials: Array, strata: Array | None = None) -> dict[str, Any]:
    """The rate of several cases together; its interval includes the spread between them.

    events, trials (cases,) counts; strata (cases,) values that are taken in turn: the spread is that within each (a
    stratified ratio).
    """
    found = rate_of(int(events.sum()), int(trials.sum()))
    if found["rate"] is None:
        return found
    variance, groups = 0.0, np.zeros(len(events)) if strata is None else strata
    for one in np.unique(groups):
        c, n = events[groups == one], trials[groups == one]
        if len(c) > 1 and n.any():
            variance += len(c) * float(np.var(c - c.sum() / n.sum() * n, ddof=1))
    half = float(upper_quantile(0.5 * (1.0 - CONFIDENCE))) * variance**0.5 / found["trials"]
    low, high = min(found["low"], found["rate"] - half), max(found["high"], found["rate"] + half)
    return found | {"low": max(low, 0.0), "high": min(high, 1.0)}


def summarise(config: Mapping[str, Any], parts: Mapping[str, Row]) -> dict[str, Any]:
    """The summary as plain data."""

    def rows(kind: str, key: str) -> list[Row]:
        return [row for name, part in parts.items() if name.startswith(kind) for row in part[key]]

    cases, rare, outages = rows("cases-", "cases"), rows("rare-", "cases"), rows("drift-", "outages")
    risks = list(config["risks"])
    result: dict[str, Any] = {"config": dict(config), "confidence": CONFIDENCE, "strata": list(STRATA)}
    if cases:
        epochs = np.sum([row["epochs"] for row in cases], 0)
        result["epochs"] = {name: int(n) for name, n in zip(STRATA, epochs, strict=True)}
        result["alarms"] = _alarms(cases)
        result["alarms_by_bias"] = {
            place: _alarms(group)[STRATA[0]] for place, group in _grouped(cases, PLACES["bias"]).items()
        }
        result["axis_epochs"] = 2 * int(epochs.sum())
        result["rates"] = {
            kind: {place: _rates(group, risks) for place, group in _grouped(cases, name_of).items()}
            for kind, name_of in PLACES.items()
        }
        result["level_over"] = _tightness(cases, risks)
    if rare:
        result["rare"] = _rare(rare, config)
    if outages:
        result["drift"] = _drift(outages, risks)
    return result


def _grouped(rows: Iterable[Row], name_of: Callable[[Row], str]) -> dict[str, list[Row]]:
    out: dict[str, list[Row]] = {}
    for row in rows:
        out.setdefault(name_of(row), []).append(row)
    return dict(sorted(out.items()))


def _alarms(cases: Sequence[Row]) -> dict[str, Any]:
    """Rates of alarms of the test by stratum."""
    alarms, epochs = (np.array([row[name] for row in cases]) for name in ("alarms", "epochs"))
    bias = np.array([row["bias_share"] for row in cases])
    return {name: rate_over(alarms[:, s], epochs[:, s], bias) for s, name in enumerate(STRATA)}


def _rates(cases: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """By form and risk: rates along, across and on either axis, and counts by stratum."""
    out: dict[str, Any] = {}
    bias = np.array([row["bias_share"] for row in cases])
    for form in Form:
        count = np.array([row["misleading"][form.name] for row in cases])
        trials = np.array([row["available"][form.name] for row in cases])
        out[form.value] = {
            f"{risk:g}": {axis: rate_over(count[:, r, a].sum(-1), trials[:, r], bias) for a, axis in enumerate(AXES)}
            | {"by_stratum": {name: int(n) for name, n in zip(STRATA, count[:, r, 2].sum(0), strict=True)}}
            for r, risk in enumerate(risks)
        }
    return out


def _tightness(cases: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """Ratios of each form's level to the exact root's, and to the least sufficient level without faults."""
    root = np.array([row["level_m"][Form.ROOT.name] for row in cases], dtype=np.float64)
    least = np.array([row["least_m"] for row in cases], dtype=np.float64)
    out: dict[str, Any] = {}
    for form in Form:
        level = np.array([row["level_m"][form.name] for row in cases], dtype=np.float64)
        out[form.value] = {
            f"{risk:g}": {"root": _spread(level[:, r] / root[:, r]), "least": _spread(level[:, r] / least[:, r])}
            for r, risk in enumerate(risks)
        }
    return out


def _spread(ratio: Array) -> dict[str, float] | None:
    """Smallest, median and largest of the finite ones."""
    known = ratio[np.isfinite(ratio)]
    if not known.size:
        return None
    return {"smallest": float(known.min()), "median": float(np.median(known)), "largest": float(known.max())}


def _rare(rare: Sequence[Row], config: Mapping[str, Any]) -> dict[str, Any]:
    """Importance estimates at the rare risk and at the least counted one, all geometries together and by biases.

    Two faults at once and wrong fixes are not drawn: ``spent`` is an upper bound of their probability, which levels
    subtract from their budget, in the mean and of the geometry with the largest.
    """
    spent = [case["spent"] for case in rare]
    out: dict[str, Any] = {"spent": {"mean": float(np.mean(spent)), "largest": max(spent)}}
    for row, risk in enumerate((config["rare_risk"], min(config["risks"]))):
        out[f"{risk:g}"] = {}
        for form in (Form.ROOT, Form.CLOSED, Form.PUBLISHED):
            known = [case for case in rare if len(case["rates"][form.name]) > row]
            if known:
                by_bias = _grouped(known, PLACES["bias"]).items()
                out[f"{risk:g}"][form.value] = _estimate(known, form, row) | {
                    "by_bias": {place: _estimate(group, form, row) for place, group in by_bias}
                }
    return out


def _estimate(cases: Sequence[Row], form: Form, row: int) -> dict[str, Any]:
    """Mean rate of some geometries along and across, the part of each stratum, and the standard deviations.

    ``spread`` is the standard deviation of the mean from the spread between geometries, ``draws`` that of the draws
    alone. ``exact`` are closed forms: without the test, which bounds the stratum without a fault; and with one fault of
    either law of sizes, tested by the separation of its own satellite alone, which bounds that one. ``spent`` is
    the probability of what is not drawn.
    """
    found = [case["rates"][form.name][row] for case in cases]
    strata, variances = ([np.array(of) for of in each] for each in zip(*found, strict=True))
    mean, spread, draws = mean_and_deviation([of.sum(0) for of in strata], [of.sum(0) for of in variances])
    parts = np.mean(strata, 0)
    out: dict[str, Any] = {
        axis: {"rate": float(mean[a]), "spread": float(spread[a]), "draws": float(draws[a])}
        | {"by_stratum": {name: float(parts[s, a]) for s, name in enumerate(DRAWN)}}
        for a, axis in enumerate(AXES[:2])
    }
    if form.name in cases[0]["exact"]:
        closed = [case["exact"][form.name] for case in cases]
        out["exact"] = {name: np.mean([one[name][row] for one in closed], 0).tolist() for name in closed[0]}
    undrawn = float(np.mean([case["spent"] for case in cases]))
    return out | {"geometries": len(cases), "spent": undrawn, "upper": float((mean + SIGMAS * spread).max())}


def _drift(outages: Sequence[Row], risks: Sequence[float]) -> dict[str, Any]:
    """By source and variant: how often the level at the end of an outage is exceeded, and the worst outage."""
    out: dict[str, Any] = {}
    for source, group in _grouped(outages, lambda row: str(row["source"])).items():
        trials = np.array([row["vehicles"] for row in group])
        out[source] = {
            variant: {
                f"{risk:g}": {
                    axis: rate_over(np.array([row["exceeded"][variant][r][a] for row in group]), trials)
                    for a, axis in enumerate(AXES)
                }
                for r, risk in enumerate(risks)
            }
            for variant in group[0]["exceeded"]
        }
    return out
