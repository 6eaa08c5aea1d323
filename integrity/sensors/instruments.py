"""What all instruments of a batch of vehicles say of one epoch: the only place where truth becomes measurements.

The link, the receiver, gyros and wheels each have a file of their own in :mod:`.sensors`; here they run in one call.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.lasting import LastingBundle
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import ZIGGURAT, Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors.area import AreaState, advance_area
from lanebound.integrity.sensors.augmentation import Corrections, corrections_of, receive_messages
from lanebound.integrity.sensors.barometer import BarometerSample, BarometerState
from lanebound.integrity.sensors.chassis import ChassisSample, ChassisState
from lanebound.integrity.sensors.compass import CompassSample, CompassState
from lanebound.integrity.sensors.corrections import CorrectionsConfig, CorrectionsState, link_parameters
from lanebound.integrity.sensors.corrections_kernel import LinkRows
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import (
    GnssConfig,
    GnssEpoch,
    GnssState,
    blank_gnss,
    blank_work,
    effect_rows,
    flat,
    gnss_epoch,
    gnss_parameters,
    motion_rows,
    near_draws,
    undifferenced,
)
from lanebound.integrity.sensors.gnss_kernel import NORMALS, UNIFORMS, Receivers
from lanebound.integrity.sensors.imu import ImuConfig, ImuSample, ImuState, blank_imu, imu_parameters, warm_up
from lanebound.integrity.sensors.imu_kernel import ImuRows
from lanebound.integrity.sensors.instruments_kernel import (
    Draws,
    InstrumentRows,
    SensedEpoch,
    draw,
    sense,
)
from lanebound.integrity.sensors.near_objects_kernel import NEAR
from lanebound.integrity.sensors.odometer import (
    OdometerConfig,
    OdometerSample,
    OdometerState,
    blank_odometer,
    odometer_parameters,
)
from lanebound.integrity.sensors.odometer_kernel import OdometerRows
from lanebound.integrity.sky.geostationary import geostationary_view
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask, blank_reception

__all__ = ["InstrumentState", "Instruments", "Measurements"]

NO_STATES = np.empty((0, 4), np.uint64)  # of streams that draw in a way of their own
LOWEST_SINE = 0.05  # of an elevation: lower satellites are not used
SENSE_US = 6.0  # of one thread for a vehicle and epoch, measured


@dataclass(frozen=True)
class Measurements:
    """All that positioning may know of one epoch: the outputs of the instruments, and where the satellites are."""

    time_s: float
    sky: SkyView
    gnss: GnssEpoch
    imu: ImuSample
    odometer: OdometerSample
    chassis: ChassisSample | None = None
    compass: CompassSample | None = None
    barometer: BarometerSample | None = None


@dataclass
class InstrumentState:
    """What lasts in the instruments of B vehicles from epoch to epoch, and where their draws come from.

    Instruments that are not fitted have no state.
    """

    streams: Streams
    area: AreaState
    gnss: GnssState
    corrections: CorrectionsState
    imu: ImuState
    odometer: OdometerState
    chassis: ChassisState | None
    compass: CompassState | None
    barometer: BarometerState | None

    def __post_init__(self) -> None:
        self.sensing, self.locating = LastingBundle(), LastingBundle()


@dataclass(frozen=True)
class Instruments:
    """The instruments of a vehicle, with their figures as the kernels take them, (1,) each."""

    dt_s: float
    gnss: GnssConfig
    corrections: CorrectionsConfig
    imu: ImuConfig
    link_rules: Records
    gnss_rules: Records
    imu_rules: Records
    odometer_rules: Records
    place_rad: tuple[float, float, float]

    @classmethod
    def of(
        cls,
        gnss: GnssConfig,
        corrections: CorrectionsConfig,
        imu: ImuConfig,
        odometer: OdometerConfig,
        dt_s: float,
        place_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Self:
        """The instruments of a configuration, read every ``dt_s`` at a place (latitude, longitude, height)."""
        return cls(
            dt_s=dt_s,
            gnss=gnss,
            corrections=corrections,
            imu=imu,
            link_rules=link_parameters(corrections, dt_s),
            gnss_rules=gnss_parameters(gnss, dt_s),
            imu_rules=imu_parameters(imu, dt_s),
            odometer_rules=odometer_parameters(odometer, dt_s),
            place_rad=place_rad,
        )

    def sense(
        self, s: InstrumentState, sky: SkyView, mask: SkyMask, truth: Truth, effects: FaultEffects
    ) -> Measurements:
        """Measure one epoch; ``s`` advances in place, by the same draws whatever is in view.

        The same as ``advance_area``, ``look`` of the mask, ``step`` of the link, ``observe``, ``sample_imu`` and
        ``sample_odometer`` one after another. All arrays are finite, of B rows and contiguous.
        """
        batch = truth.batch
        advance_area(self.gnss, self.corrections, s.area, truth.time_s, self.dt_s)
        owners = self, mask, s.streams, s.area, s.gnss, s.corrections, s.imu, s.odometer
        bundle = s.sensing.of(owners, lambda: self._rows(s, mask))
        rows: InstrumentRows = bundle.values
        if self.imu.mems_exponential:
            rows.imu.warm_up[:] = warm_up(self.imu, s.imu.on_s, self.dt_s)
        s.imu.on_s += self.dt_s
        gnss, imu, odometer = blank_gnss(batch, sky.satellites), blank_imu(batch), blank_odometer(batch)
        epoch = SensedEpoch(
            s.area.network.epoch, sky.rows, motion_rows(truth), effect_rows(effects), gnss, imu, odometer
        )
        if not s.streams.draws_by_row:
            self._draw(s.streams, rows)
        elif rows.draws.gnss.shape[0] != batch:
            draw(0, batch, bundle.handle)
        run_rows(sense, batch, bundle.handle, epoch, row_us=SENSE_US)
        signals = gnss_epoch(gnss, effects)
        if s.area.broadcast is not None:
            signals = undifferenced(
                self.gnss, self.gnss_rules, signals, sky, s.corrections.held, effects, s.area.signals, s.area.broadcast
            )
            if s.area.providers is not None:
                signals = replace(signals, corrections=self._corrections(s, sky, mask, truth))
        return Measurements(truth.time_s, sky, signals, ImuSample(*imu), OdometerSample(*odometer))

    def _corrections(self, s: InstrumentState, sky: SkyView, mask: SkyMask, truth: Truth) -> dict[str, Corrections]:
        """What vehicles hold of the providers of services after the messages of this epoch."""
        config, held, areas, broadcast = self.gnss.augmentation, s.gnss.augmentation, s.area.providers, s.area.broadcast
        assert held is not None
        assert areas is not None
        assert broadcast is not None
        geo = geostationary_view(config.geo_longitude_deg, self.place_rad, truth.batch)
        path = mask.look(truth.arc_m, truth.lane, geo).path
        in_view = ((path == SignalPath.LOS) | (path == SignalPath.FOLIAGE)) & geo.above[geo.index]
        receive_messages(config, areas, held, in_view, s.corrections.links["up"], self.dt_s)
        seen = np.maximum(sky.los_enu[sky.index, :, 2], LOWEST_SINE), sky.system
        now = self.gnss.broadcast.satellite_errors(broadcast), self.gnss.age_rate_mps * s.area.signals.memory["age"]
        epoch = s.area.network.own_epoch
        return {name: corrections_of(config, name, held, epoch, seen, now, self.dt_s) for name in config.providers}

    def _draw(self, streams: Streams, rows: InstrumentRows) -> None:
        """The draws of an epoch from streams that draw in a way of their own."""
        draws, (batch, satellites) = rows.draws, rows.receivers.signals.shape
        if self.corrections.outage_per_h > 0.0:
            rows.link.uniforms[:], rows.link.normals[:] = (
                streams.uniform("corrections", 1),
                streams.normal("corrections", 1),
            )
        rows.receivers.clock_normals[:] = streams.normal("clock", 2)
        draws.gnss_normals[:] = streams.normal("gnss", satellites, NORMALS.itemsize // 8).reshape(batch, -1)
        draws.gnss_uniforms[:] = streams.uniform("gnss", satellites, UNIFORMS.itemsize // 8).reshape(batch, -1)
        if self.gnss.near_objects.fitted:
            rows.receivers.near_normals[:] = near_draws(streams, satellites)
        rows.imu.normals[:] = streams.normal("imu", 2, 3, 5)
        rows.odometer.normals[:] = streams.normal("odometer", 1)

    def _rows(self, s: InstrumentState, mask: SkyMask) -> InstrumentRows:
        """The states as the kernel takes them."""
        batch, satellites = s.gnss.signals.shape
        normals, uniforms, near = (np.zeros((batch, satellites), kind) for kind in (NORMALS, UNIFORMS, NEAR))
        imu_normals, signals, states = np.empty((batch, 2, 3, 5)), s.area.signals, _states_of(s.streams)
        uniform, normal = np.empty((2, batch, 1))
        return InstrumentRows(
            draws=Draws(
                table=ZIGGURAT,
                places=s.streams.places,
                gnss=states("gnss"),
                clock=states("clock"),
                corrections=states("corrections") if self.corrections.outage_per_h > 0.0 else NO_STATES,
                imu=states("imu"),
                odometer=states("odometer"),
                near_objects=states("near_objects") if self.gnss.near_objects.fitted else NO_STATES,
                gnss_normals=flat(normals),
                gnss_uniforms=flat(uniforms),
                near_normals=flat(near),
                imu_normals=imu_normals.reshape(batch, -1),
            ),
            mask=mask.rows,
            reception=blank_reception(batch, satellites, mask.faces),
            link=LinkRows(
                self.link_rules, s.area.network.rows, signals.message, s.corrections.links, s.corrections.held, uniform,
                normal,
            ),
            receivers=Receivers(
                self.gnss_rules, s.gnss.signals, s.gnss.vehicles, normals, uniforms, np.empty((batch, 2)), near,
                s.corrections.held, signals.memory, signals.clock, signals.reference_enu_m, blank_work(batch),
            ),
            imu=ImuRows(self.imu_rules, s.imu.axes, s.imu.moving_bias_radps, np.zeros(batch), imu_normals),
            odometer=OdometerRows(self.odometer_rules, s.odometer.wheels, np.empty((batch, 1))),
        )  # fmt: skip


def _states_of(streams: Streams) -> Callable[[str], NDArray[np.uint64]]:
    """The generators by name that the kernel draws from; none of streams that draw in a way of their own."""
    return streams.states if streams.draws_by_row else lambda name: NO_STATES
