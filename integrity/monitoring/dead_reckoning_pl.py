"""Protection levels without redundancy (Doppler, or odometer and heading): the reference, as one covariance matrix.

``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19). The joint covariance of position, Doppler error, odometer error and
heading error follows ``C = F C F' + N``; nothing is lost when the source changes. The state is
``x = [p_E, p_N, n_E, n_N, m, d]`` as in :mod:`lanebound.integrity.monitoring.dead_reckoning_pl_kernel`, which does the
same in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_finite, require_in_range, require_shape
from lanebound.integrity.core.frames import rotate_covariance, track_from_enu_matrix
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, upper_quantile

__all__ = [
    "Growth",
    "bias_track",
    "doppler_step",
    "initial_growth",
    "missed_detection_factors",
    "odometer_step",
    "protection_levels",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STATES = 6


@dataclass(frozen=True)
class Growth:
    """Joint covariance (..., 6, 6) and accumulated biases (..., 2) in EN [m]: by heading, by speed, of either sign."""

    covariance: Array
    by_heading_m: Array
    by_speed_m: Array
    box_m: Array

    @property
    def position_covariance_m2(self) -> Array:
        """Covariance of the position error in E, N.  (..., 2, 2) [m^2]."""
        return self.covariance[..., :2, :2]


def initial_growth(
    position_covariance_m2: ArrayLike, bias_en_m: ArrayLike, heading_variance: ArrayLike,
    position_heading: ArrayLike = (0.0, 0.0),
) -> Growth:  # fmt: skip
    """After a fix.  (..., 2, 2) [m^2], (..., 2) [m], (...,) [rad^2].

    ``position_heading`` (..., 2) is the covariance of E and N with the heading [m rad].
    """
    position = require_finite("position_covariance_m2", position_covariance_m2)
    require_shape("position_covariance_m2", position, (2, 2))
    heading = require_in_range("heading_variance", heading_variance, 0.0, np.inf)
    lead = np.broadcast_shapes(position.shape[:-2], heading.shape)
    c = np.zeros((*lead, STATES, STATES))
    c[..., :2, :2] = position
    c[..., [2, 3, 4], [2, 3, 4]] = 1.0
    c[..., 5, 5] = heading
    c[..., :2, 5] = c[..., 5, :2] = require_finite("position_heading", position_heading)
    box = np.broadcast_to(require_in_range("bias_en_m", bias_en_m, 0.0, np.inf), (*lead, 2)).copy()
    return Growth(c, np.zeros((*lead, 2)), np.zeros((*lead, 2)), box)


def _processes(
    growth: Growth, phi_doppler: float, phi_odometer: float, heading_variance: ArrayLike, carry: float
) -> tuple[Array, Array]:
    """Transition (..., 6, 6) and noise factor (..., 6, 4) of the error processes; the position stays."""
    lead = growth.covariance.shape[:-2]
    f, n = np.zeros((*lead, STATES, STATES)), np.zeros((*lead, STATES, 4))
    f[..., [0, 1], [0, 1]] = 1.0
    f[..., [2, 3, 4, 5], [2, 3, 4, 5]] = [phi_doppler, phi_doppler, phi_odometer, carry]
    n[..., [2, 3], [0, 1]] = np.sqrt(1.0 - phi_doppler**2)
    n[..., 4, 2] = np.sqrt(1.0 - phi_odometer**2)
    fresh = np.asarray(heading_variance) - carry**2 * growth.covariance[..., 5, 5]
    n[..., 5, 3] = np.sqrt(np.maximum(fresh, 0.0))
    return f, n


def doppler_step(
    growth: Growth,
    dt_s: float,
    previous_factor: ArrayLike | None,
    factor: ArrayLike,
    *,
    bias_mps: ArrayLike = 0.0,
    phi_doppler: float = 0.0,
    phi_odometer: float = 0.0,
    heading_variance: ArrayLike = 0.0,
    carry: float = 1.0,
    variant: Variant = Variant.EXACT,
) -> Growth:
    """``p += dt/2 (v_{t-1} + v_t)`` (S1 eq 20), or ``p += dt v_t`` without a previous velocity.

    ``factor`` (..., 2, 2) is the lower Cholesky factor L of this epoch's velocity covariance [m/s], ``previous_factor``
    that of the last. ``phi = exp(-dt/tau)``; ``carry`` is the share of the heading error that stays. PUBLISHED grows by
    ``dt^2/4 (Q_{t-1} + Q_t)`` (S1 eq 21).
    """
    now = np.asarray(factor, dtype=np.float64) * (dt_s if previous_factor is None else 0.5 * dt_s)
    before = np.zeros((2, 2)) if previous_factor is None else 0.5 * dt_s * np.asarray(previous_factor)
    f, n = _processes(growth, phi_doppler, phi_odometer, heading_variance, carry)
    if variant is Variant.EXACT:
        f[..., :2, 2:4] = before + now * phi_doppler
        n[..., :2, :2] = now * np.sqrt(1.0 - phi_doppler**2)
    added = now @ np.swapaxes(now, -1, -2) + before @ np.swapaxes(before, -1, -2)
    covariance = _propagate(growth.covariance, f, n, added if variant is Variant.PUBLISHED else None)
    box = growth.box_m + dt_s * np.asarray(bias_mps, dtype=np.float64)[..., None]
    return Growth(covariance, growth.by_heading_m, growth.by_speed_m, box)


def odometer_step(
    growth: Growth,
    dt_s: float,
    speed_mps: ArrayLike,
    heading_rad: ArrayLike,
    *,
    sigma_mps: float,
    bias_mps: ArrayLike = 0.0,
    heading_bias_rad: ArrayLike = 0.0,
    phi_doppler: float = 0.0,
    phi_odometer: float = 0.0,
    heading_variance: ArrayLike = 0.0,
    carry: float = 1.0,
    variant: Variant = Variant.EXACT,
) -> Growth:
    """``p += V dt [sin t, cos t]`` with the interval's means (inverse of S1 eq 4; equations.md 3).

    Biases: ``c_th += v dt b_theta [cos t, -sin t]'``, ``c_v += dt b_v [sin t, cos t]'``. Parameters as in
    :func:`doppler_step`; ``heading_bias_rad`` is ``b_theta0 + db (t - t_cal)``.
    """
    r = track_from_enu_matrix(heading_rad)
    along, across = dt_s * r[..., 0, :], dt_s * np.asarray(speed_mps, dtype=np.float64)[..., None] * r[..., 1, :]
    f, n = _processes(growth, phi_doppler, phi_odometer, heading_variance, carry)
    if variant is Variant.EXACT:
        f[..., :2, 4] = along * sigma_mps * phi_odometer
        n[..., :2, 2] = along * sigma_mps * n[..., 4, 2][..., None]
        f[..., :2, 5] = 0.5 * (1.0 + carry) * across
        n[..., :2, 3] = 0.5 * across * n[..., 5, 3][..., None]
    variance = (f[..., 5, 5] ** 2 * growth.covariance[..., 5, 5] + n[..., 5, 3] ** 2)[..., None, None]
    added = (
        variance * across[..., :, None] * across[..., None, :]
        + sigma_mps**2 * along[..., :, None] * along[..., None, :]
    )
    covariance = _propagate(growth.covariance, f, n, added if variant is Variant.PUBLISHED else None)
    return Growth(
        covariance,
        growth.by_heading_m + across * np.asarray(heading_bias_rad, dtype=np.float64)[..., None],
        growth.by_speed_m + along * np.asarray(bias_mps, dtype=np.float64)[..., None],
        growth.box_m,
    )


def _propagate(covariance: Array, f: Array, n: Array, added: Array | None) -> Array:
    """``F C F' + N N'``, with ``added`` (..., 2, 2) on the position."""
    out = f @ covariance @ np.swapaxes(f, -1, -2) + n @ np.swapaxes(n, -1, -2)
    if added is not None:
        out[..., :2, :2] += added
    return np.asarray(out)


def bias_track(growth: Growth, heading_rad: ArrayLike, variant: Variant = Variant.EXACT) -> Array:
    """Bound of the accumulated bias along AT and CT (S1 eq 18-19).  -> (..., 2) [m].

    Exact: ``abs(R c_th) + abs(R c_v) + abs(R) box``. Published: ``sqrt((sin t c_E)^2 + (cos t c_N)^2)`` of the signed
    sum, sin and cos exchanged for CT.
    """
    r = track_from_enu_matrix(heading_rad)

    def turn(matrix: Array, vector: Array) -> Array:
        return np.asarray((matrix @ vector[..., None])[..., 0])

    if variant is Variant.PUBLISHED:
        total = growth.by_heading_m + growth.by_speed_m + growth.box_m
        return np.sqrt(turn(r**2, total**2))
    return np.abs(turn(r, growth.by_heading_m)) + np.abs(turn(r, growth.by_speed_m)) + turn(np.abs(r), growth.box_m)


def missed_detection_factors(config: RiskConfig, risks: ArrayLike | None = None) -> Array:
    """K_md of modes without redundancy: exact ``Qinv(P_HMI,q / 2)``, published ``Qinv(risk)``.  -> (R, 2)."""
    if config.variant is Variant.PUBLISHED:
        return np.repeat(upper_quantile(config.risks(risks))[:, None], 2, axis=1)
    return upper_quantile(0.5 * config.axis_budgets(risks, config.unmonitored_risk))


def protection_levels(
    growth: Growth, heading_rad: ArrayLike, config: RiskConfig, risks: ArrayLike | None = None
) -> Array:
    """``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19); inf when no risk is left.  -> (..., R, 2) [m]."""
    variance = np.diagonal(rotate_covariance(growth.position_covariance_m2, heading_rad), axis1=-2, axis2=-1)
    sigma = np.sqrt(np.maximum(variance, 0.0))[..., None, :]
    bias = bias_track(growth, heading_rad, config.variant)[..., None, :]
    return np.asarray(missed_detection_factors(config, risks) * sigma + bias)
