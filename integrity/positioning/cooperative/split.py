"""Messages between nodes that count no rumour twice: split covariance intersection.

The errors of two nodes have parts in common once they have exchanged positions, and the common errors of the broadcast
before that. Each error is split: part d, of unknown correlation with anything, and part i, independent of all else.
With a weight w in (0, 1)::

    P1 = P1d / w + P1i,  P2 = P2d / (1 - w) + P2i,  P = (P1^-1 + P2^-1)^-1

is at least the covariance of the fused error for every correlation of the d parts (S. Julier and J. Uhlmann 2001,
"General decentralized data fusion with covariance intersection"; of vehicles H. Li and F. Nashashibi 2013, IEEE ITS
Magazine 5(2)). Here what a node knew before the epoch is its part d, and the noise of the epoch's factors the part i.
News travel by one link in each epoch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.cooperative.factors import Factors, inverse
from lanebound.integrity.positioning.cooperative.messages import told

__all__ = ["correlated_sum", "intersection", "split_messages"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TINY_M2 = 1e-12
# Weights of the sender's knowledge that are tried; a surveyed node's costs the receiver next to nothing.
OTHERS_WEIGHT = np.array([1e-4, 1e-3, 0.01, 0.03, 0.08, 0.16, 0.3, 0.5, 0.7, 0.9])


def intersection(mean_m: Array, covariance_m2: Array, other_m: Array, other_m2: Array) -> tuple[Array, Array]:
    """Fusion of two estimates of K states by covariance intersection, of the smallest volume.

    mean_m, other_m (K, D); covariance_m2, other_m2 (K, D, D); D is 3, or 3 for each of several nodes. Correlations of
    the two are unknown. Returns mean and covariance; of the weights 0 (the first alone) to 1 (the other alone), the
    best of eleven.
    """
    weight = np.linspace(0.0, 1.0, 11)[:, None, None, None]
    own, others = inverse(covariance_m2), inverse(other_m2)
    tried = inverse((1.0 - weight) * own + weight * others)
    best = np.argmin(np.linalg.slogdet(tried)[1], axis=0)
    every = np.arange(len(mean_m))
    covariance, w = tried[best, every], weight[best, 0, 0]
    vector = (1.0 - w) * np.einsum("kij,kj->ki", own, mean_m) + w * np.einsum("kij,kj->ki", others, other_m)
    return np.einsum("kij,kj->ki", covariance, vector), covariance


def correlated_sum(covariance_m2: Array, more_m2: Array) -> Array:
    """Covariance (K, D, D) of a sum whose terms may be correlated in any way: ``(1 + a) P + (1 + 1/a) Q``.

    a is that of the smallest trace in the plane, where standard deviations add up; Q is at least a micrometre's.
    """
    ratio = np.sqrt((_in_plane(more_m2) + TINY_M2) / _in_plane(covariance_m2))[:, None, None]
    return np.asarray((1.0 + ratio) * covariance_m2 + (1.0 + 1.0 / ratio) * more_m2)


def _in_plane(covariance: Array) -> Array:
    """Sum of the variances East and North (...,) of covariances (..., D, D)."""
    variance = np.einsum("...ii->...i", covariance)
    return np.asarray(variance.reshape(*variance.shape[:-1], -1, 3)[..., :2].sum((-1, -2)))


def split_messages(mean_m: Array, covariance_m2: Array, factors: Factors) -> tuple[Array, Array]:
    """Positions (N, 3) and covariances (N, 3, 3) after each node has heard each of its neighbours once.

    Parameters
    ----------
    mean_m, covariance_m2 : (N, 3), (N, 3, 3) before the epoch, of unknown correlation between the nodes; that of a
        surveyed node is its survey's
    factors : of pairs of nodes, with noise that is independent of all that was known before the epoch
    """
    mean, before, news = mean_m.copy(), covariance_m2.copy(), np.zeros_like(covariance_m2)
    for to, of, matrix, right, lasting in _turns(factors):
        # What lasts is as old as what the sender knew.
        others = inverse(correlated_sum(covariance_m2[of], lasting))
        others_vector = np.einsum("eij,ej->ei", others, mean_m[of])
        mean[to], before[to], news[to] = _hear(mean[to], before[to], news[to], others, others_vector, matrix, right)
    return mean, before + news


def _turns(factors: Factors) -> list[tuple[Ints, Ints, Array, Array, Array]]:
    """The factors in both directions, in turns in which each node hears one neighbour at most."""
    both = factors.directed()
    to = both[0]
    order = np.argsort(to, kind="stable")
    turn = np.empty(len(to), np.int64)
    turn[order] = np.arange(len(to)) - np.searchsorted(to[order], to[order])
    chosen = (np.flatnonzero(turn == k) for k in range(int(turn.max(initial=-1)) + 1))
    return [tuple(values[rows] for values in both) for rows in chosen]  # type: ignore[misc]


def _hear(
    mean: Array, before: Array, news: Array, others: Array, others_vector: Array, matrix: Array, right: Array
) -> tuple[Array, Array, Array]:
    """Mean (E, 3), part d and part i (E, 3, 3) of receivers after a neighbour's message.

    Of the weights, and of hearing nothing, that with the smallest volume is taken: a message never harms.
    """
    edges, found = np.arange(len(mean)), []
    for w in OTHERS_WEIGHT:
        message, vector = told(w * others, w * others_vector, matrix, right)
        own = inverse(before / (1.0 - w) + news)
        covariance = inverse(own + message)
        passed = np.eye(3) - np.swapaxes(np.linalg.solve(matrix + w * others, matrix), -1, -2)  # I - L (L + J)^-1
        noise = passed @ matrix @ np.swapaxes(passed, -1, -2)
        kept = covariance @ own
        fresh = kept @ news @ np.swapaxes(kept, -1, -2) + covariance @ noise @ covariance
        moved = np.einsum("eij,ej->ei", covariance, np.einsum("eij,ej->ei", own, mean) + vector)
        found.append((moved, covariance - fresh, fresh))
    found.append((mean, before, news))
    moved, old, fresh = (np.stack(parts) for parts in zip(*found, strict=True))
    best = np.argmin(np.linalg.slogdet(old + fresh)[1], axis=0)
    return moved[best, edges], old[best, edges], fresh[best, edges]
