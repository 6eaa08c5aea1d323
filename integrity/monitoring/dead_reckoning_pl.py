"""Protection levels without redundancy (Doppler, or odometer and heading): the reference, as one covariance matrix.

``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19). The joint covariance of position, Doppler error, odometer error and
errors of the heading filter follows ``C = F C F' + N``; nothing is lost when the source changes. The state is
``x = [p_E, p_N, n_E, n_N, m, d, b, c, w_E, w_N]`` as in :mod:`lanebound.integrity.monitoring.dead_reckoning_pl_kernel`,
which does the same in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_finite, require_in_range, require_shape
from lanebound.integrity.core.frames import rotate_covariance, track_from_enu_matrix
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, upper_quantile

__all__ = [
    "Growth",
    "HeadingStep",
    "bias_track",
    "doppler_step",
    "initial_growth",
    "missed_detection_factors",
    "odometer_step",
    "protection_levels",
]

Array = NDArray[np.float64]

STATES = 10
X, W = slice(5, 8), slice(8, 10)  # errors of the heading filter, white part of the Doppler error


@dataclass(frozen=True)
class Growth:
    """Joint covariance (..., 10, 10), accumulated biases (..., 2) in EN [m]: by heading, speed, axle, either sign."""

    covariance: Array
    by_heading_m: Array
    by_speed_m: Array
    by_axle_m: Array
    box_m: Array

    @property
    def position_covariance_m2(self) -> Array:
        """Covariance of the position error in E, N.  (..., 2, 2) [m^2]."""
        return self.covariance[..., :2, :2]


@dataclass(frozen=True)
class HeadingStep:
    """What an epoch does to the errors of heading, gyro bias and gyro scale: ``x' = A (F x + [n, 0, 0])``.

    Attributes
    ----------
    walk : (...,) variance of n [rad^2]
    delta_rad, dt_s : measured turn and length, ``F = [[1, -dt, -D], [0, 1, 0], [0, 0, 1]]``; 0 at rest
    correction : (3, 3) A of the filter's update at the end
    course : (3, 2) gain times error of the course by a unit Doppler error in E and N, ``k a'``
    covariance : (3, 3) of the filter after it; None: that of F alone, for a heading without a filter
    axle_bias_rad : (...,) error of the course by the bound of the axle distance, signed
    """

    walk: ArrayLike = 0.0
    delta_rad: float = 0.0
    dt_s: float = 0.0
    correction: Array = field(default_factory=lambda: np.eye(3))
    course: Array = field(default_factory=lambda: np.zeros((3, 2)))
    covariance: Array | None = None
    axle_bias_rad: ArrayLike = 0.0

    @property
    def transition(self) -> Array:
        """F (3, 3)."""
        out = np.eye(3)
        out[0, 1:] = -self.dt_s, -self.delta_rad
        return out


STRAIGHT = HeadingStep()


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
    return Growth(c, np.zeros((*lead, 2)), np.zeros((*lead, 2)), np.zeros((*lead, 2)), box)


def _processes(
    growth: Growth, phi_doppler: float, white: float, phi_odometer: float, heading: HeadingStep
) -> tuple[Array, Array]:
    """Transition (..., 10, 10) and noise factor (..., 10, 6) of the error processes; the position stays."""
    lead = growth.covariance.shape[:-2]
    f, n = np.zeros((*lead, STATES, STATES)), np.zeros((*lead, STATES, 6))
    f[..., [0, 1], [0, 1]] = 1.0
    f[..., [2, 3, 4], [2, 3, 4]] = [phi_doppler, phi_doppler, phi_odometer]
    f[..., X, X] = heading.correction @ heading.transition
    f[..., X, 2:4] = phi_doppler * heading.course
    n[..., [2, 3], [0, 1]] = fresh = np.sqrt(1.0 - phi_doppler**2)
    n[..., 4, 2] = np.sqrt(1.0 - phi_odometer**2)
    n[..., X, 3] = np.sqrt(np.asarray(heading.walk))[..., None] * heading.correction[:, 0]
    n[..., X, :2], n[..., X, 4:] = fresh * heading.course, np.sqrt(white) * heading.course
    n[..., [8, 9], [4, 5]] = np.sqrt(white)
    return f, n


def doppler_step(
    growth: Growth,
    dt_s: float,
    previous_factor: ArrayLike | None,
    factor: ArrayLike,
    *,
    bias_mps: ArrayLike = 0.0,
    phi_doppler: float = 0.0,
    white: float = 0.0,
    phi_odometer: float = 0.0,
    heading: HeadingStep = STRAIGHT,
    variant: Variant = Variant.EXACT,
) -> Growth:
    """``p += dt/2 (v_{t-1} + v_t)`` (S1 eq 20), or ``p += dt v_t`` without a previous velocity.

    ``factor`` (..., 2, 2) is the lower Cholesky factor L of this epoch's velocity covariance [m/s], ``previous_factor``
    that of the last. ``phi = exp(-dt/tau)``, ``white`` the variance of the white part. PUBLISHED grows by ``dt^2/4
    (Q_{t-1} + Q_t)`` (S1 eq 21).
    """
    now = np.asarray(factor, dtype=np.float64) * (dt_s if previous_factor is None else 0.5 * dt_s)
    before = np.zeros((2, 2)) if previous_factor is None else 0.5 * dt_s * np.asarray(previous_factor)
    f, n = _processes(growth, phi_doppler, white, phi_odometer, heading)
    if variant is Variant.EXACT:
        f[..., :2, 2:4] = before + now * phi_doppler
        n[..., :2, :2] = now * np.sqrt(1.0 - phi_doppler**2)
        f[..., :2, W], n[..., :2, 4:] = before, now * np.sqrt(white)
    added = now @ np.swapaxes(now, -1, -2) + before @ np.swapaxes(before, -1, -2)
    covariance = _propagate(growth.covariance, f, n, added if variant is Variant.PUBLISHED else None, heading)
    box = growth.box_m + dt_s * np.asarray(bias_mps, dtype=np.float64)[..., None]
    return Growth(covariance, growth.by_heading_m, growth.by_speed_m, growth.by_axle_m, box)


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
    white: float = 0.0,
    phi_odometer: float = 0.0,
    heading: HeadingStep = STRAIGHT,
    variant: Variant = Variant.EXACT,
) -> Growth:
    """``p += V dt [sin t, cos t]`` with the interval's means (inverse of S1 eq 4; equations.md 3).

    Biases: ``c_th += v dt b_theta [cos t, -sin t]'``, ``c_v += dt b_v [sin t, cos t]'``. Parameters as in
    :func:`doppler_step`; ``heading_bias_rad`` is ``b_theta0 + db (t - t_cal)``.
    """
    r = track_from_enu_matrix(heading_rad)
    along, across = dt_s * r[..., 0, :], dt_s * np.asarray(speed_mps, dtype=np.float64)[..., None] * r[..., 1, :]
    f, n = _processes(growth, phi_doppler, white, phi_odometer, heading)
    if variant is Variant.EXACT:
        f[..., :2, 4] = along * sigma_mps * phi_odometer
        n[..., :2, 2] = along * sigma_mps * n[..., 4, 2][..., None]
        mean = 0.5 * (np.eye(3)[0] + heading.transition[0])  # of the errors at the begin, in the mean heading
        f[..., :2, X] = across[..., :, None] * mean
        n[..., :2, 3] = 0.5 * across * np.sqrt(np.asarray(heading.walk))[..., None]
    ahead = (f[..., X, X] @ growth.covariance[..., X, X] @ np.swapaxes(f[..., X, X], -1, -2))[..., 0, 0]
    variance = (ahead + n[..., 5, 3] ** 2)[..., None, None]
    added = (
        variance * across[..., :, None] * across[..., None, :]
        + sigma_mps**2 * along[..., :, None] * along[..., None, :]
    )
    covariance = _propagate(growth.covariance, f, n, added if variant is Variant.PUBLISHED else None, heading)
    return Growth(
        covariance,
        growth.by_heading_m + across * np.asarray(heading_bias_rad, dtype=np.float64)[..., None],
        growth.by_speed_m + along * np.asarray(bias_mps, dtype=np.float64)[..., None],
        growth.by_axle_m + across * np.asarray(heading.axle_bias_rad, dtype=np.float64)[..., None],
        growth.box_m,
    )


def _propagate(covariance: Array, f: Array, n: Array, added: Array | None, heading: HeadingStep) -> Array:
    """``F C F' + N N'``, with ``added`` (..., 2, 2) on the position and the filter's covariance of its errors."""
    out = f @ covariance @ np.swapaxes(f, -1, -2) + n @ np.swapaxes(n, -1, -2)
    if added is not None:
        out[..., :2, :2] += added
    if heading.covariance is not None:
        out[..., X, X] = heading.covariance
    return np.asarray(out)


def bias_track(growth: Growth, heading_rad: ArrayLike, variant: Variant = Variant.EXACT) -> Array:
    """Bound of the accumulated bias along AT and CT (S1 eq 18-19).  -> (..., 2) [m].

    Exact: ``abs(R c_th) + abs(R c_v) + abs(R c_axle) + abs(R) box``. Published: ``sqrt((sin t c_E)^2 + (cos t c_N)^2)``
    of the signed sum, sin and cos exchanged for CT.
    """
    r = track_from_enu_matrix(heading_rad)

    def turn(matrix: Array, vector: Array) -> Array:
        return np.asarray((matrix @ vector[..., None])[..., 0])

    if variant is Variant.PUBLISHED:
        total = growth.by_heading_m + growth.by_speed_m + growth.box_m
        return np.sqrt(turn(r**2, total**2))
    signed = (growth.by_heading_m, growth.by_speed_m, growth.by_axle_m)
    return np.asarray(sum(np.abs(turn(r, vector)) for vector in signed) + turn(np.abs(r), growth.box_m))


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
