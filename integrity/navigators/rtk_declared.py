"""The declared figures of RTK in the columns that its stage takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.navigators import rtk_stage_kernel as rk
from lanebound.integrity.positioning.config import RtkConfig
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig

__all__ = ["declared_rtk"]


def declared_rtk(rtk: RtkConfig, slips: CycleSlipConfig, bands: int, smallest_risk: float) -> NDArray[np.float64]:
    """Figures (NP,) of :mod:`.rtk_stage_kernel`; ``smallest_risk`` is that of the strictest level asked for."""
    r = rtk
    values: dict[int, Any] = {
        rk.BANDS: bands, rk.SIN_MASK: np.sin(np.deg2rad(r.elevation_mask_deg)),
        rk.CN0_MIN: r.cn0_min_dbhz, rk.SIGMA_CODE: r.sigma_code_m,
        rk.SIGMA_PHASE: r.sigma_phase_m, rk.SIGMA_PHASE_PL: r.sigma_phase_integrity_m, rk.PHASE_BIAS: r.phase_bias_m,
        rk.AGE_SIGMA: r.age_sigma_mps, rk.MAX_AGE: r.max_age_s, rk.FIX_MAX_AGE: r.fix_max_age_s,
        rk.FIX_LIMIT: r.ambiguity_risk_share * smallest_risk, rk.RATIO_MIN: r.ratio_min,
        rk.MAX_CANDIDATES: r.max_candidates, rk.MIN_SATELLITES: r.min_satellites, rk.MIN_FURTHER: r.min_further,
        rk.HOLD_FAILURES: r.hold_failures, rk.ATTEMPTS: r.attempts, rk.SLIP_K: slips.threshold,
        rk.SLIP_IONO: slips.ionosphere_rate_mps, rk.SLIP_FIT: slips.fit_limit,
        rk.SLIP_FAILURE: slips.repair_failure_rate, rk.RETRY: r.retry_s,
    }  # fmt: skip
    par = np.zeros(rk.NP)
    par[list(values)] = list(values.values())
    return par
