"""The odometer's scale from displacements of RTK, with a bound of its error, for one vehicle.

A window begins and ends at an RTK position; in between the car drives straight on for at least ``length``, and neither
stops nor turns by more than ``bend``. With D the distance of both positions, d that by the wheels and s the scale less
one,

    D = (1 + s) d + e,   |e| <= K sqrt(2 sigma^2 tau T) + b,
    b = PL_0 + PL_1 + b_v T + d (1 - cos(bend))

and slip. K and both levels along the track are those of a protection level; sigma and tau are of the noise of the speed
over the duration T, b_v is the bound of its constant error. Of N windows the estimate is

    s = sum (D_i - d_i) / sum d_i
    |error of s| <= (K sqrt(sum var_i) + sum b_i + g max(sum push_i, sum pull_i)) / sum d_i

``push`` and ``pull`` are the sums of specific force times distance while the wheels drive and brake. Wheels that drive
count too much and those that brake too little, by any share of the slip g per specific force.

A window can be false: wheels slip, or an RTK position is beyond its level. Where any two of the windows may be false,
the rest is true, and the error of s is at most the largest over all pairs of what the pair moves s by, and the bound of
the rest (solution separation). The risk of three is spent.

The scale changes: with time by tyres that warm up (``drift``), and by load and pressure (``change``). Both are bounds
of the configuration. A larger change ends the estimate when the latest windows contradict those before: one of 2 %
after one or two windows, one of 1 % after four to eight. Not covered: a change while there is no RTK.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["SCALE_RULES", "WHEEL_SCALE", "WHEEL_WINDOW", "advance_window", "close_window", "forget_scale", "scale_of"]

SCALE_RULES = record(
    length="shortest window [m]",
    bend="largest range of headings in a window [rad]",
    min_speed="lowest speed in a window [m/s]",
    slip="bound of the wheels' slip per specific force [s^2/m]",
    drift="bound of the change of the scale with time [1/s]",
    change="bound of its change by load or pressure [-]",
)
"""WheelScaleConfig as the kernel takes it."""

WHEEL_SCALE = record(
    scale="s in use, 0 while it is not known [-]",
    known=("?", "an estimate is in use"),
    time_s="clock [s]",
    since_s="when the oldest window of the estimate in use began [s]",
    fresh=("?", "windows have changed since the estimate in use was made"),
    count=("i8", "windows in memory"),
    next=("i8", "place of the window that is open, or that comes next"),
    open=("?", "a window is open"),
    began_s="when it began [s]",
    east="RTK position at its begin, East [m]",
    north="North [m]",
    path="distance by the wheels [m]",
    turned="turn by the gyro [rad]",
    least="smallest of these [rad]",
    most="largest [rad]",
    push="sum of forward specific force times distance [m^2/s^2]",
    pull="the same of backward force [m^2/s^2]",
)
"""State of the estimate."""

WHEEL_WINDOW = record(
    path="d, distance by the wheels [m]",
    misfit="D - d [m]",
    variance="of the noise of the wheels [m^2]",
    bound="b [m]",
    push="forward specific force times distance [m^2/s^2]",
    pull="backward specific force times distance [m^2/s^2]",
    opening="level of the RTK position where the open window began, in its place [m]",
    began_s="when it began [s]",
)
"""A window, for a protection level of each case; all but the bound is the same for all cases."""

LEAST_WINDOWS = 3  # of an estimate: two may be false
GYRO_SIGMAS = 5.0  # of the gyro bias, in the bound of a bend; beyond the factor of a level at 1e-5 (4.6)


@jit
def forget_scale(s: Any) -> None:
    """Forget all windows; the declared scale holds."""
    s.count, s.next, s.open, s.known, s.scale, s.fresh = 0, 0, False, False, 0.0, True


@jit
def advance_window(dt: float, speed: float, turning: float, force: float, rules: Any, s: Any) -> None:
    """Advance the clock, and an open window by an epoch; a bend, or a speed below the lowest one, ends it unused.

    speed : of the odometer [m/s]; turning : yaw rate less its bias [rad/s]; force : specific force forward [m/s^2].
    """
    s.time_s += dt
    if not s.open:
        return
    s.path += dt * speed
    s.turned += dt * turning
    s.least, s.most = min(s.least, s.turned), max(s.most, s.turned)
    if force > 0.0:
        s.push += dt * speed * force
    else:
        s.pull -= dt * speed * force
    s.open = speed >= rules.min_speed and s.most - s.least <= rules.bend


@jit(borrows=True)
def open_window(east: float, north: float, level: Any, windows: Records, s: Any) -> None:
    """Begin a window at the RTK position (east, north) [m] of levels (R, 2) [m]; windows (W, R)."""
    s.open, s.began_s, s.east, s.north = True, s.time_s, east, north
    s.path, s.turned, s.least, s.most, s.push, s.pull = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for r in range(windows.shape[1]):
        windows[s.next, r].opening = level[r, 0]


@jit(borrows=True)
def close_window(
    east: float, north: float, level: Any, p_bias: float, cases: Records, odometer: Any, windows: Records, s: Any
) -> bool:  # fmt: skip
    """Add the open window, which ends at (east, north) [m]; False if the scale has changed.

    The latest 1, 2, 4, ... windows are compared with those before. Here the bounds of windows count as independent: a
    false alarm costs the estimate, no more.

    level (R, 2) of that position [m]; p_bias : variance of the gyro bias [rad^2/s^2]; cases (R,) of CASE; odometer :
    declared figures.
    """
    rules, duration = odometer.estimate, s.time_s - s.began_s
    bend = min(s.most - s.least + GYRO_SIGMAS * math.sqrt(p_bias) * duration, math.pi)
    bound = odometer.bias * duration + s.path * (1.0 - math.cos(bend))
    for r in range(windows.shape[1]):
        window = windows[s.next, r]
        window.path, window.began_s = s.path, s.began_s
        window.misfit = math.hypot(east - s.east, north - s.north) - s.path
        window.variance = 2.0 * odometer.sigma**2 * odometer.tau * duration
        window.bound, window.push, window.pull = window.opening + level[r, 0] + bound, s.push, s.pull
    newest, s.open, s.fresh = s.next, False, True
    s.next, s.count = (s.next + 1) % windows.shape[0], min(s.count + 1, windows.shape[0])
    if s.count < 2:
        return True
    k, latest = max(cases[0].k_dead[0], cases[0].k_dead[1]), 1
    most = rules.drift * (s.time_s - oldest_of(windows, s.count))
    while latest < s.count:
        new = part_of(windows, s.count, newest, latest, True, k, rules.slip)
        old = part_of(windows, s.count, newest, latest, False, k, rules.slip)
        if abs(new[0] - old[0]) > math.sqrt(new[1] + old[1]) + new[2] + old[2] + most:
            return False
        latest *= 2
    return True


@jit(borrows=True)
def part_of(
    windows: Records, count: int, newest: int, latest: int, new: bool, k: float, slip: float
) -> tuple[float, float, float]:
    """Estimate of s by the latest windows, or by all others; square of what noise and bounds do to it, and slip."""
    path, misfit, square, push, pull = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        if ((newest - i) % windows.shape[0] < latest) == new:
            window = windows[i, 0]
            path += window.path
            misfit += window.misfit
            square += k * k * window.variance + window.bound * window.bound
            push += window.push
            pull += window.pull
    return misfit / path, square / (path * path), slip * max(push, pull) / path


@jit(borrows=True)
def estimate(windows: Records, count: int, r: int, k: float, slip: float, one: int, two: int) -> tuple[float, float]:
    """Estimate of s by all windows but two, or one, and the bound of its error for case r with factor K."""
    path, misfit, variance, bound, push, pull = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        if i != one and i != two:
            window = windows[i, r]
            path += window.path
            misfit += window.misfit
            variance += window.variance
            bound += window.bound
            push += window.push
            pull += window.pull
    return misfit / path, (k * math.sqrt(variance) + bound + slip * max(push, pull)) / path


@jit(borrows=True)
def oldest_of(windows: Records, count: int) -> float:
    """When the oldest window began [s]."""
    oldest = math.inf
    for i in range(count):
        oldest = min(oldest, windows[i, 0].began_s)
    return oldest


@jit(borrows=True)
def scale_of(windows: Records, count: int, r: int, case: Any, rules: Any) -> tuple[float, float]:
    """Estimate of s, and the bound of its error for case r without that of ``drift``; inf with too few windows."""
    if count < LEAST_WINDOWS:
        return 0.0, math.inf
    k, most = max(case.k_dead[0], case.k_dead[1]), 0.0
    scale, _ = estimate(windows, count, r, k, rules.slip, -1, -1)
    for i in range(count):
        for j in range(i + 1, count):
            without, own = estimate(windows, count, r, k, rules.slip, i, j)
            most = max(most, abs(scale - without) + own)
    return scale, most + rules.change
