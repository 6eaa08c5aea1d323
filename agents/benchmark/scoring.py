"""The outcome of an episode, from its rows or from its statistics in the engine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.outcome import LEVEL_MAX_M, MANOEUVRE_S, TTA_S, Outcome, Place, Task
from lanebound.envs.config import EnvConfig
from lanebound.envs.costs import CAUSES
from lanebound.envs.info import FAULT_INFO
from lanebound.integrity.assessment.record import alert_delays
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.fault_registry import fault_kinds

__all__ = ["UNNAMED", "alert_figures", "fault_figures", "outcome_of", "outcome_of_statistics"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Row = Mapping[str, Any]
ROUNDING_S = 1e-9  # times are sums of steps
ENDINGS = (("crashed", "collision"), ("off_road", "off road"), ("wrong_way", "wrong way"))
UNNAMED = Task(Place("", "", ""), "", 0)


def outcome_of(
    rows: Sequence[Row], allotted_s: float, task: Task = UNNAMED, config: EnvConfig | None = None, **more: Any
) -> Outcome:
    """The outcome of an episode.

    Parameters
    ----------
    rows : of one episode, its start first; empty where the agent failed before
    allotted_s : longest time of the episode [s]
    task : names of the outcome
    config : of the environment, for the limits of costs; None: without limits
    more : further attributes of the outcome
    """
    figures = {"allotted_s": allotted_s, **_totals(rows), **_figures(rows, allotted_s)} if rows else {}
    if config is not None:
        figures |= _limits(config, figures.get("costs", {}))
    made = Outcome(*task.place, task.agent, task.seed, **{"allotted_s": allotted_s, **figures, **more})
    return Outcome.from_dict(made.to_dict())


def outcome_of_statistics(
    info: Mapping[str, Any], statistics: Mapping[str, Any], task: Task, config: EnvConfig, **more: Any
) -> Outcome:
    """The outcome of an episode without rows; the way is the mean true speed times the time.

    Parameters
    ----------
    info : of the last step
    statistics : sums and means over the episode, as ``episode_integrity`` in ``info``
    config : of the environment, for the limits of costs
    more : further attributes: ``time_s``, ``allotted_s``
    """
    costs = {cause: statistics[cause] for cause in CAUSES}
    success, time_s = bool(info["is_success"]), more["time_s"]
    taken_s = time_s if success else max(more["allotted_s"], time_s)
    return Outcome(
        *task.place,
        task.agent,
        task.seed,
        steps=statistics["length"],
        mean_speed_mps=statistics["speed_mean_mps"],
        throughput_mps=statistics["speed_mean_mps"] * time_s / taken_s,
        total_return=statistics["return"],
        cost=statistics["cost"],
        costs=costs,
        success=success,
        collision=bool(info["crashed"]),
        lane_departure=statistics["cost_lane"] > 0.0,
        mode_shares=dict(statistics["mode_shares"]),
        availability=statistics["availability"],
        alert_share=statistics["alert_share"],
        alerts=statistics["alerts"],
        mi_steps=statistics["mi_steps"],
        hmi_steps=statistics["hmi_steps"],
        **{**_limits(config, costs), **more},
    )


def _limits(config: EnvConfig, costs: Mapping[str, float]) -> dict[str, Any]:
    """Limits of costs, and the weighted sums of the groups that have one; ``costs``: unweighted sums by cause."""
    limits = config.cost_limits.given
    groups = {group: config.cost.of_group(group, costs) for group in limits}
    return {"cost_limit": config.cost_limit, "cost_limits": limits, "group_costs": groups}


def _totals(rows: Sequence[Row]) -> dict[str, Any]:
    """Length, end, sums and shares of the steps; the start row counts in the sums only."""
    last, driven = rows[-1], rows[1:] or rows

    def total(name: str) -> float:
        return float(sum(row[name] for row in rows))

    counts = Counter(row["mode"] for row in driven)
    return {
        "steps": last["step"],
        "time_s": last["time_s"],
        "ended": _ending(last),
        "total_return": total("reward"),
        "cost": total("cost"),
        "costs": {cause: total(cause) for cause in CAUSES},
        "success": bool(last["is_success"]),
        "collision": bool(last["crashed"]),
        "mode_shares": {mode: count / len(driven) for mode, count in counts.most_common()},
        "availability": float(_flags(driven, "available").mean()),
        "alert_share": float(_flags(driven, "alert").mean()),
        "mi_steps": int(_flags(driven, "mi").sum()),
        "hmi_steps": int(_flags(driven, "hmi").sum()),
    }


def _ending(row: Row) -> str:
    """The end of an episode, from its last row."""
    ended = next((word for key, word in ENDINGS if row[key]), None)
    return ended or ("time up" if row["truncated"] else "arrived" if row["terminated"] else "stopped")


def _figures(rows: Sequence[Row], allotted_s: float) -> dict[str, Any]:
    """Motion, integrity and alerts of an episode with at least one decision; else None for shares of steps."""
    if len(rows) < 2:
        return {"availability": None, "alert_share": None, "mode_shares": {}}
    way_m, time_s = _way_m(rows), rows[-1]["time_s"]
    taken_s = time_s if rows[-1]["is_success"] else max(allotted_s, time_s)
    return {
        "distance_m": way_m,
        "mean_speed_mps": float(_column(rows, "speed_mps")[1:].mean()),
        "throughput_mps": way_m / taken_s,
        "gap_m": _median(_column(rows, "gap_m")),
        "lane_departure": bool((_column(rows, "cost_lane") > 0.0).any()),
        **_comfort(rows),
        **_integrity(rows[1:]),
        **alert_figures(rows),
        "first_fix_s": _first_fix_s(rows),
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
    """Levels, errors and continuity, without the start row."""
    found: dict[str, Any] = {}
    missing = np.zeros(len(rows), dtype=np.bool_)
    for axis in ("at", "ct"):
        level, error = _column(rows, f"pl_{axis}_m"), np.abs(_column(rows, f"err_{axis}_m"))
        missing |= ~np.isfinite(level)
        found |= {
            f"pl_{axis}_median_m": float(np.quantile(np.minimum(level, LEVEL_MAX_M), 0.5, method="higher")),
            f"pe_{axis}_median_m": float(np.median(error)),
            f"pe_{axis}_p75_m": float(np.percentile(error, 75.0)),
            f"pe_{axis}_p95_m": float(np.percentile(error, 95.0)),
            f"pe_{axis}_max_m": float(error.max()),
        }
    available = _flags(rows, "available")
    pairs = available[:-1]
    return {
        **found,
        "no_level": float(missing.mean()),
        "continuity": float(available[1:][pairs].mean()) if pairs.any() else 0.0,
    }


def fault_figures(rows: Sequence[Row], info: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of an outcome that tell of the one fault of its episode; none without one.

    Parameters
    ----------
    rows : of the episode, its start first, with ``time_s`` and ``alert``
    info : of any step
    """
    if FAULT_INFO.keys() - info.keys():
        return {}
    onset_s, alert, time_s = info["fault_onset_s"], _flags(rows, "alert"), _column(rows, "time_s")
    begun = time_s[1:][alert[1:] & ~alert[:-1] & (time_s[1:] > onset_s)]
    kind = fault_kinds()[int(info["fault_kind"])].name
    return {
        **{name: float(info[name]) for name in FAULT_INFO},
        "fault_kind": kind,
        "fault_alert_s": float(begun[0] - onset_s) if begun.size else None,
    }


def alert_figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Alerts, and errors above their limits with late or missing alerts.

    Parameters
    ----------
    rows : of an episode, its start first: ``time_s``, ``alert``, errors and alert limits
    """
    time_s, alert = _column(rows, "time_s"), _flags(rows, "alert")[1:]
    onset_s, last_s, over_s = _failures(rows[1:], time_s)
    delay_s = alert_delays(time_s[1:], alert, onset_s, last_s)
    missed = np.isinf(delay_s)
    delay_s[missed] = (over_s - onset_s)[missed]
    return {
        "alerts": int(alert[0]) + int((alert[1:] & ~alert[:-1]).sum()),
        "time_to_alert_s": float(delay_s.mean()) if delay_s.size else None,
        "time_to_alert_max_s": float(delay_s.max()) if delay_s.size else None,
        "missed_alerts": int(missed.sum()),
        "integrity_failures": int((delay_s > TTA_S + ROUNDING_S).sum()),
        "manoeuvre_continuity": _manoeuvre_continuity(time_s[1:], alert),
    }


def _manoeuvre_continuity(time_s: Array, alert: Bools) -> float | None:
    """Of all steps without an alert, so long before the end, the share after which none comes for MANOEUVRE_S.

    It is the probability of S3 II.A that the performance is maintained for the duration of a phase of operation, given
    that it was available at its beginning, over manoeuvres that begin at any moment.
    """
    ends = np.searchsorted(time_s, time_s + MANOEUVRE_S - ROUNDING_S)  # first step at the end of the manoeuvre or later
    begun = np.flatnonzero(~alert & (ends < time_s.size))
    if not begun.size:
        return None
    before = np.append(0, np.cumsum(alert))  # number of steps with an alert before each
    return float((before[ends[begun] + 1] == before[begun]).mean())


def _first_fix_s(rows: Sequence[Row]) -> float:
    """Time of the first row with a position by satellites; without one, that of the last: as long at least."""
    fixes = {mode.key for mode in Mode if mode.is_service or mode in (Mode.RTK, Mode.CODE)}
    return float(next((row["time_s"] for row in rows if row["mode"] in fixes), rows[-1]["time_s"]))


def _failures(rows: Sequence[Row], time_s: Array) -> tuple[Array, Array, Array]:
    """Begin, last step and end of errors above their limits on either axis [s].

    An error at the end of the episode ends one step later: an error without an alert lasts longer than one with.
    """
    over = np.zeros(len(rows), dtype=np.bool_)
    for axis in ("at", "ct"):
        over |= np.abs(_column(rows, f"err_{axis}_m")) > _column(rows, f"al_{axis}_m")
    edges = np.diff(over.astype(np.int8), prepend=0, append=0)
    times = np.append(time_s[1:], 2.0 * time_s[-1] - time_s[-2])
    last = np.flatnonzero(edges == -1)
    return times[edges == 1], times[last - 1], times[last]
