"""The pose that each of N egos drives by, as :class:`~lanebound.envs.tracker.Tracker` has it, and how far to trust it.

``tracks`` (N, TRACK): the newest solution, carried on; what a jump has left to be taken over; rates; what the solution
said when it was new; the error of the ego's map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.columns_kernel import flag
from lanebound.envs.vector.ego_kernel import rates
from lanebound.envs.vector.lanes_kernel import nearest, remainder
from lanebound.integrity.core.accel import jit

__all__ = ["TRACK", "Fixes", "begin_all", "coast_all", "settle_all", "take_all"]

(
    X, Y, LEFT_X, LEFT_Y, HEADING, YAW_RATE, ACCELERATION, FIX_HEADING, FIX_SPEED, LEVEL_AT, LEVEL_CT, ALERT,
    AVAILABLE, REASON, MAP_X, MAP_Y,
) = range(16)  # fmt: skip
TRACK = 16
JUMP_M, SMOOTHING_S, MAP_BOUND_M, LIMIT_AT_M, LIMIT_CT_M, BOTH, ALONG, ACROSS = range(8)  # figures; codes of reasons

Array = NDArray[np.float64]


class Fixes(NamedTuple):
    """Solutions of B vehicles, (B,) and (B, 2): the fields of ``Solution``."""

    position_en_m: Array
    heading_rad: Array
    speed_mps: Array
    pl_at_m: Array
    pl_ct_m: Array
    alert: NDArray[np.bool_]
    available: NDArray[np.bool_]
    reason: NDArray[np.int64]
    mode: NDArray[np.int64]
    rtk: NDArray[np.int64]
    hdop: Array
    satellites: NDArray[np.int64]
    satellites_doppler: NDArray[np.int64]
    excluded: NDArray[np.int64]
    since_rtk_s: Array
    since_calibration_s: Array
    corrections_age_s: Array


@jit
def _keep(t, b, fixes, v):  # type: ignore[no-untyped-def]
    """What the solution of vehicle v says, its position and heading in the plane, for the track and the belief."""
    t[X], t[Y] = fixes.position_en_m[v, 0], -fixes.position_en_m[v, 1]
    t[FIX_HEADING] = (fixes.heading_rad[v] - 0.5 * math.pi + math.pi) % (2.0 * math.pi) - math.pi
    t[FIX_SPEED], t[LEVEL_AT], t[LEVEL_CT] = fixes.speed_mps[v], fixes.pl_at_m[v], fixes.pl_ct_m[v]
    t[ALERT], t[AVAILABLE], t[REASON] = flag(fixes.alert[v]), flag(fixes.available[v]), float(fixes.reason[v])
    b[k.B_MODE], b[k.B_RTK], b[k.B_HDOP] = float(fixes.mode[v]), float(fixes.rtk[v]), fixes.hdop[v]
    b[k.B_SATELLITES], b[k.B_DOPPLER] = float(fixes.satellites[v]), float(fixes.satellites_doppler[v])
    b[k.B_EXCLUDED], b[k.B_SINCE_RTK] = float(fixes.excluded[v]), fixes.since_rtk_s[v]
    b[k.B_SINCE_CALIBRATION], b[k.B_CORRECTIONS_AGE] = fixes.since_calibration_s[v], fixes.corrections_age_s[v]


@jit
def _coast(t, dt):  # type: ignore[no-untyped-def]
    """Carry the pose on by the last speed and turn rate, between epochs."""
    turned = dt * t[YAW_RATE]
    middle = t[HEADING] + 0.5 * turned
    t[X] += dt * t[FIX_SPEED] * math.cos(middle)
    t[Y] += dt * t[FIX_SPEED] * math.sin(middle)
    t[HEADING] += turned


@jit
def _take(t, b, fixes, v, since, dt, figures):  # type: ignore[no-untyped-def]
    """A new solution, ``since`` [s] after the pose was last carried on, ``dt`` after the last one."""
    start, heading, speed = t[HEADING], t[FIX_HEADING], t[FIX_SPEED]
    _coast(t, since)
    x, y = t[X], t[Y]
    _keep(t, b, fixes, v)
    jump_x, jump_y = t[X] - x, t[Y] - y
    fade = math.exp(-dt / figures[SMOOTHING_S]) if figures[SMOOTHING_S] > 0.0 else 0.0
    if math.hypot(jump_x, jump_y) > figures[JUMP_M]:
        t[LEFT_X] -= jump_x
        t[LEFT_Y] -= jump_y
    t[LEFT_X] *= fade
    t[LEFT_Y] *= fade
    t[YAW_RATE], t[ACCELERATION] = rates(t[FIX_HEADING] - heading, t[FIX_SPEED], speed, t[ACCELERATION], dt)
    t[HEADING] = start + remainder(t[FIX_HEADING] - start)


@jit
def _settle(t, b, lanes, passed, figures):  # type: ignore[no-untyped-def]
    """Place the belief on the map; its levels are the solution's, what has not faded and the map's; count alerts."""
    b[k.B_X], b[k.B_Y] = t[X] + t[LEFT_X] + t[MAP_X], t[Y] + t[LEFT_Y] + t[MAP_Y]
    b[k.B_HEADING], b[k.B_SPEED] = t[HEADING], t[FIX_SPEED]
    b[k.B_YAW_RATE], b[k.B_ACCELERATION] = t[YAW_RATE], t[ACCELERATION]
    b[k.B_LANE] = nearest(lanes, b[k.B_X], b[k.B_Y], b[k.B_HEADING])
    s, c = math.sin(t[HEADING]), math.cos(t[HEADING])
    b[k.B_PL_AT] = t[LEVEL_AT] + (abs(c * t[LEFT_X] + s * t[LEFT_Y]) + figures[MAP_BOUND_M])
    b[k.B_PL_CT] = t[LEVEL_CT] + (abs(c * t[LEFT_Y] - s * t[LEFT_X]) + figures[MAP_BOUND_M])
    along, across = b[k.B_PL_AT] > figures[LIMIT_AT_M], b[k.B_PL_CT] > figures[LIMIT_CT_M]
    alert = t[ALERT] > 0.0
    b[k.B_REASON] = t[REASON]
    if (along or across) and not alert:
        b[k.B_REASON] = figures[BOTH if along and across else ALONG if along else ACROSS]
    b[k.B_AVAILABLE] = flag(t[AVAILABLE] > 0.0 and not (along or across))
    b[k.B_ALERT] = flag(alert or along or across)
    b[k.B_ALERT_AGE] = b[k.B_ALERT_AGE] + passed if b[k.B_ALERT] > 0.0 else 0.0


@jit
def begin_all(rows, vehicles, fixes, shift, tracks, belief):  # type: ignore[no-untyped-def]
    """Start the egos ``rows`` (n,) at their first solutions, rows ``n vehicles`` of fixes; shift (n, 2): of maps."""
    for n in range(rows.shape[0]):
        t = tracks[rows[n]]
        t[:] = 0.0
        t[MAP_X], t[MAP_Y] = shift[n, 0], shift[n, 1]
        _keep(t, belief[rows[n]], fixes, n * vehicles)
        t[HEADING] = t[FIX_HEADING]
        belief[rows[n], k.B_ALERT_AGE] = 0.0


@jit
def coast_all(rows, dt, tracks):  # type: ignore[no-untyped-def]
    """Carry poses on by ``dt`` [s] in which no epoch ended."""
    for e in rows:
        _coast(tracks[e], dt)


@jit
def take_all(rows, vehicles, fixes, since, dt, figures, tracks, belief):  # type: ignore[no-untyped-def]
    """New solutions, row ``e vehicles`` of fixes for each ego e of ``rows``."""
    for e in rows:
        _take(tracks[e], belief[e], fixes, e * vehicles, since, dt, figures)


@jit
def settle_all(rows, lanes, passed, figures, tracks, belief):  # type: ignore[no-untyped-def]
    """Bring beliefs (N, BELIEF) up to date with the tracks, ``passed`` [s] after they last were."""
    for e in rows:
        _settle(tracks[e], belief[e], lanes, passed, figures)
