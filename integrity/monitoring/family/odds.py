"""Several reflected codes at once as fault modes with odds (the kind ``odds``).

The odds that a code is off by more than its deviation bounds grow with its loss of C/N0 below that of an open sky. The
most doubtful codes are left out until few enough sets of two and three of the rest have to be monitored; the sets that
are not monitored take at most ``reflections.share`` of the smallest risk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import MOST_SYSTEMS, CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit
from lanebound.integrity.monitoring.family.odds_kernel import (
    OddsTables,
    WeighedCodes,
    find_odds,
    level_codes,
    trust_codes,
)
from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.positioning.parameters import reflection_parameters

__all__ = ["code_odds", "odds_axes", "odds_level", "trusted_codes"]

Array = NDArray[np.float64]

ODDS_US, TRUST_US, LEVEL_US = 0.02, 2.0, 30.0
LEAST_PRIOR = 1e-300  # of a system: its logarithm is finite, its share of any risk is not seen


def code_odds(epochs: CodeEpochs, config: FamilyMonitorConfig, smallest_risk: float) -> Array:
    """Odds of each code, the prior of other faults included; that alone where not used.  (E, m) [-]."""
    assert config.reflections is not None  # validated
    sine = np.sin(np.where(epochs.used, epochs.elevation_rad, 1.0))
    cn0, odds = np.where(epochs.used, epochs.cn0_dbhz, 1e3), np.empty(sine.shape)
    run_rows(
        find_odds, sine.size, sine.ravel(), cn0.ravel(), config.satellite_prior,
        reflection_parameters(config.reflections, smallest_risk), odds.reshape(-1), row_us=ODDS_US,
    )  # fmt: skip
    return odds


def trusted_codes(epochs: CodeEpochs, config: FamilyMonitorConfig, risks: Array) -> CodeEpochs:
    """The epochs without the codes that are too doubtful for the smallest risk; as they are where none is doubted."""
    if config.reflections is None:
        return epochs
    used = np.require(epochs.used.copy(), np.bool_, ["C", "W"])
    odds = code_odds(epochs, config, float(risks.min()))
    run_rows(trust_codes, epochs.count, used, _group(epochs), odds, _tables(epochs, config, risks), row_us=TRUST_US)
    return epochs.with_codes(used=used)


def odds_level(epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array) -> Array:
    """Root of the sum over single codes, sets and systems at their odds, ``hypot(PL_E, PL_N)``.  (E, R)."""
    levels = odds_axes(epochs, fit, config, risks)
    return np.asarray(np.hypot(levels[..., 0], levels[..., 1]))


def odds_axes(epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array) -> Array:
    """Levels of the first two columns of the directions with half of the risk each.  (E, R, 2)."""
    used = np.require(fit.used, np.bool_, ["C", "W"])
    los = np.require(np.where(used[..., None], epochs.los_enu, np.array([0.0, 0.0, 1.0])), np.float64, ["C", "W"])
    variance = np.where(used, np.square(np.where(used, epochs.sigma_m, 1.0)), 1.0)
    codes = WeighedCodes(
        los, used, _group(epochs), variance, np.where(used, epochs.y_m, 0.0),
        code_odds(epochs, config, float(risks.min())),
    )  # fmt: skip
    levels = np.empty((epochs.count, risks.size, 2))
    run_rows(level_codes, epochs.count, codes, _tables(epochs, config, risks), levels, row_us=LEVEL_US)
    return levels


def _group(epochs: CodeEpochs) -> NDArray[np.int64]:
    return np.require(epochs.system, np.int64, ["C", "W"])


def _tables(epochs: CodeEpochs, config: FamilyMonitorConfig, risks: Array) -> OddsTables:
    assert config.reflections is not None  # validated
    most = epochs.y_m.shape[1] + MOST_SYSTEMS
    factors = RiskConfig(false_alarm=config.false_alarm).false_alarm_factors(most)
    return OddsTables(
        reflection_parameters(config.reflections, float(risks.min())),
        np.full(MOST_SYSTEMS, max(config.constellation_prior, LEAST_PRIOR)), np.stack([factors] * 3, -1),
        np.ascontiguousarray(risks),
    )  # fmt: skip
