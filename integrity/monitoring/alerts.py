"""Alert limits, and the logic that warns when a protection level exceeds them.

An alert is raised as soon as a protection level exceeds its limit (or does not exist), and cleared only after every
level has stayed below a margin of its limit for a hold time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from lanebound.integrity.core.advice import OpenAdvice
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring import alerts_kernel as kernel
from lanebound.integrity.monitoring.alerts_kernel import ALERT_RULES, EPS_S

__all__ = [
    "ALERT_LIMITS",
    "AlertConfig",
    "AlertLimits",
    "AlertReason",
    "AlertState",
    "AlertStatus",
    "alert_parameters",
    "step",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

K_ACCURACY = 1.96  # two-sided 95 % of N(0, 1), S1 eq 22


class AlertReason(OpenAdvice):
    """Why an alert is on, one reason for each epoch: causes known from elsewhere first, then levels, then accuracy.

    ``AlertReason.register`` adds a reason for a monitor from outside.
    """

    NONE: ClassVar[AlertReason]
    PL_AT: ClassVar[AlertReason]
    PL_CT: ClassVar[AlertReason]
    BOTH: ClassVar[AlertReason]
    NO_SOLUTION: ClassVar[AlertReason]
    INTEGRITY_TEST_FAILED: ClassVar[AlertReason]
    ACCURACY: ClassVar[AlertReason]
    INITIALISING: ClassVar[AlertReason]
    NOT_CONVERGED: ClassVar[AlertReason]
    HOLDING: ClassVar[AlertReason]
    CONTEXT_WARNING: ClassVar[AlertReason]


BUILT_IN = {
    kernel.NONE: ("NONE", "no alert; the position may be used within its protection levels"),
    kernel.PL_AT: ("PL_AT", "along-track protection level exceeds its alert limit; keep a longer headway"),
    kernel.PL_CT: ("PL_CT", "cross-track protection level exceeds its alert limit; do not rely on the lane position"),
    kernel.BOTH: ("BOTH", "both protection levels exceed their alert limits; do not use the position"),
    kernel.NO_SOLUTION: ("NO_SOLUTION", "no position or no protection level; do not use the position"),
    kernel.TEST_FAILED: (
        "INTEGRITY_TEST_FAILED", "a fault was detected and could not be excluded; do not use the position",
    ),
    kernel.ACCURACY: (
        "ACCURACY", "95 % accuracy is worse than required; use the position for coarse guidance only",
    ),
    kernel.INITIALISING: ("INITIALISING", "no absolute position has been reached yet; wait for the first fix"),
    kernel.NOT_CONVERGED: ("NOT_CONVERGED", "the estimate has not converged; wait or re-initialise"),
    kernel.HOLDING: (
        "HOLDING", "limits are met again; the alert clears when they have been met for the hold time",
    ),
    kernel.HOLDING + 1: (
        "CONTEXT_WARNING", "the context monitor warns; its own reason says of what: position, speed or road",
    ),
}  # fmt: skip
for _code in sorted(BUILT_IN):
    AlertReason.register(*BUILT_IN[_code])


class AlertLimits(Config):
    """The largest error tolerable on each axis, and the accuracy required at 95 % (None: not tested)."""

    al_at_m: float = Field(1.0, gt=0, description="along-track alert limit [m]; S1 section 5")
    al_ct_m: float = Field(1.0, gt=0, description="cross-track alert limit [m]; S1 section 5")
    accuracy_at_m: float | None = Field(
        None, gt=0, description="T_acc along track, 95 % [m]; S1 eq 22, left to the user"
    )
    accuracy_ct_m: float | None = Field(
        None, gt=0, description="T_acc across track, 95 % [m]; S1 eq 22, left to the user"
    )

    @classmethod
    def named(cls, name: str) -> AlertLimits:
        """One of :data:`ALERT_LIMITS` by name, or ConfigError."""
        if name not in ALERT_LIMITS:
            raise ConfigError(f"alert limits must be one of {', '.join(ALERT_LIMITS)}, got {name!r}: correct the name")
        return ALERT_LIMITS[name]


ALERT_LIMITS: Mapping[str, AlertLimits] = MappingProxyType(
    {
        "s1": AlertLimits(),
        "s2": AlertLimits(al_at_m=1.5, al_ct_m=1.5),  # half of a 3 m lane, S2 5.3
        # Reid et al. 2019, arXiv 1906.01061, passenger cars: limits and 95 % accuracies of their conclusions
        "reid2019_freeway": AlertLimits(al_at_m=1.40, al_ct_m=0.57, accuracy_at_m=0.48, accuracy_ct_m=0.20),
        "reid2019_local": AlertLimits(al_at_m=0.29, al_ct_m=0.29, accuracy_at_m=0.10, accuracy_ct_m=0.10),
        "s5": AlertLimits(al_at_m=15.0, al_ct_m=15.0),  # S5, HAL of road navigation
    }
)


class AlertConfig(Config):
    """When an alert is raised and when it clears."""

    limits: AlertLimits = Field(AlertLimits(), description="alert limits and required accuracy")
    clear_margin: float = Field(
        0.9, gt=0, le=1, description="an alert clears below this share of the limit [-]; chosen"
    )
    clear_hold_s: float = Field(
        1.0, ge=0, description="and only after this long below it [s]; chosen: ten 10 Hz epochs"
    )
    time_to_alert_s: float = Field(1.0, ge=0, description="TTA, longest delay allowed from onset to alert [s]; S3 II.A")
    raise_after_s: float = Field(0.0, ge=0, description="persistence asked before an alert [s]; 0 raises it at once")

    @model_validator(mode="after")
    def _raise_within_tta(self) -> Self:
        if self.raise_after_s > self.time_to_alert_s:
            raise ConfigError(
                f"raise_after_s must be <= time_to_alert_s = {self.time_to_alert_s}, "
                f"got {self.raise_after_s}: shorten it"
            )
        return self


def alert_parameters(config: AlertConfig) -> Records:
    """ALERT_RULES (1,) of :mod:`.alerts_kernel`."""
    limits = config.limits
    return one_record(
        ALERT_RULES,
        al_at=limits.al_at_m,
        al_ct=limits.al_ct_m,
        accuracy_at=np.inf if limits.accuracy_at_m is None else limits.accuracy_at_m,
        accuracy_ct=np.inf if limits.accuracy_ct_m is None else limits.accuracy_ct_m,
        clear_margin=config.clear_margin,
        clear_hold_s=config.clear_hold_s,
        raise_after_s=config.raise_after_s,
        k_accuracy=K_ACCURACY,
    )


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
