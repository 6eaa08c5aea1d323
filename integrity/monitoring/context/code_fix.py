"""Position and velocity of an epoch from undifferenced codes and range rates, with the rows that monitors test.

One weighted least squares each: signals are relative to the origin, so that the equations are linear. The clocks of
the systems are unknowns of the position; velocities have one drift. This is what the context-aware monitor needs of a
receiver; any code-based service may fill a :class:`CodeFix`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.broadcast import mapping, obliquity

if TYPE_CHECKING:
    from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["CodeErrorsConfig", "CodeFix", "WeightedRows", "code_fix", "weighted_rows"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_SPREAD = 1e9  # variance in units of a single row's above which there is no solution
RIDGE = 1e-13  # added to the scaled normal matrix, so that a singular one has an inverse, which is refused


class CodeErrorsConfig(Config):
    """Errors of codes and range rates that a receiver without a reference station declares, 1 sigma."""

    mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]; usual in streets")
    least_cn0_dbhz: float = Field(30.0, ge=0, description="weakest signal used [dB-Hz]; chosen")
    ure_m: float = Field(1.6, ge=0, description="ephemeris and satellite clock [m]; 1.1 m each, S3 Table III")
    iono_zenith_m: float = Field(
        1.12, ge=0, description="zenith ionosphere that differs between satellites [m]; 2.5 m less its common 80 %"
    )
    tropo_zenith_m: float = Field(0.12, ge=0, description="zenith troposphere after a model [m]; DO-229 A.4.2.4")
    code_m: float = Field(0.6, gt=0, description="noise and multipath at the zenith at 45 dB-Hz [m]; S3 Table III")
    range_rate_mps: float = Field(0.2, gt=0, description="range rate at the zenith at 45 dB-Hz [m/s]; S1 in streets")
    decade_db: float = Field(20.0, gt=0, description="loss of C/N0 that makes the noise ten times as large [dB]")


class WeightedRows(NamedTuple):
    """A weighted least squares of B vehicles with m rows and n unknowns, the first two East and North.

    design (B, m, n), weight (B, m) 1 / sigma^2 and 0 of rows without use, residual (B, m), estimate (B, n), cofactor
    (B, n, n), redundancy (B,) rows less unknowns, solved (B,).
    """

    design: Array
    weight: Array
    residual: Array
    estimate: Array
    cofactor: Array
    redundancy: NDArray[np.int64]
    solved: Bools


class CodeFix(NamedTuple):
    """Position and velocity of B vehicles; ``codes`` and ``rates`` hold estimates, covariances and residuals."""

    codes: WeightedRows
    rates: WeightedRows

    @property
    def position_en_m(self) -> Array:
        """(B, 2); 0 where not solved."""
        return np.asarray(self.codes.estimate[:, :2])

    @property
    def covariance_en_m2(self) -> Array:
        """(B, 2, 2)."""
        return np.asarray(self.codes.cofactor[:, :2, :2])

    @property
    def velocity_en_mps(self) -> Array:
        """(B, 2)."""
        return np.asarray(self.rates.estimate[:, :2])


def weighted_rows(design: Array, observed: Array, weight: Array) -> WeightedRows:
    """``x = (G'WG)^-1 G'W y`` of each vehicle with diagonal weights (B, m); columns without a row drop out."""
    weighted = design * weight[..., None]
    across = np.swapaxes(weighted, 1, 2)
    normal = across @ design
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    live = diagonal > 0.0
    live[:, :3] = True
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)
    outer = scale[:, :, None] * scale[:, None, :]
    unit = np.eye(design.shape[-1])
    scaled = np.where(live[:, :, None] & live[:, None, :], normal * outer, unit)
    rows, unknowns = (weight > 0.0).sum(-1), live.sum(-1)
    enough = rows >= unknowns
    inverse = np.linalg.inv(np.where(enough[:, None, None], scaled + RIDGE * unit, unit))
    spread = np.diagonal(inverse, axis1=1, axis2=2)
    solved = enough & (spread > 0.0).all(-1) & (spread < MOST_SPREAD).all(-1)
    inverse = inverse * outer
    keep = solved[:, None, None] & live[:, :, None] & live[:, None, :]
    cofactor = np.where(keep, inverse, 0.0)
    estimate = (cofactor @ (across @ observed[..., None]))[..., 0]
    residual = np.where(weight > 0.0, observed - (design @ estimate[..., None])[..., 0], 0.0)
    redundancy = np.where(solved, rows - unknowns, 0)
    return WeightedRows(design, weight, residual, estimate, cofactor, redundancy, solved)


def code_fix(m: Measurements, config: CodeErrorsConfig, rows: slice = slice(None)) -> CodeFix:
    """Position and velocity of the vehicles in ``rows`` at an epoch.

    Raises
    ------
    InputError
        The receiver computes no undifferenced codes.
    """
    if m.gnss.raw_code_m is None:
        raise InputError("gnss.undifferenced must be true, is false: a code position needs undifferenced codes")
    los = m.sky.los_enu[m.sky.index[rows]]
    sine, cn0 = np.maximum(los[..., 2], 1e-3), m.gnss.cn0_dbhz[rows]
    used = m.gnss.tracked[rows] & (los[..., 2] >= np.sin(np.deg2rad(config.mask_deg))) & (cn0 >= config.least_cn0_dbhz)
    noise = 10.0 ** ((45.0 - np.minimum(cn0, 45.0)) / config.decade_db) / sine
    variance = config.ure_m**2 + np.square(config.iono_zenith_m * obliquity(sine))
    variance += np.square(config.tropo_zenith_m * mapping(sine)) + np.square(config.code_m * noise)
    systems = np.asarray(m.sky.system)[None, :, None] == np.unique(m.sky.system)
    clock = np.broadcast_to(systems, (*used.shape, systems.shape[-1])).astype(np.float64)
    codes = weighted_rows(
        np.concatenate([-los, clock], -1), m.gnss.raw_code_m[rows, :, 0], np.where(used, 1.0 / variance, 0.0)
    )
    rate_weight = np.where(used, 1.0 / np.square(config.range_rate_mps * noise), 0.0)
    drift = np.ones((*used.shape, 1))
    rates = weighted_rows(np.concatenate([-los, drift], -1), m.gnss.range_rate_mps[rows], rate_weight)
    return CodeFix(codes, rates)
