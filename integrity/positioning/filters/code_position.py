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
from lanebound.integrity.sensors.broadcast import BroadcastConfig, mapping, obliquity
from lanebound.integrity.sensors.instruments import Measurements
from lanebound.integrity.sky.systems import N_SYSTEMS

__all__ = ["CodePosition", "CodePositionConfig", "CodeSource", "locate_by_codes"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
PLACES = 48  # satellites of one epoch; further ones are left out
UNKNOWNS = 3 + N_SYSTEMS
NO_SIGMA_M2 = 1e12


class CodeSource(Enum):
    """Which codes a position is made of."""

    UNDIFFERENCED = "undifferenced"
    DIFFERENTIAL = "differential"


class CodePositionConfig(Config):
    """What a code position assumes of its signals."""

    source: CodeSource = Field(
        CodeSource.UNDIFFERENCED,
        description="undifferenced: standalone, as S4's GPS; differential: codes corrected by the reference station",
    )
    elevation_mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]")
    cn0_min_dbhz: float = Field(
        36.0, ge=0, description="lowest C/N0 used [dB-Hz]; chosen on streets of seed 1: reflections lie 12 dB below 48"
    )
    cn0_knee_dbhz: float = Field(35.0, ge=0, description="C/N0 at which the variance doubles [dB-Hz]; as RTK")
    sigma_code_m: float = Field(0.4, gt=0, description="noise and multipath at the zenith, 1 sigma [m]; RTKLIB 0.3 m")
    budget: BroadcastConfig = Field(
        BroadcastConfig(), description="slow errors of undifferenced codes, 1 sigma; S3 Table III"
    )
    differential_slow_m: float = Field(
        0.15, ge=0, description="slow errors of differential codes, 1 sigma [m]; multipath of the station"
    )
    max_age_s: float = Field(30.0, gt=0, description="oldest usable corrections [s]; RTKLIB default")
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
class _Rows:
    """Signals of B vehicles in K places: satellite (B, K) of S, line of sight (B, K, 3), clock (B, K), code, rate
    (B, K), used (B, K), variance fast and slow of each satellite's own (B, K), and slow effects common to all
    (B, K, 2), all [m]."""

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


def locate_by_codes(config: CodePositionConfig, m: Measurements) -> CodePosition:
    """The positions of one epoch; ``valid`` says where there is one."""
    rows = _gather(config, m)
    used, count = rows.used.copy(), rows.used.sum(-1)
    excluded = np.zeros(used.shape[0], dtype=np.int64)
    for attempt in range(config.exclusions + 1):
        design, gain, cofactor, solved = _solve(rows, used)
        x = (gain @ rows.code[..., None])[..., 0]
        left = np.where(used, rows.code - (design @ x[..., None])[..., 0], 0.0)
        variance = np.where(used, rows.fast + rows.own, NO_SIGMA_M2)
        freedom = used.sum(-1) - _clocks(rows, used) - 3
        misfit = (np.square(left) / variance).sum(-1)
        limit = chdtri(np.maximum(freedom, 1), config.false_rejection)
        wrong = solved & (freedom > 0) & (misfit > limit)
        if attempt == config.exclusions or not wrong.any():
            break
        of_residual = variance - np.einsum("bki,bij,bkj->bk", design, cofactor, design)
        size = np.where(used, np.square(left) / np.maximum(of_residual, 1e-9), -1.0)
        worst = size.argmax(-1)
        out = wrong & (freedom > 1)
        used[out, worst[out]] = False
        excluded[out] += 1
        if not out.any():
            break
    excess = np.maximum(misfit / np.maximum(freedom, 1), 1.0)
    return _position(config, replace(rows, fast=rows.fast * excess[:, None]), used, design, gain, x, solved & ~wrong,
                     count - excluded, excluded)  # fmt: skip


def _position(
    config: CodePositionConfig,
    rows: _Rows,
    used: Bools,
    design: Array,
    gain: Array,
    x: Array,
    good: Bools,
    satellites: NDArray[np.int64],
    excluded: NDArray[np.int64],
) -> CodePosition:
    """The solution and its covariances from the gains (B, UNKNOWNS, K)."""
    plane = np.where(used[:, None, :], gain[:, :2], 0.0)
    transposed = np.swapaxes(plane, -1, -2)
    fast = (plane * rows.fast[:, None, :]) @ transposed
    common = plane @ rows.common
    slow = (plane * rows.own[:, None, :]) @ transposed + common @ np.swapaxes(common, -1, -2)
    plain = _inverse(np.swapaxes(design * used[..., None], -1, -2) @ design)
    hdop = np.sqrt(np.maximum(plain[:, 0, 0] + plain[:, 1, 1], 0.0))
    valid = good & (hdop <= config.max_hdop)
    rate = np.where(used, rows.rate, 0.0)
    by_satellite, own = np.zeros((*used.shape[:1], rows.satellites, 2)), np.zeros((used.shape[0], rows.satellites))
    row, column = np.nonzero(used)
    by_satellite[row, rows.place[row, column]] = transposed[row, column]
    own[row, rows.place[row, column]] = rows.own[row, column]
    return CodePosition(
        position_m=np.where(valid[:, None], x[:, :3], 0.0),
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


def _gather(config: CodePositionConfig, m: Measurements) -> _Rows:
    """The usable signals of each vehicle in the first places, in the order of the satellites."""
    g, batch = m.gnss, m.gnss.tracked.shape[0]
    los = m.sky.los_enu[m.sky.index]
    standalone = config.source is CodeSource.UNDIFFERENCED
    codes = g.raw_code_m if standalone else g.code_m
    assert codes is not None  # the receiver of the kind computes them
    usable = g.tracked & (codes[..., 0] != 0.0) & (g.cn0_dbhz >= config.cn0_min_dbhz)
    usable &= los[..., 2] > np.sin(np.deg2rad(config.elevation_mask_deg))
    if not standalone:
        usable &= (g.corrections_age_s <= config.max_age_s)[:, None]
    width = min(PLACES, usable.shape[1])
    place = np.zeros((batch, PLACES), dtype=np.int64)
    place[:, :width] = np.argsort(~usable, axis=-1, kind="stable")[:, :width]
    used = np.zeros((batch, PLACES), dtype=np.bool_)
    row = np.arange(batch)[:, None]
    used[:, :width] = usable[row, place[:, :width]]
    los, cn0 = los[row, place], g.cn0_dbhz[row, place]
    sine = np.where(used, los[..., 2], 1.0)
    quality = 0.5 * (1.0 + 1.0 / np.square(sine)) * (1.0 + 10.0 ** (0.1 * (config.cn0_knee_dbhz - cn0)))
    own, common = _slow(config, sine)
    return _Rows(
        place=place,
        satellites=usable.shape[1],
        los=np.where(used[..., None], los, 0.0),
        system=m.sky.system[place],
        code=np.where(used, codes[row, place, 0], 0.0),
        rate=np.where(used, g.range_rate_mps[row, place], 0.0),
        used=used,
        fast=config.sigma_code_m**2 * quality,
        own=own,
        common=common,
    )


def _slow(config: CodePositionConfig, sine: Array) -> tuple[Array, Array]:
    """Variance of slow errors of each satellite's own (B, K), and the effects of common ones (B, K, 2)."""
    if config.source is CodeSource.DIFFERENTIAL:
        return np.full(sine.shape, config.differential_slow_m**2), np.zeros((*sine.shape, 2))
    b = config.budget
    iono = b.iono_zenith_m * obliquity(sine)
    own = b.orbit_sigma_m**2 + b.clock_sigma_m**2 + (1.0 - b.iono_common) * np.square(iono)
    return own, np.stack([np.sqrt(b.iono_common) * iono, b.tropo_zenith_m * mapping(sine)], -1)


def _clocks(rows: _Rows, used: Bools) -> NDArray[np.int64]:
    """Number of clocks that the used rows have, (B,)."""
    seen = used[..., None] & (rows.system[..., None] == np.arange(N_SYSTEMS))
    return np.asarray(seen.any(-2).sum(-1), dtype=np.int64)


def _solve(rows: _Rows, used: Bools) -> tuple[Array, Array, Array, Bools]:
    """Design (B, K, n), gain (B, n, K), cofactor (B, n, n), and where they exist (B,)."""
    one_hot = (rows.system[..., None] == np.arange(N_SYSTEMS)).astype(np.float64)
    design = np.concatenate([-rows.los, one_hot], -1) * used[..., None]
    weight = np.where(used, 1.0 / (rows.fast + rows.own), 0.0)
    weighted = np.swapaxes(design * weight[..., None], -1, -2)
    normal = weighted @ design
    enough = used.sum(-1) >= 3 + _clocks(rows, used)
    cofactor = _inverse(np.where(enough[:, None, None], normal, 0.0))
    return design, cofactor @ weighted, cofactor, enough


def _inverse(normal: Array) -> Array:
    """Inverse of normal matrices (B, n, n), in which an unknown without rows has a zero row and column."""
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    lift = np.where(diagonal > 0.0, 1e-10 * diagonal, 1.0)
    inverse = np.linalg.inv(normal + lift[..., None] * np.eye(UNKNOWNS))
    there = diagonal > 0.0
    return np.where(there[..., :, None] & there[..., None, :], inverse, 0.0)
