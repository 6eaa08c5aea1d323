"""The GNSS receiver with its reference station: what it puts out each epoch."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.accel import use_parallel
from lanebound.integrity.config import Config
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sky.systems import N_SYSTEMS, WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import Reception
from lanebound.integrity.streams import Streams
from lanebound.integrity.truth import Truth

__all__ = ["GnssConfig", "GnssEpoch", "GnssState", "initial_state", "observe"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GnssEpoch:
    """A receiver's output at one epoch; every entry is finite, untracked ones are 0.

    ``x`` is the rover's ENU position from the street's origin, ``e`` the unit vector to the satellite:
    ``code = -e.x + clk[sys, band] + errors``, ``phase = -e.x + clk'[sys, band] + lambda N + errors``,
    ``range_rate = -e.v + drift + errors``.

    Attributes
    ----------
    tracked : (B, S) bool, the code is tracked
    code_m, phase_m : (B, S, 2) rover minus reference single differences by band; a band that the receiver lacks is 0,
        and a phase is 0 where the carrier is not locked
    range_rate_mps : (B, S) Doppler with the satellite's motion taken out
    cn0_dbhz : (B, S) carrier-to-noise density
    lock_lost : (B, S) bool, carrier lock was interrupted since the previous epoch, as far as the receiver knows
    corrections_age_s : (B,) age of the reference data, inf when the link is out
    """

    tracked: NDArray[np.bool_]
    code_m: Array
    phase_m: Array
    range_rate_mps: Array
    cn0_dbhz: Array
    lock_lost: NDArray[np.bool_]
    corrections_age_s: Array


class GnssConfig(Config):
    """What the receiver and its signals really do (positioning declares its own bounds of these)."""

    bands: tuple[Literal[0, 1, 2], ...] = Field((0, 1), min_length=1, max_length=2, description="bands tracked: L1, L2, L5")
    cn0_zenith_dbhz: float = Field(48.0, description="C/N0 at the zenith in the open [dB-Hz]; patch antenna")
    cn0_horizon_dbhz: float = Field(38.0, description="C/N0 at the horizon in the open [dB-Hz]")
    cn0_sigma_db: float = Field(1.0, ge=0, description="slow fading, 1 sigma [dB]; doubled and more below trees")
    cn0_tau_s: float = Field(2.0, gt=0, description="correlation time of fading [s]; metres of driving")
    foliage_loss_db: float = Field(8.0, ge=0, description="mean loss of a tree [dB]; roadside fades of 6 to 10 dB")
    reflection_loss_db: float = Field(12.4, ge=0, description="mean loss of a reflection [dB]; Berlin, 43.8 against 31.4")
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
    nlos_scale: float = Field(
        0.05, ge=0, description="share of a late signal's excess that reaches the code [-]; 1 = consumer single-frequency"
    )
    baseline_km: float = Field(3.0, ge=0, description="distance to the reference station [km]; S1: a few kilometres")
    iono_ppm: float = Field(0.5, ge=0, description="differential ionosphere, 1 sigma [mm/km]; quiet days at mid-latitudes")
    iono_tau_s: float = Field(600.0, gt=0, description="its correlation time [s]")
    age_rate_mps: float = Field(0.0015, ge=0, description="growth of a satellite's error with the age [m/s]; 5e-12 s/s clocks")
    age_tau_s: float = Field(300.0, gt=0, description="correlation time of that rate [s]")
    slips_per_h: float = Field(0.5, ge=0, description="slips of one satellite at 40 dB-Hz [1/h]")
    slip_decade_db: float = Field(5.0, gt=0, description="loss of C/N0 that makes slips ten times as frequent [dB]")
    unannounced: float = Field(0.1, ge=0, le=1, description="share of slips that the receiver does not notice [-]")
    half_share: float = Field(0.2, ge=0, le=1, description="share of half-cycle slips [-]")
    clock_m: float = Field(100.0, ge=0, description="receiver clocks of each system, band and observable, 1 sigma [m]")
    drift_mps: float = Field(1.0, ge=0, description="receiver clock drift, 1 sigma [m/s]")

    def packed(self, dt_s: float) -> Array:
        """The figures in the columns of the kernel's ``cfg``."""
        cfg = np.zeros(gk.NC)
        values = {
            gk.DT: dt_s, gk.BANDS: len(self.bands), gk.CN0_ZENITH: self.cn0_zenith_dbhz, gk.CN0_HORIZON: self.cn0_horizon_dbhz,
            gk.CN0_SIGMA: self.cn0_sigma_db, gk.CN0_TAU: self.cn0_tau_s, gk.FOLIAGE_LOSS: self.foliage_loss_db,
            gk.REFLECTION_LOSS: self.reflection_loss_db, gk.TRACK_MIN: self.track_min_dbhz,
            gk.PHASE_MIN: self.phase_min_dbhz, gk.CODE_DELAY: self.code_delay_s - 1e-9,
            gk.PHASE_DELAY: self.phase_delay_s - 1e-9, gk.CODE_SIGMA: self.code_sigma_m, gk.PHASE_SIGMA: self.phase_sigma_m,
            gk.RATE_SIGMA: self.range_rate_sigma_mps, gk.RATE_TAU: self.range_rate_tau_s,
            gk.CODE_MULTIPATH: self.code_multipath_m, gk.PHASE_MULTIPATH: self.phase_multipath_m,
            gk.MULTIPATH_TAU: self.multipath_tau_s, gk.NLOS_SCALE: self.nlos_scale,
            gk.IONO_SIGMA: 1e-3 * self.iono_ppm * self.baseline_km, gk.IONO_TAU: self.iono_tau_s,
            gk.AGE_RATE: self.age_rate_mps, gk.AGE_TAU: self.age_tau_s, gk.SLIP_RATE: self.slips_per_h / 3600.0,
            gk.SLIP_CN0: 40.0, gk.SLIP_DECADE: self.slip_decade_db, gk.UNANNOUNCED: self.unannounced,
            gk.HALF_SHARE: self.half_share,
        }  # fmt: skip
        cfg[list(values)] = list(values.values())
        return cfg


@dataclass
class GnssState:
    """What lasts in the signals from epoch to epoch; never shown to positioning.

    memory (B, S, NM) are the columns of :mod:`.gnss_kernel`, ambiguity (B, S, 2) counts half cycles, clock (B, systems, 5)
    holds code and phase clocks of both bands [m] and, at [0, 4], the drift [m/s].
    """

    memory: Array
    ambiguity: Array
    clock: Array

    def copy(self) -> GnssState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_state(config: GnssConfig, sky: SkyView, streams: Streams) -> GnssState:
    """Stationary error processes, random integers and clocks; carriers in lock since long."""
    n_sat = len(sky.system)
    z = streams.normal("gnss", n_sat, gk.NM + 2)
    memory = z[..., : gk.NM].copy()
    memory[..., [gk.M_CODE_S, gk.M_PHASE_S]] = 0.0
    clock = config.clock_m * streams.normal("gnss", N_SYSTEMS, 5)
    clock[:, 0, 4] *= config.drift_mps / max(config.clock_m, 1e-9)
    return GnssState(memory=memory, ambiguity=2.0 * np.floor(1000.0 * z[..., gk.NM :]), clock=clock)


def observe(
    config: GnssConfig,
    state: GnssState,
    sky: SkyView,
    reception: Reception,
    truth: Truth,
    age_s: Array,
    effects: FaultEffects,
    streams: Streams,
) -> GnssEpoch:
    """The receiver's output at the end of the epoch; advances ``state`` in place.

    Parameters
    ----------
    reception : how each signal arrives, (B, S)
    truth : position and velocity of the antenna
    age_s : (B,) age of the reference data

    Draws a fixed number of normals and uniforms from stream "gnss", whatever is in view.
    """
    batch, n_sat = truth.batch, len(sky.system)
    z, u = streams.normal("gnss", n_sat, gk.N_NORMAL), streams.uniform("gnss", n_sat, gk.N_UNIFORM)
    tracked, lock_lost = np.zeros((2, batch, n_sat), dtype=np.bool_)
    code, phase = np.zeros((2, batch, n_sat, 2))
    range_rate, cn0 = np.zeros((2, batch, n_sat))
    run = gk.observe_parallel if use_parallel(batch) else gk.observe_serial
    run(
        config.packed(truth.dt_s), np.ascontiguousarray(WAVELENGTH_M[:, list(config.bands)]), sky.los_enu, sky.elevation_rad,
        sky.above, sky.system, sky.index, reception.path, reception.excess_m, truth.position_enu_m + effects.spoof_enu_m,
        truth.velocity_enu_mps, effects.reference_enu_m, age_s, effects.code_bias_m, effects.phase_bias_m,
        effects.range_rate_bias_mps, effects.cn0_drop_db, effects.slip_cycles, state.clock, z, u, state.memory,
        state.ambiguity, tracked, code, phase, range_rate, cn0, lock_lost,
    )  # fmt: skip
    return GnssEpoch(tracked, code, phase, range_rate, cn0, lock_lost, age_s)
