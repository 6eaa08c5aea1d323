"""What all instruments of a batch of vehicles say of one epoch: the only place where truth becomes measurements.

The link, the receiver, gyros and wheels each have a file of their own in :mod:`.sensors`; here they run in one call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors import instruments_kernel as sk
from lanebound.integrity.sensors.area import AreaState, advance_area
from lanebound.integrity.sensors.corrections import NO_DRAWS, CorrectionsConfig, CorrectionsState
from lanebound.integrity.sensors.corrections import parameters as link_parameters
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch, GnssState
from lanebound.integrity.sensors.gnss import tables as receiver_tables
from lanebound.integrity.sensors.imu import MOVING_MPS, ImuConfig, ImuSample, ImuState, coefficients, warm_up
from lanebound.integrity.sensors.odometer import OdometerConfig, OdometerSample, OdometerState
from lanebound.integrity.sensors.odometer import parameters as odometer_parameters
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["InstrumentState", "Instruments", "Measurements"]

Array = NDArray[np.float64]

SENSE_US = 6.0  # of one thread for a vehicle and epoch, measured


@dataclass(frozen=True)
class Measurements:
    """All that positioning may know of one epoch: the outputs of the instruments, and where the satellites are."""

    time_s: float
    sky: SkyView
    gnss: GnssEpoch
    imu: ImuSample
    odometer: OdometerSample


@dataclass
class InstrumentState:
    """What lasts in the instruments of B vehicles from epoch to epoch, and where their draws come from."""

    streams: Streams
    area: AreaState
    gnss: GnssState
    corrections: CorrectionsState
    imu: ImuState
    odometer: OdometerState


@dataclass(frozen=True)
class Instruments:
    """The instruments of a vehicle, with their figures as the arrays that the kernel takes."""

    dt_s: float
    gnss: GnssConfig
    corrections: CorrectionsConfig
    link: Array
    receiver: tuple[Array, Array, Array]
    imu_config: ImuConfig
    imu: Array
    odometer: Array

    @classmethod
    def of(
        cls, gnss: GnssConfig, corrections: CorrectionsConfig, imu: ImuConfig, odometer: OdometerConfig, dt_s: float
    ) -> Self:
        """The instruments of a configuration, read every ``dt_s``."""
        return cls(
            dt_s=dt_s,
            gnss=gnss,
            corrections=corrections,
            link=link_parameters(corrections, dt_s),
            receiver=receiver_tables(gnss, dt_s),
            imu_config=imu,
            imu=coefficients(imu, dt_s),
            odometer=odometer_parameters(odometer, dt_s),
        )

    def sense(
        self, s: InstrumentState, sky: SkyView, mask: SkyMask, truth: Truth, effects: FaultEffects
    ) -> Measurements:
        """Measure one epoch; ``s`` advances in place, by the same draws whatever is in view.

        The same as ``advance_area``, ``look`` of the mask, ``step`` of the link, ``observe``, ``sample_imu`` and
        ``sample_odometer`` one after another. All arrays are finite, of B rows and contiguous.
        """
        batch, n_sat, draw, dt = truth.batch, sky.satellites, s.streams, self.dt_s
        link_u = link_z = NO_DRAWS
        if self.corrections.outage_per_h > 0.0:
            link_u, link_z = draw.uniform("corrections"), draw.normal("corrections")
        age, range_rate, cn0 = np.empty(batch), np.zeros((batch, n_sat)), np.zeros((batch, n_sat))
        tracked, lock_lost = np.zeros((batch, n_sat), dtype=np.bool_), np.zeros((batch, n_sat), dtype=np.bool_)
        code, phase = np.zeros((batch, n_sat, 2)), np.zeros((batch, n_sat, 2))
        theta, delta_v, distance, speed = np.empty((batch, 3)), np.empty((batch, 3)), np.empty(batch), np.empty(batch)
        advance_area(self.gnss, self.corrections, s.area, truth.time_s, dt)
        g, c, i, o, area, network = s.gnss, s.corrections, s.imu, s.odometer, s.area.signals, s.area.network
        run_rows(
            sk.sense_some, batch, dt, sky.los_enu, sky.elevation_rad, sky.azimuth_rad, sky.above, sky.system, sky.index,
            mask.path, mask.excess_m, mask.spacing_m, mask.length_m, mask.closed, mask.azimuths, mask.elevations,
            truth.position_enu_m, truth.velocity_enu_mps, truth.delta_theta_rad, truth.delta_v_mps, truth.distance_m,
            truth.arc_m, truth.lane,
            self.link, network.own_epoch * dt, network.message, network.fresh, link_u, link_z, effects.corrections_lost,
            network.up, network.until, c.newest, c.outage_left, c.up, area.message, c.held,
            self.receiver[0], self.receiver[1], self.receiver[2], effects.spoof_enu_m,
            area.reference_enu_m, effects.reference_enu_m, effects.code_bias_m, effects.phase_bias_m,
            effects.range_rate_bias_mps, effects.cn0_drop_db, effects.slip_cycles, g.clock,
            draw.normal("clock", 2), area.clock, draw.normal("gnss", n_sat, gk.N_NORMAL),
            draw.uniform("gnss", n_sat, gk.N_UNIFORM), area.memory, g.oscillator, g.memory, g.ambiguity,
            self.imu, MOVING_MPS * dt, warm_up(self.imu_config, i.on_s, dt), draw.normal("imu", 2, 3, 5), i.turn_on,
            i.scale, i.instability, i.walk, i.moving_bias_radps, effects.gyro_bias_radps,
            self.odometer, draw.normal("odometer"), o.scale, effects.odometer_scale, effects.odometer_frozen,
            o.noise_mps, o.carry_m, o.last_distance_m, o.last_true_mps,
            age, tracked, code, phase, range_rate, cn0, lock_lost, theta, delta_v, distance, speed, row_us=SENSE_US,
        )  # fmt: skip
        i.on_s += dt
        return Measurements(
            truth.time_s, sky, GnssEpoch(tracked, code, phase, range_rate, cn0, lock_lost, age),
            ImuSample(theta, delta_v), OdometerSample(distance, speed),
        )  # fmt: skip
