"""Integer least squares at n = 20: the compiled warm fix against the same algorithm in plain Python."""

from __future__ import annotations

import itertools
from statistics import median

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.integrity.positioning import lambda_kernel as kernel
from lanebound.integrity.positioning.ambiguity import NODE_LIMIT, integer_least_squares

__all__ = ["drifting_problems", "measure"]

Array = NDArray[np.float64]
N_SATELLITES, EPOCHS, DT_S = 11, 400, 0.1
CODE_M, PHASE_M = 0.3, 0.003
WAVELENGTHS_M = (0.190293673, 0.244210213)  # GPS L1 and L2
SKY_RATE_RADPS = 1.2e-4  # how fast satellites of a 12-hour orbit move across the sky


def _covariance(elevation: Array, azimuth: Array) -> Array:
    """Covariance (n, n) [cycles^2] of the double-differenced ambiguities of two bands, code and phase of one epoch."""
    e = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1)
    pairs = len(elevation) - 1
    difference = np.hstack([-np.ones((pairs, 1)), np.eye(pairs)])
    weights = np.linalg.inv(2 * difference @ np.diag(np.sin(elevation) ** -2) @ difference.T)
    normal = np.zeros((3 + 2 * pairs, 3 + 2 * pairs))
    for band, wavelength in enumerate(WAVELENGTHS_M):
        for sigma, scale in ((CODE_M, 0.0), (PHASE_M, wavelength)):
            rows = np.zeros((pairs, 3 + 2 * pairs))
            rows[:, :3] = -difference @ e
            rows[:, 3 + band * pairs : 3 + (band + 1) * pairs] = scale * np.eye(pairs)
            normal += rows.T @ weights @ rows / sigma**2
    Q = np.linalg.inv(normal)[3:, 3:]
    return np.asarray((Q + Q.T) / 2)


def drifting_problems(seed: int = 3) -> tuple[Array, Array]:
    """Float ambiguities (E, 20) and covariances (E, 20, 20) of one sky at 10 Hz, satellites moving."""
    rng = np.random.default_rng(seed)
    elevation = np.arcsin(rng.uniform(np.sin(np.radians(15)), 1.0, N_SATELLITES))
    azimuth = rng.uniform(0, 2 * np.pi, N_SATELLITES)
    rates = SKY_RATE_RADPS * rng.uniform(-1, 1, (2, N_SATELLITES))
    Q = np.stack([_covariance(elevation + rates[0] * t, azimuth + rates[1] * t) for t in DT_S * np.arange(EPOCHS)])
    true = rng.integers(-50, 50, Q.shape[-1])
    noise = rng.standard_normal((EPOCHS, Q.shape[-1], 1))
    return true + (np.linalg.cholesky(Q) @ noise)[..., 0], Q


def measure(rounds: int = 5) -> list[Row]:
    """Warm compiled fix against the plain one, both returning the two best candidates; checked for equality first."""
    a, Q = drifting_problems()
    candidates, norms = np.empty((EPOCHS, 2, a.shape[-1])), np.empty((EPOCHS, 2))
    failure_rate, status = np.empty(EPOCHS), np.empty(EPOCHS, dtype=np.int64)

    def run(reuse: bool) -> int:
        kernel.solve_epochs(a, Q, NODE_LIMIT, reuse, candidates, norms, failure_rate, status)
        return EPOCHS

    plain_epochs = itertools.cycle(range(EPOCHS))

    def plain() -> int:
        e = next(plain_epochs)
        integer_least_squares(a[e], Q[e])
        return 1

    run(True)
    checked = integer_least_squares(a[:5], Q[:5])
    if status.any() or not np.array_equal(checked.candidates, candidates[:5]):
        raise AssertionError("compiled and plain integer least squares disagree")
    rates = alternate({"warm": lambda: run(True), "cold": lambda: run(False), "plain": plain}, rounds)
    return [
        Row("lambda_n20_vs_python", median_ratio(rates, "warm", "plain"), "x", gate=500, stretch=1000),
        Row("lambda_n20_us", 1e6 / median(rates["warm"]), "us", higher_is_better=False),
        Row("lambda_n20_cold_us", 1e6 / median(rates["cold"]), "us", higher_is_better=False),
    ]
