"""Inertial dead reckoning in artificial outages of a recorded drive: gyros and accelerometers, without wheels.

The recording is an inertial log with a solution of RTKLIB (:mod:`lanebound.integrity.recorded.imu_log`). The sensor
is levelled by gravity at rest. From the first part of the drive follow its azimuth in the vehicle, the lag of its
clock and the bias of its yaw rate (:func:`motion_of_log`). An outage starts at the position, track and speed of the
solution. Along the track

    v(t) = v_0 + int (f - g (p - p_0) - c) dt

with the forward specific force f, the pitch p by the gyro, and c the mean of the integrand over ``settle_s`` before the
outage, less the acceleration of the solution there: slope and bias of the accelerometer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.plotting import save
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import (
    ecef_from_geodetic,
    enu_axes,
    geodetic_from_ecef,
)
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.recorded.imu_log import G_MPS2, ImuLog, levelled, read_imu_log
from lanebound.integrity.recorded.rtklib import RtkSolution, read_rtk_solution
from lanebound.integrity.recorded.source import UNTIMED, interpolated, notes
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.outages import OutageErrors, averaged, drift_figure, errors_on_track, levels_from_fix
from lanebound.integrity.replay.reckoning import BridgeConfig, integral, reckon, turned
from lanebound.integrity.replay.sensor_checks import (
    ACCELERATION,
    CLEARLY,
    LAG_S,
    LEAST_CORRELATION,
    PITCH_RATE,
    SPEED,
    YAW_RATE,
    Agreement,
    Quantity,
    correlation,
    require_agreement,
    require_changing,
    require_lag,
    require_throughout,
    with_rate,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LAGS_S = np.arange(-0.5, 0.5001, 0.01)
MOVING_MPS = 2.0  # slowest speed at which a velocity of the solution gives the track
REST_MPS = 0.3
OLD_MPS, OLD_SHARE = 1.0, 0.2  # a velocity that differs more from the change of position is not of its epoch
LONGEST_GAP_S = 0.6  # between epochs of the solution
WORST_QUALITY = 2  # of RTKLIB: 1 fixed, 2 float
RADIANS = 0.1  # relative, of velocities that fit; read as degrees they are 57 times too large
LEAST_COHERENCE = 0.7
MIRRORS = ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0])  # that of the third axis shows in the yaw rate
MIRRORED = 0.05  # by how much coherence must be better with a mirrored axis
SLOPE_S = 2.0  # over which changes of the slope of the road are compared with the pitch gyro


class ImuOutageConfig(Config):
    """Parameters of the outages and assumed errors of the sensors."""

    rate_hz: float = Field(10.0, gt=0.0, le=100.0, description="epochs in a second [Hz]")
    longest_s: float = Field(10.0, gt=0.0, description="length of an outage [s]")
    every_s: float = Field(1.0, gt=0.0, description="time between the starts of outages [s]")
    rest_s: float = Field(2.0, gt=0.0, description="first part, at rest: gravity and biases of the gyros [s]")
    calibration_s: float = Field(
        60.0, gt=0.0, description="driving time used only to find azimuth, lag and yaw bias of the sensor [s]"
    )
    settle_s: float = Field(
        5.0, gt=0.0, description="time before an outage in which slope and accelerometer bias are found [s]"
    )
    fix_sigma_m: float = Field(0.02, gt=0.0, description="position of the solution, 1 sigma on each axis [m]")
    acceleration_bias_mps2: float = Field(
        0.15, ge=0.0, description="bound of the forward acceleration's error after settling [m/s^2]; chosen"
    )
    pitch_drift_degps: float = Field(0.05, ge=0.0, description="bound of the pitch rate's error [deg/s]; chosen")
    risk: RiskConfig = RiskConfig(integrity_risk=1e-3)
    bridge: BridgeConfig = BridgeConfig(
        speed_bias_mps=0.1, speed_scale=0.005, heading_sigma_deg=0.5, heading_bias_deg=0.5, heading_drift_degps=0.05
    )


@dataclass(frozen=True)
class InertialMotion:
    """Epochs (T,): time from the start [s], reference position (T, 2) E, N [m], track [rad] and speed [m/s]; forward
    specific force [m/s^2], pitch by the gyro [rad], yaw rate, positive to the right [rad/s]; whether the solution is
    usable; ``first`` is the epoch after the calibration; ``bridged`` are the epochs at a gap of log or solution."""

    time_s: Array
    position_m: Array
    track_rad: Array
    true_speed_mps: Array
    force_mps2: Array
    pitch_rad: Array
    yaw_rate_radps: Array
    known: Bools
    first: int
    bridged: Bools


def motion_of_log(log: ImuLog, track: RtkSolution, config: ImuOutageConfig) -> tuple[InertialMotion, dict[str, Any]]:
    """Resample log and solution to common times, and find lag, azimuth and biases of the sensor.

    Raises
    ------
    InputError
        The log does not begin at rest, the two files share too little time, or the first ``calibration_s`` of driving
        have too few accelerations to find the azimuth, or a sensor contradicts the solution: unit, sign, axis or clock.
    """
    _require_usable(track)
    at = _common_times(log, track, config)
    place, speed, heading, known, near = _reference(track, at)
    turning, ahead = np.gradient(heading, at), np.gradient(speed, at)
    on = known & near & (speed > MOVING_MPS)
    _require_changing_axes(log, at[on], turning[on], ahead[on])
    level, roll, pitch = levelled(log, config.rest_s)
    rates = _rates(log, config)
    first, bridged = _calibrated_from(log, at, speed, known, near, config)
    part = np.flatnonzero(known[:first] & ~bridged[:first] & (speed[:first] > MOVING_MPS))
    seconds, sensed = part.size / config.rate_hz, partial(_sensed, log, at, config.rate_hz)
    late, alike = require_lag("the log", turning[part], lambda lag: sensed(rates[:, 2], lag)[part], YAW_RATE)
    turns = require_agreement(YAW_RATE, "deg/s", "the log", turning[part], alike, seconds)
    _require_rest(log, at, speed, config)
    lag = _lag_of_turns(lambda lag: sensed(rates[:, 2], lag)[part], turning[part])
    yaw = sensed(rates[:, 2], lag)
    bias = float((yaw[part] - turning[part]).mean())
    force = np.stack([sensed(level.force_mps2[:, k], lag) for k in range(2)], -1)
    wanted = np.stack([ahead[part], speed[part] * turning[part]], -1)
    azimuth, coherence = _mount(force[part], wanted)
    c, s = math.cos(azimuth), math.sin(azimuth)
    forward = c * force[:, 0] + s * force[:, 1]
    others = [_rates(replace(log, rate_radps=other), config) for other in _other_gyros(log.rate_radps)]
    pitched, *mirrored = (
        integral(at, c * sensed(by[:, 1], lag) - s * sensed(by[:, 0], lag)) for by in (rates, *others)
    )
    pushes = require_agreement(ACCELERATION, "g", "the log", ahead[part], forward[part], seconds)
    climbs = _slopes_agree(track, at, speed, [pitched, *mirrored], part, config)
    driven = np.flatnonzero(known & ~bridged & with_rate(speed > MOVING_MPS))

    def throughout(quantity: Quantity, unit: str, true: Array, value: Array) -> None:
        since_s = at[driven] - log.gps_time_s[0]
        require_throughout(quantity, unit, "the log", since_s, true[driven], lambda by: sensed(value, by)[driven], lag)

    throughout(YAW_RATE, "deg/s", turning, rates[:, 2])
    throughout(ACCELERATION, "g", ahead, level.force_mps2[:, :2] @ [c, s])
    motion = InertialMotion(at - at[0], place, heading, speed, forward, pitched, yaw - bias, known, first, bridged)
    agreements = {"yaw rate": turns, "forward acceleration": pushes, "pitch rate": climbs}
    return motion, {
        "roll_deg": math.degrees(roll), "pitch_deg": math.degrees(pitch), "azimuth_deg": math.degrees(-azimuth),
        "coherence": coherence, "lag_s": lag, "yaw_bias_degps": math.degrees(bias), "from_s": float(at[first] - at[0]),
        "agreement": {
            name: replace(found, lag_s=lag if late is not None else None, corrected=True).figures()
            for name, found in agreements.items()
        },
    }  # fmt: skip


def _sensed(log: ImuLog, at_s: Array, rate_hz: float, value: Array, lag_s: float) -> Array:
    """Means of values of the log over an epoch around times (T,) plus a lag.  (T,)."""
    return averaged(log.gps_time_s, value, np.clip(at_s + lag_s, log.gps_time_s[0], log.gps_time_s[-1]), rate_hz)


def _require_rest(log: ImuLog, at_s: Array, speed_mps: Array, config: ImuOutageConfig) -> None:
    """Refuse a log whose car moves in its first ``rest_s``."""
    moved = float(speed_mps[at_s < log.gps_time_s[0] + config.rest_s].max(initial=0.0))
    if moved > REST_MPS:
        raise InputError(
            f"the log must begin with {config.rest_s:g} s at rest, moves at {moved:.1f} m/s: give another rest_s"
        )


def _require_usable(track: RtkSolution) -> None:
    """Refuse a solution without velocities, or without rows that are good enough for a reference."""
    if track.velocity_neu_mps is None:
        raise InputError(
            "the solution must have velocities in all rows, has none in some: set out-outvel of RTKLIB to on"
        )
    if not ((track.quality >= 1) & (track.quality <= WORST_QUALITY)).any():
        kinds = ", ".join(map(str, np.unique(track.quality)))
        raise InputError(
            f"the solution must have rows of Q 1 (fixed) or 2 (float), its {track.quality.size} rows have Q {kinds}: "
            "process it by RTK with a base (pos1-posmode of RTKLIB kinematic)"
        )


def _require_changing_axes(log: ImuLog, at_s: Array, turning_radps: Array, ahead_mps2: Array) -> None:
    """Refuse a frozen axis, by the reference (N,) at times (N,) [s] of driving; raw, as levelling mixes axes."""
    sensors = (YAW_RATE, "rate", log.rate_radps, turning_radps), (ACCELERATION, "force", log.force_mps2, ahead_mps2)
    for quantity, sensor, values, reference in sensors:
        for axis, value in zip("xyz", values.T, strict=True):
            named = quantity._replace(name=f"{sensor} {axis}")
            require_changing(named, "the log", log.gps_time_s, value, at_s, reference)


def _common_times(log: ImuLog, track: RtkSolution, config: ImuOutageConfig) -> Array:
    """Times (N,) [s] at ``rate_hz`` that log and solution share, less the longest lag; InputError for too few."""
    start, end = max(log.gps_time_s[0], track.gps_time_s[0]), min(log.gps_time_s[-1], track.gps_time_s[-1])
    margin = float(LAGS_S[-1])
    at = np.arange(start + margin, end - margin, 1.0 / config.rate_hz)
    if at.size < config.rate_hz * (config.settle_s + config.longest_s):
        raise InputError(
            f"log and solution must share {config.settle_s + config.longest_s + 2 * margin:g} s, share "
            f"{max(end - start, 0.0):.1f} s: are they of one drive, and both in GPS time?"
        )
    return at


def _lag_of_turns(sensed: Callable[[float], Array], turning: Array) -> float:
    """The lag [s] at which sensed yaw rates differ least from those of the solution, but for a bias; InputError at the
    edge of LAGS_S."""
    off = [float(np.std(sensed(float(lag)) - turning)) for lag in LAGS_S]
    lag = float(LAGS_S[int(np.argmin(off))])
    if lag in LAGS_S[[0, -1]]:  # the minimum lies beyond, or nowhere
        raise InputError(
            f"turns must show the lag of the log within {LAGS_S[-1]:g} s, its edge fits best: give a longer "
            "calibration_s, with turns, or correct the times"
        )
    return lag


def _rates(log: ImuLog, config: ImuOutageConfig) -> Array:
    """Rates (N, 3) of the levelled log less their means at rest [rad/s]."""
    rates, rest = levelled(log, config.rest_s)[0].rate_radps, log.gps_time_s < log.gps_time_s[0] + config.rest_s
    return np.asarray(rates - rates[rest].mean(0))


def _slopes_agree(
    track: RtkSolution, at: Array, speed: Array, pitches: list[Array], part: NDArray[np.int64],
    config: ImuOutageConfig,
) -> Agreement:  # fmt: skip
    """Agreement of the pitch by the gyro with the slope by the velocities, as changes over SLOPE_S in rad/s.

    ``pitches`` are those with the axes of the log, and with those of :func:`_other_gyros`.

    Raises
    ------
    InputError
        One of the others fits better, or the first has another unit or sign.
    """
    assert track.velocity_neu_mps is not None
    slope = np.arctan2(np.interp(at, track.gps_time_s, track.velocity_neu_mps[:, 2]), np.maximum(speed, MOVING_MPS))
    step = max(round(SLOPE_S * config.rate_hz), 1)
    k = part[(part + step < at.size) & np.isin(part + step, part)]
    by_solution, by_gyro, *others = ((values[k + step] - values[k]) / SLOPE_S for values in (slope, *pitches))
    given, found = correlation(by_solution, by_gyro), [correlation(by_solution, other) for other in others]
    better = max(found)
    if better > max(given + CLEARLY, LEAST_CORRELATION):
        # a reversed sign explains as much; of an axis midway between the two it is the same as their exchange
        or_vu = ", or change the sign of vu of the solution" * (-given > better - CLEARLY)
        if found.index(better) >= len(MIRRORS):
            raise InputError(
                "rate x and rate y of the log must be about the axes forward and left, or turned from there, exchanged "
                f"their correlation with the solution rises from {given:.2f} to {better:.2f}: exchange the two columns"
                f"{or_vu}"
            )
        raise InputError(_mirrored_text("gyro or the accelerometer", given, better) + or_vu)
    return require_agreement(
        PITCH_RATE, "deg/s", "the log, or vu of the solution,", by_solution, by_gyro, k.size / config.rate_hz
    )


def _other_gyros(rate_radps: Array) -> list[Array]:
    """Rates (N, 3) with an axis mirrored (MIRRORS), and with roll and pitch exchanged, of either sign."""
    exchanged = rate_radps[:, [1, 0, 2]]
    return [*(rate_radps * of for of in MIRRORS), exchanged, exchanged * [-1.0, -1.0, 1.0]]


def _mirrored_text(sensor: str, given: float, better: float) -> str:
    return (
        f"axes of the log must be forward, left, up or turned from there, with one axis of the {sensor} mirrored its "
        f"correlation with the solution rises from {given:.2f} to {better:.2f}: change the sign of one column"
    )


def _reference(track: RtkSolution, at: Array) -> tuple[Array, Array, Array, Bools, Bools]:
    """Position (T, 2), speed, track, whether they are usable and whether they are in no gap (T,), at times; the track
    holds while at rest."""
    enu = (track.position_ecef_m - track.position_ecef_m[0]) @ enu_axes(track.position_ecef_m[0])
    place = interpolated(at, track.gps_time_s, enu[:, :2])
    assert track.velocity_neu_mps is not None
    north, east = (np.interp(at, track.gps_time_s, track.velocity_neu_mps[:, k]) for k in range(2))
    speed = np.hypot(east, north)
    moving = speed > MOVING_MPS
    newest = np.maximum.accumulate(np.where(moving, np.arange(at.size), -1))
    course = np.arctan2(east, north)
    heading = np.unwrap(course[np.maximum(newest, int(np.argmax(moving)))])
    usable = (track.quality >= 1) & (track.quality <= WORST_QUALITY) & ~_old(track, enu)
    behind = np.clip(np.searchsorted(track.gps_time_s, at, side="right") - 1, 0, track.gps_time_s.size - 2)
    near = track.gps_time_s[behind + 1] - track.gps_time_s[behind] <= LONGEST_GAP_S
    return place, speed, heading, usable[behind] & usable[behind + 1], np.asarray(near)


def _old(track: RtkSolution, enu: Array) -> Bools:
    """Epochs whose velocity belongs to another epoch: it contradicts the change of position from and to its neighbours.

    Raises
    ------
    InputError
        Most do, by a factor, a sign or an axis.
    """
    assert track.velocity_neu_mps is not None
    time = track.gps_time_s
    if time.size < 3:
        return np.zeros(time.size, dtype=np.bool_)
    moved = np.gradient(enu[:, :2], time, axis=0)
    reported = track.velocity_neu_mps[:, [1, 0]]
    near = np.flatnonzero(
        (np.diff(time, prepend=time[0]) <= LONGEST_GAP_S) & (np.diff(time, append=time[-1]) <= LONGEST_GAP_S)
    )
    _require_degrees(track, reported)
    require_agreement(SPEED, "m/s", "the solution's velocities", moved[near].ravel(), reported[near].ravel(), near.size)
    off = np.linalg.norm(moved - reported, axis=-1)
    return np.asarray(off > OLD_MPS + OLD_SHARE * np.linalg.norm(moved, axis=-1))


def _require_degrees(track: RtkSolution, reported_mps: Array) -> None:
    """Raise InputError where the velocities (N, 2) of a solution fit its positions if these are in radians."""
    latitude, longitude, height = geodetic_from_ecef(track.position_ecef_m)
    driven = np.linalg.norm(reported_mps, axis=-1) > MOVING_MPS
    if np.abs(np.degrees(latitude)).max() > 0.5 * math.pi or not driven.any():
        return
    place = ecef_from_geodetic(np.degrees(latitude), np.degrees(longitude), height)
    moved_mps = np.linalg.norm(np.gradient(place, track.gps_time_s, axis=0), axis=-1)
    if abs(float(np.median(moved_mps[driven] / np.linalg.norm(reported_mps[driven], axis=-1))) - 1.0) < RADIANS:
        raise InputError(
            f"latitude and longitude of the solution must be in degrees, got {math.degrees(latitude[0]):.4f}, "
            f"{math.degrees(longitude[0]):.4f}, which fit its velocities as radians: convert them to degrees"
        )


def _calibrated_from(
    log: ImuLog, at: Array, speed: Array, known: Bools, near: Bools, config: ImuOutageConfig
) -> tuple[int, Bools]:
    """The epoch at which the car has driven for ``calibration_s``, and the epochs at gaps of log or solution (T,).

    Raises
    ------
    InputError
        It does not drive for so long, or the log has a gap before.
    """
    in_gap = log.timing.bridged(at, LAG_S + 1.0 / config.rate_hz, LAG_S + 1.0 / config.rate_hz)
    bridged = in_gap | ~near
    driven = np.cumsum((speed > MOVING_MPS) & known & ~bridged) / config.rate_hz
    if driven[-1] < config.calibration_s:
        raise InputError(
            f"the drive must move for {config.calibration_s:g} s of calibration, moves for {driven[-1]:.1f} s: "
            "lower calibration_s"
        )
    first = int(np.argmax(driven >= config.calibration_s))
    if in_gap[:first].any():
        raise InputError(
            f"the log must be without gaps until its calibration ends, {at[first] - at[0]:.1f} s after the start, has "
            f"{log.timing.note}: lower calibration_s, or cut the log after the gap"
        )
    return first, bridged


def _mount(force: Array, reference: Array) -> tuple[float, float]:
    """Azimuth of the sensor and the correlation of its accelerations, as :func:`_azimuth`.

    Raises
    ------
    InputError
        The accelerations do not show it, or do with one axis mirrored.
    """
    azimuth, coherence = _azimuth(force, reference)
    mirrored = _azimuth(force * [1.0, -1.0], reference)[1]
    if mirrored > max(coherence + MIRRORED, LEAST_COHERENCE):
        raise InputError(_mirrored_text("accelerometer", coherence, mirrored))
    if coherence < LEAST_COHERENCE:
        raise InputError(
            f"accelerations must show how the sensor is mounted: their correlation with the solution is "
            f"{coherence:.2f}, at least {LEAST_COHERENCE}: give a longer calibration_s, with turns and braking"
        )
    return azimuth, coherence


def _azimuth(force: Array, reference: Array) -> tuple[float, float]:
    """Angle by which the sensor's x axis lies to the left of forward, and correlation; both (N, 2) forward, right."""
    sensed, given = ((values - values.mean(0)) @ np.array([1.0, 1.0j]) for values in (force, reference))
    product = complex(np.vdot(given, sensed))
    scale = math.sqrt(float(np.vdot(given, given).real * np.vdot(sensed, sensed).real))
    return math.atan2(product.imag, product.real), abs(product) / max(scale, 1e-9)


def run_inertial_outages(motion: InertialMotion, config: ImuOutageConfig) -> OutageErrors:
    """All outages that start after the calibration at more than 2 m/s and have a usable solution throughout.

    Raises
    ------
    InputError
        There is none.
    """
    n, before = round(config.longest_s * config.rate_hz), round(config.settle_s * config.rate_hz)
    step = max(round(config.every_s * config.rate_hz), 1)
    moving = np.array([
        s for s in range(max(motion.first, before), motion.time_s.size - n, step)
        if motion.true_speed_mps[s] > MOVING_MPS and motion.known[s - before : s + n + 1].all()
    ], dtype=np.int64)  # fmt: skip
    starts = moving[[not motion.bridged[s - before : s + n + 1].any() for s in moving]]
    if not starts.size:
        raise InputError(
            f"after the calibration the drive must have {config.settle_s + config.longest_s:g} s with a usable "
            "solution (Q 1 or 2, no gaps) and no gap of the log, has none: lower longest_s or calibration_s"
        )
    estimated, heading, speed = np.zeros((starts.size, n, 2)), np.zeros((starts.size, n)), np.zeros((starts.size, n))
    for i, s in enumerate(starts):
        part = slice(s, s + n + 1)
        reached = _speed(motion, s, n, before)
        path = reckon(motion.time_s[part], reached, motion.yaw_rate_radps[part])
        estimated[i] = motion.position_m[s] + turned(path.position_m[1:], float(motion.track_rad[s]))
        heading[i], speed[i] = motion.track_rad[s] + path.heading_rad[1:], reached[1:]
    error = errors_on_track(motion.position_m, starts, estimated, heading)
    age = np.asarray((np.arange(n) + 1.0) / config.rate_hz, dtype=np.float64)
    levels = _levels(speed, heading, age, config)
    left_out = moving.size - starts.size
    return OutageErrors(age, error, levels, motion.true_speed_mps[starts], motion.time_s[starts], left_out)


def _speed(motion: InertialMotion, s: int, n: int, before: int) -> Array:
    """Speed by the accelerometer from epoch ``s`` to ``s + n`` (n + 1,) [m/s]."""
    window = slice(s - before, s + n + 1)
    time = motion.time_s[window]
    felt = motion.force_mps2[window] - G_MPS2 * (motion.pitch_rad[window] - motion.pitch_rad[s])
    gained = integral(time, felt)
    true = motion.true_speed_mps[window]
    slope = (gained[before] - (true[before] - true[0])) / (time[before] - time[0])
    return np.asarray(true[before] + gained[before:] - gained[before] - slope * (time[before:] - time[before]))


def _levels(speed_mps: Array, heading_rad: Array, age_s: Array, config: ImuOutageConfig) -> Array:
    """Levels (N, n, 2): those of a path of bounded speed and heading errors, and of the speed's growing error.

    The speed's error is at most ``b t + g d t^2 / 2``, of either sign at any time; its parts along and across the
    present heading add up with their magnitudes.
    """
    dt = 1.0 / config.rate_hz
    levels = levels_from_fix(config.bridge, config.risk, config.fix_sigma_m, dt, speed_mps, heading_rad)
    drift = G_MPS2 * math.radians(config.pitch_drift_degps)
    grown = (config.acceleration_bias_mps2 + 0.5 * drift * age_s) * age_s
    for k in range(age_s.size):
        turn = heading_rad[:, : k + 1] - heading_rad[:, k : k + 1]
        box = np.abs(np.stack([np.cos(turn), np.sin(turn)], -1)) * grown[: k + 1, None]
        levels[:, k] += dt * box.sum(1)
    return levels


AGES_S = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0)
TAG = ".tag"
CAUTION = (
    "the reference is the solution of the receiver, not a truth; outages overlap and are of one drive: the exact "
    "intervals are too narrow"
)


def imu_files(folder: Path) -> list[Path]:
    """Time tags of inertial logs (``NAME.csv.tag``) in a folder."""
    return sorted(folder.glob(f"*.csv{TAG}"))


def write_imu_outages(
    folder: Path, out: Path, config: ImuOutageConfig | None = None
) -> tuple[dict[str, Any], list[Path]]:
    """Replay a folder with ``NAME.csv``, ``NAME.csv.tag`` and one ``.pos``; writes ``replay.json`` and ``drift.png``.

    Raises
    ------
    InputError
        A file is missing, there are several of a kind, or the drive cannot be used.
    """
    config = config or ImuOutageConfig()
    tag, solution = _only(imu_files(folder), folder, "*.csv.tag"), _only(_solutions(folder), folder, "*.pos")
    plain, zipped = tag.with_suffix(""), tag.with_suffix(".gz")
    path = zipped if zipped.is_file() and not plain.is_file() else plain
    log, track = read_imu_log(path, tag), read_rtk_solution(solution)
    motion, calibration = motion_of_log(log, track, config)
    outages = run_inertial_outages(motion, config)
    ages = (*(age for age in AGES_S if age < config.longest_s), config.longest_s)
    figures = {
        "dataset": "imu_log", "caution": CAUTION, "files": [path.name, solution.name],
        "rate_hz": log.rate_hz, **outages.figures(config.risk.integrity_risk, ages),
        "agreement": calibration.pop("agreement"), "calibration": calibration,
        "stopped": notes(
            (path.name, log.stopped, log.timing), (tag.name, log.tags, UNTIMED),
            (solution.name, "; ".join(filter(None, (str(track.stopped or ""), _unused(track)))), track.timing),
        ),
    }  # fmt: skip
    summary = write_summary(out / "replay.json", figures)
    return figures, [summary, save(drift_figure(outages, config.risk.integrity_risk), out / "drift.png")]


def _unused(track: RtkSolution) -> str:
    """How many rows are neither fixed nor float, "" for none."""
    count = int(((track.quality < 1) | (track.quality > WORST_QUALITY)).sum())
    return f"{count} of {track.quality.size} rows with another Q than 1 (fixed) or 2 (float) are not used" * bool(count)


def _solutions(folder: Path) -> list[Path]:
    return sorted([*folder.glob("*.pos"), *folder.glob("*.pos.gz")])


def _only(found: list[Path], folder: Path, what: str) -> Path:
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(f"{folder} must have one {what} next to its inertial log, has {names}: leave one there")
    return found[0]
