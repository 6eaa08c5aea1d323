"""Position and velocity of an epoch from undifferenced codes and range rates, with the rows that monitors test.

One least squares each, by the solver and the error budget of all code positions. Signals are relative to the
origin, so that the equations are linear. The clocks of the systems are unknowns of the position; velocities have one
drift. This is what the context-aware monitor needs of a receiver; any code-based service may fill a :class:`CodeFix`.

Ionosphere and troposphere act on all codes at once: the covariance of the codes is not diagonal. A diagonal one, as W
in S5 and in Walter and Enge, takes them as noise of each code, which makes levels larger than the errors need.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges
from lanebound.integrity.positioning.shared_errors import solve_with_shared_errors
from lanebound.integrity.sky.systems import System

if TYPE_CHECKING:
    from lanebound.integrity.sensors.instruments import Measurements

__all__ = [
    "CodeCovariance", "CodeErrorsConfig", "CodeFix", "JudgedFix", "VehicleFix", "code_fix", "code_position",
    "doppler_fit",
]  # fmt: skip

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Rows = slice | NDArray[np.int64]
UP = np.array([0.0, 0.0, 1.0])


class CodeCovariance(StrEnum):
    """Covariance of the codes of an epoch."""

    FULL = "full"
    DIAGONAL = "diagonal"


class CodeErrorsConfig(Config):
    """Which codes and range rates a receiver without a reference station uses, and the errors that it declares."""

    mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]; usual in streets")
    least_cn0_dbhz: float = Field(30.0, ge=0, description="weakest signal used [dB-Hz]; chosen")
    errors: CodeErrorBudget = Field(
        CodeErrorBudget(reflections_m=0.6), description="of codes; reflections between suburban and urban streets"
    )
    covariance: CodeCovariance = Field(
        CodeCovariance.FULL,
        description="of the codes: full, with what ionosphere and troposphere do to all of them; diagonal: as if it "
        "were noise of each code (S5, Walter and Enge)",
    )
    plain_hdop: bool = Field(
        False, description="the level takes the HDOP without weights, as S5 names it (not in metres)"
    )
    systems: tuple[str, ...] = Field(tuple(System.__members__), min_length=1, description="systems used; S5: GPS")
    range_rate_mps: float = Field(
        0.2,
        gt=0,
        description="range rate at the zenith, 1 sigma [m/s]; 0.08 in the open, and reflections in streets, S1",
    )

    @model_validator(mode="after")
    def _systems_are_known(self) -> CodeErrorsConfig:
        unknown = [name for name in self.systems if name not in System.__members__]
        if unknown:
            raise ConfigError(f"systems must be among {', '.join(System.__members__)}, got {unknown[0]!r}: correct it")
        return self


class JudgedFix(Protocol):
    """Position and Doppler velocity of B vehicles, as the phases take them."""

    @property
    def located(self) -> Bools:
        """(B,): there is a position."""

    @property
    def position_en_m(self) -> Array:
        """(B, 2); anything finite without a position."""

    @property
    def covariance_en_m2(self) -> Array:
        """(B, 2, 2)."""

    @property
    def has_velocity(self) -> Bools:
        """(B,): there is a Doppler velocity."""

    @property
    def velocity_en_mps(self) -> Array:
        """(B, 2), by Doppler."""

    @property
    def velocity_covariance(self) -> Array:
        """(B, 2, 2) [m^2/s^2]."""


class VehicleFix(NamedTuple):
    """Position and velocity of B vehicles without the rows that they come from: of a navigator, or of a receiver."""

    located: Bools
    position_en_m: Array
    covariance_en_m2: Array
    has_velocity: Bools
    velocity_en_mps: Array
    velocity_covariance: Array

    def rows(self, rows: Rows) -> VehicleFix:
        """The fixes of some vehicles."""
        return VehicleFix(
            self.located[rows], self.position_en_m[rows], self.covariance_en_m2[rows], self.has_velocity[rows],
            self.velocity_en_mps[rows], self.velocity_covariance[rows],
        )  # fmt: skip


class CodeFix(NamedTuple):
    """Position and velocity of B vehicles; ``codes`` and ``rates`` hold solutions, covariances and residuals.

    hdop (B,): without weights, for levels that take it; None where they take the weighted one.
    """

    codes: CodeFit
    rates: CodeFit
    hdop: Array | None = None

    @property
    def located(self) -> Bools:
        """(B,): there is a position."""
        return self.codes.solved

    @property
    def position_en_m(self) -> Array:
        """(B, 2); 0 where not solved."""
        return np.asarray(self.codes.x_m[:, :2])

    @property
    def covariance_en_m2(self) -> Array:
        """(B, 2, 2)."""
        return np.asarray(self.codes.cofactor[:, :2, :2])

    @property
    def has_velocity(self) -> Bools:
        """(B,): there is a Doppler velocity."""
        return self.rates.solved

    @property
    def velocity_en_mps(self) -> Array:
        """(B, 2)."""
        return np.asarray(self.rates.x_m[:, :2])

    @property
    def velocity_covariance(self) -> Array:
        """(B, 2, 2)."""
        return np.asarray(self.rates.cofactor[:, :2, :2])


class _Signals(NamedTuple):
    """What is used of B vehicles: unit vectors (B, S, 3), used (B, S), C/N0 (B, S), systems (S,)."""

    los: Array
    used: Bools
    cn0_dbhz: Array
    system: NDArray[np.int64]


def _signals(m: Measurements, config: CodeErrorsConfig, rows: Rows) -> _Signals:
    los, cn0 = m.sky.los_enu[m.sky.index[rows]], m.gnss.cn0_dbhz[rows]
    used = m.gnss.tracked[rows] & (los[..., 2] >= np.sin(np.deg2rad(config.mask_deg))) & (cn0 >= config.least_cn0_dbhz)
    system = np.asarray(m.sky.system, dtype=np.int64)
    used &= np.isin(system, [System[name].value for name in config.systems])
    return _Signals(np.where(used[..., None], los, UP), used, cn0, system)


def doppler_fit(m: Measurements, config: CodeErrorsConfig, rows: Rows = slice(None)) -> CodeFit:
    """Velocity of the vehicles in ``rows`` by range rates."""
    return _doppler(m, config, rows, _signals(m, config, rows))


def _doppler(m: Measurements, config: CodeErrorsConfig, rows: Rows, s: _Signals) -> CodeFit:
    factor = config.errors.errors(s.los[..., 2], s.cn0_dbhz).factor
    variance = config.range_rate_mps**2 * factor
    return solve_ranges(s.los, m.gnss.range_rate_mps[rows], variance, s.used, np.zeros_like(s.system))


def code_fix(m: Measurements, config: CodeErrorsConfig, rows: Rows = slice(None)) -> CodeFix:
    """Position and velocity of the vehicles in ``rows`` at an epoch.

    Raises
    ------
    InputError
        The receiver computes no undifferenced codes.
    """
    if m.gnss.raw_code_m is None:
        raise InputError("gnss.undifferenced must be true, is false: a code position needs undifferenced codes")
    s = _signals(m, config, rows)
    codes, plain = code_position(s.los, m.gnss.raw_code_m[rows, :, 0], s.cn0_dbhz, s.used, s.system, config)
    return CodeFix(codes, _doppler(m, config, rows, s), plain)


def code_position(
    los_enu: Array, code_m: Array, cn0_dbhz: Array, used: Bools, system: NDArray[np.int64], config: CodeErrorsConfig
) -> tuple[CodeFit, Array | None]:
    """Positions by codes (E, m) with the declared errors, and their HDOP without weights where the level takes it."""
    errors = config.errors.errors(los_enu[..., 2], cn0_dbhz)
    if config.covariance is CodeCovariance.FULL:
        own = errors.fast_m2 + errors.own_m2
        codes = solve_with_shared_errors(los_enu, code_m, own, used, system, errors.common_m)
    else:
        codes = solve_ranges(los_enu, code_m, errors.variance_m2, used, system)
    plain = solve_ranges(los_enu, code_m, 1.0, used, system).hdop_m if config.plain_hdop else None
    return codes, plain
