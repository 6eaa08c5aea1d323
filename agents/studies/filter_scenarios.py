"""The trials of S4 as simulated drives, its fit of an accelerometer, and the faults that its gate is for.

Trials are its scenarios 5 to 11: routes, outages, spurious positions, filters. S4 prints neither maps nor times of its
circuits beyond what its text states: lengths, speeds and lengths of outages are those of the text, shapes of roads are
chosen. Positions are GPS alone with errors as EGNOS leaves them. The reference point is S4's geometrical centre, half
way between the axles, so that the vehicles slip in bends as its model says.

S4's fit of the error of an accelerometer (section II-C5) is repeated on static logs made by its law, with the noise it
states. A least-squares fit with a free constant leaves a mean error of 0. S4 states -3.2e-4 m/s^2 after its fit, which
alone drifts by 0.58 m in 60 s, most of its 0.7 m: that mean is of other data than the fit, or the fit had not
converged.

Faults: positions rejected, and errors with the gate and without it. Vehicles drive a loop of city streets under an open
sky, with the equipment of S4's trials. Each meets the fault from another side. All filters see the same measurements.
What counts is each position that was due while the fault lasted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.fault_response import LOOP_M
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.navigators.vehicle_filter.navigator import FilterNavigator
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sensors.inertial_law import PUBLISHED, drift_m, fit_inertial_law
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]

LOG_S, STEP_S = 2000.0, 0.1  # four times tau; S4 states neither
NOISE_MPS2 = 0.0033  # standard deviation after the fit, S4
AFTER_S = 60.0
PAPER = {
    "C1 [m/s^2]": PUBLISHED.c1_mps2, "C2 [m/s^2]": PUBLISHED.c2_mps2, "tau [s]": PUBLISHED.tau_s,
    "mean left [m/s^2]": -3.2172e-4, "deviation left [m/s^2]": NOISE_MPS2,
    "drift in 60 s, uncorrected [m]": 55.0, "drift in 60 s, corrected [m]": 0.7,
}  # fmt: skip
"""What S4 states."""


def work_law(logs: int, first_seed: int, advance: Advance = ignore) -> dict[str, list[float]]:
    """5 %, median and 95 % over logs of what S4 states; drifts without sign."""
    time_s = np.arange(0.0, LOG_S, STEP_S)
    found = []
    for k in range(logs):
        noise = NOISE_MPS2 * named_generator(first_seed + k, "static log").standard_normal(time_s.size)
        error = PUBLISHED.error_mps2(time_s) + noise
        law = fit_inertial_law(time_s, error).law
        left = error - law.error_mps2(time_s)
        drifts = (abs(drift_m(time_s, a, AFTER_S)) for a in (error, left))
        found.append([law.c1_mps2, law.c2_mps2, law.tau_s, left.mean(), left.std(), *drifts])
        advance((k + 1) / logs)
    spread = np.quantile(np.array(found), [0.05, 0.5, 0.95], axis=0).T
    return {name: values.tolist() for name, values in zip(PAPER, spread, strict=True)}


def law_rows(found: Mapping[str, Any]) -> Table:
    """Rows: figure, S4, ours with 5 and 95 %."""
    return ("static log", "S4", "ours", "5 .. 95 %"), [
        (name, f"{PAPER[name]:g}", f"{middle:.4g}", f"{low:.4g} .. {high:.4g}")
        for name, (low, middle, high) in found.items()
    ]


AXLE_M = 1.35  # reference point ahead of the rear axle: half of the wheelbase, S4's geometrical centre
EQUIPMENT: Mapping[str, Any] = {
    "sky": {"galileo": 0, "glonass": 0, "beidou": 0, "qzss": 0, "lat_deg": 38.02, "lon_deg": -1.17},  # Murcia
    "gnss": {
        "bands": [0],
        "undifferenced": True,
        "broadcast": {"orbit_sigma_m": 0.6, "clock_sigma_m": 0.6, "iono_zenith_m": 0.7},
    },
    "imu": {"mems_exponential": True},
    "chassis": {"fitted": True, "axle_m": AXLE_M},
    "positioning": {"axle_m": AXLE_M},
    "compass": {"fitted": True},
    "position": {"codes": {"errors": {"satellite_m": 0.85, "iono_zenith_m": 0.7, "reflections_m": 0.3}}},
}
"""Of the vehicles: GPS on one frequency; UDRE of 0.85 m and a zenith delay of 0.7 m stand for EGNOS's corrections
(UDREI 5 to 6 and GIVEI 6 to 7 of DO-229D tables A-6 and A-17)."""


@dataclass(frozen=True)
class Scenario:
    """One trial.

    points_m : corners of the road (P, 2); corner_m : radius of its bends; length_s : duration; outages_s : spans
    without GNSS; spurious_s : spans with a displaced position, by ``shift_m``; start_sigma_m, heading_deg : 1-sigma of
    the pose known at the start; filters : configurations by name; compared : pairs of them, drive by drive;
    paper : what S4 states, by name of the figure (:mod:`.filters`); equipment : changes of EQUIPMENT
    """

    number: str
    title: str
    points_m: tuple[tuple[float, float], ...]
    length_s: float
    drive: DriveConfig
    filters: Mapping[str, Mapping[str, Any]]
    corner_m: float = 15.0
    outages_s: tuple[tuple[float, float], ...] = ()
    spurious_s: tuple[tuple[float, float], ...] = ()
    shift_m: float = 25.0
    start_sigma_m: float = 1.5
    heading_deg: float = 2.0
    compared: tuple[tuple[str, str], ...] = ()
    paper: Mapping[str, float] = field(default_factory=dict)
    equipment: Mapping[str, Any] = field(default_factory=dict)

    @property
    def road(self) -> Road:
        """The road."""
        return Road.through(np.array(self.points_m), corner_radius_m=self.corner_m)


def disturbed(scenario: Scenario, m: Measurements, time_s: float, azimuth_rad: Array) -> Measurements:
    """The measurements with the outages and spurious positions of a trial.

    A spurious position is a displacement of all ranges alike, (B,) azimuths: consistent, so that no residual shows it.
    """
    g = m.gnss
    if any(low <= time_s < high for low, high in scenario.outages_s):
        return replace(m, gnss=replace(g, tracked=np.zeros_like(g.tracked)))
    if any(low <= time_s < high for low, high in scenario.spurious_s) and g.raw_code_m is not None:
        by = scenario.shift_m * np.stack([np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0 * azimuth_rad], -1)
        shift = -np.einsum("bsk,bk->bs", m.sky.los_enu[m.sky.index], by)
        return replace(m, gnss=replace(g, raw_code_m=g.raw_code_m + np.where(g.raw_code_m != 0.0, shift[..., None], 0)))
    return m


def _campus() -> tuple[tuple[float, float], ...]:
    """A semi-urban way of some 3 km with wide bends."""
    return ((0, 0), (300, 0), (500, 180), (500, 520), (760, 700), (1100, 700), (1250, 950), (1250, 1500), (1250, 2400))


def _yard() -> tuple[tuple[float, float], ...]:
    """Sharp turns at every 25 to 45 m, then straight on; the trial ends after 390 m."""
    turns = (0, 0), (45, 0), (45, 30), (15, 30), (15, 60), (60, 60), (60, 90), (20, 90), (20, 120), (70, 120)
    return (*turns, (70, 150), (200, 150))


IMM: Mapping[str, Any] = {"filter": "imm"}
WIDE, CURVED = "SM-EKF, yaw noise of curved", "CM-EKF"
UNTESTED: Mapping[str, Any] = {**IMM, "gate": {"enabled": False}}
SM: Mapping[str, Any] = {"filter": "ekf", "models": ["straight"]}
FREE = {"red_share": 0.0}
SCENARIOS = {
    s.number: s
    for s in (
        Scenario(
            "5", "dead reckoning and IMM-EKF, no gate", _campus(), 180.0, DriveConfig(speed_limit_mps=10.0, **FREE),
            {"IMM-EKF as S4": {**UNTESTED, "position": {"excess_tau_s": 0.0}}, "IMM-EKF": UNTESTED}, corner_m=60.0,
            outages_s=((60, 102), (130, 150)), spurious_s=((54, 60), (126, 130)),
            paper={"max DR": 50.0, "max IMM-EKF": 10.0, "max IMM-EKF as S4": 10.0},
        ),
        Scenario(
            "6", "IMM-EKF with the gate", _campus(), 180.0, DriveConfig(speed_limit_mps=10.0, **FREE),
            {"IMM-EKF": IMM}, corner_m=60.0, outages_s=((60, 102), (130, 150)), spurious_s=((54, 60), (126, 130)),
            paper={"max IMM-EKF": 15.0, "error at the end of the first outage IMM-EKF": 15.0},
        ),
        Scenario(
            "7", "long outage: 5 min and 2.5 km", _campus(), 360.0, DriveConfig(speed_limit_mps=8.5, **FREE),
            {"IMM-EKF": IMM}, corner_m=60.0, outages_s=((50, 350),),
            paper={"max IMM-EKF": 35.0, "rms in outage IMM-EKF": 17.5},
        ),
        Scenario(
            "8-9", "EKF and UKF, outages of 50 s at 40 km/h", _campus(), 270.0,
            DriveConfig(speed_limit_mps=11.1, **FREE), {"EKF": SM, "UKF": {**SM, "filter": "ukf"}}, corner_m=60.0,
            outages_s=((60, 110), (170, 220)), compared=(("UKF", "EKF"),),
        ),
        Scenario(
            "10", "390 m of sharp turns without GNSS", _yard(), 79.7,
            DriveConfig(speed_limit_mps=5.0, lateral_mps2=3.0, **FREE), {
                "SM-EKF": SM, WIDE: {**SM, "straight": {"yaw_acceleration": 1.0}},
                CURVED: {"filter": "ekf", "models": ["curved"]}, "IMM-EKF": IMM,
            }, corner_m=10.0, outages_s=((0, 1e9),), start_sigma_m=0.3, heading_deg=0.5,
            compared=tuple((name, "IMM-EKF") for name in ("SM-EKF", WIDE, CURVED)),
            paper={"max IMM-EKF": 3.0, "rms of SM-EKF less IMM-EKF": 0.484},
        ),
        Scenario(
            "11", "trust level in semi-urban traffic", _campus(), 240.0, DriveConfig(speed_limit_mps=10.0),
            {"IMM-EKF": IMM}, corner_m=60.0, outages_s=((70, 80), (110, 122), (180, 187)), spurious_s=((105, 110),),
            paper={"rms IMM-EKF": 3.55, "HTL median": 6.0, "HTL below 7 m": 0.5},
        ),
    )
}  # fmt: skip
"""The trials by number; what S4 states of each."""

GYRO = {
    "imu": {"gyro": {"density": 1e-9, "instability": 0.0, "random_walk": 0.0, "turn_on": 0.0, "scale": 0.0}},
    "positioning": {"heading": {
        "bias_initial_radps": 1e-6, "bias_walk_radps": 1e-9, "gyro_scale": 0.0, "angle_random_walk_rad": 1e-6,
    }},
}  # fmt: skip
COMPASS = {
    "compass": {"deviation_deg": 0.0, "disturbance_deg": 0.0, "noise_deg": 0.1},
    "motion": {"compass_deviation_deg": 0.0, "compass_sigma_deg": 0.1, "compass_tau_s": 0.0},
}
WHEELS = {"chassis": {"scale_sigma": 0.0}, "motion": {"wheel_scale": 0.0}}
STEERING = {
    "chassis": {"steering_offset_deg": 0.0, "steering_noise_deg": 0.0, "steering_step_deg": 0.0},
    "motion": {"steering_sigma_deg": 0.01, "steering_tau_s": 0.0},
}
START = {"start_sigma_m": 0.01, "heading_deg": 0.01}


def _biased(true_radps: float, declared_radps: float) -> Mapping[str, Any]:
    """A gyro bias at the start, 1 sigma."""
    return {
        "imu": {"gyro": {"turn_on": true_radps}},
        "positioning": {"heading": {"bias_initial_radps": declared_radps}},
    }


def _sharp(*changes: Mapping[str, Any], **start: float) -> Scenario:
    equipment: dict[str, Any] = {}
    for change in changes:
        equipment = deep_merge(equipment, change)
    return replace(SCENARIOS["10"], equipment=equipment, **start)  # type: ignore[arg-type]


SHARP: Mapping[str, Scenario] = {
    "gyro bias 0.05 deg/s (automotive)": _sharp(_biased(8.7e-4, 8.7e-4)),
    "gyro calibrated for 10 s at rest: 0.0044 deg/s": _sharp(_biased(7.7e-5, 1e-4)),
    "gyro without errors": _sharp(GYRO),
    "compass without deviation and disturbances": _sharp(COMPASS),
    "steering angle without errors": _sharp(STEERING),
    "start known": _sharp(**START),
    "gyro, start, wheels, steering": _sharp(GYRO, WHEELS, STEERING, **START),
}
"""Scenario 10 with better sensors; what is true and what is declared change together. S4 has a calibrated gyro (section
II-C5). A bias of the rest of 10 s at 0.014 deg/s/sqrt(Hz) is left of it here."""


RISK = 1e-3  # of the level whose exceedance is counted
WARM_UP_S, FAULT_S, FAULT_AFTER_S = 30.0, 20.0, 30.0
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
    excluded, epochs = 0, round((WARM_UP_S + FAULT_S + FAULT_AFTER_S) / dt)
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
    after = round((FAULT_S + FAULT_AFTER_S) / dt) * vehicles
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
    track = SkyTrack.from_config(config.sky, WARM_UP_S + FAULT_S + FAULT_AFTER_S + 20.0)
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


def fault_rows(result: Mapping[str, Any]) -> Table:
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
