"""What a receiver declares of its codes: the one error budget of services, filters, monitors and the context monitor.

Users differ in figures only, and say why: a service with corrections has no broadcast errors, and a budget for levels
declares reflections that one for an open sky does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.positioning.code_errors_kernel import CODE_ERRORS, CODE_PARTS, fill_parts

__all__ = ["CodeErrorBudget", "CodeErrorParts"]

Array = NDArray[np.float64]

ROW_US = 0.05


@dataclass(frozen=True)
class CodeErrorParts:
    """Parts of the variance of codes (...,).

    fast_m2 noise and multipath, own_m2 each satellite's own slow errors; common_m (..., 2) effects per sigma of the
    slow errors that all satellites share, ionosphere and troposphere; factor f of elevation and C/N0.
    """

    fast_m2: Array
    own_m2: Array
    common_m: Array
    factor: Array

    @property
    def variance_m2(self) -> Array:
        """Variance of each code by itself.  (...,)."""
        return np.asarray(self.fast_m2 + self.own_m2 + np.square(self.common_m).sum(-1))


class CodeErrorBudget(Config):
    """Declared errors of codes, 1 sigma, without corrections by a provider unless a service says so."""

    noise_m: float = Field(0.15, gt=0, description="white noise of the code of one band, zenith [m]; S3 Table III")
    multipath_m: float = Field(0.15, ge=0, description="multipath of a direct signal, zenith [m]; S3 Table III")
    reflections_m: float = Field(
        0.0,
        ge=0,
        description="further multipath where surroundings reflect, zenith [m]; RMS of L1 codes from 36 dB-Hz on in "
        "simulated streets, seed 101: suburban 0.2, urban 0.7, dense 1.4, of all tracked 0.4, 1.6, 2.7; open sky 0",
    )
    phase_m: float = Field(0.005, gt=0, description="carrier of one band, zenith [m]; S3 Table III 3 and 2 mm, rounded")
    cn0_knee_dbhz: float = Field(35.0, ge=0, description="C/N0 at which the variance doubles [dB-Hz]; as RTK")
    multipath_tau_s: float = Field(10.0, gt=0, description="longest correlation time of multipath in motion [s]")
    rest_tau_s: float = Field(
        300.0,
        gt=0,
        description="the same at rest, where only satellites move [s]; a reflector in 3 m turns its phase in 250 s",
    )
    multipath_length_m: float = Field(
        20.0,
        ge=0,
        description="way over which multipath lasts [m]: a car that creeps passes it in this length over its speed, "
        "from multipath_tau_s up to rest_tau_s; 10 to 20 m of facade",
    )
    satellite_m: float = Field(1.56, ge=0, description="ephemeris and clock [m]; S3 Table III, 1.1 m each")
    satellite_growth_m2ps: float = Field(
        1e-3,
        ge=0,
        description="growth of the variance of a satellite's correction with its age [m^2/s]; above (1.5 mm/s age)^2, "
        "of clocks of 5e-12, up to 400 s",
    )
    iono_zenith_m: float = Field(
        2.5, ge=0, description="vertical ionosphere on L1 after a broadcast model [m]; half of 5 m by day, S3 Table III"
    )
    iono_common: float = Field(
        0.8, ge=0, le=1, description="share of its variance that all satellites have in common [-]; as simulated"
    )
    iono_growth_m2ps: float = Field(
        0.006,
        ge=0,
        description="growth of the variance of a vertical correction with its age [m^2/s]; above (1.5 mm/s age)^2 to "
        "600 s",
    )
    iono_rate_mps: float = Field(
        1.5e-3,
        ge=0,
        description="rate of the vertical ionosphere, 1 sigma [m/s]: carrier smoothing on one frequency lags by twice "
        "its change; as simulated: 2.5 m, smooth, of 3600 s",
    )
    tropo_zenith_m: float = Field(0.12, ge=0, description="zenith troposphere after a model [m]; DO-229 A.4.2.4")

    def rules(self) -> Records:
        """As kernels take it, (1,) of CODE_ERRORS."""
        return _rules(self)

    def errors(self, sine: ArrayLike, cn0_dbhz: ArrayLike) -> CodeErrorParts:
        """The parts of codes of one band by the sine of the elevation and C/N0 [dB-Hz], (...,) each."""
        level, cn0 = np.broadcast_arrays(np.asarray(sine, np.float64), np.asarray(cn0_dbhz, np.float64))
        parts = np.empty(level.shape, CODE_PARTS)
        run_rows(fill_parts, level.size, self.rules(), level.ravel(), cn0.ravel(), parts.reshape(-1), row_us=ROW_US)
        common = np.stack([parts["iono"], parts["tropo"]], -1)
        return CodeErrorParts(parts["fast"], parts["own"], common, parts["factor"])


@lru_cache(maxsize=64)
def _rules(b: CodeErrorBudget) -> Records:
    return one_record(
        CODE_ERRORS,
        noise=b.noise_m,
        multipath=np.hypot(b.multipath_m, b.reflections_m),
        phase=b.phase_m,
        knee=b.cn0_knee_dbhz,
        moving_tau=b.multipath_tau_s,
        rest_tau=b.rest_tau_s,
        length=b.multipath_length_m,
        satellite=b.satellite_m,
        satellite_growth=b.satellite_growth_m2ps,
        iono=b.iono_zenith_m,
        iono_common=b.iono_common,
        iono_growth=b.iono_growth_m2ps,
        iono_rate=b.iono_rate_mps,
        tropo=b.tropo_zenith_m,
    )
