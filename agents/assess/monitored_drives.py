"""Simulated street drives as epochs of the monitor family: undifferenced codes, carriers, Doppler steps and a map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.street_drives import StreetDrivesConfig, road_of, street_of
from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.integrity.monitoring.family.budget import CodeBudget
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.replay.code_epochs import TrackedEpochs
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

__all__ = ["simulated_epochs"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

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
