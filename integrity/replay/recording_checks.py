"""The sensors of comma2k19 and smartLoc against the reference of the recording: unit, sign, axis, lag, position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.recorded.comma import Comma
from lanebound.integrity.recorded.imu_log import G_MPS2
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.replay.sensor_checks import (
    ACCELERATION,
    LAG_S,
    SLIP_S,
    SPEED,
    YAW_RATE,
    Agreement,
    Quantity,
    likely_unit,
    require_agreement,
    require_changing,
    require_lag,
    require_same_times,
    require_throughout,
    scale_change,
    with_rate,
)

__all__ = ["aligned_comma", "check_comma", "check_smartloc"]

Array = NDArray[np.float64]

EVERY_S, MEAN_S = 0.1, 0.4  # epochs, and the time over which a motion is taken
NEAR_S = LAG_S + MEAN_S  # of a gap, which a value there can touch
MOVING_MPS = 2.0
AWAY_M = 100.0  # of a receiver's positions from the reference, median
ALIKE = 0.8  # mean cosine of courses that are the same
EARTH_M = (6.3e6, 6.5e6)  # of ground and aircraft from the centre
GRAVITY = 0.15  # relative, of the mean force


class _Reference:
    """Motion of the reference at times (T,) inside of it, every EVERY_S, from positions in E, N (N, 2)."""

    def __init__(self, time_s: Array, place_m: Array) -> None:
        start, end = float(time_s[0]) + MEAN_S, float(time_s[-1]) - MEAN_S
        self.time_s = np.arange(start, end, EVERY_S)
        ahead, behind = (self._at(time_s, place_m, self.time_s + side * 0.5 * MEAN_S) for side in (1.0, -1.0))
        self.velocity_mps = (ahead - behind) / MEAN_S
        self.speed_mps = np.hypot(*self.velocity_mps.T)
        self.course_rad = np.unwrap(np.arctan2(self.velocity_mps[:, 0], self.velocity_mps[:, 1]))
        self.moving = with_rate(self.speed_mps > MOVING_MPS)

    @staticmethod
    def _at(time_s: Array, place_m: Array, at_s: Array) -> Array:
        return np.stack([np.interp(at_s, time_s, column) for column in place_m.T], -1)

    def rate(self, value: Array) -> Array:
        """Change of a value (T,) with time."""
        return np.asarray(np.gradient(value, EVERY_S)) if value.size > 1 else np.zeros(value.size)

    def follow(
        self, quantity: Quantity, unit: str, where: str, reference: Array, time_s: Array, value: Array,
        keep: NDArray[np.bool_],
    ) -> Agreement:  # fmt: skip
        """Agreement of a sensor's series with values (T,) of the reference at the epochs to keep, after its lag; it
        must hold throughout."""
        at = self.time_s[keep]
        require_changing(quantity, where, time_s, value, at, reference[keep])
        inside = at[(at > time_s[0] + LAG_S) & (at < time_s[-1] - LAG_S)]
        if at.size and not inside.size:
            raise InputError(
                f"times of {where} must be those of the reference, {at[0]:.1f} to {at[-1]:.1f} s, got "
                f"{time_s[0]:.1f} to {time_s[-1]:.1f} s: are they of one clock, and in s?"
            )
        wanted = reference[np.isin(self.time_s, inside)]
        means = _means(time_s, value, inside)
        since_s = inside - self.time_s[:1]
        try:
            lag, sensed = require_lag(where, wanted, means, quantity)
            found = require_agreement(quantity, unit, where, wanted, sensed, inside.size * EVERY_S)
            require_throughout(quantity, unit, where, since_s, wanted, means, lag)
        except InputError:
            changes = None if quantity.biased else scale_change(quantity, since_s, wanted, means)
            if changes is None:
                raise
            raise InputError(  # another scale in a part looks like another time
                f"scale of {where} must be the same in the whole drive, is {changes}: cut the recording there, or "
                "correct the column"
            ) from None
        return replace(found, lag_s=lag)


def _means(time_s: Array, value: Array, at_s: Array) -> Callable[[float], Array]:
    """Means of a series over MEAN_S around times (T,) plus a lag."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(time_s))])

    def mean(lag_s: float) -> Array:
        low, high = (np.interp(at_s + lag_s + side * 0.5 * MEAN_S, time_s, total) for side in (-1.0, 1.0))
        return np.asarray((high - low) / MEAN_S)

    return mean


def aligned_comma(segment: Comma) -> tuple[Comma, dict[str, Agreement]]:
    """A segment whose speeds, gyro and accelerometer have no lag of SLIP_S and more behind its reference, where the
    drive shows one, and what :func:`check_comma` finds, which it raises for."""
    found = check_comma(segment)
    parts = {
        "speed": "CAN/speed", "wheel_speed": "CAN/wheel_speed", "rotation_rate": "yaw rate",
        "acceleration": "forward acceleration",
    }  # fmt: skip
    moved: dict[str, Any] = {}
    for part, name in parts.items():
        own = {key: of for key, of in found.items() if key.startswith(name) and of.lag_s is not None}
        lag_s = float(np.mean([of.lag_s for of in own.values()])) if own else 0.0  # wheels have one clock
        if abs(lag_s) >= SLIP_S:
            moved[part] = getattr(segment, part).earlier(lag_s)
            found |= {key: replace(of, corrected=True) for key, of in own.items()}
    return replace(segment, **moved), found


def check_comma(segment: Comma) -> dict[str, Agreement]:
    """How speed, wheels, gyro, accelerometer and receiver of a comma2k19 segment follow its reference, by name.

    Raises
    ------
    InputError
        One contradicts the reference by its unit, sign, axis, clock or place.
    """
    r = segment.reference
    _require_on_earth("global_pose/frame_positions", r.position_ecef_m)
    latitude, longitude, height = geodetic_from_ecef(r.position_ecef_m[0])
    axes = ecef_from_enu_matrix(latitude, longitude)
    place, reported = ((r.position_ecef_m - r.position_ecef_m[0]) @ axes)[:, :2], (r.velocity_ecef_mps @ axes)[:, :2]
    motion = _Reference(r.time_s, place)
    clear = ~segment.bridged(motion.time_s, NEAR_S, NEAR_S)
    if clear.sum() * EVERY_S < 1.0:
        return {}
    velocity = np.stack([_means(r.time_s, column, motion.time_s)(0.0) for column in reported.T], -1)
    found = {
        "reference velocity": replace(
            require_agreement(
                SPEED, "m/s", "global_pose/frame_velocities", motion.velocity_mps[clear].ravel(),
                velocity[clear].ravel(), clear.sum() * EVERY_S,
            ),
            lag_s=0.0,  # of the same rows
        )
    }  # fmt: skip
    for name, values in (("CAN/speed", segment.speed), ("CAN/wheel_speed", segment.wheel_speed)):
        for k, column in enumerate(np.atleast_2d(values.value.T)):
            there = clear & ~values.timing.bridged(motion.time_s, NEAR_S, NEAR_S)
            found[f"{name} {k}"] = motion.follow(SPEED, "m/s", name, motion.speed_mps, values.time_s, column, there)
    gyro, force = segment.rotation_rate, segment.acceleration
    turning, driven = motion.rate(motion.course_rad), clear & motion.moving
    found["yaw rate"] = motion.follow(YAW_RATE, "rad/s", "IMU/gyro", turning, gyro.time_s, gyro.value[:, 2], driven)
    _require_gravity(force.value)
    ahead = motion.rate(motion.speed_mps)
    found["forward acceleration"] = motion.follow(
        ACCELERATION, "m/s^2", "IMU/accelerometer", ahead, force.time_s, force.value[:, 0],
        driven & ~force.timing.bridged(motion.time_s, NEAR_S, NEAR_S),
    )  # fmt: skip
    if segment.fixes is not None:
        found["receiver speed"] = _check_fixes(segment, motion, place, axes, float(height))
    return found


def _require_on_earth(where: str, place_ecef_m: Array) -> None:
    """Refuse positions that are no ECEF coordinates in metres."""
    radius = float(np.median(np.linalg.norm(place_ecef_m, axis=-1)))
    if not EARTH_M[0] < radius < EARTH_M[1]:
        raise InputError(
            f"{where} must be ECEF positions in m, some 6.4e6 from the Earth's centre, got {radius:.4g}: convert them "
            "(from km, or from latitude and longitude)"
        )


def _require_gravity(force_mps2: Array) -> None:
    """Refuse a mean force that is gravity in another unit or on another axis."""
    mean = force_mps2.mean(0)
    size = float(np.linalg.norm(mean)) / G_MPS2
    unit = likely_unit(ACCELERATION, "m/s^2", size, size)
    if unit is not None and abs(size - 1.0) > GRAVITY:
        raise InputError(
            f"IMU/accelerometer must feel gravity in m/s^2, its mean is {size * G_MPS2:.3g}: it is probably in {unit}; "
            "convert it"
        )
    if abs(size - 1.0) <= GRAVITY and mean[2] > -0.5 * G_MPS2:
        raise InputError(
            f"IMU/accelerometer must have the axes forward, right, down, so that its mean is near (0, 0, -9.8), got "
            f"({', '.join(f'{v:.1f}' for v in mean)}): reorder the axes or change their signs"
        )


def _check_fixes(segment: Comma, motion: _Reference, place: Array, axes: Array, height: float) -> Agreement:
    """Places, courses and speeds of the receiver's fixes against the reference."""
    assert segment.fixes is not None
    f, r = segment.fixes, segment.reference
    inside = (f.time_s > motion.time_s[0]) & (f.time_s < motion.time_s[-1])
    if not inside.any():
        return Agreement(1.0, 0.0, False)
    time = f.time_s[inside]
    true = np.stack([np.interp(time, r.time_s, column) for column in place.T], -1)

    def local(latitude: Array, longitude: Array) -> Array:
        ecef = ecef_from_geodetic(latitude, longitude, np.full(f.time_s.size, height))
        return np.asarray(((ecef - r.position_ecef_m[0]) @ axes)[:, :2])

    def away(latitude: Array, longitude: Array) -> float:
        return float(np.median(np.linalg.norm(local(latitude, longitude)[inside] - true, axis=-1)))

    lat, lon = np.radians(f.latitude_deg), np.radians(f.longitude_deg)
    require_same_times("GNSS/live_gnss_ublox", f.time_s, local(lat, lon), r.time_s, place)
    off = away(lat, lon)
    if off > AWAY_M:
        forms = {"in radians": (f.latitude_deg, f.longitude_deg), "exchanged": (lon, lat)}
        likely = next((name for name, angles in forms.items() if away(*angles) <= AWAY_M), "of another drive")
        raise InputError(
            f"GNSS/live_gnss_ublox must have latitude and longitude in degrees, its positions are {off:.0f} m from the "
            f"reference (median): they are probably {likely}; convert them"
        )
    _require_course(f.course_deg[inside], np.interp(time, motion.time_s, motion.course_rad),
                    np.interp(time, motion.time_s, motion.speed_mps) > MOVING_MPS)  # fmt: skip
    return motion.follow(
        SPEED, "m/s", "GNSS/live_gnss_ublox", motion.speed_mps, f.time_s, f.speed_mps, motion.time_s > 0.0
    )


def _require_course(course_deg: Array, true_rad: Array, moving: NDArray[np.bool_]) -> None:
    """Refuse courses that are not clockwise from North in degrees."""
    if not moving.any():
        return
    given, true = course_deg[moving], true_rad[moving]
    forms = {
        "clockwise from North in degrees": np.radians(given), "in radians": given,
        "counterclockwise from East": 0.5 * np.pi - np.radians(given),
        "counterclockwise from North": -np.radians(given), "of the opposite direction": np.radians(given) + np.pi,
    }  # fmt: skip
    fits = {name: float(np.cos(course - true).mean()) for name, course in forms.items()}
    first, likely = next(iter(forms)), max(fits, key=lambda name: fits[name])
    if fits[first] < ALIKE:
        better = f"they are probably {likely}" if fits[likely] >= ALIKE else "no usual form explains them"
        raise InputError(
            f"GNSS/live_gnss_ublox must have courses {first}, their mean cosine with the reference is "
            f"{fits[first]:.2f}: {better}; convert them"
        )


def check_smartloc(drive: SmartLoc) -> dict[str, Agreement]:
    """How wheels and gyro of a smartLoc drive follow its ground truth, by name; empty without one.

    Raises
    ------
    InputError
        One contradicts the truth by its unit, sign, axis or clock.
    """
    o, truth = drive.odometry, drive.truth
    if truth is None or truth.time_s.size < 3 or o.time_s.size < 3:
        return {}
    _require_on_earth("point3", truth.position_ecef_m)
    axes = ecef_from_enu_matrix(*geodetic_from_ecef(truth.position_ecef_m[0])[:2])
    motion = _Reference(truth.time_s, ((truth.position_ecef_m - truth.position_ecef_m[0]) @ axes)[:, :2])
    clear = ~drive.bridged(motion.time_s) & truth.at(motion.time_s)[1]
    if clear.sum() * EVERY_S < 1.0:
        return {}
    turning = motion.rate(motion.course_rad)
    return {
        "speed": motion.follow(SPEED, "m/s", "odom3", motion.speed_mps, o.time_s, o.speed_mps, clear),
        "yaw rate": motion.follow(
            YAW_RATE, "rad/s", "odom3", turning, o.time_s, -o.yaw_rate_left_radps, clear & motion.moving
        ),
    }
