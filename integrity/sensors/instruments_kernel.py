"""All instruments of vehicles over one epoch, in one call: draws, sky mask, link, receiver, gyros, wheels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.streams_kernel import fill, uniform
from lanebound.integrity.sensors import imu_kernel, odometer_kernel
from lanebound.integrity.sensors.arrival_kernel import WORK
from lanebound.integrity.sensors.corrections_kernel import LINK_RULES, receive
from lanebound.integrity.sensors.draws_kernel import draw_normals, draw_uniforms
from lanebound.integrity.sensors.gnss_kernel import (
    GNSS_RULES,
    NORMALS,
    UNIFORMS,
    Effects,
    Receiver,
    ReceiverDraws,
    Sensed,
    observe_vehicle,
)
from lanebound.integrity.sensors.imu_kernel import IMU_RULES
from lanebound.integrity.sensors.near_objects_kernel import NEAR
from lanebound.integrity.sensors.odometer_kernel import ODOMETER_RULES
from lanebound.integrity.sky.mask_kernel import RECEPTION, find_cells, look_up

__all__ = ["DRAWN_STREAMS", "INSTRUMENT_RULES", "VEHICLE_DRAWS", "Sensors", "draw_jointly", "draw_width", "sense"]

DRAWN_STREAMS = ("gnss", "near_objects", "clock", "imu", "odometer", "corrections")
GNSS, NEAR_OBJECTS, CLOCK, IMU, ODOMETER, CORRECTIONS = range(6)  # of them

INSTRUMENT_RULES = record(
    link=(LINK_RULES, "the reference link"),
    gnss=(GNSS_RULES, "the receiver"),
    imu=(IMU_RULES, "the inertial sensors"),
    odometer=(ODOMETER_RULES, "the odometer"),
)

VEHICLE_DRAWS = record(
    clock=("f8", (2,), "of the receiver, standard normal [-]"),
    imu=("f8", (2, 3, 5), "by triad and axis, standard normal [-]"),
    odometer="standard normal [-]",
    outage="whether an outage begins, uniform [-]",
    outage_length="standard normal [-]",
)
"""Draws of a vehicle and epoch in addition to those for its satellites."""
OF_SATELLITE = (NORMALS.itemsize // 8, UNIFORMS.itemsize // 8, NEAR.itemsize // 8)
OF_VEHICLE = VEHICLE_DRAWS.itemsize // 8
CLOCK_AT, IMU_AT, ODOMETER_AT, OUTAGE_AT, LENGTH_AT = (
    place // 8
    for _, place in sorted(VEHICLE_DRAWS.fields.values(), key=lambda field: field[1])  # type: ignore[union-attr]
)
"""Places of the fields in the row of a vehicle's draws."""


class Sensors(NamedTuple):
    """What lasts in the instruments of B vehicles.

    links (B,) of LINK; held (B, S) of STATION; receivers (B,) of RECEIVER; signals (B, S) of SIGNAL; inertial (B,) of
    INERTIAL; wheels (B,) of WHEELS.
    """

    links: Records
    held: Records
    receivers: Records
    signals: Records
    inertial: Records
    wheels: Records


class SensingScratch(NamedTuple):
    """Scratch of :func:`sense`: cells and reception (S,) of the satellites, a row (W,) of draws, work (1,) WORK."""

    cells: Records
    reception: Records
    row: NDArray[np.float64]
    work: Records


@jit
def draw_width(satellites):  # type: ignore[no-untyped-def]
    """Numbers that a vehicle draws in an epoch for S satellites and for itself."""
    return sum(OF_SATELLITE) * satellites + OF_VEHICLE


@jit(inline=True)
def split(row, satellites):  # type: ignore[no-untyped-def]
    """The draws of a vehicle, (W,): those of NORMALS, UNIFORMS and NEAR for S satellites, and of VEHICLE_DRAWS."""
    a = OF_SATELLITE[0] * satellites
    b = a + OF_SATELLITE[1] * satellites
    c = b + OF_SATELLITE[2] * satellites
    return row[:a], row[a:b], row[b:c], row[c:]


@jit(borrows=True)
def draw_first(g, rules, draws, row, satellites):  # type: ignore[no-untyped-def]
    """The first draws from the streams that a vehicle draws from twice, by the generators ``g``."""
    normals, _, _, own = split(row, satellites)
    draw_normals(draws.generators[GNSS, g], g, draws.places, draws.table, normals)
    if rules.link.outages:
        own[OUTAGE_AT] = uniform(draws.generators[CORRECTIONS, g])


@jit(borrows=True)
def draw_rest(g, rules, draws, row, satellites):  # type: ignore[no-untyped-def]
    """All further draws."""
    generators, table = draws.generators, draws.table
    _, uniforms, near, own = split(row, satellites)
    draw_uniforms(generators[GNSS, g], g, draws.places, uniforms)
    if rules.gnss.near.fitted:
        draw_normals(generators[NEAR_OBJECTS, g], g, draws.places, table, near)
    fill(generators[CLOCK, g], table, own[CLOCK_AT:IMU_AT])
    fill(generators[IMU, g], table, own[IMU_AT:ODOMETER_AT])
    fill(generators[ODOMETER, g], table, own[ODOMETER_AT:OUTAGE_AT])
    if rules.link.outages:
        fill(generators[CORRECTIONS, g], table, own[LENGTH_AT:])


@jit
def draw_jointly(rules, draws, satellites):  # type: ignore[no-untyped-def]
    """The draws of all vehicles, ``draws.drawn`` (B, W), from one generator of each stream: rules (1,)."""
    for v in range(draws.drawn.shape[0]):
        draw_first(0, rules[0], draws, draws.drawn[v], satellites)
    for v in range(draws.drawn.shape[0]):
        draw_rest(0, rules[0], draws, draws.drawn[v], satellites)


@jit
def sense(first, last, epoch, rules, areas, sensors, draws, mask, sky, truths, effects, observed):  # type: ignore[no-untyped-def]
    """Measure vehicles ``first`` to ``last - 1`` of B, whose sensors advance.

    Parameters
    ----------
    epoch : its number on the clock of the areas
    rules, areas, sensors : (1,) of INSTRUMENT_RULES; Areas, A is 1 or B; Sensors
    draws : Draws of DRAWN_STREAMS; vehicles with one generator for all have drawn before
    mask, sky : MaskRows and SatelliteRows
    truths, effects : (B,) of TRUTH; Effects
    observed : Sensed, filled but for the sight, which is read
    """
    vehicles, satellites, latest = observed.vehicles, observed.signals.shape[1], -1
    cells, reception = np.empty(satellites, np.int64), np.empty(satellites, RECEPTION)
    scratch = SensingScratch(cells, reception, np.empty(draw_width(satellites)), np.zeros(1, WORK))
    for v in range(first, last):
        k = vehicles[v].sight
        if k != latest:
            find_cells(mask.rules[0], sky.azimuth[k], sky.elevation[k], cells)
            latest = k
        sense_vehicle(v, epoch, rules[0], areas, sensors, draws, mask, sky, truths[v], effects, observed, scratch)


@jit(borrows=True)
def sense_vehicle(v, epoch, par, areas, sensors, draws, mask, sky, truth, effects, observed, scratch):  # type: ignore[no-untyped-def]
    """:func:`sense` for vehicle v, whose satellites stand in ``scratch.cells``."""
    moved, out, satellites = effects.vehicles[v], observed.vehicles[v], observed.signals.shape[1]
    a, row = v % areas.sites.shape[0], scratch.row
    if draws.drawn.shape[0] > 0:
        row = draws.drawn[v]
    else:
        draw_first(v, par, draws, row, satellites)
        draw_rest(v, par, draws, row, satellites)
    normals, uniforms, near, own = split(row, satellites)
    z = own.view(VEHICLE_DRAWS)[0]
    look_up(mask, scratch.cells, truth.arc, truth.lane, scratch.reception)
    out.age = receive(
        epoch, par.link, areas.networks[a], areas.message[a], z.outage, z.outage_length, moved.corrections_lost,
        sensors.links[v], sensors.held[v],
    )  # fmt: skip
    observe_vehicle(
        par.gnss, areas.sites[a], areas.slow[a],
        Receiver(sensors.receivers[v], sensors.signals[v], sensors.held[v]),
        ReceiverDraws(normals.view(NORMALS), uniforms.view(UNIFORMS), near.view(NEAR), z.clock), sky, scratch.reception,
        truth, Effects(effects.signals[v], moved), Sensed(observed.signals[v], out), scratch.work[0],
    )  # fmt: skip
    imu_kernel.measure(par.imu, sensors.inertial[v], z.imu, truth, moved.gyro_bias_radps, out)
    odometer_kernel.measure(par.odometer, sensors.wheels[v], z.odometer, truth.distance, moved, out)
    out.next_best[0], out.next_best[1] = moved.next_best[0], moved.next_best[1]
