"""What delays the signals of satellites on the way to one receiver: undifferenced observables for standalone services.

An observable of one receiver contains what a single difference against a reference station cancels: errors of the
broadcast orbit and clock, ionosphere and troposphere. Models of both remove a part; ``residual`` is what they leave::

    code  = r + c dt + E + D + F(el) (I_z + I_s) f_1^2 / f^2 + M(el) T_z + noise and multipath
    phase = r + c dt + E + D - F(el) (I_z + I_s) f_1^2 / f^2 + M(el) T_z + lambda N + noise and multipath

E orbit error along the line of sight, D satellite clock error, I_z zenith delay of the ionosphere, I_s a further one of
the satellite's own ray, T_z zenith delay of the troposphere, one for all satellites. Obliquity F of a thin shell at
350 km, mapping M of RTCA DO-229D A.4.2.4. Receiver clock, noise and multipath by the arrival of signals are those of
:mod:`.gnss` for the receiver of :meth:`UndifferencedConfig.receiver`; :func:`add_delays` makes its output
undifferenced.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView

__all__ = [
    "Delays",
    "UndifferencedConfig",
    "UndifferencedState",
    "add_delays",
    "advance",
    "delays",
    "initial_state",
    "obliquity",
    "troposphere_mapping",
]

Array = NDArray[np.float64]

EARTH_M, SHELL_M = 6_371_000.0, 350_000.0  # mean radius; height of the thin shell, IS-GPS-200 20.3.3.5.2.5


class UndifferencedConfig(Config):
    """Errors of the signal in space and of the atmosphere, 1 sigma; S3 table III is the budget (standard model, L1)."""

    orbit_m: float = Field(
        1.1, ge=0, description="broadcast orbit along the line of sight [m]; S3 table III, 1.1 to 2.1"
    )
    orbit_tau_s: float = Field(7200.0, gt=0, description="its correlation time [s]; chosen: validity of an ephemeris")
    clock_m: float = Field(1.1, ge=0, description="satellite clock [m]; S3 table III, 1.1 to 2.1")
    clock_tau_s: float = Field(3600.0, gt=0, description="its correlation time [s]; chosen: half that of the orbit")
    iono_zenith_m: float = Field(
        5.0, ge=0, description="mean zenith delay of the ionosphere on L1 [m]; chosen: mid-latitudes by day"
    )
    iono_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="residual zenith delay over the mean one after the broadcast model, 1 sigma [-]; IS-GPS-200 "
        "20.3.3.5.2.5: the model removes at least half; slant 2.5 to 7 m, S3 table III 4 to 7",
    )
    iono_tau_s: float = Field(3600.0, gt=0, description="correlation time of the residual [s]; chosen")
    iono_own_m: float = Field(
        0.3, ge=0, description="further zenith delay of a satellite's own ray [m]; chosen: structures between the rays"
    )
    iono_own_tau_s: float = Field(
        600.0, gt=0, description="its correlation time [s]; as of the differential ionosphere"
    )
    tropo_zenith_m: float = Field(2.4, ge=0, description="mean zenith delay of the troposphere [m]; sea level, DO-229D")
    tropo_residual_m: float = Field(
        0.12,
        ge=0,
        description="residual zenith delay after a model [m]; DO-229D A.4.2.4; slant 0.12 to 0.7, S3 table III",
    )
    tropo_tau_s: float = Field(1800.0, gt=0, description="its correlation time [s]; as gnss.tropo_tau_s")

    def receiver(self, gnss: GnssConfig) -> GnssConfig:
        """The receiver of ``gnss`` alone: without the station's part of noise, of clocks and of coordinates, and
        without the differential terms of :class:`~lanebound.integrity.sensors.gnss.GnssConfig`."""
        parts = gnss.station_parts
        own = {
            f"{name}_m": math.sqrt(max(total**2 - part**2, 0.0))
            for name, total, part in (
                ("code_sigma", gnss.code_sigma_m, parts["station_code"]),
                ("phase_sigma", gnss.phase_sigma_m, parts["station_phase"]),
                ("code_multipath", gnss.code_multipath_m, parts["station_code_multipath"]),
                ("phase_multipath", gnss.phase_multipath_m, parts["station_phase_multipath"]),
            )
        }
        none = [name for name in GnssConfig.model_fields if name.startswith("station_") and not name.endswith("tau_s")]
        none += ["reference_offset_m", "baseline_km", "age_rate_mps"]
        return gnss.replace(**own, **dict.fromkeys(none, 0.0))


@dataclass
class UndifferencedState:
    """Gauss-Markov processes of unit variance of A areas: orbit, clock, iono_own (A, S); iono, tropo (A,)."""

    orbit: Array
    clock: Array
    iono_own: Array
    iono: Array
    tropo: Array

    def copy(self) -> UndifferencedState:
        """An independent copy."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class Delays:
    """Delays of A areas and S satellites [m]: of the band L1, or of all bands alike.

    Attributes
    ----------
    satellite : (A, S) orbit and clock error
    iono : (A, S) slant delay of the ionosphere on L1
    tropo : (A, S) slant delay of the troposphere
    iono_model, tropo_model : (K, S) what the models say, of K views
    """

    satellite: Array
    iono: Array
    tropo: Array
    iono_model: Array
    tropo_model: Array

    @property
    def residual(self) -> Array:
        """(A, S) delay of codes on L1 after both models."""
        return self.satellite + self.iono - self.iono_model + self.tropo - self.tropo_model


def obliquity(elevation_rad: ArrayLike) -> Array:
    """``F = (1 - (R cos el / (R + h))^2)^-1/2`` of a thin shell: slant over zenith delay of the ionosphere."""
    share = EARTH_M * np.cos(elevation_rad) / (EARTH_M + SHELL_M)
    return np.asarray(1.0 / np.sqrt(1.0 - share**2))


def troposphere_mapping(elevation_rad: ArrayLike) -> Array:
    """``M = 1.001 / sqrt(0.002001 + sin^2 el)``, from 4 degrees on (RTCA DO-229D A.4.2.4)."""
    return np.asarray(1.001 / np.sqrt(0.002001 + np.sin(elevation_rad) ** 2))


def initial_state(satellites: int, streams: Streams) -> UndifferencedState:
    """Stationary processes of ``streams.batch`` areas, from streams "ephemeris", "ionosphere" and "troposphere"."""
    ephemeris, iono = streams.normal("ephemeris", satellites, 2), streams.normal("ionosphere", satellites + 1)
    return UndifferencedState(
        orbit=ephemeris[..., 0].copy(), clock=ephemeris[..., 1].copy(), iono_own=iono[:, 1:].copy(),
        iono=iono[:, 0].copy(), tropo=streams.normal("troposphere"),
    )  # fmt: skip


def advance(config: UndifferencedConfig, state: UndifferencedState, dt_s: float, streams: Streams) -> None:
    """Advance the processes by ``dt_s``, in place; the number of draws does not depend on what is in view."""
    satellites = state.orbit.shape[1]
    ephemeris, iono = streams.normal("ephemeris", satellites, 2), streams.normal("ionosphere", satellites + 1)
    for process, z, tau_s in (
        (state.orbit, ephemeris[..., 0], config.orbit_tau_s),
        (state.clock, ephemeris[..., 1], config.clock_tau_s),
        (state.iono_own, iono[:, 1:], config.iono_own_tau_s),
        (state.iono, iono[:, 0], config.iono_tau_s),
        (state.tropo, streams.normal("troposphere"), config.tropo_tau_s),
    ):
        process *= math.exp(-dt_s / tau_s)
        process += math.sqrt(-math.expm1(-2.0 * dt_s / tau_s)) * z


def delays(config: UndifferencedConfig, state: UndifferencedState, sky: SkyView) -> Delays:
    """Delays of the satellites of a view from one place and time (K = 1), which all areas see.

    Raises
    ------
    InputError
        The view has several rows, or other satellites than the state.
    """
    if sky.elevation_rad.shape != (1, state.orbit.shape[1]):
        raise InputError(
            f"sky must have 1 row and {state.orbit.shape[1]} satellites, got {sky.elevation_rad.shape}: pass one view"
        )
    c, elevation = config, np.maximum(sky.elevation_rad, 0.0)
    slant, mapping = obliquity(elevation), troposphere_mapping(elevation)
    zenith = c.iono_zenith_m * (1.0 + c.iono_share * state.iono)[:, None] + c.iono_own_m * state.iono_own
    tropo = (c.tropo_zenith_m + c.tropo_residual_m * state.tropo)[:, None]
    return Delays(
        satellite=c.orbit_m * state.orbit + c.clock_m * state.clock,
        iono=slant * zenith,
        tropo=mapping * tropo,
        iono_model=slant * c.iono_zenith_m,
        tropo_model=mapping * c.tropo_zenith_m,
    )


def add_delays(epoch: GnssEpoch, found: Delays, sky: SkyView, bands: tuple[int, ...]) -> GnssEpoch:
    """The undifferenced code and phase of B receivers, each in its area (one for all, or one each).

    ``epoch`` is the output of receivers of :meth:`UndifferencedConfig.receiver` with these bands. Codes and phases that
    are not measured stay 0.

    Raises
    ------
    InputError
        There are neither 1 nor B areas, or other satellites.
    """
    batch, satellites, width = epoch.code_m.shape
    if found.satellite.shape[0] not in (1, batch) or found.satellite.shape[1] != satellites:
        raise InputError(
            f"found must be of 1 or {batch} areas and {satellites} satellites, got {found.satellite.shape}: "
            "make both agree"
        )
    dispersion = np.zeros((satellites, width))
    waves = WAVELENGTH_M[sky.system]
    dispersion[:, : len(bands)] = (waves[:, list(bands)] / waves[:, :1]) ** 2
    alike, iono = (found.satellite + found.tropo)[..., None], found.iono[..., None] * dispersion
    return replace(
        epoch,
        code_m=np.where(epoch.code_m != 0.0, epoch.code_m + alike + iono, 0.0),
        phase_m=np.where(epoch.phase_m != 0.0, epoch.phase_m + alike - iono, 0.0),
    )
