"""Position and velocity by least squares from codes and range rates of one epoch, for the loosely coupled filter.

Per vehicle one clock for each system, weights by elevation and C/N0, and exclusion of the satellite with the largest
normalised residual until the rest is consistent; residuals that are still larger than declared raise the noise by their
ratio. The covariance has two parts: a fast one (noise, multipath) and a slow
one (orbits, clocks, atmosphere), which a filter must not average away.

Satellites of a vehicle are gathered in a fixed number of places, so that the result does not depend on how many
satellites the sky of the batch holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import chdtri

from lanebound.integrity.core.config import Config
from lanebound.integrity.positioning.code_errors import CodeErrorBudget, CodeErrorParts
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges
from lanebound.integrity.sensors.augmentation import Corrections
from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["SBAS", "CodePosition", "CodePositionConfig", "CodeSource", "DifferentialErrorBudget", "locate_by_codes"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
PLACES = 48  # satellites of one epoch; further ones are left out
UP = np.array([0.0, 0.0, 1.0])
SBAS = "sbas_l1"  # the provider of its corrections
SLANT = CodeErrorBudget(satellite_m=0.0, iono_zenith_m=1.0, iono_common=0.0)  # own variance: squared slant factor


class CodeSource(Enum):
    """Which codes a position is made of."""

    UNDIFFERENCED = "undifferenced"
    DIFFERENTIAL = "differential"
    SBAS = "sbas"


class DifferentialErrorBudget(CodeErrorBudget):
    """Errors of codes that a near station corrects: no orbits, clocks and atmosphere, but the station's multipath."""

    satellite_m: float = Field(0.15, ge=0, description="slow multipath of the station [m]; as GnssConfig")
    iono_zenith_m: float = Field(0.0, ge=0, description="differential ionosphere, vertical [m]; 0.0015 m at 3 km")
    tropo_zenith_m: float = Field(0.0, ge=0, description="differential troposphere, zenith [m]; 0.0012 m at 3 km")


class CodePositionConfig(Config):
    """What a code position assumes of its signals."""

    source: CodeSource = Field(
        CodeSource.UNDIFFERENCED,
        description="undifferenced: standalone, as S4's GPS; differential: codes corrected by the reference station; "
        "sbas: by satellite corrections and ionospheric grid (EGNOS), of their satellites alone",
    )
    elevation_mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]")
    cn0_min_dbhz: float = Field(
        36.0, ge=0, description="lowest C/N0 used [dB-Hz]; chosen on streets of seed 1: reflections lie 12 dB below 48"
    )
    errors: CodeErrorBudget = Field(
        CodeErrorBudget(reflections_m=0.3),
        description="errors of undifferenced codes; reflections of suburban and urban streets that pass the tests",
    )
    differential_errors: DifferentialErrorBudget = Field(
        DifferentialErrorBudget(reflections_m=0.3), description="errors of codes corrected by the station"
    )
    height_sigma_m: float | None = Field(
        None,
        gt=0,
        description="1 sigma of the height of the road over its origin, by a map [m]; a position then has a "
        "redundant row at least; none: not used",
    )
    max_age_s: float = Field(30.0, gt=0, description="oldest usable corrections of the station [s]; RTKLIB default")
    sbas_max_age_s: float = Field(18.0, gt=0, description="oldest SBAS corrections of satellites [s]; DO-229D")
    grid_max_age_s: float = Field(600.0, gt=0, description="oldest ionospheric grid of SBAS [s]; DO-229D")
    false_rejection: float = Field(
        1e-3, gt=0, lt=1, description="P(a consistent epoch is found inconsistent) [-]; S5 P_FA"
    )
    exclusions: int = Field(4, ge=0, le=20, description="satellites excluded at most [-]; chosen")
    max_hdop: float = Field(6.0, gt=0, description="largest horizontal dilution of a position [-]; chosen")


@dataclass(frozen=True)
class CodePosition:
    """Position of the antenna of B vehicles by one epoch of codes.

    position_m (B, 3) E, N, U; velocity_mps (B, 2) E, N; fast_m2, slow_m2, velocity_m2 (B, 2, 2) covariances E, N;
    valid (B,); satellites, excluded (B,); hdop (B,), inf where not solved. gain (B, S, 2): change of E, N per error of
    a satellite's code; own_m2 (B, S) variance of its own slow error; common_m (B, 2, 2): E, N by each common slow
    error.
    """

    position_m: Array
    velocity_mps: Array
    fast_m2: Array
    slow_m2: Array
    velocity_m2: Array
    valid: Bools
    satellites: NDArray[np.int64]
    excluded: NDArray[np.int64]
    hdop: Array
    gain: Array
    own_m2: Array
    common_m: Array


@dataclass(frozen=True)
class _CodeRows:
    """Signals of B vehicles in K places: satellite (B, K) of S, line of sight (B, K, 3), clock (B, K), code, rate
    (B, K), used (B, K), variance fast and slow of each satellite's own (B, K), and slow effects common to all
    (B, K, 2), all [m]; known height (B,) and its 1 sigma (B,), inf for none."""

    place: NDArray[np.int64]
    satellites: int
    los: Array
    system: NDArray[np.int64]
    code: Array
    rate: Array
    used: Bools
    fast: Array
    own: Array
    common: Array
    height: tuple[Array, Array] | None

    def solve(self, used: Bools) -> CodeFit:
        """Least squares of some of the signals, weighted by what is not common to all."""
        return solve_ranges(self.los, self.code, self.fast + self.own, used, self.system, self.height)


def locate_by_codes(config: CodePositionConfig, m: Measurements) -> CodePosition:
    """The positions of one epoch; ``valid`` says where there is one."""
    rows = _gather(config, m)
    used, count = rows.used.copy(), rows.used.sum(-1)
    excluded = np.zeros(used.shape[0], dtype=np.int64)
    for attempt in range(config.exclusions + 1):
        fit = rows.solve(used)
        limit = chdtri(np.maximum(fit.df, 1), config.false_rejection)
        wrong = fit.solved & (fit.df > 0) & (fit.wsse > limit)
        worst = np.where(used, np.abs(fit.normalised), -1.0).argmax(-1)
        out = wrong & (fit.df > 1)
        if attempt == config.exclusions or not out.any():
            break
        used[out, worst[out]] = False
        excluded[out] += 1
    return _position(config, rows, used, fit, fit.solved & ~wrong, count - excluded, excluded)


def _position(
    config: CodePositionConfig,
    rows: _CodeRows,
    used: Bools,
    fit: CodeFit,
    good: Bools,
    satellites: NDArray[np.int64],
    excluded: NDArray[np.int64],
) -> CodePosition:
    """The solution and its covariances; residuals larger than declared raise the noise by their ratio."""
    excess = np.maximum(fit.wsse / np.maximum(fit.df, 1), 1.0)
    transposed = fit.gain[..., :2]  # (B, K, 2)
    plane = np.ascontiguousarray(np.swapaxes(transposed, -1, -2))
    fast = (plane * (rows.fast * excess[:, None])[:, None, :]) @ transposed
    common = plane @ rows.common
    slow = (plane * rows.own[:, None, :]) @ transposed + common @ np.swapaxes(common, -1, -2)
    plain = solve_ranges(rows.los, rows.code, 1.0, used, rows.system, rows.height)
    hdop = np.where(plain.solved, plain.hdop_m, np.inf)
    valid = good & (hdop <= config.max_hdop)
    if rows.height is not None:
        valid &= fit.df >= 1  # a height that is wrong shows in the residuals only beside a redundant code
    rate = np.where(used, rows.rate, 0.0)
    by_satellite, own = np.zeros((*used.shape[:1], rows.satellites, 2)), np.zeros((used.shape[0], rows.satellites))
    row, column = np.nonzero(used)
    by_satellite[row, rows.place[row, column]] = transposed[row, column]
    own[row, rows.place[row, column]] = rows.own[row, column]
    return CodePosition(
        position_m=np.where(valid[:, None], fit.x_m, 0.0),
        velocity_mps=np.where(valid[:, None], (plane @ rate[..., None])[..., 0], 0.0),
        fast_m2=fast,
        slow_m2=slow,
        velocity_m2=plane @ transposed,
        valid=valid,
        satellites=np.where(good, satellites, 0),
        excluded=excluded,
        hdop=np.where(good, hdop, np.inf),
        gain=by_satellite,
        own_m2=own,
        common_m=common,
    )


def _gather(config: CodePositionConfig, m: Measurements) -> _CodeRows:
    """The usable signals of each vehicle in the first places, in the order of the satellites."""
    g, batch = m.gnss, m.gnss.tracked.shape[0]
    los = m.sky.los_enu[m.sky.index]
    codes = g.code_m if config.source is CodeSource.DIFFERENTIAL else g.raw_code_m
    assert codes is not None  # the receiver of the kind computes them
    usable = g.tracked & (codes[..., 0] != 0.0) & (g.cn0_dbhz >= config.cn0_min_dbhz)
    usable &= los[..., 2] > np.sin(np.deg2rad(config.elevation_mask_deg))
    usable &= _in_time(config, m)
    width = min(PLACES, usable.shape[1])
    place = np.zeros((batch, PLACES), dtype=np.int64)
    place[:, :width] = np.argsort(~usable, axis=-1, kind="stable")[:, :width]
    used = np.zeros((batch, PLACES), dtype=np.bool_)
    row = np.arange(batch)[:, None]
    used[:, :width] = usable[row, place[:, :width]]
    los, cn0 = np.where(used[..., None], los[row, place], UP), g.cn0_dbhz[row, place]
    correction, errors = _corrected(config, m, place, used, los[..., 2], cn0)
    known = config.height_sigma_m
    return _CodeRows(
        place=place,
        satellites=usable.shape[1],
        los=los,
        system=m.sky.system[place],
        code=np.where(used, codes[row, place, 0] - correction, 0.0),
        rate=np.where(used, g.range_rate_mps[row, place], 0.0),
        used=used,
        fast=errors.fast_m2,
        own=errors.own_m2,
        common=errors.common_m,
        height=None if known is None else (np.zeros(batch), np.full(batch, known)),
    )


def _in_time(config: CodePositionConfig, m: Measurements) -> Bools:
    """Signals whose corrections are in time, or that need none.  (B, S)."""
    if config.source is CodeSource.UNDIFFERENCED:
        return np.ones_like(m.gnss.tracked)
    if config.source is CodeSource.DIFFERENTIAL:
        return np.broadcast_to((m.gnss.corrections_age_s <= config.max_age_s)[:, None], m.gnss.tracked.shape)
    held = _held(m)
    fresh = (held.age_s <= config.sbas_max_age_s) & (held.zenith_age_s <= config.grid_max_age_s)
    there = np.isfinite(held.declared_m) & np.isfinite(held.satellite_m + held.zenith_m)
    return np.asarray(fresh[:, None] & there)


def _corrected(
    config: CodePositionConfig, m: Measurements, place: NDArray[np.int64], used: Bools, sine: Array, cn0_dbhz: Array
) -> tuple[Array, CodeErrorParts]:
    """What is to be subtracted from the codes (B, K) [m], and the errors that are left.

    Of SBAS ``satellite + F dz``, with variances ``sigma_UDRE^2 + F^2 sigma_GIVE^2`` as declared (DO-229 appendix J),
    which grow with the ages of the messages.
    """
    if config.source is CodeSource.UNDIFFERENCED:
        return np.zeros(used.shape), config.errors.errors(sine, cn0_dbhz)
    if config.source is CodeSource.DIFFERENTIAL:
        return np.zeros(used.shape), config.differential_errors.errors(sine, cn0_dbhz)
    held, row = _held(m), np.arange(used.shape[0])[:, None]
    budget = config.errors.replace(satellite_m=0.0, iono_zenith_m=0.0)
    left, squared = budget.errors(sine, cn0_dbhz), SLANT.errors(sine, cn0_dbhz).own_m2
    age, grid_age = np.where(used.any(-1), [held.age_s, held.zenith_age_s], 0.0)[..., None]
    declared = np.where(used, held.declared_m[place], 0.0)
    satellite = np.square(declared) + budget.satellite_growth_m2ps * age
    vertical = held.zenith_declared_m**2 + budget.iono_growth_m2ps * grid_age
    correction = held.satellite_m[row, place] + np.sqrt(squared) * held.zenith_m[row, place]
    return np.where(used, correction, 0.0), replace(left, own_m2=left.own_m2 + satellite + squared * vertical)


def _held(m: Measurements) -> Corrections:
    """What the vehicles hold of SBAS."""
    assert m.gnss.corrections is not None, "the receiver of the kind simulates its provider"
    return m.gnss.corrections[SBAS]
