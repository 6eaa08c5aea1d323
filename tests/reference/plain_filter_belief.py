"""What lasts in a vehicle filter, in NumPy: the reference of the kernels of ``vehicle_filter``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.filters.code_position import CodePosition
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

__all__ = [
    "BIASES",
    "COMMON",
    "FilterBelief",
    "slow_columns",
    "take_slow_error",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
BIASES = 5  # bounded constant errors: GNSS East, GNSS North, course, speed, speed at rest
COMMON = 2  # slow errors common to all satellites: ionosphere, troposphere


@dataclass
class FilterBelief:
    """Filters of B vehicles with r models each.

    Attributes
    ----------
    x, p : (B, r, STATES), (B, r, STATES, STATES); probability (B, r)
    influence : (B, r, STATES, BIASES + COMMON + S) change of the state per unit of each bounded constant error, and
        per sigma of each slow error, common ones and those of the S satellites
    turned_rad : (B,) integrated gyro
    known : (B,) a position has been begun with
    biased : (B,) the slow error of GNSS positions has its prior
    excess : (B,) mean of NIS / 2 of positions
    gain, own_m2, common_m : of the last position used, :class:`CodePosition`; fix_age_s (B,) its age, inf before
    moved_m : (B,) distance driven since then
    rejected_s : (B, 2) how long GNSS positions and motion have been rejected throughout
    """

    x: Array
    p: Array
    probability: Array
    influence: Array
    turned_rad: Array
    known: Bools
    biased: Bools
    gain: Array
    own_m2: Array
    common_m: Array
    fix_age_s: Array
    moved_m: Array
    rejected_s: Array
    excess: Array


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
