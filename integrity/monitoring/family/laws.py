"""Laws of errors (S3 V-A): normal mixtures for codes, Rayleigh and Pareto for positions, and how well they fit.

A jump model is a mixture with ties: nominal errors, the same with another mean, and the same with another variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.core.streams import named_generator

__all__ = ["NormalMixture", "ParetoTail", "fit_jumps", "fit_mixture", "fit_normal", "fit_pareto", "fit_rayleigh"]

Array = NDArray[np.float64]

ROUNDS = 300
SETTLED = 1e-9
LEAST_SIGMA_M = 1e-3


@dataclass(frozen=True)
class NormalMixture:
    """``sum_k p_k N(mean_k, sigma_k^2)``, (K,) each; ``free`` parameters count in the information criterion."""

    share: Array
    mean_m: Array
    sigma_m: Array
    free: int

    def log_density(self, error_m: ArrayLike) -> Array:
        """Logarithm of the density.  (...,)."""
        e = np.asarray(error_m, dtype=np.float64)[..., None]
        part = np.log(self.share) - 0.5 * np.square((e - self.mean_m) / self.sigma_m) - np.log(self.sigma_m)
        most = part.max(-1)
        total = np.log(np.exp(part - most[..., None]).sum(-1))
        return np.asarray(most + total - 0.5 * np.log(2.0 * np.pi))

    def beyond(self, size_m: float) -> float:
        """P(abs(error) > size)."""
        late = ndtr(-(size_m - self.mean_m) / self.sigma_m)
        early = ndtr((-size_m - self.mean_m) / self.sigma_m)
        return float((self.share * (late + early)).sum())

    def quantile_m(self, risk: float) -> float:
        """Size that errors exceed with this risk."""
        from scipy.optimize import brentq  # as in significance.py

        high = float((np.abs(self.mean_m) + 40.0 * self.sigma_m).max())
        return float(brentq(lambda x: self.beyond(x) - risk, 0.0, high, xtol=1e-9))

    def criterion(self, error_m: ArrayLike) -> float:
        """Bayesian information criterion; the least is the best of laws fitted to the same errors."""
        e = np.asarray(error_m, dtype=np.float64).ravel()
        return float(self.free * np.log(e.size) - 2.0 * self.log_density(e).sum())


def fit_normal(error_m: ArrayLike) -> NormalMixture:
    """One normal law by mean and deviation."""
    e = _checked(error_m)
    return NormalMixture(np.ones(1), np.array([e.mean()]), np.array([max(e.std(), LEAST_SIGMA_M)]), 2)


def fit_mixture(error_m: ArrayLike, parts: int = 3, seed: int = 0) -> NormalMixture:
    """Mixture of ``parts`` normal laws by expectation and maximisation, begun at quantiles."""
    e = _checked(error_m)
    rng = named_generator(seed, "mixture")
    mean = np.quantile(e, (np.arange(parts) + 0.5) / parts) + 1e-3 * e.std() * rng.normal(size=parts)
    start = NormalMixture(np.full(parts, 1.0 / parts), mean, np.full(parts, max(e.std(), LEAST_SIGMA_M)), 3 * parts - 1)
    return _improved(e, start, _maximised)


def fit_jumps(error_m: ArrayLike) -> NormalMixture:
    """Mean and variance jump: ``N(0, s0^2)``, ``N(m, s0^2)`` and ``N(0, s1^2)`` by expectation and maximisation."""
    e = _checked(error_m)
    core = max(float(np.median(np.abs(e))) / 0.6745, LEAST_SIGMA_M)
    late = float(np.quantile(e, 0.9))
    start = NormalMixture(
        np.array([0.6, 0.2, 0.2]), np.array([0.0, late, 0.0]), np.array([core, core, 3.0 * core]), 5
    )  # fmt: skip
    return _improved(e, start, _tied)


def _improved(e: Array, law: NormalMixture, maximise: object) -> NormalMixture:
    before = -np.inf
    for _ in range(ROUNDS):
        part = np.log(law.share) - 0.5 * np.square((e[:, None] - law.mean_m) / law.sigma_m) - np.log(law.sigma_m)
        part -= part.max(-1, keepdims=True)
        weight = np.exp(part)
        weight /= weight.sum(-1, keepdims=True)
        law = maximise(e, weight, law)  # type: ignore[operator]
        now = float(law.log_density(e).mean())
        if now - before < SETTLED:
            break
        before = now
    return law


def _maximised(e: Array, weight: Array, law: NormalMixture) -> NormalMixture:
    total = np.maximum(weight.sum(0), 1e-9)
    mean = (weight * e[:, None]).sum(0) / total
    sigma = np.sqrt((weight * np.square(e[:, None] - mean)).sum(0) / total)
    return NormalMixture(total / total.sum(), mean, np.maximum(sigma, LEAST_SIGMA_M), law.free)


def _tied(e: Array, weight: Array, law: NormalMixture) -> NormalMixture:
    """Means 0, m, 0 and deviations s0, s0, s1."""
    total = np.maximum(weight.sum(0), 1e-9)
    jump = float((weight[:, 1] * e).sum() / total[1])
    square = weight[:, 0] * np.square(e) + weight[:, 1] * np.square(e - jump)
    core = np.sqrt(square.sum() / (total[0] + total[1]))
    wide = np.sqrt((weight[:, 2] * np.square(e)).sum() / total[2])
    sigma = np.maximum(np.array([core, core, wide]), LEAST_SIGMA_M)
    return NormalMixture(total / total.sum(), np.array([0.0, jump, 0.0]), sigma, law.free)


def fit_rayleigh(size: ArrayLike) -> float:
    """Scale ``sqrt(mean r^2 / 2)`` of a Rayleigh law of sizes (n,) >= 0."""
    r = _checked(size)
    return float(np.sqrt(0.5 * np.square(r).mean()))


@dataclass(frozen=True)
class ParetoTail:
    """Sizes beyond ``threshold``, a ``share`` of all: ``P(r > u + x | r > u) = (1 + shape x / scale)^(-1/shape)``."""

    threshold: float
    share: float
    scale: float
    shape: float

    def quantile(self, risk: float) -> float:
        """Size exceeded with this risk; the threshold for risks above the share."""
        ratio = min(risk / self.share, 1.0)
        grown = -np.log(ratio) if abs(self.shape) < 1e-9 else (ratio**-self.shape - 1.0) / self.shape
        return float(self.threshold + self.scale * grown)


def fit_pareto(size: ArrayLike, share: float = 0.2) -> ParetoTail:
    """Generalised Pareto tail of the largest ``share`` of sizes (n,), by weighted moments (Hosking and Wallis 1987)."""
    r = np.sort(_checked(size))
    threshold = float(np.quantile(r, 1.0 - share))
    x = r[r > threshold] - threshold
    if x.size < 5:
        raise InputError(f"size must have 5 values beyond the threshold, got {x.size}: take a larger share")
    order = (np.arange(1, x.size + 1) - 0.35) / x.size
    mean, moment = float(x.mean()), float((x * (1.0 - order)).mean())
    shape = float(np.clip(2.0 - mean / (mean - 2.0 * moment), -0.9, 0.9))
    return ParetoTail(threshold, float((r > threshold).mean()), max(mean * (1.0 - shape), 1e-9), shape)


def _checked(value: ArrayLike) -> Array:
    e = require_finite("error_m", value).ravel()
    if e.size < 5:
        raise InputError(f"error_m must have 5 errors or more, got {e.size}: use more data")
    return e
