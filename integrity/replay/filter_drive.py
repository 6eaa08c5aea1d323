"""A recorded drive through the filters on vehicle models: epochs of the sensors that the recording has.

The filter is the one of ``navigator.kind: filter``, with its own kernels, declared errors and levels. What a recording
lacks is switched off and named. The heading is not given: it is found by the Doppler course of the receiver
(comma2k19), or by the turn that fits the reckoned path of the last minute to the code positions (smartLoc).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import bounding_by_axis, doubt
from lanebound.integrity.assessment.plotting import save, series_figure
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import (
    ecef_from_enu_matrix,
    ecef_from_geodetic,
    geodetic_from_ecef,
    track_from_enu_matrix,
)
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.navigators.vehicle_filter.navigator import blank_state, fix_of, run_filters
from lanebound.integrity.navigators.vehicle_filter.parameters import filter_parameters, level_cases
from lanebound.integrity.navigators.vehicle_filter.records_kernel import MEASURED, PositionFix
from lanebound.integrity.navigators.vehicle_filter.start_kernel import give_headings
from lanebound.integrity.positioning.filters.code_position import CodePosition, CodeSource, locate_by_codes
from lanebound.integrity.recorded.comma import Comma, read_comma
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.code_epochs import path_headings, recorded_epochs
from lanebound.integrity.replay.outages import averaged
from lanebound.integrity.replay.reckoning import reckon
from lanebound.integrity.replay.sensor_checks import aligned_comma, check_smartloc
from lanebound.integrity.sensors.gnss import GnssEpoch
from lanebound.integrity.sensors.imu import ImuSample
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sensors.odometer import OdometerSample
from lanebound.integrity.sky.view import SkyView

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

WIDEST_RAD = np.deg2rad(10.0)  # deviation of a path's heading that begins a filter
AFTER_GAP_S = 10.0  # after a gap of the sensors errors are not judged
FRESH_S = 0.15  # age of a receiver's position that counts for an epoch; they come at 10 Hz


class FilterReplayConfig(Config):
    """The filter, and what it assumes of a recording."""

    navigator: NavigatorConfig = Field(
        NavigatorConfig.load({"kind": "filter"}), description="a filter; what the recording lacks is switched off"
    )
    fix_slow_m: float = Field(
        2.1, gt=0, description="comma2k19: slow error of the receiver's positions, 1 sigma [m]; 2.5 m CEP, u-blox M8"
    )
    fix_fast_m: float = Field(0.5, gt=0, description="comma2k19: their noise, 1 sigma [m]; chosen")
    fix_speed_mps: float = Field(0.3, gt=0, description="comma2k19: the receiver's velocity, 1 sigma [m/s]; chosen")
    wheel_scale: float = Field(
        0.01, ge=0, description="scale of the wheels of a car that nobody calibrated, 1 sigma [-]; chosen"
    )
    risks: tuple[float, ...] = Field((1e-2, 1e-3, 1e-4), min_length=1, description="risks of the levels counted [-]")

    def filter_of(self, dt_s: float) -> FilterConfig:
        """The filter at an epoch length, without the sensors that recordings lack.

        Raises
        ------
        ConfigError
            The navigator is of another kind, or takes positions that recordings do not hold.
        """
        c = self.navigator
        if not isinstance(c, FilterConfig):
            raise ConfigError(f"navigator must be of kind filter, got {c.kind}: give filter or imm_s4")
        source = c.position.codes.source
        if source is not CodeSource.UNDIFFERENCED:
            raise ConfigError(
                f"navigator.position.codes.source must be undifferenced for a recording, which holds no corrections, "
                f"got {source.value}: give filter or imm_s4, or set it"
            )
        levels = [{"integrity_risk": risk} for risk in self.risks]
        return c.replace(
            dt_s=dt_s, chassis={"fitted": False}, compass={"fitted": False}, more_levels=levels,
            motion={"accelerometer": "off", "wheel_scale": self.wheel_scale},
        )  # fmt: skip


@dataclass(frozen=True)
class SensorDrive:
    """Epochs of a recorded drive, and what only an assessment knows.

    time_s (T,), every dt_s; turn_rad (T,) increments to the right, speed_mps (T,) at the epochs; fix: positions by
    codes or of the receiver, of T rows; course_rad, course_sigma_rad (T,): a heading that begins a filter, inf where
    there is none; truth_m (T, 2), known (T,); instruments: what the filter takes of the
    recording; lacking: sensors that it does not have.
    """

    time_s: Array
    dt_s: float
    turn_rad: Array
    speed_mps: Array
    fix: CodePosition
    course_rad: Array
    course_sigma_rad: Array
    truth_m: Array
    known: Bools
    instruments: tuple[str, ...]
    lacking: tuple[str, ...]


@dataclass(frozen=True)
class FilterDrive:
    """Epochs (T,): estimate and truth E, N (T, 2), heading, levels (T, R, 2), trust level, NIS of positions (0 without
    one), probability of the curved model, mode, alert, available; whether a position was used, rejected."""

    config: FilterConfig
    sensors: SensorDrive
    position_m: Array
    heading_rad: Array
    levels_m: Array
    trust_m: Array
    nis: Array
    curved: Array
    mode: NDArray[np.int64]
    alert: Bools
    available: Bools
    used: Bools
    rejected: Bools


def comma_sensors(segment: Comma, config: FilterReplayConfig, dt_s: float = 0.1) -> SensorDrive:
    """The epochs of a comma2k19 segment; positions are those of its receiver, without their geometry.

    Raises
    ------
    InputError
        The segment has no positions of its receiver.
    """
    config.filter_of(dt_s)
    if segment.fixes is None:
        raise InputError("segment must have GNSS/live_gnss_ublox, has none: the filter needs positions")
    f, r, gyro = segment.fixes, segment.reference, segment.rotation_rate
    start, end = (
        pick(float(s[edge]) for s in (r.time_s, segment.speed.time_s, gyro.time_s, f.time_s))
        for pick, edge in ((max, 0), (min, -1))
    )
    at = np.arange(start + dt_s, end, dt_s)
    latitude, longitude, height = geodetic_from_ecef(r.position_ecef_m[0])
    axes = ecef_from_enu_matrix(latitude, longitude)
    truth = (r.position_ecef_m - r.position_ecef_m[0]) @ axes
    ecef = ecef_from_geodetic(np.deg2rad(f.latitude_deg), np.deg2rad(f.longitude_deg), np.full(len(f.time_s), height))
    place, course = ((ecef - r.position_ecef_m[0]) @ axes)[:, :2], np.deg2rad(f.course_deg)
    velocity = f.speed_mps[:, None] * np.stack([np.sin(course), np.cos(course)], -1)
    newest = np.searchsorted(f.time_s, at, side="right") - 1
    age = at - f.time_s[newest]
    turn = dt_s * averaged(gyro.time_s, gyro.value[:, 2], at - 0.5 * dt_s, 1.0 / dt_s)
    return SensorDrive(
        at - start, dt_s, turn, segment.speed.at(at),
        _receiver_fix(config, place[newest] + age[:, None] * velocity[newest], velocity[newest], age <= FRESH_S),
        np.zeros(at.size), np.full(at.size, np.inf),
        interpolated(at, r.time_s, truth[:, :2]),
        ~segment.bridged(at, dt_s, AFTER_GAP_S),
        ("positions and velocities of the receiver", "yaw gyro", "speed of the wheels"),
        ("codes with ephemerides, so positions have no geometry and no test of residuals",
         "wheel angle: that of the hand wheel is recorded, its ratio is not", "compass",
         "accelerometers along the axes of the car: the phone is tilted by some 3 degrees", "lever arms"),
    )  # fmt: skip


def _receiver_fix(config: FilterReplayConfig, position_m: Array, velocity_mps: Array, valid: Bools) -> CodePosition:
    """Positions of a receiver with declared errors: common to all of its satellites, as nothing is known of them."""
    count, eye, none = len(valid), np.broadcast_to(np.eye(2), (len(valid), 2, 2)), np.zeros(len(valid), np.int64)
    assert isinstance(config.navigator, FilterConfig)
    doppler = config.fix_speed_mps / config.navigator.positioning.doppler.sigma_mps
    return CodePosition(
        position_m=np.column_stack([position_m, np.zeros(count)]), velocity_mps=velocity_mps,
        fast_m2=config.fix_fast_m**2 * eye, slow_m2=config.fix_slow_m**2 * eye, velocity_m2=doppler**2 * eye,
        valid=valid, satellites=none, excluded=none, hdop=np.ones(count), gain=np.zeros((count, 1, 2)),
        own_m2=np.zeros((count, 1)), common_m=config.fix_slow_m * eye,
    )  # fmt: skip


def smartloc_sensors(drive: SmartLoc, config: FilterReplayConfig) -> SensorDrive:
    """The epochs of a smartLoc drive; positions are those of its codes, as in simulated drives."""
    tracked = recorded_epochs(drive)
    e, o = tracked.epochs, drive.odometry
    if o.time_s.size < 2:
        raise InputError(f"drive must have odometry, got {o.time_s.size} lines 'odom3': give the whole file")
    dt_s = float(np.round(np.median(np.diff(e.time_s)), 3))
    c = config.filter_of(dt_s)
    path = reckon(o.time_s, o.speed_mps, -o.yaw_rate_left_radps)
    heading = np.interp(e.time_s, path.time_s, path.heading_rad)
    fix = locate_by_codes(c.position.codes, _measurements(e.time_s, e))
    at = interpolated(e.time_s, path.time_s, path.position_m)
    turn, spread = _path_courses(e.time_s, at, fix)
    return SensorDrive(
        e.time_s - e.time_s[0], dt_s, np.diff(heading, prepend=heading[0]),
        np.interp(e.time_s, o.time_s, o.speed_mps), fix, turn + heading, spread, tracked.truth_enu_m[:, :2],
        tracked.known,
        ("codes", "yaw rate", "speed of the wheels"),
        ("accelerometers", "wheel angle", "compass", "range rates, for a first heading", "lever arms"),
    )  # fmt: skip


def _path_courses(time_s: Array, path_m: Array, fix: CodePosition) -> tuple[Array, Array]:
    """Turn of the reckoned path that fits the valid positions of the last minute, and its deviation, (T,)."""
    turn, spread = np.zeros(time_s.size), np.full(time_s.size, np.inf)
    k = np.flatnonzero(fix.valid)
    if k.size:
        turn[k], spread[k] = path_headings(time_s[k], path_m[k], fix.position_m[k, :2])
    return turn, spread


def _measurements(time_s: Array, e: CodeEpochs) -> Measurements:
    """All epochs at once, one row each, as codes of one band."""
    shape = e.y_m.shape
    code, none = np.zeros((*shape, 2)), np.zeros(shape)
    code[..., 0] = np.where(e.used, np.where(e.y_m == 0.0, 1e-9, e.y_m), 0.0)
    sky = SkyView(
        e.los_enu, e.elevation_rad, none, none, none, e.used, e.system, np.arange(shape[1]), np.arange(shape[0])
    )
    gnss = GnssEpoch(
        e.used, code, np.zeros_like(code), none, e.cn0_dbhz, np.zeros(shape, np.bool_), np.zeros(shape[0]), code
    )
    still = np.zeros((shape[0], 3))
    return Measurements(
        float(time_s[0]), sky, gnss, ImuSample(still, still), OdometerSample(np.zeros(shape[0]), np.zeros(shape[0]))
    )


def drive_filter(sensors: SensorDrive, config: FilterReplayConfig) -> FilterDrive:
    """Run the filter of a configuration over a drive, from a cold start."""
    c = config.filter_of(sensors.dt_s)
    parameters, cases, fix = filter_parameters(c), level_cases(c), fix_of(sensors.fix)
    state = blank_state(c, 1, sensors.fix.own_m2.shape[1])
    found = []
    for k in range(sensors.time_s.size):
        row = slice(k, k + 1)
        if not state.vehicles["aligned"][0] and sensors.course_sigma_rad[k] < WIDEST_RAD:
            give_headings(
                state, np.zeros(1, np.int64), sensors.course_rad[row].copy(), float(sensors.course_sigma_rad[k])
            )
        one = PositionFix(fix.vehicles[row], fix.satellites[row])
        found.append(run_filters(parameters, cases, state, _motion(sensors, row), one))
    return _gathered(c, sensors, found)


def _motion(s: SensorDrive, row: slice) -> Records:
    """The motion of one epoch, MEASURED (1,)."""
    found = np.zeros(1, MEASURED)
    found["turn"][:, 2], found["speed"] = s.turn_rad[row], s.speed_mps[row]
    found["distance"] = np.abs(found["speed"]) * s.dt_s
    return found


def _gathered(c: FilterConfig, sensors: SensorDrive, found: Sequence[tuple[Records, Array]]) -> FilterDrive:
    out, levels = (np.concatenate(rows) for rows in zip(*found, strict=True))
    values = {
        "position_m": out["position"], "heading_rad": out["heading"], "levels_m": levels, "trust_m": out["trust"],
        "nis": out["nis"][:, 0], "curved": out["curved"], "mode": out["mode"], "alert": out["alert"],
        "available": out["available"], "used": out["used"], "rejected": out["rejected"],
    }  # fmt: skip
    return FilterDrive(c, sensors, **values)


CAUTION = "epochs of one drive are not independent: the exact intervals are too narrow"


def write_filter(
    folder: Path, kind: str, out: Path, navigator: str, changes: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a smartLoc or comma2k19 folder through a filter; writes ``replay.json`` and ``series.png`` into ``out``.

    navigator : name of a preset, or ``filter``; ``changes`` of :class:`FilterReplayConfig`

    Raises
    ------
    InputError
        The folder lacks what the filter needs.
    ConfigError
        The navigator is no filter, or a change is invalid.
    """
    named = {"navigator": NavigatorConfig.data_of(navigator)}
    config = FilterReplayConfig.build(None, deep_merge(named, dict(changes)))
    if kind == "smartloc":
        city = read_city(folder)
        sensors, notes, agreement = smartloc_sensors(city, config), city.notes, check_smartloc(city)
    else:
        segment, agreement = aligned_comma(read_comma(folder))
        sensors, notes = comma_sensors(segment, config), segment.notes
    drive = drive_filter(sensors, config)
    found = {"dataset": "filter", "recording": kind, "navigator": navigator, "stopped": notes}
    found["agreement"] = {name: of.figures() for name, of in agreement.items()}
    found |= filter_summary(drive, config)
    summary = write_summary(out / "replay.json", found)
    figure = series_figure(_record(drive, 1), risk=config.risks[0])
    return found, [summary, save(figure, out / "series.png")]


def filter_summary(drive: FilterDrive, config: FilterReplayConfig) -> dict[str, Any]:
    """Statistics as JSON data, over the epochs with a level and a known truth."""
    s, error = drive.sensors, _errors(drive)
    levelled = s.known & np.isfinite(drive.levels_m[:, 0]).all(-1)
    fixed = s.known & s.fix.valid
    doubts = (
        doubt(risk, error[levelled], drive.levels_m[levelled, 1 + k], "epochs") for k, risk in enumerate(config.risks)
    )
    off = np.linalg.norm(error, axis=-1)
    fix_off = np.linalg.norm(s.fix.position_m[:, :2] - s.truth_m, axis=-1)
    return {
        "filter": drive.config.filter,
        "doubt": next(filter(None, doubts), None),
        "epochs": int(s.time_s.size),
        "with_truth": int(s.known.sum()),
        "with_level": int(levelled.sum()),
        "first_level_s": float(s.time_s[np.argmax(levelled)]) if levelled.any() else None,
        "sensors": list(s.instruments),
        "lacking": list(s.lacking),
        "horizontal_m": _spread(off[levelled]),
        "positions_m": _spread(fix_off[fixed]),
        "positions": {
            "valid": int(s.fix.valid.sum()), "used": int(drive.used.sum()), "rejected": int(drive.rejected.sum()),
            "nis_median": float(np.median(drive.nis[drive.nis > 0.0])) if (drive.nis > 0.0).any() else None,
        },
        "curved_mean": float(drive.curved[levelled].mean()) if levelled.any() else None,
        "trust": {
            "median_m": float(np.median(drive.trust_m[levelled])) if levelled.any() else None,
            "exceeded": int((off[levelled] > drive.trust_m[levelled]).sum()),
        },
        "levels": {
            f"{risk:g}": bounding_by_axis(error[levelled], drive.levels_m[levelled, 1 + k])
            for k, risk in enumerate(config.risks)
            if levelled.any()
        },
        "caution": CAUTION,
    }  # fmt: skip


def _errors(drive: FilterDrive) -> Array:
    """Estimate less truth along and across the estimated heading, (T, 2)."""
    off = drive.position_m - drive.sensors.truth_m
    return np.asarray((track_from_enu_matrix(drive.heading_rad) @ off[..., None])[..., 0])


def _spread(value: Array) -> dict[str, float] | None:
    """RMS, median, 95 % and largest."""
    if not value.size:
        return None
    return {
        "rms": float(np.sqrt(np.square(value).mean())), "median": float(np.median(value)),
        "p95": float(np.quantile(value, 0.95)), "max": float(value.max()),
    }  # fmt: skip


def _record(drive: FilterDrive, case: int) -> Record:
    """Epochs with a truth, with the levels of a case."""
    s, error = drive.sensors, _errors(drive)
    k = s.known
    level = drive.levels_m[k, case]
    return Record(
        s.time_s[k], drive.mode[k], error[k, 0], error[k, 1], level[:, 0], level[:, 1], drive.alert[k],
        drive.available[k],
    )  # fmt: skip
