"""From the rows of an episode to its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.outcome import LEVEL_MAX_M
from lanebound.agents.episodes.summary import summarise
from lanebound.integrity.assessment.events import alert_delays

__all__ = ["figures"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Row = Mapping[str, Any]


def figures(rows: Sequence[Row], allotted_s: float) -> dict[str, Any]:
    """The figures of an :class:`~lanebound.agents.benchmark.outcome.Outcome` that follow from the rows.

    Parameters
    ----------
    rows : of one episode, its start first
    allotted_s : the time there was
    """
    summary = summarise(rows).to_dict()
    del summary["seed"]
    if len(rows) < 2:
        return {**summary, "allotted_s": allotted_s, "availability": None, "alert_share": None, "mode_shares": {}}
    way_m = _way_m(rows)
    taken_s = summary["time_s"] if summary["success"] else max(allotted_s, summary["time_s"])
    return {
        **summary,
        "allotted_s": allotted_s,
        "distance_m": way_m,
        "mean_speed_mps": float(_column(rows, "speed_mps")[1:].mean()),
        "throughput_mps": way_m / taken_s,
        "gap_m": _median(_column(rows, "gap_m")),
        "lane_departure": bool((_column(rows, "cost_lane") > 0.0).any()),
        **_comfort(rows),
        **_integrity(rows[1:]),
        **_alerts(rows),
    }


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([row[name] for row in rows], dtype=np.float64)


def _flags(rows: Sequence[Row], name: str) -> Bools:
    return np.array([row[name] for row in rows], dtype=np.bool_)


def _way_m(rows: Sequence[Row]) -> float:
    return float(np.hypot(np.diff(_column(rows, "true_x_m")), np.diff(_column(rows, "true_y_m"))).sum())


def _median(values: Array) -> float | None:
    """Median of the finite values; None where there are none."""
    there = values[np.isfinite(values)]
    return float(np.median(there)) if there.size else None


def _comfort(rows: Sequence[Row]) -> dict[str, Any]:
    """Root mean squares of the true car's motion, differences from one decision to the next."""
    dt_s = np.diff(_column(rows, "time_s"))
    speed, heading = _column(rows, "speed_mps"), np.unwrap(_column(rows, "true_heading_rad"))
    along = np.diff(speed) / dt_s
    across = speed[1:] * np.diff(heading) / dt_s
    return {
        "rms_acceleration_mps2": _rms(along),
        "rms_jerk_mps3": _rms(np.diff(along) / dt_s[1:]),
        "rms_lateral_mps2": _rms(across),
    }


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _integrity(rows: Sequence[Row]) -> dict[str, Any]:
    """Levels, errors, alerts and availability; the start, before any decision, does not count."""
    found: dict[str, Any] = {}
    missing = np.zeros(len(rows), dtype=np.bool_)
    for axis in ("at", "ct"):
        level, error = _column(rows, f"pl_{axis}_m"), np.abs(_column(rows, f"err_{axis}_m"))
        missing |= ~np.isfinite(level)
        found |= {
            f"pl_{axis}_median_m": float(np.quantile(np.minimum(level, LEVEL_MAX_M), 0.5, method="higher")),
            f"pe_{axis}_median_m": float(np.median(error)),
            f"pe_{axis}_max_m": float(error.max()),
        }
    available = _flags(rows, "available")
    pairs = available[:-1]
    return {
        **found,
        "no_level": float(missing.mean()),
        "continuity": float(available[1:][pairs].mean()) if pairs.any() else 0.0,
    }


def _alerts(rows: Sequence[Row]) -> dict[str, Any]:
    """Alerts, and the errors above their limits that had none, or waited for it."""
    time_s, alert = _column(rows, "time_s"), _flags(rows, "alert")[1:]
    onset_s, last_s, over_s = _failures(rows[1:], time_s)
    delay_s = alert_delays(time_s[1:], alert, onset_s, last_s)
    missed = np.isinf(delay_s)
    delay_s[missed] = (over_s - onset_s)[missed]
    return {
        "alerts": int(alert[0]) + int((alert[1:] & ~alert[:-1]).sum()),
        "time_to_alert_s": float(delay_s.mean()) if delay_s.size else None,
        "missed_alerts": int(missed.sum()),
    }


def _failures(rows: Sequence[Row], time_s: Array) -> tuple[Array, Array, Array]:
    """When an error on either axis came to exceed its limit, did so for the last time, and was over.

    An error that is there at the end is over one step later; so what has no alert waits longer than what has one.
    """
    over = np.zeros(len(rows), dtype=np.bool_)
    for axis in ("at", "ct"):
        over |= np.abs(_column(rows, f"err_{axis}_m")) > _column(rows, f"al_{axis}_m")
    edges = np.diff(over.astype(np.int8), prepend=0, append=0)
    times = np.append(time_s[1:], 2.0 * time_s[-1] - time_s[-2])
    last = np.flatnonzero(edges == -1)
    return times[edges == 1], times[last - 1], times[last]
