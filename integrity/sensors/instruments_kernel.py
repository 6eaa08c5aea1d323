"""All instruments of vehicles over one epoch, in one call: draws, sky mask, link, receiver, gyros, wheels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle
from lanebound.integrity.sensors import corrections_kernel as link_kernel
from lanebound.integrity.sensors import imu_kernel, odometer_kernel
from lanebound.integrity.sensors.corrections_kernel import LinkRows
from lanebound.integrity.sensors.draws_kernel import draw_normals, draw_normals_at, draw_uniforms, draw_uniforms_at
from lanebound.integrity.sensors.gnss_kernel import (
    EffectRows,
    GnssOutputs,
    MotionRows,
    Receivers,
    observe_vehicle,
)
from lanebound.integrity.sensors.imu_kernel import ImuOutputs, ImuRows
from lanebound.integrity.sensors.odometer_kernel import OdometerOutputs, OdometerRows
from lanebound.integrity.sky.raytrace_kernel import MaskRows, ReceptionRows, SatelliteRows, look_up

__all__ = ["Draws", "InstrumentRows", "SensedEpoch", "draw", "sense"]

Array = NDArray[np.float64]
Words = NDArray[np.uint64]


class Draws(NamedTuple):
    """Generators of B vehicles (B, 4), or one for all (1, 4), and the draws of the receiver as flat arrays.

    table of :func:`~lanebound.integrity.core.streams_kernel.fill`; places (B, S) of the satellites to draw for, (0, 0)
    for all; gnss_normals (B, 10 S), gnss_uniforms (B, 2 S), near_normals (B, 4 S), imu_normals (B, 30): the same memory
    as the draws of the receivers and of the inertial sensors.
    """

    table: Array
    places: NDArray[np.bool_]
    gnss: Words
    clock: Words
    corrections: Words
    imu: Words
    odometer: Words
    near_objects: Words
    gnss_normals: Array
    gnss_uniforms: Array
    near_normals: Array
    imu_normals: Array


class InstrumentRows(NamedTuple):
    """What lasts of the instruments of B vehicles from epoch to epoch, with their parameters."""

    draws: Draws
    mask: MaskRows
    reception: ReceptionRows
    link: LinkRows
    receivers: Receivers
    imu: ImuRows
    odometer: OdometerRows


class SensedEpoch(NamedTuple):
    """One epoch: its number on the clock of the areas, what is measured, and the outputs."""

    number: int
    sky: SatelliteRows
    motion: MotionRows
    effects: EffectRows
    gnss: GnssOutputs
    imu: ImuOutputs
    odometer: OdometerOutputs


@jit(borrows=True)
def draw_rows(first, last, rows):  # type: ignore[no-untyped-def]
    """The draws of an epoch for vehicles ``first`` to ``last - 1``, of each stream in its order."""
    draws, link = rows.draws, rows.link
    if link.rules[0].outages:
        draw_uniforms(first, last, draws.corrections, link.uniforms)
        draw_normals(first, last, draws.corrections, draws.table, link.normals)
    draw_normals(first, last, draws.clock, draws.table, rows.receivers.clock_normals)
    draw_normals_at(first, last, draws.gnss, draws.places, draws.table, draws.gnss_normals)
    draw_uniforms_at(first, last, draws.gnss, draws.places, draws.gnss_uniforms)
    if rows.receivers.rules[0].near.fitted:
        draw_normals_at(first, last, draws.near_objects, draws.places, draws.table, draws.near_normals)
    draw_normals(first, last, draws.imu, draws.table, draws.imu_normals)
    draw_normals(first, last, draws.odometer, draws.table, rows.odometer.normals)


@jit(borrows=True)
def draw(first, last, handle):  # type: ignore[no-untyped-def]
    """:func:`draw_rows` of a bundle of InstrumentRows."""
    draw_rows(first, last, unbundle(handle))


@jit(borrows=True)
def sense(first, last, handle, epoch):  # type: ignore[no-untyped-def]
    """Measure vehicles ``first`` to ``last - 1``; ``handle`` of a bundle of InstrumentRows, whose states advance.

    Vehicles with one generator for all have drawn before.
    """
    rows, sky, motion, effects = unbundle(handle), epoch.sky, epoch.motion, epoch.effects
    if rows.draws.gnss.shape[0] == rows.receivers.vehicles.shape[0]:
        draw_rows(first, last, rows)
    look_up(first, last, rows.mask, sky, motion.arc, motion.lane, rows.reception)
    link_kernel.advance(first, last, epoch.number, rows.link, effects.lost, epoch.gnss.age)
    for v in range(first, last):
        observe_vehicle(v, rows.reception, rows.receivers, sky, motion, effects, epoch.gnss)
    imu_kernel.measure(first, last, rows.imu, motion, effects.gyro_bias, epoch.imu)
    odometer_kernel.measure(
        first, last, rows.odometer, motion.distance, effects.odometer_scale, effects.odometer_frozen, epoch.odometer
    )
