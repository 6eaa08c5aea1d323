"""Cycle slips: NumPy reference of detection and repair.

Between two epochs the phases of a satellite change by ``d_b = rho + clock - I_b + lambda_b N_b``. Detection asks
whether N = 0 explains the changes; repair finds which integers do. The kernels and their letters are in
:mod:`lanebound.integrity.positioning.cycle_slips_kernel`; everything here takes any leading batch axes.

Sources: Blewitt (1990), Geophys. Res. Lett. 17, 199-202 (wide lane and geometry-free); Liu (2011), J. Geodesy 85,
171-183 (rate of the ionosphere).
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning import cycle_slips_kernel as kernel
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from plain_ambiguity import bootstrap_failure_rate, decorrelate, integer_least_squares

__all__ = ["RepairStatus", "SlipEvidence", "detect", "remove_common", "repair"]

Array = NDArray[np.float64]


class SlipEvidence(IntFlag):
    """Which tests found a slip."""

    NONE = kernel.NO_SLIP
    GEOMETRY_FREE = kernel.GEOMETRY_FREE
    PREDICTED = kernel.PREDICTED
    CODE_PHASE = kernel.CODE_PHASE


class RepairStatus(IntEnum):
    """Whether the integers of a slip are known."""

    REPAIRED = kernel.REPAIRED
    NOT_UNIQUE = kernel.NOT_UNIQUE
    HALF_CYCLE = kernel.HALF_CYCLE
    INCONSISTENT = kernel.INCONSISTENT


def remove_common(change: ArrayLike, member: ArrayLike, system: ArrayLike) -> Array:
    """Subtract the median change of each system's members (the receiver clock): (..., S), (..., S), (S,) -> (..., S).

    NaN where a satellite is no member, or its system has fewer than 3 members and clock and slip cannot be told apart.
    """
    value, usable = np.broadcast_arrays(np.asarray(change, dtype=np.float64), np.asarray(member, dtype=bool))
    group, out = np.asarray(system), np.full(value.shape, np.nan)
    for k in np.unique(group):
        mine = usable & (group == k)
        enough = mine.sum(axis=-1, keepdims=True) >= kernel.MIN_COMMON
        kept = np.where(mine, value, np.nan)
        middle = np.nanmedian(np.where(enough, kept, 0.0), axis=-1, keepdims=True)
        out = np.where(mine & enough, value - middle, out)
    return out


def _pair(name: str, value: ArrayLike) -> tuple[Array, Array]:
    """The two bands of an array (..., 2)."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise InputError(f"{name} must have shape (..., 2), one entry for each band, got {array.shape}: reshape it")
    return array[..., 0], array[..., 1]


def detect(
    phase_change_m: ArrayLike,
    wavelength_m: ArrayLike,
    predicted_m: ArrayLike,
    sigma_phase_m: ArrayLike,
    sigma_predicted_m: ArrayLike,
    sigma_ionosphere_m: ArrayLike,
    threshold: float,
    *,
    geometry_free_m: ArrayLike = 0.0,
    code_change_m: ArrayLike = (0.0, 0.0),
    sigma_code_m: ArrayLike = np.inf,
) -> NDArray[np.int64]:
    """Evidence of slips, values of :class:`SlipEvidence`, from changes between two epochs.

    Parameters
    ----------
    phase_change_m, code_change_m, wavelength_m
        (..., 2) by band [m], receiver clock removed; a wavelength of 0 says that there is no second band.
    predicted_m, sigma_predicted_m
        Change of range from Doppler or inertial sensors (...,) [m] and its standard deviation, inf: no prediction.
    geometry_free_m, sigma_ionosphere_m
        Expected change of phase 1 - phase 2 and its standard deviation (...,) [m].
    sigma_phase_m, sigma_code_m
        Standard deviations of one phase and one code at one epoch (...,) [m].
    threshold
        Standard deviations at which a test rejects (:attr:`CycleSlipConfig.threshold`).

    Raises
    ------
    InputError
        When an array by band does not end in an axis of 2.
    """
    d1, d2 = _pair("phase_change_m", phase_change_m)
    c1, c2 = _pair("code_change_m", code_change_m)
    l1, l2 = _pair("wavelength_m", wavelength_m)
    p, g = np.asarray(predicted_m, dtype=np.float64), np.asarray(geometry_free_m, dtype=np.float64)
    phase_var, iono_var = 2 * np.square(sigma_phase_m), np.square(sigma_ionosphere_m)
    known_var = phase_var + np.square(sigma_predicted_m)
    dual = l2 > 0
    l2 = np.where(dual, l2, np.nan)
    wide, narrow = 1 / (1 / l1 - 1 / l2), 1 / (1 / l1 + 1 / l2)
    code_var = 2 * narrow**2 * np.square(sigma_code_m)
    mw = wide * (d1 / l1 - d2 / l2) - narrow * (c1 / l1 + c2 / l2)
    mw_var = (l1**-2.0 + l2**-2.0) * (wide**2 * phase_var + code_var)
    first = np.abs(d1 - p) > threshold * np.sqrt(known_var)
    second = dual & (np.abs(d2 + g - p) > threshold * np.sqrt(known_var + iono_var))
    free = dual & (np.abs(d1 - d2 - g) > threshold * np.sqrt(2 * phase_var + iono_var))
    code = np.abs(mw) > threshold * np.sqrt(mw_var)
    evidence = np.where(free, SlipEvidence.GEOMETRY_FREE, 0) + np.where(first | second, SlipEvidence.PREDICTED, 0)
    return np.asarray(evidence + np.where(code, SlipEvidence.CODE_PHASE, 0), dtype=np.int64)


def repair(
    phase_change_m: ArrayLike,
    wavelength_m: ArrayLike,
    predicted_m: float,
    sigma_phase_m: float,
    sigma_predicted_m: float,
    sigma_ionosphere_m: float,
    config: CycleSlipConfig | None = None,
    *,
    geometry_free_m: float = 0.0,
) -> tuple[Array, RepairStatus]:
    """Slips (2,) [cycles] of one satellite that explain its changes of phase, if only one pair can; else zeros.

    Integer least squares in half cycles of ``(d1 - p, d2 + g - p) = (lambda_1 N_1, lambda_2 N_2) + e``: see
    :func:`lanebound.integrity.positioning.cycle_slips_kernel.repair_slip` for the conditions.
    """
    config = config or CycleSlipConfig()
    d1, d2 = _pair("phase_change_m", phase_change_m)
    half = 0.5 * np.asarray(wavelength_m, dtype=np.float64)
    none = np.zeros(2)
    if not half[1] > 0:
        return none, RepairStatus.NOT_UNIQUE
    variance = np.full((2, 2), sigma_predicted_m**2) + 2 * sigma_phase_m**2 * np.eye(2)
    variance[1, 1] += sigma_ionosphere_m**2
    jump = np.array([d1 - predicted_m, d2 + geometry_free_m - predicted_m])
    Q = variance / np.outer(half, half)
    solution, reduced = integer_least_squares(jump / half, Q), decorrelate(Q)
    if reduced is None or solution.status or bootstrap_failure_rate(reduced.D) > config.repair_failure_rate:
        return none, RepairStatus.NOT_UNIQUE
    best, second = solution.norms
    if best > config.fit_limit:
        return none, RepairStatus.INCONSISTENT
    if second - best < -2 * np.log(config.repair_failure_rate):
        return none, RepairStatus.NOT_UNIQUE
    if (solution.candidates[0] % 2).any():
        return none, RepairStatus.HALF_CYCLE
    return solution.candidates[0] / 2, RepairStatus.REPAIRED
