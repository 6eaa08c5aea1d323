"""Model of a GNSS receiver with a reference station: measurements of each epoch."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.clock import OCXO_H0, OCXO_HM2, TCXO_H0, TCXO_HM2, clock_gains
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sky.systems import N_SYSTEMS, WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import Reception

__all__ = ["AreaSignals", "GnssConfig", "GnssEpoch", "GnssState", "initial_state", "observe"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GnssEpoch:
    """Output of a receiver at one epoch; all entries are finite, those of untracked signals are 0.

    ``x`` is the ENU position of the rover relative to the origin of the street, ``e`` the unit vector to the satellite:
    ``code = -e.x + clk[sys, band] + errors``, ``phase = -e.x + clk'[sys, band] + lambda N + errors``,
    ``range_rate = -e.v + drift + errors``.

    Attributes
    ----------
    tracked : (B, S) bool, the code is tracked
    code_m, phase_m : (B, S, 2) rover minus reference single differences by band; a band without tracking is 0, and a
        phase without carrier lock is 0
    range_rate_mps : (B, S) Doppler without the motion of the satellite
    cn0_dbhz : (B, S) carrier-to-noise density
    lock_lost : (B, S) bool, the receiver detected a loss of carrier lock since the previous epoch
    corrections_age_s : (B,) age of the reference data, inf without data
    """

    tracked: NDArray[np.bool_]
    code_m: Array
    phase_m: Array
    range_rate_mps: Array
    cn0_dbhz: Array
    lock_lost: NDArray[np.bool_]
    corrections_age_s: Array


@dataclass
class AreaSignals:
    """Errors common to all receivers of an area; A is 1, or the number of vehicles if each has its own area.

    memory (A, S, N_SLOW) are the columns ``A_*`` of :mod:`.gnss_kernel`, message (A, S, N_STATION) the columns ``S_*``
    of the newest message of the station, clock (A, 2) the clock of the station [m], [m/s], reference_enu_m (A, 3) the
    error of the station coordinates.
    """

    memory: Array
    message: Array
    clock: Array
    reference_enu_m: Array


class GnssConfig(Config):
    """True properties of the receiver and its signals (the positioning configuration has separate assumed bounds).

    Values described as differenced are for rover minus station. The station contributes the ``station_`` values, but at
    most half of the variance, which is the share of two equal receivers as assumed by RTKLIB (``varerr`` in rtkpos.c
    doubles the variance of one receiver). The part of the station depends only on the elevation, because the station
    has an open sky. The rover contributes the rest of the stated variance.
    """

    bands: tuple[Literal[0, 1, 2], ...] = Field(
        (0, 1), min_length=1, max_length=2, description="bands tracked: L1, L2, L5"
    )
    cn0_zenith_dbhz: float = Field(48.0, description="C/N0 at the zenith in the open [dB-Hz]; patch antenna")
    cn0_horizon_dbhz: float = Field(38.0, description="C/N0 at the horizon in the open [dB-Hz]")
    cn0_sigma_db: float = Field(1.0, ge=0, description="slow fading, 1 sigma [dB]; doubled and more below trees")
    cn0_tau_s: float = Field(2.0, gt=0, description="correlation time of fading [s]; metres of driving")
    foliage_loss_db: float = Field(8.0, ge=0, description="mean loss of a tree [dB]; roadside fades of 6 to 10 dB")
    reflection_loss_db: float = Field(
        12.4, ge=0, description="mean loss of a reflection [dB]; Berlin, 43.8 against 31.4"
    )
    track_min_dbhz: float = Field(22.0, ge=0, description="code tracking threshold [dB-Hz]")
    phase_min_dbhz: float = Field(32.0, ge=0, description="carrier tracking threshold [dB-Hz]")
    code_delay_s: float = Field(0.2, ge=0, description="time to reacquire the code [s]")
    phase_delay_s: float = Field(1.0, ge=0, description="time to reacquire the carrier [s]")
    code_sigma_m: float = Field(0.15, ge=0, description="white code noise, zenith, one band, differenced [m]")
    phase_sigma_m: float = Field(0.003, ge=0, description="white phase noise, zenith, one band, differenced [m]")
    range_rate_sigma_mps: float = Field(0.08, ge=0, description="range-rate error, zenith [m/s]; S1: 10 cm/s of speed")
    range_rate_tau_s: float = Field(0.54, gt=0, description="correlation time of the range-rate error [s]")
    code_multipath_m: float = Field(0.15, ge=0, description="code multipath in line of sight, zenith, 1 sigma [m]")
    phase_multipath_m: float = Field(0.002, ge=0, description="phase multipath, zenith, 1 sigma [m]")
    multipath_tau_s: float = Field(3.0, gt=0, description="correlation time of multipath [s]; metres of driving")
    multipath_per_m: float = Field(
        0.0,
        ge=0,
        description="faster decay in motion: this value times the speed is added to 1/tau [1/m]; 0.1: facades of 10 m",
    )
    nlos_scale: float = Field(
        0.05,
        ge=0,
        description="share of the excess path of a reflection in the code [-]; 1: consumer single-frequency",
    )
    station_code_m: float = Field(
        0.1, ge=0, description="the station's part of code_sigma_m [m]; argued: a survey receiver"
    )
    station_phase_m: float = Field(0.002, ge=0, description="the station's part of phase_sigma_m [m]; argued as well")
    station_code_multipath_m: float = Field(
        0.1, ge=0, description="the station's part of code_multipath_m [m]; argued: survey antenna on a roof"
    )
    station_phase_multipath_m: float = Field(
        0.001, ge=0, description="the station's part of phase_multipath_m [m]; argued as well"
    )
    station_multipath_tau_s: float = Field(
        120.0, gt=0, description="correlation time of station multipath [s]; argued: only satellites move"
    )
    baseline_km: float = Field(3.0, ge=0, description="distance to the reference station [km]; S1: a few kilometres")
    iono_ppm: float = Field(
        0.5, ge=0, description="differential ionosphere, 1 sigma [mm/km]; quiet days at mid-latitudes"
    )
    iono_tau_s: float = Field(600.0, gt=0, description="correlation time of the ionosphere [s]")
    tropo_ppm: float = Field(
        0.4,
        ge=0,
        description="differential troposphere at the zenith after a model, 1 sigma [mm/km]; equal heights, up to 1 ppm",
    )
    tropo_tau_s: float = Field(
        1800.0, gt=0, description="correlation time of the troposphere [s]; 900-2700 s, Joerger and Pervan 2016"
    )
    orbit_ppm: float = Field(
        0.05, ge=0, description="broadcast orbits, differenced [mm/km]; 1 m error over 20,000 km of range"
    )
    age_rate_mps: float = Field(
        0.0015, ge=0, description="growth of a satellite's error with the age [m/s]; 5e-12 s/s clocks"
    )
    age_tau_s: float = Field(300.0, gt=0, description="correlation time of age_rate_mps [s]")
    slips_per_h: float = Field(0.5, ge=0, description="slips of one satellite at 40 dB-Hz [1/h]")
    slip_decade_db: float = Field(5.0, gt=0, description="loss of C/N0 that makes slips ten times as frequent [dB]")
    unannounced: float = Field(0.1, ge=0, le=1, description="share of slips that the receiver does not detect [-]")
    half_share: float = Field(0.2, ge=0, le=1, description="share of half-cycle slips [-]")
    half_cycle_resolve_s: float = Field(
        6.0,
        ge=0,
        description="time until a half cycle is corrected [s]; one subframe, whose preamble gives the sign, IS-GPS-200",
    )
    clock_m: float = Field(100.0, ge=0, description="delays of each system, band and observable, 1 sigma [m]")
    drift_mps: float = Field(
        100.0,
        ge=0,
        description="receiver clock drift at the start, 1 sigma [m/s]; 0.3 ppm; a TCXO is within 0.5 to 2 ppm",
    )
    clock_h0: float = Field(TCXO_H0, ge=0, description="white frequency noise of the receiver's clock [s]; TCXO")
    clock_hm2: float = Field(TCXO_HM2, ge=0, description="frequency random walk of its clock, h-2 [Hz]; TCXO")
    station_clock_h0: float = Field(OCXO_H0, ge=0, description="white frequency noise of the station's clock [s]; OCXO")
    station_clock_hm2: float = Field(OCXO_HM2, ge=0, description="frequency random walk of its clock, h-2 [Hz]; OCXO")
    reference_offset_m: float = Field(
        0.0,
        ge=0,
        description="horizontal error of the reference coordinates, in a random direction [m]; datum, antenna",
    )

    @property
    def station_parts(self) -> dict[int, float]:
        """1-sigma of the station's part of code, phase and their multipath [m], by column of the kernel's ``cfg``."""
        half = math.sqrt(0.5)
        return {
            gk.STATION_CODE: min(self.station_code_m, half * self.code_sigma_m),
            gk.STATION_PHASE: min(self.station_phase_m, half * self.phase_sigma_m),
            gk.STATION_CODE_MP: min(self.station_code_multipath_m, half * self.code_multipath_m),
            gk.STATION_PHASE_MP: min(self.station_phase_multipath_m, half * self.phase_multipath_m),
        }

    def packed(self, dt_s: float) -> Array:
        """The values as array ``cfg`` of the kernel."""
        cfg = np.zeros(gk.NC)
        values = {
            gk.DT: dt_s, gk.BANDS: len(self.bands), gk.CN0_ZENITH: self.cn0_zenith_dbhz,
            gk.CN0_HORIZON: self.cn0_horizon_dbhz, gk.CN0_SIGMA: self.cn0_sigma_db,
            gk.FOLIAGE_LOSS: self.foliage_loss_db, gk.REFLECTION_LOSS: self.reflection_loss_db,
            gk.TRACK_MIN: self.track_min_dbhz, gk.PHASE_MIN: self.phase_min_dbhz,
            gk.CODE_DELAY: self.code_delay_s - 1e-9, gk.PHASE_DELAY: self.phase_delay_s - 1e-9,
            gk.CODE_SIGMA: self.code_sigma_m, gk.PHASE_SIGMA: self.phase_sigma_m,
            gk.RATE_SIGMA: self.range_rate_sigma_mps, gk.CODE_MULTIPATH: self.code_multipath_m,
            gk.PHASE_MULTIPATH: self.phase_multipath_m, gk.MULTIPATH_DECAY: np.exp(-dt_s / self.multipath_tau_s),
            gk.MULTIPATH_PER_M: self.multipath_per_m, gk.NLOS_SCALE: self.nlos_scale,
            gk.IONO_SIGMA: 1e-3 * self.iono_ppm * self.baseline_km, gk.AGE_RATE: self.age_rate_mps,
            gk.TROPO_SIGMA: 1e-3 * self.tropo_ppm * self.baseline_km,
            gk.ORBIT_SIGMA: 1e-3 * self.orbit_ppm * self.baseline_km, gk.SLIP_RATE: self.slips_per_h / 3600.0,
            gk.SLIP_CN0: 40.0, gk.SLIP_DECADE: self.slip_decade_db, gk.UNANNOUNCED: self.unannounced,
            gk.HALF_SHARE: self.half_share, gk.HALF_RESOLVE: self.half_cycle_resolve_s + 1e-9, **self.station_parts,
        }  # fmt: skip
        cfg[list(values)] = list(values.values())
        weakest_db = (cfg[gk.SLIP_CN0] - self.phase_min_dbhz) / self.slip_decade_db
        cfg[gk.SLIP_MOST] = dt_s * cfg[gk.SLIP_RATE] * 10.0**weakest_db
        cfg[[gk.CLOCK_11, gk.CLOCK_21, gk.CLOCK_22]] = clock_gains(self.clock_h0, self.clock_hm2, dt_s)
        for decay, gain, tau_s in (
            (gk.CN0_DECAY, gk.CN0_GAIN, self.cn0_tau_s),
            (gk.RATE_DECAY, gk.RATE_GAIN, self.range_rate_tau_s),
        ):
            cfg[decay], cfg[gain] = np.exp(-dt_s / tau_s), np.sqrt(-np.expm1(-2.0 * dt_s / tau_s))
        return cfg


@lru_cache(maxsize=64)
def tables(config: GnssConfig, dt_s: float) -> tuple[Array, Array, Array]:
    """Array ``cfg`` of the kernel, and wavelengths [m] and relative ionospheric delays (first band 1) of the bands."""
    wavelength = np.ascontiguousarray(WAVELENGTH_M[:, list(config.bands)])
    return config.packed(dt_s), wavelength, (wavelength / wavelength[:, :1]) ** 2


@dataclass
class GnssState:
    """True state of the signals between epochs, which positioning must not use.

    memory (B, S, NM) are the columns of :mod:`.gnss_kernel`, ambiguity (B, S, 2) is in half cycles, clock (B, systems,
    4) are the delays of code and phase of both bands [m], oscillator (B, 2) is offset [m] and drift [m/s].
    """

    memory: Array
    ambiguity: Array
    clock: Array
    oscillator: Array

    def copy(self) -> GnssState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_state(config: GnssConfig, sky: SkyView, streams: Streams) -> GnssState:
    """Create the state at the start of a receiver: stationary error processes, random integers and clocks."""
    z = streams.normal("gnss", len(sky.system), gk.N_INITIAL + 2)
    memory = np.zeros((*z.shape[:-1], gk.NM))
    memory[..., : gk.N_INITIAL] = z[..., : gk.N_INITIAL]
    clock = streams.normal("clock", N_SYSTEMS * 4 + 1)
    oscillator = np.column_stack([np.zeros(streams.batch), config.drift_mps * clock[:, -1]])
    delays = config.clock_m * clock[:, :-1].reshape(-1, N_SYSTEMS, 4)
    return GnssState(memory, 2.0 * np.floor(1000.0 * z[..., gk.N_INITIAL :]), delays, oscillator)


def observe(
    config: GnssConfig,
    state: GnssState,
    sky: SkyView,
    reception: Reception,
    truth: Truth,
    age_s: Array,
    message: Array,
    effects: FaultEffects,
    streams: Streams,
    area: AreaSignals,
) -> GnssEpoch:
    """Compute the output of the receiver at the end of the epoch; ``state`` advances in place.

    Parameters
    ----------
    reception : propagation of each signal, (B, S)
    truth : position and velocity of the antenna
    age_s : (B,) age of the reference data
    message : (B, S, N_STATION) errors of the station in these data, columns ``S_*`` of :mod:`.gnss_kernel`
    area : errors of this epoch common to all receivers of an area

    The number of draws from streams "gnss" and "clock" is fixed; it does not depend on the satellites in view.

    Raises
    ------
    InputError
        When truth, sky, reception, streams and area disagree on the number of vehicles or satellites.
    """
    batch, n_sat = truth.batch, len(sky.system)
    if not streams.batch == sky.batch == batch or reception.path.shape != (batch, n_sat):
        raise InputError(
            f"truth holds {batch} vehicles, sky {sky.batch}, streams {streams.batch}, "
            f"reception {reception.path.shape}: make all the same batch"
        )
    if area.memory.shape[0] not in (1, batch) or area.memory.shape[1] != n_sat:
        raise InputError(
            f"area must hold 1 or {batch} areas and {n_sat} satellites, got {area.memory.shape}: make both agree"
        )
    if message.shape != (batch, n_sat, gk.N_STATION):
        raise InputError(
            f"message must have shape {(batch, n_sat, gk.N_STATION)}, got {message.shape}: one for each vehicle"
        )
    z, u = streams.normal("gnss", n_sat, gk.N_NORMAL), streams.uniform("gnss", n_sat, gk.N_UNIFORM)
    tracked, lock_lost = np.zeros((2, batch, n_sat), dtype=np.bool_)
    code, phase = np.zeros((2, batch, n_sat, 2))
    range_rate, cn0 = np.zeros((2, batch, n_sat))
    cfg, wavelength, dispersion = tables(config, truth.dt_s)
    gk.observe_serial(
        cfg, wavelength, dispersion, sky.los_enu, sky.above, sky.system, sky.index,
        reception.path, reception.excess_m, truth.position_enu_m + effects.spoof_enu_m, truth.velocity_enu_mps,
        area.reference_enu_m + effects.reference_enu_m, age_s, effects.code_bias_m, effects.phase_bias_m,
        effects.range_rate_bias_mps, effects.cn0_drop_db, effects.slip_cycles, state.clock,
        streams.normal("clock", 2), area.clock, z, u, area.memory, message, state.oscillator, state.memory,
        state.ambiguity, tracked, code, phase, range_rate, cn0, lock_lost,
    )  # fmt: skip
    return GnssEpoch(tracked, code, phase, range_rate, cn0, lock_lost, age_s)
