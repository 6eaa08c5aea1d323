"""The road vehicle's rules as data: integrity risk, its allocation, fault priors, false alarms, and their factors.

S1 and S2 print factors that are smaller than their own tests and risks ask for; both variants are here. *Exact* factors
hold what they promise: the separation test's own threshold (two sides, two axes, every mode), a two-sided fault-free
factor, and missed-detection factors from the prior and the share of each mode. *Published* factors,
``K_fa = Qinv(a/(2 n))`` and one ``K_md = Qinv(risk)``, reproduce the papers' tables.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import field_validator
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import require_in_range

__all__ = [
    "RiskConfig",
    "Variant",
    "direction_factor",
    "false_alarm_factor",
    "multiple_fault_risk",
    "pair_risk",
    "upper_quantile",
]

Array = NDArray[np.float64]


SATELLITE_PRIORS = (1e-5, 1e-5, 1e-4, 1e-5, 1e-5)
DOPPLER_CONSTELLATION_PRIORS = (1e-8, 1e-4, 1e-4, 1e-4, 1e-4)


class Variant(Enum):
    """Which factors and biases a protection level uses."""

    EXACT = "exact"
    PUBLISHED = "published"


class RiskConfig(Config):
    """Allowed risk, how it is divided, and how likely the faults are."""

    integrity_risk: float = Field(
        1e-5, gt=0, lt=1, description="total horizontal risk P_HMI at an epoch [-]; S2 section 4.2"
    )
    at_share: float = Field(0.5, gt=0, lt=1, description="share of the risk given to along track [-]; S1 section 3.2")
    fault_free_share: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="share w_0 of the fault-free mode in the closed form, 0 for equal shares [-]; S1 eq 17",
    )
    false_alarm: float = Field(
        0.01, gt=0, lt=1, description="significance alpha of the separation test [-]; S1 section 3.2"
    )
    direction_test: bool = Field(
        False, description="test the direction of largest separation, not AT and CT, as fde.search=direction; S2 eq 9"
    )
    satellite_prior: tuple[float, ...] = Field(
        SATELLITE_PRIORS,
        min_length=5,
        max_length=8,
        description="fault probability of one satellite, by system [-]; WG-C ARAIM ADD v3.1 (1e-5), ICAO GLONASS 1e-4",
    )
    fault_duration_s: float = Field(
        3600.0,
        gt=0,
        description="mean time that a fault lasts: a prior P means P / this new faults [1/s]; WG-C ARAIM ADD v3.1",
    )
    constellation_prior: tuple[float, ...] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0),
        min_length=5,
        max_length=8,
        description="fault probability of a whole system [-]; 0: common to rover and reference, so it cancels in RTK",
    )
    doppler_constellation_prior: tuple[float, ...] = Field(
        DOPPLER_CONSTELLATION_PRIORS,
        min_length=5,
        max_length=8,
        description="fault probability of a whole system in Doppler, which no reference shares, by system [-]; "
        "WG-C ARAIM ADD v3.1: GPS 1e-8, others 1e-4",
    )
    unmonitored_risk: float = Field(0.0, ge=0, lt=1, description="risk spent on events outside the fault modes [-]")
    subtract_multiple: bool = Field(
        True, description="spend risk on two or more faults at once, which no mode covers; S1 and S2 neglect it"
    )
    spend_unsolvable: bool = Field(
        False, description="spend the prior of a mode that cannot be solved, instead of giving no protection level"
    )
    variant: Variant = Field(Variant.EXACT, description="exact or published factors and biases; equations.md section 6")

    @field_validator("satellite_prior", "constellation_prior", "doppler_constellation_prior")
    @classmethod
    def _priors_are_probabilities(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0.0 <= p < 1.0 for p in value):
            raise ValueError(f"every prior must lie in [0, 1), got {value}")
        return value

    @property
    def monitors_constellations(self) -> bool:
        """Whether any system as a whole may fail."""
        return any(p > 0.0 for p in self.constellation_prior)

    def priors(self) -> tuple[Array, Array]:
        """Priors of the satellites and of the constellation of each group, for the kernels.  (8,) each [-]."""
        return _by_group(self.satellite_prior), _by_group(self.constellation_prior)

    def doppler_priors(self) -> Array:
        """Priors of the constellation of each group in Doppler, for the kernels.  (8,) [-]."""
        return _by_group(self.doppler_constellation_prior)

    def axis_budgets(self, risks: ArrayLike | None = None, spent: ArrayLike = 0.0) -> Array:
        """``(risk - spent) (at_share, 1 - at_share)``.

        risks (R,), by default the one configured; spent (...,) [-] -> (..., R, 2), not positive when nothing is left.
        """
        wanted = np.atleast_1d(require_in_range("risks", self.risks(risks), 0.0, 1.0, low_open=True, high_open=True))
        left = wanted - np.asarray(spent, dtype=np.float64)[..., None]
        return np.asarray(left[..., None] * np.array([self.at_share, 1.0 - self.at_share]))

    def risks(self, risks: ArrayLike | None = None) -> Array:
        """The given risks or, without any, the configured one.  (R,)."""
        return np.atleast_1d(np.asarray(self.integrity_risk if risks is None else risks, dtype=np.float64))

    def false_alarm_factors(self, largest: int, rank: int = 1) -> Array:
        """K_fa for 0 to ``largest`` fault modes, of a mode with separations of this rank.  (largest + 1,)."""
        counts = np.arange(largest + 1)
        if self.direction_test:
            return direction_factor(self.false_alarm, counts, rank)
        return false_alarm_factor(self.false_alarm, counts, self.variant)


def _by_group(priors: tuple[float, ...]) -> Array:
    """Priors, 0 for groups without one.  (8,)."""
    return np.array([*priors, *(0.0,) * (8 - len(priors))])


def upper_quantile(p: ArrayLike) -> Array:
    """``Qinv(p)``: x with Q(x) = p; -inf for p >= 1, inf for p <= 0.  p (...,) -> (...,)."""
    return np.asarray(-ndtri(np.clip(np.asarray(p, dtype=np.float64), 0.0, 1.0)))


def false_alarm_factor(alpha: float, n_modes: ArrayLike, variant: Variant = Variant.EXACT) -> Array:
    """Threshold of ``abs(d_i)/sigma_di`` (S1 eq 13): ``Qinv(a/(4 n))`` exact, ``Qinv(a/(2 n))`` published.

    The exact one is two-sided on two axes of n modes, as the test itself. n_modes (...,) -> (...,), 0 without modes.
    """
    n = np.asarray(n_modes, dtype=np.float64)
    sides = 4.0 if variant is Variant.EXACT else 2.0
    return np.where(n > 0.0, upper_quantile(alpha / (sides * np.maximum(n, 1.0))), 0.0)


def direction_factor(alpha: float, n_modes: ArrayLike, rank: ArrayLike) -> Array:
    """Threshold of the largest direction, ``sqrt(chi2_{1-a/n}(rank))`` (S2 eq 9).  (...,) -> (...,), 0 for none."""
    n = np.asarray(n_modes, dtype=np.float64)
    return np.where(n > 0.0, np.sqrt(chdtri(np.asarray(rank), alpha / np.maximum(n, 1.0))), 0.0)


def pair_risk(priors: ArrayLike) -> Array:
    """Bound of the probability of two or more faults, ``sum_{i<j} P_i P_j``.  (..., M) -> (...,).

    Above :func:`multiple_fault_risk` by at most a share ``sum P_i`` of it, and free of cancellation.
    """
    p = np.asarray(priors, dtype=np.float64)
    return np.asarray(0.5 * (p.sum(-1) ** 2 - (p * p).sum(-1)))


def multiple_fault_risk(priors: ArrayLike) -> Array:
    """Probability of two or more of independent faults, exactly (sum over k >= 2).  (..., M) -> (...,)."""
    p = np.asarray(priors, dtype=np.float64)
    none, one, more = np.ones(p.shape[:-1]), np.zeros(p.shape[:-1]), np.zeros(p.shape[:-1])
    for i in range(p.shape[-1]):
        q = p[..., i]
        more = more + one * q
        one = one * (1.0 - q) + none * q
        none = none * (1.0 - q)
    return np.asarray(more)
