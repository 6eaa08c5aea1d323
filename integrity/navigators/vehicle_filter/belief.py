"""What lasts from epoch to epoch in a vehicle filter, and how it begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.alerts import AlertState
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.positioning.filters.code_position import CodePosition
from lanebound.integrity.positioning.filters.vehicle_models import STATES, S

__all__ = [
    "BIASES",
    "COMMON",
    "FilterBelief",
    "begin_at",
    "blank_belief",
    "give_heading",
    "slow_columns",
    "take_slow_error",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
BIASES = 4  # bounded constant errors: GNSS East, GNSS North, course, speed
COMMON = 2  # slow errors common to all satellites: ionosphere, troposphere
POSE = [S.EAST, S.NORTH, S.GNSS_EAST, S.GNSS_NORTH]
EPS_RAD2 = 1e-10  # keeps the covariance of heading and integrated gyro regular


@dataclass
class FilterBelief:
    """Filters of B vehicles with r models each.

    Attributes
    ----------
    x, p : (B, r, STATES), (B, r, STATES, STATES); probability (B, r)
    influence : (B, r, STATES, BIASES + COMMON + S) change of the state per unit of each bounded constant error, and
        per sigma of each slow error, common ones and those of the S satellites
    turned_rad : (B,) integrated gyro
    known, aligned : (B,) a position has been begun with; the heading is given
    biased : (B,) the slow error of GNSS positions has its prior
    gain, own_m2, common_m : of the last position used, :class:`CodePosition`; fix_age_s (B,) its age, inf before
    moved_m : (B,) distance driven since then
    rejected_s : (B, 2) how long GNSS positions and motion have been rejected throughout
    doubt_m, doubt_s : (B,) distance to the positions that the filter has been moved to after it rejected them for long,
        which the levels hold, and how much longer [s]
    alert : of the levels
    """

    x: Array
    p: Array
    probability: Array
    influence: Array
    turned_rad: Array
    known: Bools
    aligned: Bools
    biased: Bools
    gain: Array
    own_m2: Array
    common_m: Array
    fix_age_s: Array
    moved_m: Array
    rejected_s: Array
    doubt_m: Array
    doubt_s: Array
    alert: AlertState


def blank_belief(config: FilterConfig, batch: int, satellites: int) -> FilterBelief:
    """Vehicles that have just been switched on: nothing is known but the spread of sensor errors."""
    models = len(config.chosen_models)
    p = np.zeros((batch, models, STATES, STATES))
    for place, sigma in initial_sigmas(config).items():
        p[..., place, place] = sigma**2
    return FilterBelief(
        x=np.zeros((batch, models, STATES)),
        p=p,
        probability=np.full((batch, models), 1.0 / models),
        influence=np.zeros((batch, models, STATES, BIASES + COMMON + satellites)),
        turned_rad=np.zeros(batch),
        known=np.zeros(batch, np.bool_),
        aligned=np.zeros(batch, np.bool_),
        biased=np.zeros(batch, np.bool_),
        gain=np.zeros((batch, satellites, 2)),
        own_m2=np.zeros((batch, satellites)),
        common_m=np.zeros((batch, 2, 2)),
        fix_age_s=np.full(batch, np.inf),
        moved_m=np.full(batch, np.inf),
        rejected_s=np.zeros((batch, 2)),
        doubt_m=np.zeros(batch),
        doubt_s=np.zeros(batch),
        alert=AlertState.initial(batch),
    )


def initial_sigmas(config: FilterConfig) -> dict[S, float]:
    """1-sigma of the states that have a prior of their own."""
    heading, motion = config.positioning.heading, config.motion
    found = {
        S.YAW_RATE: 0.2,  # any turn
        S.SPEED: 3.0,  # until the first wheel speed, of the same epoch
        S.SLIP: np.deg2rad(2.0),
        S.SLIDE: np.deg2rad(motion.slide_sigma_deg),
    }
    if "curved" in config.chosen_models:
        found[S.SLIP_RATE] = 0.05
    if config.sensor_errors:
        found |= {
            S.GYRO_BIAS: heading.bias_initial_radps,
            S.GYRO_SCALE: heading.gyro_scale,
            S.WHEEL_SCALE: motion.wheel_scale,
            S.ACCEL_BIAS: motion.accelerometer_bias_mps2,
            S.COMPASS: np.deg2rad(motion.compass_deviation_deg),
        }
    return found


def give_heading(
    b: FilterBelief, rows: NDArray[np.int64] | slice, heading_rad: Array, sigma_rad: Array | float
) -> None:
    """Set the heading (n,) of vehicles and its 1-sigma; the gyro's integral begins anew, its bias stays."""
    for place in (S.HEADING, S.GYRO_ANGLE):
        b.p[rows, :, place, :] = 0.0
        b.p[rows, :, :, place] = 0.0
    variance = np.broadcast_to(np.square(sigma_rad), np.shape(heading_rad))[:, None]
    b.turned_rad[rows] = 0.0
    b.x[rows, :, S.HEADING] = np.asarray(heading_rad)[:, None]
    b.x[rows, :, S.GYRO_ANGLE] = -np.asarray(heading_rad)[:, None]
    b.p[rows, :, S.HEADING, S.HEADING] = variance
    b.p[rows, :, S.GYRO_ANGLE, S.GYRO_ANGLE] = variance + EPS_RAD2
    b.p[rows, :, S.HEADING, S.GYRO_ANGLE] = b.p[rows, :, S.GYRO_ANGLE, S.HEADING] = -variance
    b.influence[rows, :, S.HEADING] = b.influence[rows, :, S.GYRO_ANGLE] = 0.0
    b.aligned[rows] = True


def begin_at(b: FilterBelief, rows: NDArray[np.int64] | slice, position_m: Array, variance_m2: Array | float) -> None:
    """Set the position (n, 2) of vehicles and its variance on each axis, or covariance (n, 2, 2); slow errors of GNSS
    positions have no prior yet."""
    for place in POSE:
        b.p[rows, :, place, :] = 0.0
        b.p[rows, :, :, place] = 0.0
    covariance = np.asarray(variance_m2)
    covariance = covariance * np.eye(2) if covariance.ndim == 0 else covariance[:, None]
    b.x[rows, :, :2] = position_m[:, None]
    b.x[rows, :, S.GNSS_EAST :] = 0.0
    b.p[rows, :, :2, :2] = covariance
    b.influence[rows, :, :2] = b.influence[rows, :, S.GNSS_EAST :] = 0.0
    b.known[rows], b.biased[rows] = True, False
    b.fix_age_s[rows] = b.moved_m[rows] = np.inf
    b.rejected_s[rows] = b.doubt_m[rows] = b.doubt_s[rows] = 0.0


def take_slow_error(b: FilterBelief, fix: CodePosition, now: Bools, slow_tau_s: float) -> None:
    """Bring the slow error of GNSS positions to the satellites of this fix, for vehicles ``now`` (B,).

    The error is ``K e`` of the satellites' own and common slow errors e with the gains K of the position. From one fix
    to the next it is ``A`` times the old one plus an independent part: ``A = K' C K_0' (K_0 V K_0')^-1`` with ``C = a
    V`` the covariance of e then and now. The first fix gives the prior.
    """
    slow = fix.slow_m2
    first, later = now & ~b.biased, now & b.biased
    if first.any():
        b.p[first, :, S.GNSS_EAST :, S.GNSS_EAST :] = slow[first][:, None]
    if later.any():
        k = np.flatnonzero(later)
        decay = np.exp(-b.fix_age_s[k] / slow_tau_s)[:, None, None]
        both = np.sqrt(fix.own_m2[k] * b.own_m2[k])  # 0 where a satellite is new or gone
        crossed = np.swapaxes(fix.gain[k], -1, -2) @ (both[..., None] * b.gain[k])
        crossed = decay * (crossed + fix.common_m[k] @ np.swapaxes(b.common_m[k], -1, -2))
        old = np.swapaxes(b.gain[k], -1, -2) @ (b.own_m2[k][..., None] * b.gain[k])
        old = old + b.common_m[k] @ np.swapaxes(b.common_m[k], -1, -2)
        a = crossed @ np.linalg.inv(old + 1e-9 * np.eye(2))
        gained = slow[k] - a @ old @ np.swapaxes(a, -1, -2)
        _turn_error(b, k, a, 0.5 * (gained + np.swapaxes(gained, -1, -2)))
    b.biased[now] = True
    b.gain[now], b.own_m2[now], b.common_m[now] = fix.gain[now], fix.own_m2[now], fix.common_m[now]


def _turn_error(b: FilterBelief, k: NDArray[np.int64], a: Array, gained_m2: Array) -> None:
    """``g <- A g + w`` of vehicles k with covariance ``gained_m2`` of w, (n, 2, 2) each."""
    place, a = slice(S.GNSS_EAST, STATES), a[:, None]
    x, p = b.x[k], b.p[k]
    x[..., place] = (a @ x[..., place, None])[..., 0]
    p[..., place, :] = a @ p[..., place, :]
    p[..., :, place] = p[..., :, place] @ np.swapaxes(a, -1, -2)
    p[..., place, place] += gained_m2[:, None]
    b.x[k], b.p[k] = x, p
    influence = b.influence[k]
    influence[..., place, :] = a @ influence[..., place, :]
    b.influence[k] = influence


def slow_columns(fix: CodePosition) -> Array:
    """Change of the position E, N per sigma of each slow error, (B, 2, COMMON + S) [m]."""
    own = fix.gain * np.sqrt(fix.own_m2)[..., None]
    return np.concatenate([fix.common_m, np.swapaxes(own, -1, -2)], -1)
