"""Undifferenced observables: what a receiver measures without a station, corrected by broadcast ephemerides and models.

A single difference is the rover's observable less the station's. The undifferenced one follows from it exactly: what
the station contributed (its clock, noise, multipath and the error of its coordinates) and what the age of its data adds
are taken back, and the errors that a difference cancels come in:

    code = -e.x + clk + (orbit + clock) + F(el) dz_iono (f1/f)^2 + m(el) dz_tropo + own multipath and noise,
    phase the same with the ionosphere's sign turned, and lambda N.

These errors are what remains after the broadcast corrections. The ionosphere is a zenith delay times the obliquity ``F
= (1 - (R cos(el) / (R + h))^2)^-1/2`` of a thin shell; a stated share of its variance is common to all satellites, the
rest is each one's own pierce point. The troposphere is one zenith delay for all satellites times the mapping function
``m = 1.001 (0.002001 + sin(el)^2)^-1/2``. Both functions: RTCA DO-229, appendix A.4. The budget is that of S3 Table
III.

All errors are Gauss-Markov processes of the second order of an area, which all its vehicles share. They are smooth: the
ionosphere changes by about a millimetre in a second, so that carriers may be compared from one epoch to the next.

A process of unit variance with a double pole a is ``y_k+1 = 2 a y_k - a^2 y_k-1 + sqrt((1 - a^2)^3 / (1 + a^2)) z``, of
correlation ``(1 + k (1 - a^2) / (1 + a^2)) a^k``. With ``a = exp(-2.146 dt / tau)`` it falls to 1/e in tau.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.streams import Streams

__all__ = ["BroadcastConfig", "BroadcastState", "change_rate", "initial_broadcast", "mapping", "obliquity"]

Array = NDArray[np.float64]
EARTH_M, SHELL_M = 6378136.3, 350e3
OWN = 3  # processes of a satellite: orbit, clock, ionosphere
TO_A_TAU = 2.146193  # root of (1 + x) exp(-x) = 1/e
COMMON = 2  # processes of an area: ionosphere, troposphere


class BroadcastConfig(Config):
    """Errors of undifferenced observables that remain after broadcast ephemerides and models, 1 sigma."""

    orbit_sigma_m: float = Field(
        1.1, ge=0, description="ephemeris, along the line of sight [m]; S3 Table III, lower end"
    )
    orbit_tau_s: float = Field(3600.0, gt=0, description="correlation time of the ephemeris [s]; half an upload of 2 h")
    clock_sigma_m: float = Field(1.1, ge=0, description="satellite clock [m]; S3 Table III, lower end")
    clock_tau_s: float = Field(1800.0, gt=0, description="correlation time of the satellite clock [s]; chosen")
    iono_zenith_m: float = Field(
        2.5,
        ge=0,
        description="zenith delay on L1 after a broadcast model [m]; half of 5 m by day, as the model removes "
        "at least half, IS-GPS-200 20.3.3.5.2.5; 2.5 to 7 m on a slant, S3 Table III 4 to 7",
    )
    iono_common: float = Field(
        0.8, ge=0, le=1, description="share of its variance that is common to all satellites [-]; chosen"
    )
    iono_tau_s: float = Field(3600.0, gt=0, description="correlation time of the ionosphere [s]; chosen")
    tropo_zenith_m: float = Field(
        0.12, ge=0, description="zenith delay after a model [m]; DO-229 A.4.2.4; 0.12 to 0.7 m on a slant, S3 Table III"
    )
    tropo_tau_s: float = Field(1800.0, gt=0, description="correlation time of the troposphere [s]; Joerger 2016")

    def advance(self, state: BroadcastState, dt_s: float, streams: Streams) -> None:
        """Advance the errors of all areas by an epoch, in place; stream "broadcast"."""
        own, common = streams.normal("broadcast", *state.own.shape[1:]), streams.normal("broadcast", COMMON)
        tau = np.array([self.orbit_tau_s, self.clock_tau_s, self.iono_tau_s])
        _advance(state.own, state.own_before, tau, dt_s, own)
        of_area = np.array([self.iono_tau_s, self.tropo_tau_s])
        _advance(state.common, state.common_before, of_area, dt_s, common)

    def delays(self, state: BroadcastState, sine: Array, row: NDArray[np.int64]) -> tuple[Array, Array]:
        """Delay of all bands alike, and of the ionosphere on the first band, (B, S) each [m].

        Parameters
        ----------
        sine : (B, S) sine of the elevation, above 0 where a satellite is in view
        row : (B,) area of each vehicle
        """
        own, common = state.own[row], state.common[row]
        alike = self.orbit_sigma_m * own[..., 0] + self.clock_sigma_m * own[..., 1]
        alike += self.tropo_zenith_m * mapping(sine) * common[:, 1:]
        zenith = np.sqrt(self.iono_common) * common[:, :1] + np.sqrt(1.0 - self.iono_common) * own[..., 2]
        return alike, self.iono_zenith_m * obliquity(sine) * zenith

    def satellite_errors(self, state: BroadcastState) -> Array:
        """Error of ephemeris and clock of each satellite of A areas, (A, S) [m]."""
        return np.asarray(self.orbit_sigma_m * state.own[..., 0] + self.clock_sigma_m * state.own[..., 1])

    def zenith_delays(self, state: BroadcastState) -> Array:
        """Vertical ionosphere on the first band at each pierce point, (A, S) [m]."""
        common = np.sqrt(self.iono_common) * state.common[:, :1]
        return np.asarray(self.iono_zenith_m * (common + np.sqrt(1.0 - self.iono_common) * state.own[..., 2]))


@dataclass
class BroadcastState:
    """Errors of A areas in units of their sigma: own (A, S, 3) of orbit, clock, ionosphere; common (A, 2) of
    ionosphere, troposphere. own_before, common_before: what the step before adds to what follows from the present, in
    units of its sigma."""

    own: Array
    common: Array
    own_before: Array
    common_before: Array

    def copy(self) -> BroadcastState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_broadcast(satellites: int, streams: Streams) -> BroadcastState:
    """Stationary errors of ``streams.batch`` areas."""
    own, common = streams.normal("broadcast", satellites, OWN), streams.normal("broadcast", COMMON)
    before = streams.normal("broadcast", satellites, OWN), streams.normal("broadcast", COMMON)
    return BroadcastState(own, common, *before)


def _advance(values: Array, before: Array, tau_s: Array, dt_s: float, z: Array) -> None:
    """The next values of processes of the second order, in place; given a value y, the one before is ``r y + s u``
    with their correlation r, ``s^2 = 1 - r^2`` and u of ``before``."""
    a = np.exp(-TO_A_TAU * dt_s / tau_s)
    r = 2.0 * a / (1.0 + a * a)
    s = (1.0 - a * a) / (1.0 + a * a)
    last = values.copy()
    values *= 2.0 * a - a * a * r
    values -= a * a * s * before
    values += np.sqrt((1.0 - a * a) ** 3 / (1.0 + a * a)) * z
    before[:] = (last - r * values) / s


def change_rate(tau_s: float) -> float:
    """Standard deviation of the rate of a process of unit variance, ``2.146 / tau`` [1/s].

    The variance of its change over t is ``2 (1 - (1 + x) exp(-x))`` with ``x = 2.146 t / tau``, at most ``x^2``.
    """
    return TO_A_TAU / tau_s


def obliquity(sine: Array) -> Array:
    """Slant over zenith delay of a thin ionospheric shell, from the sine of the elevation (RTCA DO-229, A.4.4.10.4)."""
    cosine = EARTH_M / (EARTH_M + SHELL_M) * np.sqrt(1.0 - np.square(sine))
    return np.asarray(1.0 / np.sqrt(1.0 - np.square(cosine)))


def mapping(sine: Array) -> Array:
    """Slant over zenith delay of the troposphere, from the sine of the elevation (RTCA DO-229, A.4.2.4)."""
    return np.asarray(1.001 / np.sqrt(0.002001 + np.square(sine)))
