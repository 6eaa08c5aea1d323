"""Does the odometer lie? Its speed against the accelerometer, the gyro, itself and Doppler, for one vehicle.

``w`` (WATCH_SIZE,) is the watch's memory and ``limits`` (LIMITS,) the figures of
:class:`~lanebound.integrity.positioning.config.OdometerWatchConfig`, with the columns named below.

Speed: the mean speeds V of two epochs differ by ``f = (dv_{t-1} + dv_t) / 2``, half of the forward velocity increments
of each. The misfit ``e = f - (V_t - V_{t-1})`` is summed one-sidedly (Page's CUSUM),
``G = max(0, G + e - allowed)``, with all that a healthy vehicle may differ by: accelerometer bias, gravity on the
steepest road, scale and brake dive, misaligned lateral force, the lever arm in turns. The odometer's noise telescopes,
whatever the window: G is the largest over all windows, and exceeds ``K sqrt(2) sigma`` with at most about 2 Q(K) for
each epoch even while every allowance is used up.

A slow change below the allowance, and a slow error of scale, cannot be seen: the declared scale bounds the latter.
"""

from __future__ import annotations

from lanebound.integrity.core.accel import jit

# memory
LAST_SPEED, LAST_DV, HAS_LAST, ABOVE, BELOW, SAME_S, TURNING_S, DOUBT, AGREE_S = range(9)
WATCH_SIZE = 9
# figures
ALLOWED, SCALE, MISALIGNMENT, LEVER, JUMP, STUCK, STILL_RATE, STILL, AGREE = range(9)
LIMITS = 9
STANDING_MPS = 0.02  # slower is no pulse


@jit
def turning_at_rest(w, limits, dt, speed, rate):  # type: ignore[no-untyped-def]
    """Whether the gyro turns, at ``rate`` [rad/s], while the odometer says rest; counts how long in ``w``."""
    turning = abs(speed) < STANDING_MPS and abs(rate) > limits[STILL_RATE]
    w[TURNING_S] = w[TURNING_S] + dt if turning else 0.0
    return turning


@jit
def _misfit(w, limits, dt, speed, forward, lateral, rate):  # type: ignore[no-untyped-def]
    """Advance both sums; True when one exceeds what noise may do, and then begin anew."""
    allowed = dt * (limits[ALLOWED] + limits[LEVER] * rate * rate) + limits[MISALIGNMENT] * abs(lateral)
    allowed += limits[SCALE] * max(abs(forward), abs(w[LAST_DV]))
    e = 0.5 * (forward + w[LAST_DV]) - (speed - w[LAST_SPEED])
    w[ABOVE], w[BELOW] = max(0.0, w[ABOVE] + e - allowed), max(0.0, w[BELOW] - e - allowed)
    if max(w[ABOVE], w[BELOW]) <= limits[JUMP]:
        return False
    w[ABOVE], w[BELOW] = 0.0, 0.0
    return True


@jit
def watch_odometer(w, limits, dt, speed, forward, lateral, rate, conflict, agrees):  # type: ignore[no-untyped-def]
    """Advance the watch by an epoch; whether the odometer is in doubt.

    Parameters
    ----------
    speed : odometer's mean speed [m/s]; forward, lateral : velocity increments of the accelerometer [m/s].
    rate : yaw rate less its bias [rad/s].
    conflict : a tested Doppler speed contradicts the odometer; agrees : one confirms it.

    Doubt comes from a contradiction, from a moving odometer that repeats the very same value, or from a turn at rest.
    It goes after Doppler has agreed for some time without any of these.
    """
    wrong = conflict or w[TURNING_S] > limits[STILL]
    if w[HAS_LAST] > 0.0:
        same = speed == w[LAST_SPEED] and abs(speed) > STANDING_MPS
        w[SAME_S] = w[SAME_S] + dt if same else 0.0
        wrong = _misfit(w, limits, dt, speed, forward, lateral, rate) or w[SAME_S] > limits[STUCK] or wrong
    w[LAST_SPEED], w[LAST_DV], w[HAS_LAST] = speed, forward, 1.0
    w[AGREE_S] = w[AGREE_S] + dt if agrees and not wrong else 0.0
    if wrong:
        w[DOUBT] = 1.0
    elif w[AGREE_S] > limits[AGREE]:
        w[DOUBT] = 0.0
    return w[DOUBT] > 0.0
