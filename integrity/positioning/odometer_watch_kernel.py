"""The odometer watch: odometer speed against the accelerometer, the gyro, itself and Doppler, for one vehicle.

The mean speeds V of two epochs differ by ``f = (dv_{t-1} + dv_t) / 2``, half of the forward velocity increments of
each. The misfit ``e = f - (V_t - V_{t-1})`` is summed one-sidedly (Page's CUSUM), ``G = max(0, G + e - allowed)``, with
all that a healthy vehicle may differ by: accelerometer bias, gravity on the steepest road, scale and brake dive,
misaligned lateral force, the lever arm in turns. The odometer's noise telescopes, whatever the window: G is the largest
over all windows, and exceeds ``K sqrt(2) sigma`` with at most about 2 Q(K) for each epoch even while every allowance is
used up.

Not detected: a slow change below the allowance, and a slow error of scale; the declared scale bounds the latter.
"""

from __future__ import annotations

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["ODOMETER_WATCH", "WATCH_LIMITS", "turning_at_rest", "watch_odometer"]

ODOMETER_WATCH = record(
    last_speed="speed of the last epoch [m/s]",
    last_increment="forward velocity increment of the last epoch [m/s]",
    has_last=("?", "there was a last epoch"),
    above="one-sided sum of positive misfits [m/s]",
    below="one-sided sum of negative misfits [m/s]",
    same_s="how long a moving odometer has repeated one value [s]",
    turning_s="how long the gyro has turned while the odometer shows rest [s]",
    doubted=("?", "the odometer contradicts another sensor"),
    agree_s="how long Doppler has agreed [s]",
)
"""State of the odometer watch."""

WATCH_LIMITS = record(
    allowed="acceleration that bias and grade explain [m/s^2]",
    scale="share of the increment that may be wrong [-]",
    misalignment="share of the lateral increment seen forward [-]",
    lever="distance of the IMU from the rear axle [m]",
    jump="sum of misfits that noise does not reach [m/s]",
    stuck_s="how long a moving odometer may repeat one value [s]",
    still_rate="yaw rate of no vehicle at rest [rad/s]",
    still_s="how long that must last [s]",
    agree_s="how long Doppler must agree until the doubt ends [s]",
)
"""OdometerWatchConfig as the kernel takes it."""

STANDING_MPS = 0.02  # slower is no pulse


@jit
def turning_at_rest(dt: float, speed: float, rate: float, limits: Any, w: Any) -> bool:
    """Whether the gyro turns, at ``rate`` [rad/s], while the odometer shows rest; counts how long in ``w``."""
    turning = abs(speed) < STANDING_MPS and abs(rate) > limits.still_rate
    w.turning_s = w.turning_s + dt if turning else 0.0
    return turning


@jit
def _misfit(dt: float, speed: float, forward: float, lateral: float, rate: float, limits: Any, w: Any) -> bool:
    """Advance both sums; True when one exceeds what noise may do, and both then start from zero."""
    allowed = dt * (limits.allowed + limits.lever * rate * rate) + limits.misalignment * abs(lateral)
    allowed += limits.scale * max(abs(forward), abs(w.last_increment))
    e = 0.5 * (forward + w.last_increment) - (speed - w.last_speed)
    w.above, w.below = max(0.0, w.above + e - allowed), max(0.0, w.below - e - allowed)
    if max(w.above, w.below) <= limits.jump:
        return False
    w.above, w.below = 0.0, 0.0
    return True


@jit
def watch_odometer(
    dt: float, speed: float, forward: float, lateral: float, rate: float, conflict: bool, agrees: bool, limits: Any,
    w: Any,
) -> bool:  # fmt: skip
    """Advance the watch by an epoch; whether the odometer is doubted.

    Parameters
    ----------
    speed : odometer's mean speed [m/s]; forward, lateral : velocity increments of the accelerometer [m/s].
    rate : yaw rate less its bias [rad/s].
    conflict : a tested Doppler speed contradicts the odometer; agrees : one confirms it.

    A doubt begins with a contradiction, with a moving odometer that repeats one value, or with a turn at rest. It ends
    after Doppler has agreed for some time without any of these.
    """
    wrong = conflict or w.turning_s > limits.still_s
    if w.has_last:
        same = speed == w.last_speed and abs(speed) > STANDING_MPS
        w.same_s = w.same_s + dt if same else 0.0
        wrong = _misfit(dt, speed, forward, lateral, rate, limits, w) or w.same_s > limits.stuck_s or wrong
    w.last_speed, w.last_increment, w.has_last = speed, forward, True
    w.agree_s = w.agree_s + dt if agrees and not wrong else 0.0
    if wrong:
        w.doubted = True
    elif w.agree_s > limits.agree_s:
        w.doubted = False
    return bool(w.doubted)
