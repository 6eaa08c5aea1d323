"""Least-squares adjustment of the pseudoranges of the last seconds, connected by wheel speed and yaw rate.

Unknowns: current position (E, N, U), current clock, its rate and curvature, rotation psi of the dead-reckoned path
against North, its scale kappa, and one offset for each further system. A pseudorange of age ``a <= 0`` is measured at
the position ``p = p_now + (1 + kappa) R(psi) (X - X_now)`` on the path and equals
``|s - p| + c + c' a + c'' a^2 / 2 + offset + mu(C/N0)``.

Errors of one satellite are correlated in time (:class:`ErrorCourse`), errors of different satellites are independent.
Outliers get less weight (Danish method). The rows of each satellite are then condensed to a few independent rows, which
form a fault mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import enu_axes
from lanebound.integrity.positioning.condense import condense_white, gauss_markov_covariance
from lanebound.integrity.positioning.correlation import bound_correlation
from lanebound.integrity.positioning.danish import DanishConfig, variance_factor
from lanebound.integrity.replay.reckoning import turned
from lanebound.integrity.sky.orbit import ranges_and_sights

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CLOCK, RATE, CURVATURE, PSI, KAPPA = 3, 4, 5, 6, 7
FIXED_UNKNOWNS = 8
PRIOR_SIGMA = {CURVATURE: 0.05, PSI: 1.8, KAPPA: 0.01}  # [m/s^2] low-cost oscillator, [rad] unknown, [-] wheels
PRIOR_RATE_MPS = 3e3  # 10 ppm
STEPS = 3  # initial Gauss-Newton steps; each Danish iteration adds one


@dataclass(frozen=True)
class ErrorCourse:
    """How code errors of unit variance of a satellite change with time: a Gauss-Markov error of correlation time
    ``tau_s`` [s] and unit variance, plus a white one of variance ``white``; with ``tau_s`` 0 a white one of variance 1.
    """

    tau_s: float
    white: float = 0.0

    @classmethod
    def between(cls, shortest_s: float, longest_s: float, step_s: float) -> ErrorCourse:
        """Bound of errors whose correlation time lies in [shortest, longest], in any linear estimate of samples that
        are ``step_s`` apart (:func:`~lanebound.integrity.positioning.correlation.bound_correlation`).

        A code that jumps when the direct ray is lost or regained, as a random telegraph signal, has the spectrum of a
        Gauss-Markov error whose correlation time is half the mean time between jumps. It is covered if that lies in the
        range.
        """
        if longest_s <= 0.0:
            return cls(0.0)
        return cls(longest_s, bound_correlation(min(shortest_s, longest_s), longest_s, step_s).white)

    def correlation(self, age_s: Array) -> Array:
        """Covariance (m, m) at ages (m,) [s]."""
        return gauss_markov_covariance(age_s, np.ones(age_s.size), self.tau_s, self.white)


@dataclass(frozen=True)
class LocalFrame:
    """The local frame: origin (3,) ECEF [m] and the matrix whose columns are E, N, U."""

    origin_ecef_m: Array
    axes: Array

    @classmethod
    def at(cls, origin_ecef_m: Array) -> LocalFrame:
        """The frame at a point (3,) [m]."""
        return cls(origin_ecef_m, enu_axes(origin_ecef_m))

    def ecef(self, enu_m: Array) -> Array:
        """Convert local coordinates (..., 3) to ECEF [m]."""
        return np.asarray(self.origin_ecef_m + enu_m @ self.axes.T)

    def local(self, ecef_m: Array) -> Array:
        """Convert ECEF (..., 3) to local coordinates [m]."""
        return np.asarray((ecef_m - self.origin_ecef_m) @ self.axes)


@dataclass(frozen=True)
class WindowRows:
    """Pseudoranges of a window, (m,): age <= 0 [s], range minus expected error and sigma [m], satellite (m, 3) ECEF,
    index of the satellite and of its system (0: no offset), dead-reckoned displacement (m, 2) and path length [m]."""

    age_s: Array
    range_m: Array
    sigma_m: Array
    satellite_ecef_m: Array
    satellite: Ints
    system: Ints
    way_m: Array
    length_m: Array


@dataclass(frozen=True)
class WhitenedSystem:
    """Independent rows of unit variance: design (r, n), y (r,) at ``x``, owner (r,): satellite or -1 for priors.

    ``misfit`` and ``freedom`` (satellites,): residual sum of squares and degrees of freedom within each satellite.
    """

    design: Array
    y: Array
    owner: Ints
    x: Array
    factor: Array
    misfit: Array
    freedom: Ints


def build(rows: WindowRows, frame: LocalFrame, x: Array) -> tuple[Array, Array]:
    """Compute the design matrix (m, n) at x (n,) and observed minus computed (m,) [m]."""
    way = turned(rows.way_m, x[PSI])
    place = np.zeros((len(way), 3))
    place[:, :2] = x[:2] + (1.0 + x[KAPPA]) * way
    place[:, 2] = x[2]
    distance, sight = ranges_and_sights(rows.satellite_ecef_m, frame.ecef(place))
    e = sight @ frame.axes
    offset = np.zeros((len(way), x.size - FIXED_UNKNOWNS))
    later = rows.system > 0
    offset[np.flatnonzero(later), rows.system[later] - 1] = 1.0
    across = np.stack([way[:, 1], -way[:, 0]], -1) * (1.0 + x[KAPPA])
    design = np.column_stack([
        -e, np.ones(len(way)), rows.age_s, 0.5 * rows.age_s**2,
        -(e[:, :2] * across).sum(1), -(e[:, :2] * way).sum(1), offset,
    ])  # fmt: skip
    clock = design[:, CLOCK:PSI] @ x[CLOCK:PSI] + offset @ x[FIXED_UNKNOWNS:]
    return design, rows.range_m - distance - clock


def settle(
    rows: WindowRows, frame: LocalFrame, start: Array, course: ErrorCourse, danish: DanishConfig
) -> WhitenedSystem:
    """Solve by Gauss-Newton with Danish re-weighting from ``start``; returns the system at the solution."""
    whitener = _whitener(rows, course)
    x, factor = start.copy(), np.ones(len(rows.age_s))
    for _ in range(STEPS):
        x = x + _step(rows, frame, x, factor, whitener)
    for _ in range(danish.iterations):
        _, left = build(rows, frame, x)
        new = variance_factor(left / rows.sigma_m, danish)
        settled = bool((np.abs(new - factor) <= danish.settled * factor).all())
        factor = new
        x = x + _step(rows, frame, x, factor, whitener)
        if settled:
            break
    return _condensed(rows, frame, x, factor, whitener)


def _whitener(rows: WindowRows, course: ErrorCourse) -> Array:
    """``L^-1`` of the correlation matrix ``L L'`` of all rows; different satellites are independent.  (m, m)."""
    out = np.zeros((len(rows.age_s), len(rows.age_s)))
    for s in range(int(rows.satellite.max()) + 1):
        own = np.flatnonzero(rows.satellite == s)
        out[np.ix_(own, own)] = np.linalg.inv(np.linalg.cholesky(course.correlation(rows.age_s[own])))
    return out


def _white(rows: WindowRows, frame: LocalFrame, x: Array, factor: Array, whitener: Array) -> Array:
    """Rows of unit variance (m, n + 1); the last column is the right-hand side."""
    design, left = build(rows, frame, x)
    sigma = rows.sigma_m * np.sqrt(factor)
    return np.asarray(whitener @ (np.column_stack([design, left]) / sigma[:, None]))


def _step(rows: WindowRows, frame: LocalFrame, x: Array, factor: Array, whitener: Array) -> Array:
    """The Gauss-Newton step (n,)."""
    prior, target = _priors(x)
    white = np.concatenate([_white(rows, frame, x, factor, whitener), np.column_stack([prior, target])])
    return np.asarray(np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0])


def _condensed(rows: WindowRows, frame: LocalFrame, x: Array, factor: Array, whitener: Array) -> WhitenedSystem:
    """The condensed rows of each satellite, and the rows of the priors."""
    white = _white(rows, frame, x, factor, whitener)
    parts, owner, misfit, freedom = [], [], [], []
    for s in range(int(rows.satellite.max()) + 1):
        part = condense_white(white[rows.satellite == s])
        parts.append((part.design, part.y))
        owner += [s] * len(part.y)
        misfit.append(part.misfit)
        freedom.append(part.freedom)
    prior, target = _priors(x)
    return WhitenedSystem(
        np.concatenate([p[0] for p in parts] + [prior]), np.concatenate([p[1] for p in parts] + [target]),
        np.array(owner + [-1] * len(target)), x, factor, np.array(misfit), np.array(freedom),
    )  # fmt: skip


def _priors(x: Array) -> tuple[Array, Array]:
    """Prior rows for curvature, scale, psi and clock rate: design (r, n) and right-hand side (r,)."""
    sigma = {**PRIOR_SIGMA, RATE: PRIOR_RATE_MPS}
    rows, target = np.zeros((len(sigma), x.size)), np.zeros(len(sigma))
    for i, (column, spread) in enumerate(sigma.items()):
        rows[i, column] = 1.0 / spread
        target[i] = 0.0 if column == PSI else -x[column] / spread
    return rows, target
