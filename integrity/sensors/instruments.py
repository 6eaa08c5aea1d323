"""What all instruments of a batch of vehicles say of one epoch: the only place where truth becomes measurements.

The link, the receiver, gyros and wheels each have a file of their own in :mod:`.sensors`; here they run in one call.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records, one_record, packed
from lanebound.integrity.core.streams import EVERY_PLACE, ZIGGURAT, Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import instruments_kernel as kernel
from lanebound.integrity.sensors.area import AreaState, advance_area
from lanebound.integrity.sensors.augmentation import Corrections, corrections_of, receive_messages
from lanebound.integrity.sensors.barometer import BarometerSample, BarometerState
from lanebound.integrity.sensors.chassis import ChassisSample, ChassisState
from lanebound.integrity.sensors.compass import CompassSample, CompassState
from lanebound.integrity.sensors.corrections import CorrectionsConfig, CorrectionsState, link_parameters
from lanebound.integrity.sensors.draws_kernel import Draws
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import (
    GnssConfig,
    GnssEpoch,
    GnssState,
    gnss_epoch,
    gnss_parameters,
    undifferenced,
)
from lanebound.integrity.sensors.gnss_kernel import Effects, Sensed
from lanebound.integrity.sensors.imu import ImuConfig, ImuSample, ImuState, imu_parameters
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL, OBSERVED_VEHICLE
from lanebound.integrity.sensors.odometer import OdometerConfig, OdometerSample, OdometerState, odometer_parameters
from lanebound.integrity.sky.constellation import geostationary_view
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

__all__ = ["InstrumentState", "Instruments", "Measurements", "observed"]

NO_GENERATORS = np.empty((len(kernel.DRAWN_STREAMS), 0, 4), np.uint64)  # not draws_by_row
NOT_DRAWN, NO_ERROR = np.empty((0, 0)), np.zeros(1, np.int64)
LOWEST_SINE = 0.05  # of an elevation: lower satellites are not used
SENSE_US = 6.0  # of one thread for a vehicle and epoch, measured


@dataclass(frozen=True)
class Measurements:
    """The measurements of one epoch and the directions of satellites: all that positioning may use.

    ``given`` holds the records (:func:`observed`) of which the arrays are fields; None for arrays of the user.
    """

    time_s: float
    sky: SkyView
    gnss: GnssEpoch
    imu: ImuSample
    odometer: OdometerSample
    chassis: ChassisSample | None = None
    compass: CompassSample | None = None
    barometer: BarometerSample | None = None
    given: tuple[Records, Records] | None = field(default=None, init=False, repr=False, compare=False)

    def with_samples(self, **samples: Any) -> Self:
        """The same with further samples, by the names of their fields."""
        more = replace(self, **samples)
        object.__setattr__(more, "given", self.given)
        return more


def observed(m: Measurements) -> tuple[Records, Records]:
    """The measurements as kernels take them: (B, S) of OBSERVED_SIGNAL and (B,) of OBSERVED_VEHICLE.

    Those of the instruments are returned without a copy; those built from arrays of the user's own, or with a part of
    them replaced, are packed.
    """
    g, (given, vehicles) = m.gnss, m.given or (None, None)
    signals = packed(
        OBSERVED_SIGNAL, given, tracked=g.tracked, lock_lost=g.lock_lost, cn0=g.cn0_dbhz, range_rate=g.range_rate_mps,
        code=g.code_m, phase=g.phase_m, integer_error=NO_ERROR if g.integer_error is None else g.integer_error,
    )  # fmt: skip
    vehicles = packed(
        OBSERVED_VEHICLE, vehicles, age=g.corrections_age_s, turn=m.imu.delta_theta_rad, delta_v=m.imu.delta_v_mps,
        speed=m.odometer.speed_mps, distance=m.odometer.distance_m,
        next_best=NO_ERROR if g.next_best is None else g.next_best,
    )  # fmt: skip
    vehicles["sight"] = m.sky.index
    if signals is not given:
        signals["e"] = m.sky.los_enu[m.sky.index]
    return signals, vehicles


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


@dataclass(frozen=True)
class Instruments:
    """The instruments of a vehicle, with their figures as the kernel takes them: rules (1,) of INSTRUMENT_RULES."""

    dt_s: float
    gnss: GnssConfig
    corrections: CorrectionsConfig
    imu: ImuConfig
    rules: Records
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
            rules=one_record(
                kernel.INSTRUMENT_RULES,
                link=link_parameters(corrections, dt_s),
                gnss=gnss_parameters(gnss, dt_s),
                imu=imu_parameters(imu, dt_s),
                odometer=odometer_parameters(odometer, dt_s),
            ),
            place_rad=place_rad,
        )

    def sense(
        self, s: InstrumentState, sky: SkyView, mask: SkyMask, truth: Truth, effects: FaultEffects
    ) -> Measurements:
        """Measure one epoch; ``s`` advances in place, by the same draws whatever is in view.

        The same as ``advance_area``, ``look`` of the mask, ``step`` of the link, ``observe``, ``sample_imu`` and
        ``sample_odometer`` one after another. All arrays are finite, of B rows and contiguous.
        """
        advance_area(self.gnss, self.corrections, s.area, truth.time_s, self.dt_s)
        s.imu.advance(self.imu, self.dt_s)
        signals, vehicles = np.empty(s.gnss.signals.shape, OBSERVED_SIGNAL), np.empty(truth.batch, OBSERVED_VEHICLE)
        vehicles["sight"] = sky.index
        sensors = kernel.Sensors(
            s.corrections.links, s.corrections.held, s.gnss.vehicles, s.gnss.signals, s.imu.sensors, s.odometer.wheels
        )
        run_rows(
            kernel.sense, truth.batch, s.area.network.epoch, self.rules, s.area.rows, sensors,
            self._draws(s.streams, truth.batch, sky.satellites), mask.rows, sky.rows, truth.records,
            Effects(effects.signals, effects.vehicles), Sensed(signals, vehicles), row_us=SENSE_US,
        )  # fmt: skip
        m = Measurements(
            truth.time_s, sky, self._receiver(s, sky, mask, truth, effects, gnss_epoch(signals, vehicles)),
            ImuSample(vehicles["turn"], vehicles["delta_v"]), OdometerSample(vehicles["distance"], vehicles["speed"]),
        )  # fmt: skip
        object.__setattr__(m, "given", (signals, vehicles))
        return m

    def _receiver(
        self, s: InstrumentState, sky: SkyView, mask: SkyMask, truth: Truth, effects: FaultEffects, epoch: GnssEpoch
    ) -> GnssEpoch:
        """The output of the receiver with the undifferenced observables and the corrections that it has."""
        if s.area.broadcast is None:
            return epoch
        rules = self.rules["gnss"]
        epoch = undifferenced(
            self.gnss, rules, epoch, sky, s.corrections.held, effects, s.area.signals, s.area.broadcast
        )
        if s.area.providers is None:
            return epoch
        return replace(epoch, corrections=self._corrections(s, sky, mask, truth))

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

    def _draws(self, streams: Streams, batch: int, satellites: int) -> Draws:
        """The generators of an epoch, one for each vehicle, or the draws of all."""
        generators = streams.together(kernel.DRAWN_STREAMS) if streams.draws_by_row else NO_GENERATORS
        if generators.shape[1] == batch:
            return Draws(generators, ZIGGURAT, streams.places, NOT_DRAWN)
        draws = Draws(generators, ZIGGURAT, EVERY_PLACE, np.empty((batch, kernel.draw_width(satellites))))
        if streams.draws_by_row:
            kernel.draw_jointly(self.rules, draws, satellites)
        else:
            self._draw(streams, draws.drawn, satellites)
        return draws

    def _draw(self, streams: Streams, drawn: NDArray[np.float64], satellites: int) -> None:
        """Fill the draws (B, W) from streams that do not give one generator a vehicle (not ``draws_by_row``)."""
        width, batch = kernel.OF_SATELLITE, len(drawn)
        normals, uniforms, near, rest = np.split(drawn, satellites * np.cumsum(width), axis=1)
        own = rest.view(kernel.VEHICLE_DRAWS)[:, 0]
        normals[:] = streams.normal("gnss", satellites, width[0]).reshape(batch, -1)
        uniforms[:] = streams.uniform("gnss", satellites, width[1]).reshape(batch, -1)
        if self.gnss.near_objects.fitted:
            near[:] = streams.normal("near_objects", satellites, width[2]).reshape(batch, -1)
        own["clock"], own["imu"] = streams.normal("clock", 2), streams.normal("imu", 2, 3, 5)
        own["odometer"] = streams.normal("odometer")
        if self.corrections.outage_per_h > 0.0:
            own["outage"], own["outage_length"] = streams.uniform("corrections"), streams.normal("corrections")
