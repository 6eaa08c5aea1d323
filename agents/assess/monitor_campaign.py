"""The fault campaign of monitors: time until each one notices a fault, and for how long it misleads before it does.

Vehicles drive a street twice with the same noise, with a fault and without it, so that all differences are effects of
the fault. A monitor notices a fault in the first epoch in which it raises an alarm or has no level within the alert
limit where it does not so without the fault, or excludes more codes than without it. The time to alert runs while the
position is off by more than the alert limit and declared available.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.monitored_drives import simulated_epochs
from lanebound.agents.assess.street_drives import StreetDrivesConfig
from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.monitoring.family.kinds import MonitorKind
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.replay.code_epochs import TrackedEpochs
from lanebound.integrity.sensors.faults import Fault, FaultSchedule

__all__ = ["CampaignConfig", "alert_times", "campaign_rows", "run_campaign"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
LOWEST_RAD = np.deg2rad(25.0)  # of a satellite that fails: tracked in most streets
CASES: dict[str, Mapping[str, Any]] = {
    "step of one satellite": {"kind": "satellite_range", "magnitude_m": 50.0},
    "ramp of one satellite": {"kind": "satellite_range", "magnitude_m": 50.0, "profile": "ramp"},
    "reflections": {"kind": "nlos_burst", "magnitude_m": 60.0},
    "ramp of a system": {"kind": "constellation", "magnitude_m": 50.0, "profile": "ramp"},
}
"""Sizes at the upper end of what the kinds try; a ramp grows over the length of the fault."""


class CampaignConfig(Config):
    """Faults that monitors meet under each sky, in one street."""

    cases: tuple[str, ...] = Field((), description="of the campaign; none: no campaign; all: every one")
    onset_s: float = Field(5.0, ge=0, description="from the end of the warm-up to the fault [s]")
    length_s: float = Field(10.0, gt=0, description="length of the fault [s]")
    after_s: float = Field(5.0, ge=0, description="length of the drive after it [s]")
    every: int = Field(1, ge=1, description="every n-th epoch is used; times are multiples of it")
    alert_limit_m: float = Field(10.0, gt=0, description="alert limit of the campaign [m]; codes permit no lane")

    @property
    def chosen(self) -> list[str]:
        """Names of the cases."""
        return list(CASES) if self.cases == ("all",) else [name for name in CASES if name in self.cases]


def run_campaign(
    config: CampaignConfig,
    drives: StreetDrivesConfig,
    sky: str,
    kinds: Sequence[MonitorKind],
    changes: Mapping[str, Any],
    risk: float,
    advance: Advance = ignore,
) -> dict[str, Any]:
    """Figures of each case and monitor under a sky; ``changes`` are those of kinds that need fitted errors."""
    span = config.onset_s + config.length_s + config.after_s
    wanted = drives.replace(duration_s=span, faults=None)
    quiet, found = simulated_epochs(wanted, sky, 0, config.every), {}
    for n, case in enumerate(config.chosen):
        faulty = simulated_epochs(wanted, sky, 0, config.every, faults=partial(_schedule, config, wanted, case))
        found[case] = {
            kind.name: alert_times(config, wanted, kind, changes if "fit" in kind.needs else {}, (quiet, faulty), risk)
            for kind in kinds
        }
        advance((n + 1) / len(config.chosen))
    return found


def _schedule(config: CampaignConfig, drives: StreetDrivesConfig, case: str, navigator: Navigator) -> FaultSchedule:
    """The fault of a case: for each vehicle another satellite, systems in turn, or the same for all."""
    start = drives.warm_up_s + config.onset_s
    base = {**CASES[case], "start_s": start, "duration_s": config.length_s, "ramp_s": config.length_s}
    track, rows = navigator.track, np.zeros(navigator.batch, np.int64)
    sky = track.at(track.start_s + start, rows)
    if base["kind"] == "satellite_range":
        high = np.flatnonzero(sky.elevation_rad[0] > LOWEST_RAD)
        struck = high[np.arange(navigator.batch) % high.size]
        own = [{"system": int(sky.system[s]), "prn": int(sky.prn[s]), "vehicle": v} for v, s in enumerate(struck)]
    elif base["kind"] == "constellation":
        systems = np.unique(sky.system[sky.elevation_rad[0] > LOWEST_RAD])[:2]
        own = [{"system": int(systems[v % systems.size]), "vehicle": v} for v in range(navigator.batch)]
    else:
        own = [{}]
    return FaultSchedule([Fault.load({**base, **each}) for each in own])


def alert_times(
    config: CampaignConfig,
    drives: StreetDrivesConfig,
    kind: MonitorKind,
    changes: Mapping[str, Any],
    runs: tuple[TrackedEpochs, TrackedEpochs],
    risk: float,
) -> dict[str, Any]:
    """Response of a monitor to a fault, from epochs without it and with it: by vehicle, in seconds; None for never."""
    states = [_states(config, kind, changes, tracked, risk) for tracked in runs]
    (_, _, few, calm), (error, available, excluded, alert) = states
    batch = int(runs[0].epochs.drive[-1]) + 1
    time = runs[0].epochs.time_s.reshape(batch, -1)
    since = time - (drives.warm_up_s + config.onset_s)
    step = float(np.median(np.diff(time[0])))
    noticed = ((excluded > few) | (alert & ~calm)).reshape(batch, -1) & (since > 0.0)
    beyond = (error > config.alert_limit_m).reshape(batch, -1) & (since > 0.0)
    misled = beyond & available.reshape(batch, -1)
    when = np.where(noticed, since, np.inf).min(-1)
    return {
        "noticed_s": [float(t) if np.isfinite(t) else None for t in when],
        "failed": beyond.any(-1).tolist(),
        "alert_s": [step * _longest(row) for row in misled],
    }


def _states(
    config: CampaignConfig, kind: MonitorKind, changes: Mapping[str, Any], tracked: TrackedEpochs, risk: float
) -> tuple[Array, Bools, NDArray[np.int64], Bools]:
    """Horizontal errors, availability, number of excluded codes, and alarm or no level within the limit (E,) each."""
    v = watch(tracked.epochs, kind.config(dict(changes)), risk)
    error = np.hypot(*(v.position_enu_m - tracked.truth_enu_m)[:, :2].T)
    available = np.asarray(v.usable & (v.hpl_m[:, 0] <= config.alert_limit_m))
    return error, available, np.asarray(v.excluded.sum(-1)), np.asarray(v.alarm | ~available)


def _longest(held: Bools) -> int:
    """Epochs of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def campaign_rows(found: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """One row for each monitor; by case: vehicles that noticed the fault, median time to that, vehicles whose error
    exceeds the limit, and the longest time to alert."""
    cases = list(found)
    rows = [
        (name, *(_cell(found[case][name]) for case in cases)) for name in (found[cases[0]] if cases else ())
    ]  # fmt: skip
    return ("monitor", *cases), rows


def _cell(of: Mapping[str, Any]) -> str:
    seen = [t for t in of["noticed_s"] if t is not None]
    median = "-" if not seen else f"{float(np.median(seen)):.1f} s"
    return f"{len(seen)}/{len(of['noticed_s'])} in {median}; {sum(of['failed'])}, {max(of['alert_s']):.1f} s"
