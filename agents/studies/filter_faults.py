"""Faults that S4's gate is for: positions rejected, and errors with the gate and without it.

Vehicles drive a loop of city streets under an open sky, with the equipment of S4's trials. Each meets the fault from
another side. All filters see the same measurements. What counts is each position that was due while the fault lasted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.agents.studies.fault_response import LOOP_M
from lanebound.agents.studies.filter_scenarios import AXLE_M, EQUIPMENT
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.navigators.vehicle_filter.navigator import FilterNavigator
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["FAULTS", "FILTERS", "fault_rows", "work_fault"]

Array = NDArray[np.float64]
RISK = 1e-3  # of the level whose exceedance is counted
WARM_UP_S, FAULT_S, AFTER_S = 30.0, 20.0, 30.0
FILTERS: Mapping[str, Mapping[str, Any]] = {
    "gate": {},
    "no gate": {"gate": {"enabled": False}},
    "no gate, no memory": {"gate": {"enabled": False}, "position": {"excess_tau_s": 0.0}},
}
"""The default, without the gate, and without the memory of innovations either, which is a gate of its own."""
FAULTS: Mapping[str, Mapping[str, Any] | None] = {
    "none": None,
    "nlos_burst, 20 m, 4 satellites": {"kind": "nlos_burst", "magnitude_m": 20.0},
    "nlos_burst, 60 m, 4 satellites": {"kind": "nlos_burst", "magnitude_m": 60.0},
    "spoofing, step of 5 m": {"kind": "spoofing", "magnitude_m": 5.0},
    "spoofing, step of 25 m": {"kind": "spoofing", "magnitude_m": 25.0},
    "spoofing, 2 m/s to 20 m": {"kind": "spoofing", "magnitude_m": 20.0, "profile": "ramp", "ramp_s": 10.0},
    "spoofing, 0.5 m/s to 10 m": {"kind": "spoofing", "magnitude_m": 10.0, "profile": "ramp", "ramp_s": 20.0},
}
"""Faults by name, as configurations of :class:`~lanebound.integrity.sensors.faults.Fault`."""


@dataclass
class _Kept:
    """Of one filter: largest error of each vehicle; positions rejected and used during the fault and after it;
    epochs beyond the level, along or across, and beyond the trust level, from the onset on."""

    worst_m: Array
    positions: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 2), np.int64))
    beyond: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, np.int64))


def work_fault(name: str, vehicles: int, first_seed: int, advance: Advance = ignore) -> dict[str, Any]:
    """All vehicles through one fault, with each filter."""
    seeds = list(range(first_seed, first_seed + vehicles))
    navigators = {key: _navigator(change, FAULTS[name], seeds) for key, change in FILTERS.items()}
    first = next(iter(navigators.values()))
    road = Road.through(np.array(LOOP_M), corner_radius_m=25.0, closed=True, lane_count=2, lane_width_m=3.25)
    car, traffic, dt = CityDrive(road, DriveConfig(), first.config.dt_s, AXLE_M), Streams(seeds), first.config.dt_s
    state = car.start(traffic, spread_m=road.length_m)
    for navigator in navigators.values():
        navigator.place(state.position_m.copy(), state.heading_rad.copy(), 1.0, np.deg2rad(1.0))
    kept = {key: _Kept(np.zeros(vehicles)) for key in navigators}
    excluded, epochs = 0, round((WARM_UP_S + FAULT_S + AFTER_S) / dt)
    for k in range(epochs):
        truth, time_s = car.step(state, traffic), dt * (k + 1)
        m = first.measure(truth)
        lasts = WARM_UP_S < time_s <= WARM_UP_S + FAULT_S + 0.5 * dt
        for key, navigator in navigators.items():
            solution = navigator.locate(m)
            if time_s > WARM_UP_S:
                _count(kept[key], navigator, solution, truth, lasts)
        excluded += int((solution.excluded > 0).sum()) if lasts else 0
        advance((k + 1) / epochs)
    after = round((FAULT_S + AFTER_S) / dt) * vehicles
    return {
        "vehicles": vehicles,
        "codes_excluded": excluded / (round(FAULT_S / dt) * vehicles),
        "filters": {key: _summed(found, after) for key, found in kept.items()},
    }


def _navigator(change: Mapping[str, Any], fault: Mapping[str, Any] | None, seeds: list[int]) -> FilterNavigator:
    """The navigator of one filter, with the fault of each vehicle."""
    data = deep_merge(deep_merge({"kind": "filter", "more_levels": [{"integrity_risk": RISK}]}, EQUIPMENT), change)
    config = NavigatorConfig.load(data)
    faults = [] if fault is None else [
        Fault.load({"start_s": WARM_UP_S, "duration_s": FAULT_S, "vehicle": row, "azimuth_deg": 67.0 * row % 360.0}
                   | dict(fault)) for row in range(len(seeds))
    ]  # fmt: skip
    track = SkyTrack.from_config(config.sky, WARM_UP_S + FAULT_S + AFTER_S + 20.0)
    navigator = Navigator(config, track, SkyMask.open(), seeds, faults=FaultSchedule(faults))
    assert isinstance(navigator, FilterNavigator)
    return navigator


def _count(kept: _Kept, navigator: FilterNavigator, solution: Solution, truth: Truth, lasts: bool) -> None:
    """Add an epoch from the onset on."""
    report = navigator.report
    assert report is not None
    away = solution.position_en_m - truth.position_enu_m[:, :2]
    off = np.linalg.norm(away, axis=-1)
    along = np.abs(np.einsum("bij,bj->bi", track_from_enu_matrix(truth.heading_rad), away))
    kept.worst_m = np.maximum(kept.worst_m, off)
    kept.positions[0 if lasts else 1] += [int(report.gnss_rejected.sum()), int(report.gnss_used.sum())]
    kept.beyond += [int((along > solution.pl_cases_m[:, 1]).any(-1).sum()), int((off > report.htl_m).sum())]


def _summed(kept: _Kept, epochs: int) -> dict[str, Any]:
    """Plain figures; largest errors as 5 %, median, 95 % and largest of the vehicles."""
    during, later = (rejected / max(rejected + used, 1) for rejected, used in kept.positions.tolist())
    return {
        "positions": int(kept.positions[0].sum()),
        "rejected": during,
        "rejected_after": later,
        "worst_m": [float(q) for q in np.quantile(kept.worst_m, [0.05, 0.5, 0.95, 1.0])],
        "beyond_level": int(kept.beyond[0]) / epochs,
        "beyond_trust": int(kept.beyond[1]) / epochs,
    }


def fault_rows(result: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """A row for each fault and filter."""
    heads = (
        "fault", "filter", "codes excluded", "rejected", "after", "largest [m]", "5 .. 95 %; most",
        f"> PL at {RISK:g}", "> HTL",
    )  # fmt: skip
    rows: list[tuple[str, ...]] = []
    for name, found in result["faults"].items():
        for key, f in found["filters"].items():
            low, middle, high, most = (f"{v:.1f}" for v in f["worst_m"])
            first = key == next(iter(found["filters"]))
            rows.append((
                name if first else "", key, f"{100 * found['codes_excluded']:.0f} % of epochs" if first else "",
                f"{100 * f['rejected']:.1f} % of {f['positions']}", f"{100 * f['rejected_after']:.1f} %", middle,
                f"{low} .. {high}; {most}", f"{100 * f['beyond_level']:.2g} %", f"{100 * f['beyond_trust']:.2g} %",
            ))  # fmt: skip
    return heads, rows
