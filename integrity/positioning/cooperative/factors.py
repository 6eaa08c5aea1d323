"""What one epoch says of pairs of nodes: Gaussian factors of the difference of two positions.

A factor between nodes i and j is ``exp(-(x_i - x_j)' L (x_i - x_j) / 2 + v' (x_i - x_j))`` with an information matrix L
of any rank: a baseline from double differences has rank 3, a range rank 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape

__all__ = ["Factors", "inverse", "joint_solution", "line_between", "normal_equations", "range_factors"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME_PLACE_M = 1e-6  # closer nodes have no direction to each other


@dataclass(frozen=True)
class Factors:
    """Factors of E pairs of nodes.

    Attributes
    ----------
    ends : (E, 2) nodes i and j
    information : (E, 3, 3) of ``x_i - x_j`` [1/m^2]
    vector : (E, 3) information times the measured difference [1/m]
    lasting : (E, 3, 3) covariance of a further error of the difference, which lasts from epoch to epoch [m^2]
    """

    ends: Ints
    information: Array
    vector: Array
    lasting: Array

    @classmethod
    def none(cls) -> Self:
        """No factor at all."""
        return cls(np.empty((0, 2), np.int64), np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))

    def joined(self, other: Factors) -> Factors:
        """The factors of both; a pair may have several."""
        return Factors(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True)))

    def take(self, rows: ArrayLike) -> Factors:
        """Some of the factors, by mask or index."""
        which = np.asarray(rows)
        return Factors(*(values[which] for values in vars(self).values()))

    def directed(self) -> tuple[Ints, Ints, Array, Array, Array]:
        """Both directions of each factor: receiver, sender (2E,), information, vector and lasting; first as given."""
        to, of = np.concatenate([self.ends, self.ends[:, ::-1]]).T
        twice = (np.concatenate([values, values]) for values in (self.information, self.lasting))
        information, lasting = twice
        return to, of, information, np.concatenate([self.vector, -self.vector]), lasting

    @property
    def whole(self) -> Self:
        """The same with all of the error in the information: ``(L^-1 + lasting)^-1``, of any rank."""
        shrunk = inverse(np.eye(3) + self.information @ self.lasting)
        information = shrunk @ self.information
        return type(self)(self.ends, 0.5 * (information + np.swapaxes(information, -1, -2)),
                          np.einsum("eij,ej->ei", shrunk, self.vector), np.zeros_like(self.lasting))  # fmt: skip


def range_factors(
    ends: ArrayLike, range_m: ArrayLike, sigma_m: ArrayLike, about_m: ArrayLike, about_m2: Array | None = None
) -> Factors:
    """Ranges between nodes, linearised about positions: ``u'(x_i - x_j) = r`` with the unit vector u from j to i.

    A distance bends: with the covariance P of the difference its mean is longer by ``tr(H P) / 2`` and its variance by
    ``tr(H P H P) / 2``, with ``H = (I - u u') / d`` (Y. Bar-Shalom et al. 2001, second-order extended Kalman filter).

    Parameters
    ----------
    ends : (E, 2) nodes; range_m, sigma_m : (E,) measured ranges and their 1 sigma [m]
    about_m, about_m2 : (N, 3), (N, 3, 3) positions about which they are linearised, and their covariances; None: as
        known

    Raises
    ------
    InputError
        When a range is negative, a sigma is not positive, or two nodes of a pair are at one place.
    """
    pairs = np.asarray(ends, np.int64).reshape(-1, 2)
    length, sigma, about = (require_finite(n, v) for n, v in (
        ("range_m", range_m), ("sigma_m", sigma_m), ("about_m", about_m)))  # fmt: skip
    require_shape("range_m", length, (len(pairs),))
    if (length < 0.0).any():
        raise InputError(f"range_m must be >= 0, got {length.min():g}: leave out ranges that were not measured")
    if (sigma <= 0.0).any():
        raise InputError(f"sigma_m must be > 0, got {sigma.min():g}: give the standard deviation of each range")
    spread = np.zeros((len(pairs), 3, 3)) if about_m2 is None else about_m2[pairs[:, 0]] + about_m2[pairs[:, 1]]
    line = line_between(about[pairs[:, 0]], about[pairs[:, 1]], spread)
    if (line.distance_m < SAME_PLACE_M).any():
        i, j = pairs[int(np.argmin(line.distance_m))]
        raise InputError(f"about_m must place nodes {i} and {j} apart, got one place for both: a range needs a line")
    weight = 1.0 / (np.square(sigma) + line.bend_m2)
    information = weight[:, None, None] * line.unit[:, :, None] * line.unit[:, None, :]
    vector = (weight * (length - line.bend_m))[:, None] * line.unit
    return Factors(pairs, information, vector, np.zeros_like(information))


class SightLine(NamedTuple):
    """Lines between nodes (...,): distance, unit vector (..., 3) to the first, and what bends the mean and the variance
    of the distance."""

    distance_m: Array
    unit: Array
    bend_m: Array
    bend_m2: Array


def line_between(first_m: Array, second_m: Array, covariance_m2: Array) -> SightLine:
    """The lines from second to first nodes (..., 3), of whose difference ``covariance_m2`` (..., 3, 3) is known."""
    apart = first_m - second_m
    distance = np.linalg.norm(apart, axis=-1)
    unit = apart / np.maximum(distance, SAME_PLACE_M)[..., None]
    across = np.eye(3) - unit[..., :, None] * unit[..., None, :]
    curved = across @ covariance_m2 / np.maximum(distance, SAME_PLACE_M)[..., None, None]
    bend = 0.5 * np.trace(curved, axis1=-2, axis2=-1)
    return SightLine(distance, unit, bend, 0.5 * np.trace(curved @ curved, axis1=-2, axis2=-1))


def inverse(matrix: Array) -> Array:
    """Inverse of matrices (..., D, D)."""
    return np.asarray(np.linalg.inv(matrix), np.float64)


def normal_equations(factors: Factors, nodes: int) -> tuple[Array, Array]:
    """Normal matrix (3N, 3N) and right side (3N,) of the factors alone, with all of their errors."""
    factors = factors.whole
    normal, right = np.zeros((nodes, 3, nodes, 3)), np.zeros((nodes, 3))
    for a, sign_a in ((0, 1.0), (1, -1.0)):
        np.add.at(right, factors.ends[:, a], sign_a * factors.vector)
        for b, sign_b in ((0, 1.0), (1, -1.0)):
            into = (factors.ends[:, a], slice(None), factors.ends[:, b], slice(None))
            np.add.at(normal, into, sign_a * sign_b * factors.information)  # type: ignore[arg-type]
    return normal.reshape(3 * nodes, 3 * nodes), right.reshape(-1)


def joint_solution(mean_m: Array, covariance_m2: Array, factors: Factors) -> tuple[Array, Array]:
    """Positions (N, 3) and their joint covariance (3N, 3N) from a joint prior and factors: exact least squares.

    mean_m (N, 3), covariance_m2 (3N, 3N); of a surveyed node that of its survey.
    """
    normal, right = normal_equations(factors, len(mean_m))
    prior = inverse(covariance_m2)
    covariance = inverse(prior + normal)
    return np.asarray(covariance @ (prior @ mean_m.reshape(-1) + right)).reshape(-1, 3), np.asarray(covariance)
