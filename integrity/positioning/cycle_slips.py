"""Thresholds of cycle slip detection and repair (:mod:`lanebound.integrity.positioning.cycle_slips_kernel`)."""

from __future__ import annotations

from pydantic import Field
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.config import Config

__all__ = ["CycleSlipConfig"]

TESTS_PER_SATELLITE = 4  # geometry-free, two predicted, code-phase


class CycleSlipConfig(Config):
    """Thresholds of slip detection and repair."""

    false_alarm_rate: float = Field(
        1e-5,
        gt=0.0,
        lt=1.0,
        description="P(flagged without a slip), satellite and epoch [1]; once in 3 hours at 10 Hz",
    )
    repair_failure_rate: float = Field(
        1e-4,
        gt=0.0,
        lt=1.0,
        description="P(a repair is wrong) [1]; a tenth of the 1e-3 customary in resolution",
    )
    repair_false_rejection: float = Field(
        1e-3, gt=0.0, lt=1.0, description="P(the right repair is refused for its fit) [1]"
    )
    ionosphere_rate_mps: float = Field(
        0.001,
        ge=0.0,
        description="sd of the rate of phase 1 - phase 2 [m/s]; above the 0.1 mm/s of a quiet ionosphere",
    )

    @property
    def threshold(self) -> float:
        """Standard deviations at which one test rejects: ``Qinv(P_FA / (2 * 4))``, Bonferroni over the tests."""
        return -float(ndtri(self.false_alarm_rate / (2 * TESTS_PER_SATELLITE)))

    @property
    def fit_limit(self) -> float:
        """Largest squared norm of an accepted repair: the chi-square quantile with 2 degrees of freedom."""
        return float(chdtri(2, self.repair_false_rejection))
