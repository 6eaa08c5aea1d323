"""Fixed-failure-rate ratio test: the threshold table and its look-up.

``mu`` bounds best over second best norm: accept when ``norm_1 <= mu norm_2``. ``P_IF`` is the bootstrapped failure
rate of the decorrelated ambiguities, as :func:`lanebound.integrity.positioning.lambda_kernel.bootstrap_failure_rate`
gives it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

Array = NDArray[np.float64]

LIMITS = np.array([1e-3, 1e-2])
NUMBERS = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0, 28.0, 40.0, 66.0])
FAILURE_RATES = np.array([1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2])
MU = np.array(
    [
        [
            [0.9110, 0.7184, 0.4702, 0.2747, 0.1529, 0.0281, 0.0015, 0.0001],
            [0.9137, 0.7628, 0.4973, 0.3599, 0.2352, 0.0733, 0.0273, 0.0072],
            [0.9581, 0.7628, 0.5505, 0.4017, 0.2459, 0.1095, 0.0496, 0.0214],
            [0.9657, 0.7862, 0.5644, 0.4595, 0.3105, 0.2181, 0.1034, 0.0635],
            [0.9657, 0.7862, 0.6540, 0.4855, 0.4045, 0.2600, 0.2078, 0.1473],
            [0.9657, 0.8387, 0.6824, 0.5537, 0.4515, 0.3421, 0.2903, 0.2530],
            [0.9657, 0.8632, 0.7139, 0.6273, 0.5146, 0.4264, 0.3378, 0.3258],
            [0.9657, 0.9012, 0.8139, 0.6558, 0.6446, 0.5520, 0.5325, 0.4858],
            [0.9657, 0.9012, 0.8139, 0.7476, 0.7001, 0.6563, 0.5947, 0.5802],
            [0.9657, 0.9185, 0.8461, 0.7974, 0.7381, 0.7067, 0.6772, 0.6772],
            [0.9748, 0.9316, 0.8706, 0.8390, 0.7999, 0.7681, 0.7533, 0.7533],
            [0.9946, 0.9554, 0.9177, 0.8864, 0.8695, 0.8460, 0.8460, 0.8460],
        ],
        [
            [1.0000, 1.0000, 1.0000, 0.9657, 0.6160, 0.2514, 0.0707, 0.0042],
            [1.0000, 1.0000, 1.0000, 0.9687, 0.6954, 0.3401, 0.1863, 0.0630],
            [1.0000, 1.0000, 1.0000, 0.9687, 0.7141, 0.3953, 0.2364, 0.1137],
            [1.0000, 1.0000, 1.0000, 0.9903, 0.7473, 0.5212, 0.3206, 0.2103],
            [1.0000, 1.0000, 1.0000, 0.9929, 0.8087, 0.5764, 0.4565, 0.3333],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.8446, 0.6723, 0.5484, 0.4680],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.8601, 0.7004, 0.5819, 0.5329],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.9248, 0.7831, 0.7692, 0.6985],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.9327, 0.8605, 0.7692, 0.7339],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.9349, 0.8605, 0.8151, 0.7912],
            [1.0000, 1.0000, 1.0000, 0.9942, 0.9474, 0.8895, 0.8577, 0.8493],
            [1.0000, 1.0000, 1.0000, 0.9966, 0.9634, 0.9281, 0.9099, 0.9036],
        ],
    ]
)  # [limit, n, failure rate]: every cell by tests/reference/plain_ratio_test.py, simulate_thresholds


@jit
def _position(grid: Array, value: float) -> tuple[int, float]:
    """Interval of an ascending grid and the fraction within it, in the logarithm, clipped to the grid."""
    last = grid.shape[0] - 1
    if value <= grid[0]:
        return 0, 0.0
    if value >= grid[last]:
        return last - 1, 1.0
    i = 0
    while grid[i + 1] < value:
        i += 1
    return i, math.log(value / grid[i]) / math.log(grid[i + 1] / grid[i])


@jit
def tabulated_mu(n: int, failure_rate: float, limit: float) -> float:
    """Largest mu for which P(wrong and accepted) <= limit; 0 (accept nothing) where the table says nothing.

    A limit between two tables takes the smaller. Beyond the last n the last one counts (mu grows with n: conservative).
    """
    if n <= 0 or failure_rate <= limit:
        return 1.0
    if limit < LIMITS[0] or not failure_rate <= FAILURE_RATES[FAILURE_RATES.shape[0] - 1]:
        return 0.0
    table = 1 if limit >= LIMITS[1] else 0
    i, u = _position(NUMBERS, float(n))
    k, v = _position(FAILURE_RATES, failure_rate)
    low = MU[table, i, k] + v * (MU[table, i, k + 1] - MU[table, i, k])
    high = MU[table, i + 1, k] + v * (MU[table, i + 1, k + 1] - MU[table, i + 1, k])
    return float(low + u * (high - low))


@jit
def minimum_ratio(n: int, failure_rate: float, limit: float, floor: float) -> float:
    """Smallest second best over best norm to accept: ``max(1 / mu, floor)``, inf when nothing may be accepted.

    The floor guards against errors of the model, which the failure rate knows nothing of.
    """
    mu = tabulated_mu(n, failure_rate, limit)
    return max(1.0 / mu, floor) if mu > 0.0 else math.inf
