"""Detectable biases of one satellite: theory beside the results of detection and exclusion.

Geometries, noise and faulty satellites are drawn at random. A bias is so many times the minimal detectable one of its
satellite, ``sqrt(lambda_0 / c'MC)`` (Baarda 1968): at 1 the test of the faulty satellite alone has the power that
lambda_0 was computed for, else that of a non-central chi-square. Detection sees more (the other tests and the global
one), exclusion less (it must name the right satellite).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, chndtr

from lanebound.agents.assess.bounding_summary import rate_of
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.detection import (
    adjust,
    diagonal_covariance,
    minimal_detectable_bias,
    w_test,
)
from lanebound.integrity.monitoring.exclusion import FdeConfig, FdeOutcome, detect_and_exclude
from lanebound.integrity.monitoring.significance import noncentrality
from lanebound.integrity.positioning.least_squares import design_matrix

__all__ = ["FACTORS", "detectability"]

Array = NDArray[np.float64]

FACTORS = (0.0, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
GEOMETRIES = 40
LOWEST_RAD = np.deg2rad(10.0)
SYSTEMS = 2
FREE_DRAWS = 4  # so many times more without a fault: false alarms are rare
UNSOLVED = 1e-6  # of the largest redundancy; a satellite below has no redundancy


def detectability(fde: FdeConfig, satellites: int, draws: int, seed: int = 1) -> dict[str, Any]:
    """Rates by the size of the bias for geometries of so many satellites.

    Returns
    -------
    ``satellites`` and ``by_factor``, a row for each size: ``factor`` of the minimal detectable bias; ``theory``, the
    power of the faulty satellite's own test; ``own`` that power measured; ``noticed``, anything detected; ``right``,
    that satellite excluded and no other. At factor 0 ``noticed`` is the false alarm.
    """
    rng = named_generator([seed, satellites], "detectability")
    design, variance = _geometries(rng, satellites)
    silent = adjust(design, diagonal_covariance(variance), np.zeros((GEOMETRIES, satellites)))
    size = float(fde.tables(satellites).local_significance[int(silent.df[0]), satellites])
    lambda0 = noncentrality(size, fde.power)
    least = minimal_detectable_bias(silent, np.full(GEOMETRIES, lambda0))
    each = max(1, draws // GEOMETRIES)
    rows = []
    for factor in FACTORS:
        count = each * (1 if factor else FREE_DRAWS)
        faulty, observed = _observed(rng, variance, factor * least, count)
        rows.append(_row(fde, (design, variance), faulty, observed, size, factor))
        rows[-1]["theory"] = float(1.0 - chndtr(float(chdtri(1, size)), 1, factor * factor * lambda0))
    return {"satellites": satellites, "redundancy": int(silent.df[0]), "alpha": fde.alpha, "by_factor": rows}


def _geometries(rng: np.random.Generator, satellites: int) -> tuple[Array, Array]:
    """Designs (K, n, 5) and variances (K, n) [of the zenith's], with redundancy of every satellite."""
    designs: list[Array] = []
    variances: list[Array] = []
    while len(designs) < GEOMETRIES:
        sine = rng.uniform(np.sin(LOWEST_RAD), 1.0, satellites)
        azimuth, flat = rng.uniform(0.0, 2.0 * np.pi, satellites), np.sqrt(1.0 - sine * sine)
        los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
        design = design_matrix(los, np.arange(satellites) % SYSTEMS, SYSTEMS)
        variance = 0.5 * (1.0 + 1.0 / sine**2)
        state = adjust(design, diagonal_covariance(variance), np.zeros(satellites))
        share = np.diagonal(state.reliability) * variance
        if state.solvable and share.min() > UNSOLVED:
            designs.append(design)
            variances.append(variance)
    return np.array(designs), np.array(variances)


def _observed(rng: np.random.Generator, variance: Array, bias: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """The faulty satellite (K, D) and observations (K, D, n) with its bias, of either sign."""
    shape = (GEOMETRIES, count, variance.shape[-1])
    faulty = rng.integers(shape[-1], size=shape[:2])
    noise = rng.standard_normal(shape) * np.sqrt(variance)[:, None]
    size = np.take_along_axis(bias[:, None].repeat(count, 1), faulty[..., None], -1)
    sign = rng.choice([-1.0, 1.0], shape[:2])[..., None]
    return faulty, noise + sign * size * (np.arange(shape[-1]) == faulty[..., None])


def _row(
    fde: FdeConfig, model: tuple[Array, Array], faulty: NDArray[np.int64], observed: Array, size: float, factor: float
) -> dict[str, Any]:
    """Counts of one size of bias."""
    design, covariance = model[0][:, None], diagonal_covariance(model[1])[:, None]
    found = detect_and_exclude(fde, design, covariance, observed)
    own = w_test(adjust(design, covariance, observed), size).failed
    own = np.take_along_axis(own, faulty[..., None], -1)[..., 0]
    noticed = (found.outcome == FdeOutcome.EXCLUDED.code) | (found.outcome == FdeOutcome.UNRESOLVED.code)
    right = (found.excluded == (np.arange(observed.shape[-1]) == faulty[..., None])).all(-1)
    n = noticed.size
    return {
        "factor": factor,
        "own": rate_of(int(own.sum()), n),
        "noticed": rate_of(int(noticed.sum()), n),
        "right": rate_of(int(right.sum()), n),
    }
