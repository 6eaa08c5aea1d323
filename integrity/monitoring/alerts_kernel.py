"""The alert logic of one vehicle; :func:`lanebound.integrity.monitoring.alerts.step` does the same for arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["ALERT", "ALERT_RULES", "alert_step", "find_reason"]

EPS_S = 1e-9  # a hold of 1 s lasts ten epochs of 0.1 s, whatever they sum to
NONE, PL_AT, PL_CT, BOTH, NO_SOLUTION, TEST_FAILED, ACCURACY, INITIALISING, NOT_CONVERGED, HOLDING = range(10)

ALERT = record(
    alert=("?", "the alert is on"),
    reason=("i8", "code of AlertReason"),
    onset_s="age of the present violation [s]; -1 while there is none",
    clear_s="how long all limits have been met with margin [s]",
)
"""State of the alert."""

ALERT_RULES = record(
    al_at="alert limit along track [m]",
    al_ct="alert limit across track [m]",
    accuracy_at="required accuracy along track, 95 %, inf: not tested [m]",
    accuracy_ct="required accuracy across track [m]",
    clear_margin="share of the limits below which an alert clears [-]",
    clear_hold_s="how long they must be met with this margin [s]",
    raise_after_s="how long a violation must last before the alert [s]",
    k_accuracy="standard deviations of the 95 % accuracy [-]",
)
"""AlertConfig as the kernel takes it."""


@jit
def find_reason(
    cause: int, pl_at: float, pl_ct: float, sigma_at: float, sigma_ct: float, scale: float, rules: Any
) -> int:
    """Code of what is wrong now, with the limits multiplied by ``scale``; a NaN counts as missing."""
    if cause != NONE:
        return cause
    at_inside, ct_inside = pl_at <= scale * rules.al_at, pl_ct <= scale * rules.al_ct
    if not (at_inside or ct_inside):
        return BOTH if pl_at < np.inf or pl_ct < np.inf else NO_SOLUTION
    if not at_inside:
        return PL_AT
    if not ct_inside:
        return PL_CT
    if not (rules.k_accuracy * sigma_at < rules.accuracy_at and rules.k_accuracy * sigma_ct < rules.accuracy_ct):
        return ACCURACY
    return NONE


@jit
def alert_step(
    cause: int, pl_at: float, pl_ct: float, sigma_at: float, sigma_ct: float, dt: float, rules: Any, state: Any
) -> bool:
    """Advance the alert by one epoch; returns whether the position is available."""
    now = find_reason(cause, pl_at, pl_ct, sigma_at, sigma_ct, 1.0, rules)
    if now != NONE:
        state.onset_s = state.onset_s + dt if state.onset_s >= 0.0 else 0.0
        state.clear_s = 0.0
        state.alert = state.alert or state.onset_s >= rules.raise_after_s - EPS_S
    else:
        state.onset_s = -1.0
        inside = find_reason(cause, pl_at, pl_ct, sigma_at, sigma_ct, rules.clear_margin, rules) == NONE
        state.clear_s = state.clear_s + dt if inside else 0.0
        state.alert = state.alert and state.clear_s < rules.clear_hold_s - EPS_S
    if now != NONE:
        state.reason = now
    else:
        state.reason = HOLDING if state.alert else NONE
    return bool(now == NONE)
