"""SPAWN with Gaussian messages: the sum-product algorithm on the network of nodes (S2 section 7, [38] and [39]).

Each node holds the information (matrix J, vector h) of its position: a prior and one message from each neighbour. What
node j tells node i leaves out what i told it::

    J, h of j without i  ->  K = L (L + J)^-1,  message J_m = L - K L,  h_m = (v + K (h - v)) for x_i

with L, v of the factor of ``x_i - x_j``. After as many rounds as the network is wide, a network without loops has the
exact marginals. On loops news come back: means converge where they do, variances are too small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.cooperative.factors import Factors, inverse

__all__ = ["sum_product", "told"]

Array = NDArray[np.float64]


def told(information: Array, vector: Array, matrix: Array, right: Array) -> tuple[Array, Array]:
    """What senders with ``information`` (E, 3, 3), ``vector`` (E, 3) say of receivers over factors (matrix, right).

    The factor is that of receiver less sender. Returns information (E, 3, 3) and vector (E, 3) for the receiver.
    """
    gain = np.swapaxes(np.linalg.solve(matrix + information, matrix), -1, -2)  # L (L + J)^-1, both symmetric
    message = matrix - gain @ matrix
    return 0.5 * (message + np.swapaxes(message, -1, -2)), right + np.einsum("eij,ej->ei", gain, vector - right)


def sum_product(mean_m: Array, covariance_m2: Array, factors: Factors, rounds: int = 10) -> tuple[Array, Array]:
    """Marginals of the nodes, positions (N, 3) and covariances (N, 3, 3), after rounds of messages.

    Parameters
    ----------
    mean_m, covariance_m2 : (N, 3), (N, 3, 3) priors of the nodes, taken as independent
    factors : of pairs of nodes
    rounds : of messages between neighbours; the longest way between two nodes makes a network without loops exact

    Raises
    ------
    InputError
        When ``rounds`` is negative.
    """
    if rounds < 0:
        raise InputError(f"rounds must be >= 0, got {rounds}: give the number of rounds of messages")
    prior = inverse(covariance_m2)
    prior_vector = np.einsum("nij,nj->ni", prior, mean_m)
    to, of, matrix, right, _ = factors.whole.directed()
    back = np.roll(np.arange(len(to)), len(to) // 2)
    told_matrix, told_vector = np.zeros_like(matrix), np.zeros_like(right)
    matrices, vectors = prior.copy(), prior_vector.copy()
    for _ in range(rounds):
        told_matrix, told_vector = told(
            matrices[of] - told_matrix[back], vectors[of] - told_vector[back], matrix, right
        )
        matrices, vectors = prior.copy(), prior_vector.copy()
        np.add.at(matrices, to, told_matrix)
        np.add.at(vectors, to, told_vector)
    covariance = inverse(matrices)
    return np.einsum("nij,nj->ni", covariance, vectors), covariance
