"""Double differences of codes that nodes share, as factors of their positions (S2 section 7: V2V double differences).

The code of satellite s at node i is ``y_is = -e_s.x_i + c_i + b_s + n_is`` with the clock c_i of the receiver and
system, the error b_s of the satellite's signal, which nodes near each other have in common, and noise n_is of variance
``1 / w_is``. Between two nodes b_s falls out, and the difference of the clocks is estimated::

    y_is - y_js = -e_s.(x_i - x_j) + (c_i - c_j) + n_is - n_js

A code that enters several differences makes them correlated. A factor that takes ``d_i / w_is + d_j / w_js`` as the
variance of a difference, with the number d of differences that a code enters, is never overconfident: with D the
matrix of the differences, R the variances of the codes and W the weights of the differences, each row of ``W D R D'``
has absolute sum ``W (d_i / w_i + d_j / w_j) = 1``, so that its eigenvalues are at most 1 and ``W D R D' W <= W``: the
covariance that the weights promise is no smaller than that of the solution, also when each pair estimates clocks of its
own. Nodes need to know nothing of the codes of others than with how many they are shared.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.cooperative.factors import Factors

__all__ = ["clock_free", "double_differences"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def clock_free(weight: Array, system: Ints) -> Array:
    """Weight matrices (..., S, S) of codes whose clocks are unknown: ``W - W 1 (1'W 1)^-1 1'W`` for each system.

    weight (..., S) [1/m^2], 0 where a code is not used; system (S,).
    """
    out = np.zeros((*weight.shape, weight.shape[-1]))
    diagonal = np.arange(weight.shape[-1])
    out[..., diagonal, diagonal] = weight
    for number in np.unique(system):
        own = weight * (system == number)
        total = own.sum(-1)
        share = own / np.where(total > 0.0, total, 1.0)[..., None]
        out -= own[..., :, None] * share[..., None, :]
    return out


def double_differences(
    pairs: Ints, los_enu: Array, code_m: Array, variance_m2: Array, used: Bools, system: Ints, lasting_m2: Array
) -> Factors:
    """Factors of the pairs of nodes that share their codes.

    Parameters
    ----------
    pairs : (E, 2) nodes that share their codes, each pair once
    los_enu : (S, 3) unit vectors to the satellites; nodes are near each other
    code_m, variance_m2, used : (N, S) codes by node, the variances of their white noise and which are used
    system : (S,) clocks of systems are estimated apart
    lasting_m2 : (N, S) variances of further errors, which last from epoch to epoch
    """
    both = used[pairs[:, 0]] & used[pairs[:, 1]]  # (E, S)
    shared = np.zeros(code_m.shape)
    for end in range(2):
        np.add.at(shared, pairs[:, end], both)
    white, lasting = (_of_pairs(pairs, np.where(used, shared * v, 0.0)) for v in (variance_m2, lasting_m2))
    weight = clock_free(np.where(both, 1.0 / np.where(both, white, 1.0), 0.0), system)
    difference = np.where(both, code_m[pairs[:, 0]] - code_m[pairs[:, 1]], 0.0)
    projected = np.einsum("sk,est->ekt", -los_enu, weight)
    information = projected @ -los_enu
    gain = np.linalg.pinv(information, rcond=1e-6, hermitian=True) @ projected
    left = (gain * np.where(both, lasting, 0.0)[:, None]) @ np.swapaxes(gain, -1, -2)
    return Factors(pairs, information, np.einsum("ekt,et->ek", projected, difference), left)


def _of_pairs(pairs: Ints, values: Array) -> Array:
    """Sum of the values (N, S) of both nodes, (E, S)."""
    return np.asarray(values[pairs[:, 0]] + values[pairs[:, 1]])
