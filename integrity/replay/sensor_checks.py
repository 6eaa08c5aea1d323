"""Sensors of comma2k19 and smartLoc against the reference of the recording: unit, sign, axis, lag, position.

The sensed value is regressed on the reference's, which has errors of its own. They pull the slope towards 0, so that
the true one lies between the slope and slope / correlation^2 (Frisch 1934, "Statistical confluence analysis"). A slope
that cannot be near 1 is a unit or a sign; a strong motion that the sensor does not follow is another axis or drive. A
drive with too little motion proves nothing, which the result says. Windows show what only a part of a drive has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, enu_axes, geodetic_from_ecef
from lanebound.integrity.recorded.comma import Comma
from lanebound.integrity.recorded.imu_log import G_MPS2
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay.reckoning import integral

Array = NDArray[np.float64]

SLOPES = 0.75, 1.3  # of a sensor in its unit; wheels and gyros are good to some percent, slopes of roads add to forces
LEAST_CORRELATION = 0.5  # of a sensor that follows a motion
LASTING_S = 1.0  # errors of a reference last as long
SURE = 3.0  # deviations
LIKE = 0.1  # relative, of the slope of a unit
LAG_S, LAG_STEP_S, LONGEST_LAG_S = 0.5, 0.01, 20.0
NEARER = 3.0  # times nearer are positions whose times are right
WINDOW_S, WINDOW_STEP_S = 8.0, 2.0
STILL, STRAIGHT, MOVES = 0.25, 0.05, 0.5  # spread in a window over a strong motion: below, too little to test
FROZEN = 1e-6  # of a strong motion; beyond rounding, far below the resolution of any sensor
FROZEN_S = 4.0  # of one value; recorded sensors keep one for 0.5 s at most while the car drives
SLIP_S = 0.1  # of lags that need no clock: slip grows with the acceleration, which looks like 0.02 to 0.05 s early
JUMP_S, LONGEST_JUMP_S = 0.25, 0.7  # of a clock inside a drive; a longer one leaves a gap, or no likeness
SURE_CORRELATION, CLEARLY = 0.7, 0.2  # of a lag that needs no wider search, and by how much another must be better


class Quantity(NamedTuple):
    """A sensed quantity: name, units [SI], spread of a motion that a sensor must follow, whether it has a bias."""

    name: str
    units: Mapping[str, float]
    strong: float
    biased: bool


YAW_RATE = Quantity(
    "yaw rate",
    {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mrad/s": 1e-3, "mdeg/s": math.pi / 180e3, "deg/h": math.pi / 648e3},
    math.radians(3.0), True,
)  # fmt: skip
PITCH_RATE = YAW_RATE._replace(name="pitch rate", strong=math.inf)  # springs move a car more than slopes do
SPEED = Quantity(
    "speed",
    {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "knots": 0.514444, "ft/s": 0.3048, "cm/s": 0.01, "mm/s": 1e-3},
    2.0, False,
)  # fmt: skip
ACCELERATION = Quantity(
    "acceleration",
    {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "cm/s^2": 0.01, "mm/s^2": 1e-3, "ft/s^2": 0.3048}, 0.7, True,
)  # fmt: skip
"""A spread of 0.7 m/s^2 is that of braking and of bends; slopes of the road add to what a sensor feels."""


@dataclass(frozen=True)
class Agreement:
    """Slope of sensed on reference, their correlation, whether the motion was strong enough to prove anything, and the
    lag behind the reference [s], None where the drive does not show it, and whether it is taken out of the times."""

    slope: float
    correlation: float
    tested: bool
    lag_s: float | None = None
    corrected: bool = False

    def figures(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self)


def require_agreement(
    quantity: Quantity, unit: str, where: str, reference: Array, sensed: Array, seconds: float
) -> Agreement:
    """How values (N,) of a sensor follow those of the reference over ``seconds``; both in SI, read as ``unit``.

    Raises
    ------
    InputError
        Slope or correlation show another unit, sign or axis; the message names the likely one.
    """
    pair = np.stack([reference, sensed])
    if reference.size < 3:
        return Agreement(1.0, 0.0, False)
    centred = pair - pair.mean(1, keepdims=True)
    (rr, rs), (_, ss) = (centred @ centred.T).tolist()
    alike = rs / math.sqrt(rr * ss) if rr * ss > 0.0 else 0.0
    if not quantity.biased:
        (rr, rs), (_, ss) = (pair @ pair.T).tolist()
    slope = rs / rr if rr > 0.0 else 1.0
    fit2 = min(rs * rs / (rr * ss), 1.0) if rr * ss > 0.0 else 0.0
    spread = math.sqrt((1.0 - fit2) * ss / rr / max(seconds / LASTING_S, 1.0)) if rr > 0.0 else math.inf
    strong = math.sqrt(rr / reference.size) >= quantity.strong
    follows = fit2 >= LEAST_CORRELATION**2
    low, high = max(abs(slope) - SURE * spread, 0.0), (abs(slope) + SURE * spread) / max(fit2, 1e-9)
    wrong = slope < 0.0 or low > SLOPES[1] or high < SLOPES[0]
    if (follows and wrong) or (strong and not follows):
        raise InputError(
            f"{quantity.name} of {where} must follow the reference, the slope on it is {slope:.3g} and the correlation "
            f"{alike:.2f}: {_likely(quantity, unit, slope, (low, high), follows)}"
        )
    return Agreement(slope, alike, follows)


def _likely(quantity: Quantity, unit: str, slope: float, bounds: tuple[float, float], follows: bool) -> str:
    """What a slope says of the columns, as a remedy."""
    if not follows:
        return "it is probably another axis, another drive, or a sensor without a signal; correct the columns"
    found = likely_unit(quantity, unit, *bounds)
    sign = "its sign is reversed" if slope < 0.0 else ""
    scale = f"it is probably in {found}, not in {unit}" if found is not None else ""
    if found is None and (bounds[1] < SLOPES[0] or bounds[0] > SLOPES[1]):
        return "no usual unit explains its size, it is probably another axis or drive; correct the columns"
    return f"{' and '.join(text for text in (sign, scale) if text)}; convert the column"


def likely_unit(quantity: Quantity, unit: str, low: float, high: float) -> str | None:
    """The unit of values that are by a factor between ``low`` and ``high`` too large when read as ``unit``, None where
    no usual one or ``unit`` itself is."""
    factors = {name: quantity.units[unit] / size for name, size in quantity.units.items()}
    fits = {name for name, factor in factors.items() if low / (1.0 + LIKE) <= factor <= high * (1.0 + LIKE)}
    middle = math.log(max(low * high, 1e-24)) / 2.0
    return None if unit in fits or not fits else min(fits, key=lambda name: abs(math.log(factors[name]) - middle))


def require_lag(
    where: str, reference: Array, sensed: Callable[[float], Array], quantity: Quantity
) -> tuple[float | None, Array]:
    """Lag of a sensor behind the reference [s] at which they are alike most, of either sign, and its values (N,) there.

    reference (N,); ``sensed`` gives values (N,) at the times of the reference plus a lag. Without a motion that shows
    a lag it is None, and the values are those without one.

    Raises
    ------
    InputError
        They are more alike beyond the search, or its edge is best: clocks differ; the message names by how much.
    """
    if float(np.std(reference)) < quantity.strong:
        return None, sensed(0.0)
    lags = np.arange(-LAG_S, LAG_S + 0.5 * LAG_STEP_S, LAG_STEP_S)
    near = [abs(correlation(reference, sensed(float(lag)))) for lag in lags]
    best = int(np.argmax(near))
    at_edge = best in (0, lags.size - 1)
    if at_edge or near[best] < SURE_CORRELATION:
        far = np.arange(-LONGEST_LAG_S, LONGEST_LAG_S + 0.05, 0.02)
        wide = [abs(correlation(reference, sensed(float(lag)))) for lag in far]
        k = int(np.argmax(wide))
        if abs(far[k]) >= LAG_S and wide[k] >= LEAST_CORRELATION and (at_edge or wide[k] > near[best] + CLEARLY):
            raise InputError(
                f"clocks of {where} and of the reference must agree within {LAG_S:g} s, the {quantity.name} of the "
                f"reference comes {far[k]:+.2f} s later in {where} (correlation {wide[k]:.2f}): is one in UTC and one "
                "in GPS time? Correct the times of one of them"
            )
    return float(lags[best]), sensed(float(lags[best]))


def require_changing(
    quantity: Quantity, where: str, time_s: Array, value: Array, at_s: Array, reference: Array
) -> None:  # fmt: skip
    """Test a raw series (M,) at times (M,) [s] for one value that lasts; reference (N,) at the times (N,) of driving.

    Raises
    ------
    InputError
        It keeps one value for FROZEN_S of the drive in which the reference changes.
    """
    ends = np.append(np.flatnonzero(np.abs(np.diff(value)) > FROZEN * quantity.strong), value.size - 1)
    starts = np.append(0, ends[:-1] + 1)
    # inertial sensors have noise even on a straight road, which the reference shows by its own; wheels may stand
    least = (STRAIGHT if quantity.biased else STILL) * quantity.strong
    step_s = float(np.median(np.diff(at_s))) if at_s.size > 1 else 0.0
    for k in np.flatnonzero(time_s[ends] - time_s[starts] > FROZEN_S):
        start, end, one = time_s[starts[k]], time_s[ends[k]], float(value[starts[k]])
        true = reference[(at_s >= start) & (at_s <= end)]
        stuck = not quantity.biased and abs(one) < FROZEN and float(true.mean() if true.size else 0.0) > quantity.strong
        if true.size * step_s > FROZEN_S and (float(np.std(true)) > least or stuck):
            raise InputError(
                f"{quantity.name} of {where} must change as the reference does, it keeps one value, {one:.4g}, for "
                f"{end - start:.1f} s from {start - time_s[0]:.1f} s on: the sensor was frozen, padded or without a "
                "signal; cut the recording there, or correct the column"
            )


def require_throughout(
    quantity: Quantity, unit: str, where: str, time_s: Array, reference: Array, sensed: Callable[[float], Array],
    lag_s: float | None,
) -> None:  # fmt: skip
    """Test windows of WINDOW_S of a drive: reference (N,) at times (N,) [s] from its start, both in the unit of the
    quantity; ``sensed`` and lag [s] as of :func:`require_lag`.

    Raises
    ------
    InputError
        In a window with enough motion a sensor has another sign or unit, or another lag than elsewhere.
    """
    offsets = np.arange(-LONGEST_JUMP_S, LONGEST_JUMP_S + 0.01, 0.05)
    values, usual = np.stack([sensed((lag_s or 0.0) + float(offset)) for offset in offsets]), offsets.size // 2
    changes = quantity._replace(biased=True, strong=math.inf)  # noise of the reference alone is no contradiction
    least = 0.75 * WINDOW_S / float(np.median(np.diff(time_s))) if time_s.size > 1 else math.inf
    for start in np.arange(time_s[0], time_s[-1] - 0.5 * WINDOW_S, WINDOW_STEP_S) if time_s.size else ():
        k = slice(*np.searchsorted(time_s, [start, start + WINDOW_S]))
        true, felt = reference[k], values[:, k]
        if true.size < least:  # mostly in a gap
            continue
        there = f"{where} between {start:.0f} and {start + WINDOW_S:.0f} s"
        spread = float(np.std(true)) / quantity.strong
        if not quantity.biased and float(np.mean(true)) > quantity.strong:
            require_agreement(quantity, unit, there, true, felt[usual], WINDOW_S)
        if spread < MOVES:  # neither sign nor lag shows
            continue
        require_agreement(changes, unit, there, true, felt[usual], WINDOW_S)
        if quantity.name == ACCELERATION.name:  # slopes of the road shift it
            continue
        # what each leaves of the reference, whatever its scale, which would look like another time
        off = np.sqrt([max(1.0 - max(correlation(true, row), 0.0) ** 2, FROZEN) for row in felt])
        best = int(np.argmin(off))
        if abs(offsets[best]) >= JUMP_S and off[usual] > NEARER * off[best]:
            raise InputError(
                f"clocks of {there} and of the reference must keep their difference, the {quantity.name} comes "
                f"{offsets[best]:+.2f} s later than in the whole drive: one of them jumped; cut the recording there"
            )


def scale_change(quantity: Quantity, time_s: Array, reference: Array, sensed: Callable[[float], Array]) -> str | None:
    """Words where the scale of a sensor without a bias changes by more than LIKE, and less than a unit would, between
    windows of WINDOW_S in which the car moves, at every lag; else None. Arguments as of :func:`require_throughout`."""
    starts = np.arange(time_s[0], time_s[-1] - WINDOW_S, WINDOW_STEP_S) if time_s.size else np.zeros(0)
    parts = [slice(*np.searchsorted(time_s, [start, start + WINDOW_S])) for start in starts]
    driven = [k for k, part in enumerate(parts) if reference[part].size and reference[part].min() > quantity.strong]
    if not driven:
        return None

    def scales(lag_s: float) -> Array:
        value = sensed(lag_s)
        return np.array([value[parts[k]].mean() / reference[parts[k]].mean() for k in driven])

    # of another clock the scale is the same at its lag
    at_lags = [scales(float(lag)) for lag in np.arange(-LONGEST_LAG_S, LONGEST_LAG_S + 0.05, 0.1)]
    now = scales(0.0)
    steady = any(np.ptp(found) < LIKE * np.abs(found).min() for found in at_lags)
    if steady or now.max() > now.min() * SLOPES[1] / SLOPES[0]:
        return None
    ends = (driven[int(np.argmin(now))], now.min()), (driven[int(np.argmax(now))], now.max())
    return " and ".join(f"{of:.2f} between {starts[k]:.0f} and {starts[k] + WINDOW_S:.0f} s" for k, of in ends)


def with_rate(moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Epochs (T,) at which a car moves, as at their neighbours: a track that is held at rest jumps when it starts."""
    return np.asarray(moving & np.append(moving[1:], True) & np.insert(moving[:-1], 0, True))


def require_same_times(where: str, time_s: Array, place_m: Array, true_s: Array, true_m: Array) -> None:
    """Raise InputError where positions (T, d) are nearer to the reference (N, d) at times LAG_S or more away."""
    lags = np.arange(-LONGEST_LAG_S, LONGEST_LAG_S + 0.05, 0.1)

    def away_m(lag_s: float) -> float:
        at = time_s + lag_s
        inside = (at >= true_s[0]) & (at <= true_s[-1])
        if 2 * inside.sum() < time_s.size:
            return math.inf
        there = interpolated(at[inside], true_s, true_m)
        return float(np.median(np.linalg.norm(there - place_m[inside], axis=-1)))

    now, found = away_m(0.0), np.array([away_m(float(lag)) for lag in lags])
    k = int(np.argmin(found))
    if abs(lags[k]) >= LAG_S and found[k] < now / NEARER and now < math.inf:
        raise InputError(
            f"times of {where} and of the reference must agree within {LAG_S:g} s, positions are {now:.1f} m apart and "
            f"{found[k]:.1f} m with times {lags[k]:+.1f} s later: is one in UTC and one in GPS time? Correct the times "
            "of one of them, or out-timesys of a solution of RTKLIB"
        )


def correlation(first: Array, second: Array) -> float:
    """Correlation of two series (N,), 0 where one is constant."""
    a, b = first - first.mean(), second - second.mean()
    size = math.sqrt(float((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


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
        ahead, behind = (interpolated(self.time_s + side * 0.5 * MEAN_S, time_s, place_m) for side in (1.0, -1.0))
        self.velocity_mps = (ahead - behind) / MEAN_S
        self.speed_mps = np.hypot(*self.velocity_mps.T)
        self.course_rad = np.unwrap(np.arctan2(self.velocity_mps[:, 0], self.velocity_mps[:, 1]))
        self.moving = with_rate(self.speed_mps > MOVING_MPS)

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
    total = integral(time_s, value)

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
    true = interpolated(time, r.time_s, place)

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
    axes = enu_axes(truth.position_ecef_m[0])
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
