"""Simulated street drives as epochs of the monitor family: undifferenced codes, carriers, Doppler steps and a map.

The fault campaign measures the time until a monitor notices a fault, and for how long it misleads before. Vehicles
drive a street twice with the same noise, with a fault and without it, so that all differences are effects of the fault.
A monitor notices a fault in the first epoch in which it raises an alarm or has no level within the alert limit where it
does not so without the fault, or excludes more codes than without it. The time to alert runs while the position is off
by more than the alert limit and declared available.

Fit code errors of a drive, recorded or simulated, to classes of C/N0, elevation and path; save them as a preset.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.street_drives import StreetDrivesConfig, road_of, street_of
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.error_classes import ErrorClasses, ErrorLaw, FittedErrors
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import MonitorKind
from lanebound.integrity.monitoring.family.laws import (
    NormalMixture,
    fit_jumps,
    fit_mixture,
    fit_normal,
    fit_pareto,
    fit_rayleigh,
)
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.overbounds import BoundForm, ErrorSides, overbound
from lanebound.integrity.monitoring.family.weighting import CodeBudget
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.code_epochs import TrackedEpochs, recorded_epochs
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

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


def campaign_rows(found: Mapping[str, Any]) -> Table:
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


BAND = 0
RATE_SIGMA_MPS = 0.1  # of a Doppler velocity; S1: 0.10 m/s


@dataclass
class _Sampled:
    """Arrays of sampled epochs of B vehicles, each (B, ...), in the order of time."""

    rows: dict[str, list[NDArray[np.generic]]] = field(default_factory=dict)

    def add(self, **values: NDArray[np.generic]) -> None:
        for name, value in values.items():
            self.rows.setdefault(name, []).append(np.array(value))

    def flat(self, name: str) -> NDArray[np.generic]:
        """All epochs of the first vehicle, then those of the next.  (B T, ...)."""
        stacked = np.stack(self.rows[name], 1)
        return np.asarray(stacked.reshape(-1, *stacked.shape[2:]))


def simulated_epochs(
    config: StreetDrivesConfig,
    sky: str,
    number: int,
    every: int = 5,
    advance: Advance = ignore,
    faults: Callable[[Navigator], FaultSchedule] | None = None,
) -> TrackedEpochs:
    """The vehicles of a street at each ``every``-th epoch after the warm-up, with ``faults`` of their sky.

    The map of the street predicts blocked paths at the place of the road that is nearest to the code position.
    """
    wanted = config.replace(navigator={"gnss": {"undifferenced": True}})
    navigator, drive = street_of(wanted, sky, number)
    if faults is not None:
        navigator.faults = faults(navigator)
    dt, budget = navigator.config.dt_s, CodeBudget()
    first, epochs = (round(time_s / dt) for time_s in (wanted.warm_up_s, wanted.span_s))
    sampled, views, state = _Sampled(), [], _Between(navigator.batch, budget)
    fixes = navigator.config.kind == "rtk_reckoning"  # which resolves integers
    for k, truth in zip(range(epochs), drive, strict=False):
        m = navigator.measure(truth)
        solution = navigator.locate(m) if fixes else None
        state.add(m, dt)
        advance((k + 1) / epochs)
        if k < first or (k - first) % every:
            continue
        views.append(m.sky)
        sampled.add(time=np.full(navigator.batch, truth.time_s), truth=truth.position_enu_m, **state.sample(m))
        if solution is not None:
            sampled.add(**_fixed(navigator, m, solution))
    return _tracked(sampled, views, navigator.mask, road_of(wanted, number))


class _Between:
    """What changes between samples: carriers that are held, and the displacement by Doppler."""

    def __init__(self, batch: int, budget: CodeBudget) -> None:
        self.budget, self.step, self.span_s = budget, np.zeros((batch, 3)), 0.0
        self.phase: Array | None = None
        self.held: Bools | None = None
        self.fixed = np.ones(batch, bool)

    def add(self, m: Measurements, dt: float) -> None:
        """An epoch of the receiver."""
        g, los = m.gnss, m.sky.los_enu[m.sky.index]
        rates = CodeEpochs.of(g.range_rate_mps, los, RATE_SIGMA_MPS, g.tracked, 0)
        fit = solve_codes(rates)
        self.step += dt * fit.x_m
        self.span_s += dt
        self.fixed &= fit.solved
        if self.held is not None:
            self.held &= g.tracked & ~g.lock_lost & (_phase(m) != 0.0)

    def sample(self, m: Measurements) -> dict[str, NDArray[np.generic]]:
        """The values of an epoch that is kept, and a new beginning."""
        g, sky = m.gnss, m.sky
        assert g.raw_code_m is not None  # asked for
        los, elevation = sky.los_enu[sky.index], sky.elevation_rad[sky.index]
        code = g.raw_code_m[..., BAND]
        phase, held = _phase(m), self.held
        change = np.zeros_like(phase) if self.phase is None else phase - self.phase
        kept = np.zeros(phase.shape, bool) if held is None else held
        sigma = np.where(self.fixed, RATE_SIGMA_MPS * self.span_s, np.inf)
        out: dict[str, NDArray[np.generic]] = {
            "y": code, "used": g.tracked & (code != 0.0), "los": los, "elevation": elevation, "cn0": g.cn0_dbhz,
            "sigma": self.budget.code(elevation, g.cn0_dbhz), "step": self.step.copy(), "spread": sigma,
            "change": np.where(kept, change, 0.0), "kept": kept,
            "loose": self.budget.carrier_step(elevation, self.span_s),
        }  # fmt: skip
        self.phase, self.held = phase, g.tracked & (phase != 0.0)
        self.step[:], self.span_s = 0.0, 0.0
        self.fixed[:] = True
        return out


def _fixed(navigator: Navigator, m: Measurements, solution: Solution) -> dict[str, NDArray[np.generic]]:
    """Carriers less the integers that RTK holds, mean of the bands, their deviations for levels, where there is one,
    and the probability that a held integer is wrong."""
    g, rtk = m.gnss, navigator.config.positioning.rtk
    held, integers = (navigator.state.belief.ambiguities[name] for name in ("held", "integers"))
    bands = list(navigator.config.gnss.bands)
    cycles = WAVELENGTH_M[m.sky.system][:, bands] * integers[..., : len(bands)]
    phase = g.phase_m[..., : len(bands)]
    kept = held & g.tracked & (phase != 0.0).all(-1)
    sine, age = m.sky.los_enu[m.sky.index][..., 2], g.corrections_age_s[:, None]
    factor = CodeErrorBudget(cn0_knee_dbhz=rtk.cn0_knee_dbhz).errors(sine, g.cn0_dbhz).factor
    aged = rtk.age_sigma_mps * np.where(np.isfinite(age), age, 0.0)
    return {
        "fixed": np.where(kept, (phase - cycles).mean(-1), 0.0), "fixed_kept": kept & np.isfinite(age),
        "fixed_sigma": np.hypot(rtk.sigma_phase_integrity_m * np.sqrt(factor), aged), "risk": solution.wrong_fix_risk,
    }  # fmt: skip


def _phase(m: Measurements) -> Array:
    assert m.gnss.raw_phase_m is not None  # asked for
    return m.gnss.raw_phase_m[..., BAND]


def _tracked(sampled: _Sampled, views: list[SkyView], mask: SkyMask, road: Road) -> TrackedEpochs:
    """The samples as epochs, with the prediction of the map, and with the turn of the sights taken out of carriers."""
    v = {name: sampled.flat(name) for name in sampled.rows}
    batch = len(sampled.rows["time"][0])
    drive = np.repeat(np.arange(batch), len(sampled.rows["time"]))
    up = np.array([0.0, 0.0, 1.0])
    used: Bools = np.asarray(v["used"], dtype=bool)
    los = np.where(used[..., None], v["los"], up)
    plain = CodeEpochs(
        time_s=np.asarray(v["time"], dtype=np.float64), y_m=np.asarray(v["y"], dtype=np.float64), los_enu=los,
        sigma_m=np.asarray(v["sigma"], dtype=np.float64), used=used, system=views[0].system.astype(np.int64),
        cn0_dbhz=np.asarray(v["cn0"], dtype=np.float64), elevation_rad=np.asarray(v["elevation"], dtype=np.float64),
        drive=drive,
    )  # fmt: skip
    fix = solve_codes(plain).x_m
    shadowed = _predicted(fix[:, :2].reshape(batch, -1, 2), views, mask, road)
    before = np.concatenate([fix[:1], fix[:-1]])
    turned = np.diff(los, axis=0, prepend=los[:1])
    kept = np.asarray(v["kept"], dtype=bool) & used & ~plain.starts()[:, None]
    kept[1:] &= used[:-1]
    change = np.where(kept, v["change"] + (turned @ before[..., None])[..., 0], 0.0)
    epochs = CodeEpochs(**{
        **vars(plain), "shadowed": shadowed, "step_enu_m": v["step"], "step_sigma_m": v["spread"],
        "carrier_step_m": change, "carrier_kept": kept, "carrier_sigma_m": v["loose"], **_of_fixes(v),
    })  # fmt: skip
    return TrackedEpochs(epochs.checked(), np.asarray(v["truth"], dtype=np.float64), np.ones(drive.size, bool))


def _of_fixes(v: dict[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """The fields of fixed carriers, where the navigator resolves integers."""
    if "fixed" not in v:
        return {}
    return {
        "fixed_m": v["fixed"], "fixed_sigma_m": v["fixed_sigma"], "fixed_kept": np.asarray(v["fixed_kept"], dtype=bool),
        "fix_risk": v["risk"],
    }  # fmt: skip


def _predicted(fix_en_m: Array, views: list[SkyView], mask: SkyMask, road: Road) -> Bools:
    """Paths that the map predicts to be reflected or blocked at the code positions (B, T, 2).  (B T, S)."""
    arc = np.clip(road.project(fix_en_m)[0], 0.0, road.length_m)
    found = [mask.look(arc[:, t], np.zeros(len(arc), np.int64), view).path for t, view in enumerate(views)]
    path = np.stack(found, 1)
    return np.asarray((path == SignalPath.REFLECTED) | (path == SignalPath.BLOCKED)).reshape(-1, path.shape[-1])


STRONG_DBHZ = 42.0
ENOUGH_STRONG = 3
RISKS = (1e-1, 1e-2, 1e-3)


class FitErrorsConfig(Config):
    """Which part is fitted, and how."""

    training_share: float = Field(0.4, gt=0, le=1, description="first part of a recorded drive that is fitted [-]")
    streets: int = Field(4, ge=1, description="streets that are fitted under a sky")
    form: BoundForm = Field(BoundForm.TAIL, description="what of the errors' law is bounded")
    sides: ErrorSides = Field(ErrorSides.BOTH, description="sides bounded; reflections are late")
    centred: bool = Field(True, description="bound about the median, which is subtracted from codes")
    cn0_edges_dbhz: tuple[float, ...] = Field(
        (0.0, 28.0, 33.0, 38.0, 43.0, 60.0), min_length=2, description="edges of classes of C/N0 [dB-Hz]"
    )
    elevation_edges_deg: tuple[float, ...] = Field(
        (0.0, 20.0, 40.0, 90.0), min_length=2, description="edges of classes of elevation [deg]"
    )
    fewest: int = Field(60, ge=10, description="errors of a class; with fewer it has the law of its C/N0, or of all")
    drives: StreetDrivesConfig = StreetDrivesConfig(vehicles=8, duration_s=60.0, seed=1001)


def fit_errors(dataset: Path | None, sky: str | None, config: FitErrorsConfig) -> tuple[FittedErrors, dict[str, Any]]:
    """Classes and position laws of a data set or of simulated streets, and how well laws of all errors fit.

    Raises
    ------
    InputError
        Neither or both are given, or there are too few errors.
    """
    if (dataset is None) == (sky is None):
        raise InputError("fit-errors must have a DATASET or --sky, got both or none: name one")
    if dataset is not None:
        tracked = _first_part(recorded_epochs(read_city(dataset)), config.training_share)
        parts, source = [tracked], f"first {config.training_share:g} of {dataset.name}"
    else:
        assert sky is not None
        parts = [simulated_epochs(config.drives, sky, k) for k in range(config.streets)]
        source = f"{config.streets} simulated streets under {sky}, seed {config.drives.seed}"
    found = [(*code_errors_of(part), part.epochs) for part in parts]
    error = np.concatenate([e[ok] for e, ok, _ in found])
    cn0, elevation = (np.concatenate([getattr(p, name)[ok] for _, ok, p in found]) for name in FIELDS)
    mapped = all(p.shadowed is not None for _, _, p in found)
    path = np.concatenate([p.shadowed[ok] for _, ok, p in found if p.shadowed is not None]) if mapped else None
    method = f"{config.form.value} overbound of {config.sides.value} sides; {error.size} errors of lanebound fit-errors"
    classes = _classes(error, cn0, elevation, path, config, f"{source}; {method}")
    fitted = FittedErrors.load({"classes": classes.to_dict(), **_position_laws(parts)})
    return fitted, {"errors": int(error.size), "laws": _laws(error)}


FIELDS = ("cn0_dbhz", "elevation_rad")


def _first_part(tracked: TrackedEpochs, share: float) -> TrackedEpochs:
    time = tracked.epochs.time_s
    own = time < time[0] + share * (time[-1] - time[0])
    return TrackedEpochs(tracked.epochs.take(own), tracked.truth_enu_m[own], tracked.known[own])


def code_errors_of(tracked: TrackedEpochs) -> tuple[Array, Bools]:
    """Errors of codes (E, m) [m] with known truth, and where they are known.

    The clock of each epoch is the median of strong codes less the offset of their system, the offset the median over
    the drive of each receiver. What strong codes have in common counts as clock.
    """
    e = tracked.epochs
    known = e.used & tracked.known[:, None]
    error = np.zeros(e.y_m.shape)
    for drive in np.unique(e.drive):  # each receiver has a clock of its own
        own = e.drive == drive
        error[own] = _errors_of_drive(e.take(own), tracked.truth_enu_m[own], known[own])
    return error, known


def _errors_of_drive(e: CodeEpochs, truth_enu_m: Array, known: Bools) -> Array:
    """Errors of the codes of one receiver, 0 where not known.  (E, m) [m]."""
    away = e.y_m + (e.los_enu @ truth_enu_m[..., None])[..., 0]
    strong = known & (e.cn0_dbhz >= STRONG_DBHZ)
    strong = np.where((strong.sum(-1) < ENOUGH_STRONG)[:, None], known, strong)
    offset = np.zeros(e.y_m.shape[1])
    for _ in range(3):
        clock = _median(np.where(strong, away - offset, np.nan))
        for system in np.unique(e.system):
            own = e.system == system
            values = (away - clock[:, None])[:, own][strong[:, own]]
            offset[own] = np.median(values) if values.size else 0.0
    return np.where(known, away - offset - clock[:, None], 0.0)


def _median(values: Array) -> Array:
    out = np.zeros(len(values))
    some = np.isfinite(values).any(-1)
    out[some] = np.nanmedian(values[some], -1)
    return out


def _classes(
    error: Array, cn0: Array, elevation: Array, path: Bools | None, config: FitErrorsConfig, source: str
) -> ErrorClasses:
    """The law of each class; with few errors that of its C/N0 class, and then that of all."""
    paths = ("any",) if path is None else ("direct", "shadowed")
    shape = len(config.cn0_edges_dbhz) - 1, len(config.elevation_edges_deg) - 1, len(paths)
    blank = {
        "source": source, "cn0_edges_dbhz": config.cn0_edges_dbhz, "elevation_edges_deg": config.elevation_edges_deg,
        "paths": paths, "sides": config.sides.value,
    }  # fmt: skip
    table = ErrorClasses.load({**blank, "laws": [{"sigma_m": 1.0}] * int(np.prod(shape))})
    index = np.array(np.unravel_index(table.index(cn0, elevation, path), shape))
    laws = []
    for c in np.ndindex(shape):
        same = index == np.array(c)[:, None]
        own = next(
            (mask for mask in (same.all(0), same[0] & same[2], same[0]) if mask.sum() >= config.fewest),
            np.ones(error.size, bool),
        )
        laws.append(_law(error[own], int(same.all(0).sum()), config))
    return ErrorClasses.load({**blank, "laws": laws})


def _law(error: Array, count: int, config: FitErrorsConfig) -> dict[str, Any]:
    found = overbound(error, config.form, config.sides, centred=config.centred)
    centre, sigma, bias = (round(float(v), 3) for v in (found.centre_m, found.sigma_m, found.bias_m))
    return ErrorLaw(count=count, centre_m=centre, sigma_m=max(sigma, 1e-3), bias_m=bias).to_dict()


def _position_laws(parts: Sequence[TrackedEpochs]) -> dict[str, float]:
    """Rayleigh and Pareto laws of the horizontal error over the deviation stated for the codes."""
    ratios = []
    for part in parts:
        fit = solve_codes(part.epochs)
        own = fit.solved & part.known
        away = np.hypot(*(fit.x_m - part.truth_enu_m)[own, :2].T)
        ratios.append(away / fit.major_m[own])
    ratio = np.concatenate(ratios)
    tail = fit_pareto(ratio)
    values = {
        "rayleigh_factor": fit_rayleigh(ratio), "pareto_threshold": tail.threshold, "pareto_share": tail.share,
        "pareto_scale": tail.scale, "pareto_shape": tail.shape,
    }  # fmt: skip
    return {name: round(value, 4) for name, value in values.items()}


def _laws(error: Array) -> dict[str, Any]:
    """Criterion and quantiles of each law of all errors, next to the errors themselves."""
    laws = {"normal": fit_normal(error), "mean and variance jump": fit_jumps(error), "mixture": fit_mixture(error)}
    process = dirichlet_mixture(error)
    laws |= {} if process is None else {"dirichlet process": process}
    rows = {
        name: {"parts": int(law.share.size), "criterion": law.criterion(error),
               "quantiles_m": [law.quantile_m(risk) for risk in RISKS]}
        for name, law in laws.items()
    }  # fmt: skip
    rows["errors"] = {
        "parts": 0,
        "criterion": None,
        "quantiles_m": np.quantile(np.abs(error), [1 - r for r in RISKS]).tolist(),
    }
    return rows


def dirichlet_mixture(error_m: Array) -> NormalMixture | None:
    """Dirichlet-process mixture by variational Bayes; None without scikit-learn, which is an optional package."""
    try:
        from sklearn.mixture import BayesianGaussianMixture
    except ImportError:
        return None
    model = BayesianGaussianMixture(
        n_components=8, weight_concentration_prior_type="dirichlet_process", random_state=0, max_iter=5000,
        tol=1e-3,
    )  # fmt: skip
    model.fit(error_m[:, None])
    kept = model.weights_ > 1e-3
    share = model.weights_[kept] / model.weights_[kept].sum()
    sigma = np.sqrt(model.covariances_[kept, 0, 0])
    return NormalMixture(share, model.means_[kept, 0], sigma, 3 * int(kept.sum()) - 1)


def write_preset(path: Path, fitted: FittedErrors) -> None:
    """The preset as YAML."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump({"kind": "fitted_errors", **fitted.to_dict()}, sort_keys=False), encoding="utf-8")


def class_rows(classes: ErrorClasses) -> Table:
    """One row for each class."""
    rows: list[tuple[Any, ...]] = []
    c, e = classes.cn0_edges_dbhz, classes.elevation_edges_deg
    for (i, j, k), law in zip(np.ndindex(len(c) - 1, len(e) - 1, len(classes.paths)), classes.laws, strict=True):
        span = f"{c[i]:g} to {c[i + 1]:g}", f"{e[j]:g} to {e[j + 1]:g}", classes.paths[k]
        rows.append((*span, law.count, law.centre_m, law.sigma_m, law.bias_m))
    return ("C/N0 [dB-Hz]", "elevation [deg]", "path", "errors", "centre [m]", "sigma [m]", "bias [m]"), rows


def law_rows(result: Mapping[str, Any]) -> Table:
    """One row for each law of all errors."""
    rows = [
        (name, law["parts"] or "-", law["criterion"], *(round(q, 2) for q in law["quantiles_m"]))
        for name, law in result["laws"].items()
    ]
    return ("law", "parts", "BIC", *(f"beyond at {risk:g} [m]" for risk in RISKS)), rows
