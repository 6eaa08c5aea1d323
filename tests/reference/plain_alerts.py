"""The alert logic for arrays of vehicles: the reference of :mod:`lanebound.integrity.monitoring.alerts_kernel`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.alerts import K_ACCURACY, AlertConfig, AlertReason
from lanebound.integrity.monitoring.alerts_kernel import EPS_S

__all__ = ["AlertState", "AlertStatus", "step"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass
class AlertState:
    """Alert memory of B vehicles.

    Attributes
    ----------
    alert : (B,) the alert is on.
    reason : (B,) codes of :class:`AlertReason`.
    onset_s : (B,) age of the present violation [s]; -1 while there is none.
    clear_s : (B,) how long all limits have been met with margin [s].
    """

    alert: Bools
    reason: NDArray[np.int64]
    onset_s: Array
    clear_s: Array

    @classmethod
    def initial(cls, vehicles: int) -> AlertState:
        """Alerted for want of a position: a vehicle is not trusted before its first good epoch and hold time."""
        return cls(
            alert=np.ones(vehicles, dtype=np.bool_),
            reason=np.full(vehicles, AlertReason.INITIALISING.code, dtype=np.int64),
            onset_s=np.full(vehicles, -1.0),
            clear_s=np.zeros(vehicles),
        )

    def copy(self) -> AlertState:
        """An independent copy."""
        return AlertState(self.alert.copy(), self.reason.copy(), self.onset_s.copy(), self.clear_s.copy())


@dataclass(frozen=True)
class AlertStatus:
    """What a user learns, (B,) each: alert, reason code, whether the limits are met now, seconds of the TTA left."""

    alert: Bools
    reason: NDArray[np.int64]
    available: Bools
    tta_left_s: Array


def step(
    config: AlertConfig,
    state: AlertState,
    pl_at_m: ArrayLike,
    pl_ct_m: ArrayLike,
    dt_s: float,
    *,
    sigma_at_m: ArrayLike = 0.0,
    sigma_ct_m: ArrayLike = 0.0,
    cause: ArrayLike = AlertReason.NONE.code,
) -> AlertStatus:
    """Advance ``state`` in place by one epoch: alert when ``PL_q > AL_q``, available when ``PL_q <= AL_q``.

    ``cause`` holds codes of :class:`AlertReason` known from elsewhere (a failed test, initialising); they alert
    whatever the levels are. The accuracy test is ``1.96 sigma_q < T_acc,q`` (S1 eq 22). A NaN or infinite level counts
    as missing. ``tta_left_s`` is the time to alert not yet used up by a violation still silent. All arrays (B,).

    Raises
    ------
    InputError
        ``dt_s`` is not positive.
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be > 0, got {dt_s}: pass the epoch interval")
    shape = state.alert.shape
    now = _reasons(config, shape, pl_at_m, pl_ct_m, sigma_at_m, sigma_ct_m, cause, 1.0)
    with_margin = _reasons(config, shape, pl_at_m, pl_ct_m, sigma_at_m, sigma_ct_m, cause, config.clear_margin)
    wrong, clear = now != AlertReason.NONE.code, with_margin == AlertReason.NONE.code
    state.onset_s[:] = np.where(wrong, np.where(state.onset_s >= 0.0, state.onset_s + dt_s, 0.0), -1.0)
    state.clear_s[:] = np.where(clear, state.clear_s + dt_s, 0.0)
    raised = wrong & (state.onset_s >= config.raise_after_s - EPS_S)
    held = state.alert & (wrong | (state.clear_s < config.clear_hold_s - EPS_S))
    state.alert[:] = raised | held
    quiet = np.where(state.alert, AlertReason.HOLDING.code, AlertReason.NONE.code)
    state.reason[:] = np.where(wrong, now, quiet)
    waiting = wrong & ~state.alert
    left = config.time_to_alert_s - np.where(waiting, state.onset_s, 0.0)
    return AlertStatus(state.alert.copy(), state.reason.copy(), ~wrong, left)


def _reasons(
    config: AlertConfig,
    shape: tuple[int, ...],
    pl_at_m: ArrayLike,
    pl_ct_m: ArrayLike,
    sigma_at_m: ArrayLike,
    sigma_ct_m: ArrayLike,
    cause: ArrayLike,
    margin: float,
) -> NDArray[np.int64]:
    """Code of what is wrong now, with the limits scaled by ``margin``; an outside cause comes first."""
    limits, reason = config.limits, AlertReason
    at, ct = (np.broadcast_to(np.asarray(v, dtype=np.float64), shape) for v in (pl_at_m, pl_ct_m))
    over_at, over_ct = ~(at <= margin * limits.al_at_m), ~(ct <= margin * limits.al_ct_m)
    missing = ~(at < np.inf) & ~(ct < np.inf)
    coarse = _too_coarse(sigma_at_m, limits.accuracy_at_m) | _too_coarse(sigma_ct_m, limits.accuracy_ct_m)
    known = np.broadcast_to(np.asarray(cause, dtype=np.int64), shape)
    cases: list[tuple[Any, AlertReason]] = [
        (missing, reason.NO_SOLUTION),
        (over_at & over_ct, reason.BOTH),
        (over_at, reason.PL_AT),
        (over_ct, reason.PL_CT),
        (np.broadcast_to(coarse, shape), reason.ACCURACY),
    ]
    own = np.select([case for case, _ in cases], [member.code for _, member in cases], reason.NONE.code)
    return np.where(known != reason.NONE.code, known, own)


def _too_coarse(sigma_m: ArrayLike, required_m: float | None) -> Bools:
    """Whether ``1.96 sigma < T_acc`` fails (S1 eq 22); a missing requirement never fails."""
    sigma = np.asarray(sigma_m, dtype=np.float64)
    return np.asarray(~(K_ACCURACY * sigma < (np.inf if required_m is None else required_m)))
