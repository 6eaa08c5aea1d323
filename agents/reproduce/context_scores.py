"""Figures of the drives of the context study: what monitors found at every point, and counts against the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance
from lanebound.agents.reproduce.context_drive import ContextDrive, ContextPoint
from lanebound.integrity.assessment.charging_rates import charging_counts
from lanebound.integrity.assessment.warning_rates import WarningCounts, sweep_thresholds
from lanebound.integrity.monitoring.context.code_fix import CodeFix
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextReason, ContextVerdict
from lanebound.integrity.monitoring.context.position_phase import check_position
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedPhase, SpeedTest
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

if TYPE_CHECKING:
    from lanebound.agents.reproduce.context_study import ContextStudyConfig

__all__ = ["ASSUMED", "Judge", "MonitorSeries", "drive_figures", "warned_by"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

THRESHOLDS = np.arange(0.0, 101.0)
ASSUMED = "assumed"
Judge = tuple[str, str]
"""A map and a matcher; or ASSUMED and the name of an assumption."""
PHASES = ("position", "speed", "map")


class MonitorSeries:
    """What all monitors found at all points: arrays (T, B)."""

    def __init__(self) -> None:
        self.point: dict[str, list[NDArray[Any]]] = {}
        self.found: dict[Judge, dict[str, list[NDArray[Any]]]] = {}

    @classmethod
    def of(
        cls,
        drive: ContextDrive,
        points: int,
        monitors: Mapping[Judge, ContextMonitor],
        others: Mapping[str, ContextMonitor],
        config: ContextConfig,
        advance: Advance,
    ) -> MonitorSeries:
        """Drive, and let every monitor judge every point."""
        out, batch = cls(), next(iter(monitors.values())).speed.memory["count"].size
        phases = {form: SpeedPhase(config.speed.replace(form=form), batch) for form in SpeedForm}
        for k, p in enumerate(drive.points):
            position = check_position(p.fix.codes, config.position, p.fix.hdop)
            tests = {form: _speed_test(phase, p) for form, phase in phases.items()}
            speed = tests[config.speed.form]
            _add(out.point, _of_point(p, tests))
            for key, monitor in monitors.items():
                verdict = monitor.step(p.fix, p.wheel_mps, position, speed)
                _add(out.found.setdefault(key, {}), _of_verdict(verdict, p.fix, p))
            for name, monitor in others.items():
                verdict = monitor.step(p.others[name], p.wheel_mps)
                _add(out.found.setdefault((ASSUMED, name), {}), _of_verdict(verdict, p.others[name], p))
            advance((k + 1) / points)
        return out

    def of_points(self, name: str, b: int) -> NDArray[Any]:
        """A quantity of the points of drive ``b``, (T,)."""
        return np.array([row[b] for row in self.point[name]])

    def of_found(self, key: Judge, name: str, b: int) -> NDArray[Any]:
        """What a monitor found, of drive ``b``, (T,)."""
        return np.array([row[b] for row in self.found[key][name]])


def _add(to: dict[str, list[NDArray[Any]]], values: Mapping[str, NDArray[Any]]) -> None:
    for name, value in values.items():
        to.setdefault(name, []).append(value)


def _speed_test(phase: SpeedPhase, p: ContextPoint) -> SpeedTest:
    return phase.step(p.fix.velocity_en_mps, p.fix.velocity_covariance, p.wheel_mps, p.fix.has_velocity)


def _of_point(p: ContextPoint, tests: Mapping[SpeedForm, SpeedTest]) -> dict[str, NDArray[Any]]:
    first = tests[SpeedForm.WHEEL]
    return {
        "driving": p.driving, "speed": p.speed_mps, "known": first.known, "average": first.average_mps,
        "true": p.true_link[:, 0], **{f"speed {form}": test.consistent for form, test in tests.items()},
    }  # fmt: skip


def _of_verdict(v: ContextVerdict, fix: CodeFix, p: ContextPoint) -> dict[str, NDArray[Any]]:
    error = np.linalg.norm(fix.position_en_m - p.position_en_m, axis=-1)
    return {
        "warn": v.warn, "reason": v.reason, "phases": v.phases, "link": v.link,
        "right": (v.link[:, None] == p.true_link).any(-1), "probability": v.match.probability,
        "error": np.where(fix.located, error, np.inf), "level": v.position.level_m,
        "available": v.position.available, "consistent": v.position.consistent,
        "in motion": ~v.speed.at_rest, "has velocity": fix.has_velocity, "speed": v.speed.consistent,
        "map": v.map.matched & v.map.passed, "own score": v.map.score,
    }  # fmt: skip


def drive_figures(config: ContextStudyConfig, s: MonitorSeries, maps: Mapping[str, RoadMap], b: int) -> dict[str, Any]:
    """Counts of one drive, of every matcher and map."""
    driving, own = s.of_points("driving", b), next(iter(s.found))
    moving, error = s.of_found(own, "in motion", b), s.of_found(own, "error", b)
    out: dict[str, Any] = {
        "points": int(driving.sum()),
        "moving": float(moving[driving].mean()),
        "error_m": np.quantile(error[driving], [0.5, 0.95], method="lower").tolist(),
        "speed": {
            str(form): float((~s.of_points(f"speed {form}", b))[driving & moving & s.of_points("known", b)].mean())
            for form in SpeedForm
        },
        "of": {},
        "assumptions": {},
    }
    for which, kind in s.found:
        found = _judged(config, s, maps["true"], (which, kind), b)
        if which == ASSUMED:
            out["assumptions"][kind] = found
        else:
            out["of"][f"{which}, {kind}"] = found
    return out


def _judged(config: ContextStudyConfig, s: MonitorSeries, road_map: RoadMap, key: Judge, b: int) -> dict[str, Any]:
    """Counts of warnings of each rule of warning, the sweep, and what charging makes of the verdicts."""
    get, driving = partial(s.of_found, key, b=b), s.of_points("driving", b)
    wrong, level = ~get(name="right"), get(name="level")
    stages = _stages(get, driving)
    sweep = sweep_thresholds(get(name="own score"), wrong, THRESHOLDS, stages[-1][0])
    belief = sweep_thresholds(100.0 * get(name="probability"), wrong, THRESHOLDS, driving)
    charges = charging_counts(
        config.charging, road_map, link=get(name="link"), warn=get(name="warn"), speed_mps=s.of_points("average", b),
        true_link=s.of_points("true", b), driving=driving,
        true_speed_mps=_averaged(s.of_points("speed", b), config.monitor.speed.intervals),
    )  # fmt: skip
    accepted = driving & get(name="consistent") & np.isfinite(level)
    return {
        "right": float((~wrong)[driving].mean()),
        "passed": int((get(name="phases") == len(PHASES))[driving].sum()),
        "available": float(get(name="available")[driving].mean()),
        "level_m": float(np.quantile(level[driving], 0.5, method="lower")),
        "beyond": [int((get(name="error") > level)[accepted].sum()), int(accepted.sum())],
        "reasons": np.bincount(get(name="reason")[driving], minlength=len(ContextReason)).tolist(),
        "counts": {name: _counted(WarningCounts.of(warn, wrong, driving)) for name, warn in _rules(config, get)},
        "stages": [_counted(WarningCounts.of(warn, wrong, reached)) for reached, warn in stages],
        "sweep": [sweep.false_alarms.tolist(), sweep.missed.tolist(), sweep.points],
        "belief": [belief.false_alarms.tolist(), belief.missed.tolist(), belief.points],
        "charging": charges,
    }


def _stages(get: Any, driving: Bools) -> list[tuple[Bools, Bools]]:
    """Of each phase, the points (T,) that reach it and those that it warns of; at rest none reaches the second."""
    first = get(name="available") & get(name="consistent")
    second, speed = driving & first & get(name="in motion"), get(name="speed")
    return [(driving, ~first), (second, ~speed), (second & speed, ~get(name="map"))]


def _rules(config: ContextStudyConfig, get: Any) -> Iterator[tuple[str, Bools]]:
    """Rules of warning (T,): the monitor's own verdicts, those without each phase, of each alone, and naive ones."""
    rest = ~get(name="in motion")
    yield "as printed", warned_by(get, PHASES) | rest
    yield "all phases", get(name="warn")
    for left in PHASES:
        yield f"without {left}", warned_by(get, [phase for phase in PHASES if phase != left])
    for phase in PHASES:
        yield f"{phase} alone", warned_by(get, [phase])
    yield "level alone", np.asarray(get(name="level") > config.monitor.position.alert_limit_m)
    yield "never", np.zeros(rest.size, np.bool_)
    yield "always", np.ones(rest.size, np.bool_)


def warned_by(get: Any, phases: list[str] | tuple[str, ...]) -> Bools:
    """Warnings (T,) of some phases by their results: of the position at every point, of speed and map as in the last
    motion while at rest, before the first motion always, and at rest without a Doppler velocity."""
    moving, failed = get(name="in motion"), np.zeros_like(get(name="warn"))
    if "speed" in phases:
        failed = failed | ~get(name="speed")
    if "map" in phases:
        failed = failed | ~get(name="map")
    if phases != ["position"]:
        last = np.maximum.accumulate(np.where(moving, np.arange(moving.size), -1))
        failed = np.where(last >= 0, failed[np.maximum(last, 0)], True)
    if "speed" in phases:
        failed = failed | (~moving & ~get(name="has velocity"))
    if "position" in phases:
        failed = failed | ~(get(name="available") & get(name="consistent"))
    return np.asarray(failed)


def _averaged(speed_mps: Array, intervals: int) -> Array:
    """Mean over the last intervals, as the monitor averages; over fewer at the start."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (speed_mps[1:] + speed_mps[:-1]))])
    k = np.arange(speed_mps.size)
    begin = np.maximum(k - intervals, 0)
    return np.where(k > 0, (total - total[begin]) / np.maximum(k - begin, 1), speed_mps)


def _counted(c: WarningCounts) -> list[int]:
    return [c.points, c.wrong, c.false_alarms, c.missed]
