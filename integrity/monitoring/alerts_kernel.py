"""The alert logic of one vehicle as a kernel; :func:`lanebound.integrity.monitoring.alerts.step` is its reference."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["alert_step", "find_reason"]

# Codes of AlertReason, repeated because Numba's cache does not see other files change (a test compares them).
EPS_S = 1e-9  # a hold of 1 s lasts ten epochs of 0.1 s, whatever they sum to
NONE, PL_AT, PL_CT, BOTH, NO_SOLUTION, ACCURACY, HOLDING = 0, 1, 2, 3, 4, 6, 9


@jit
def find_reason(
    cause: int, pl_at: float, pl_ct: float, sigma_at: float, sigma_ct: float, scale: float, limits: NDArray[Any]
) -> int:
    """Code of what is wrong now; a NaN counts as missing. ``limits`` from ``AlertConfig.packed``."""
    if cause != NONE:
        return cause
    at_inside, ct_inside = pl_at <= scale * limits[0], pl_ct <= scale * limits[1]
    if not (at_inside or ct_inside):
        return BOTH if pl_at < np.inf or pl_ct < np.inf else NO_SOLUTION
    if not at_inside:
        return PL_AT
    if not ct_inside:
        return PL_CT
    if not (limits[7] * sigma_at < limits[2] and limits[7] * sigma_ct < limits[3]):
        return ACCURACY
    return NONE


@jit
def alert_step(
    i: int,
    cause: int,
    pl_at: float,
    pl_ct: float,
    sigma_at: float,
    sigma_ct: float,
    dt: float,
    limits: NDArray[Any],
    alert: NDArray[Any],
    reason: NDArray[Any],
    onset_s: NDArray[Any],
    clear_s: NDArray[Any],
) -> bool:
    """Advance vehicle ``i`` of the state arrays by one epoch; returns whether the position is available."""
    now = find_reason(cause, pl_at, pl_ct, sigma_at, sigma_ct, 1.0, limits)
    if now != NONE:
        onset_s[i] = onset_s[i] + dt if onset_s[i] >= 0.0 else 0.0
        clear_s[i] = 0.0
        alert[i] = alert[i] or onset_s[i] >= limits[6] - EPS_S
    else:
        onset_s[i] = -1.0
        inside = find_reason(cause, pl_at, pl_ct, sigma_at, sigma_ct, limits[4], limits) == NONE
        clear_s[i] = clear_s[i] + dt if inside else 0.0
        alert[i] = alert[i] and clear_s[i] < limits[5] - EPS_S
    if now != NONE:
        reason[i] = now
    else:
        reason[i] = HOLDING if alert[i] else NONE
    return bool(now == NONE)
