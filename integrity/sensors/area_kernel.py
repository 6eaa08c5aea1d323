"""What the vehicles of an area share, over one epoch: slow errors, noise of the station, its clock and its network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sensors.corrections_kernel import NetworkRows, advance_network
from lanebound.integrity.sensors.draws_kernel import draw_normals, draw_normals_at
from lanebound.integrity.sensors.gnss_kernel import BANDS, SLOW, gauss_markov

__all__ = ["AREA_RULES", "PROCESSES", "AreaDraws", "AreaRows", "advance"]

Array = NDArray[np.float64]
Words = NDArray[np.uint64]

PROCESSES = 4 + BANDS  # of SLOW, one of which advances in an epoch

AREA_RULES = record(
    dt="length of an epoch [s]",
    decay=(SLOW, "of each process over PROCESSES epochs [-]"),
    gain=(SLOW, "of each process on a new draw [-]"),
    clock_11="gains of the station's clock on two draws: offset [m]",
    clock_21="drift on the first [m/s]",
    clock_22="drift on the second [m/s]",
)


class AreaDraws(NamedTuple):
    """Generators of A areas (A, 4), or one for all (1, 4), and arrays for the draws of an epoch.

    table of :func:`~lanebound.integrity.core.streams_kernel.fill`; places (A, S) of the satellites to draw for, (0, 0)
    for all; atmosphere (A, S); noise (A, S) of STATION_NOISE and the same memory as (A, 4 S); clock, outages (A, 2).
    """

    table: Array
    places: NDArray[np.bool_]
    atmosphere_states: Words
    station_states: Words
    network_states: Words
    atmosphere: Array
    noise: Records
    noise_normals: Array
    clock: Array
    outages: Array


class AreaRows(NamedTuple):
    """A areas of S satellites.

    rules (1,) of AREA_RULES; link_rules (1,) of LINK_RULES; network; memory (A, S) of SLOW; message (A, S) of STATION;
    clock (A, 2) offset [m] and drift [m/s] of the station's clock.
    """

    rules: Records
    link_rules: Records
    network: NetworkRows
    memory: Records
    message: Records
    clock: Array
    draws: AreaDraws


@jit(borrows=True)
def advance_process(process, rules, z, slow):  # type: ignore[no-untyped-def]
    """Advance one of the slow processes of a satellite by the draw z."""
    decay, gain = rules.decay, rules.gain
    if process == 0:
        slow.iono = gauss_markov(slow.iono, decay.iono, gain.iono, z)
    elif process == 1:
        slow.age = gauss_markov(slow.age, decay.age, gain.age, z)
    elif process == 2:
        slow.tropo = gauss_markov(slow.tropo, decay.tropo, gain.tropo, z)
    elif process == 3:
        slow.code_multipath = gauss_markov(slow.code_multipath, decay.code_multipath, gain.code_multipath, z)
    else:
        b = process - 4
        before = slow.phase_multipath[b]
        slow.phase_multipath[b] = gauss_markov(before, decay.phase_multipath[b], gain.phase_multipath[b], z)


@jit(borrows=True)
def write_message(slow, noise, message):  # type: ignore[no-untyped-def]
    """The station's part of a satellite in a new message: its multipath as it now is, and white noise."""
    message.code_multipath = slow.code_multipath
    for b in range(BANDS):
        message.phase_multipath[b] = slow.phase_multipath[b]
        message.code[b], message.phase[b] = noise.code[b], noise.phase[b]


@jit(borrows=True)
def draw_stations(first, last, area):  # type: ignore[no-untyped-def]
    """The draws of areas ``first`` to ``last - 1`` after their network."""
    draws = area.draws
    draw_normals_at(first, last, draws.atmosphere_states, draws.places, draws.table, draws.atmosphere)
    if area.network.fresh[first]:
        draw_normals_at(first, last, draws.station_states, draws.places, draws.table, draws.noise_normals)
    draw_normals(first, last, draws.station_states, draws.table, draws.clock)


@jit(borrows=True)
def advance_drawn(epoch, handle):  # type: ignore[no-untyped-def]
    """All areas after their network and their draws: slow processes, fresh messages, and the stations' clocks."""
    area = unbundle(handle)
    rules, draws, network = area.rules[0], area.draws, area.network
    for a in range(area.memory.shape[0]):
        process = (epoch - network.begun[a]) % PROCESSES
        for s in range(area.memory.shape[1]):
            advance_process(process, rules, draws.atmosphere[a, s], area.memory[a, s])
            if network.fresh[a]:
                write_message(area.memory[a, s], draws.noise[a, s], area.message[a, s])
        clock, z = area.clock[a], draws.clock[a]
        clock[0] += rules.dt * clock[1] + rules.clock_11 * z[0]
        clock[1] += rules.clock_21 * z[0] + rules.clock_22 * z[1]


@jit(borrows=True)
def advance(epoch, handle):  # type: ignore[no-untyped-def]
    """All areas to ``epoch`` of the clock, the one after the present, with their draws; ``handle`` of AreaRows.

    Areas with one generator for all have one clock, so that all or none have a fresh message.
    """
    area = unbundle(handle)
    draws, areas, link_rules = area.draws, area.memory.shape[0], area.link_rules[0]
    if link_rules.outages:
        draw_normals(0, areas, draws.network_states, draws.table, draws.outages)
    advance_network(epoch, link_rules, draws.outages, area.network)
    if draws.station_states.shape[0] == areas:
        for a in range(areas):
            draw_stations(a, a + 1, area)
    else:
        draw_stations(0, areas, area)
    advance_drawn(epoch, handle)
