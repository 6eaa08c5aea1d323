"""What the vehicles of an area share, over one epoch: slow errors, noise of the station, its clock and its network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.streams_kernel import fill
from lanebound.integrity.sensors.corrections_kernel import advance_network
from lanebound.integrity.sensors.draws_kernel import draw_normals
from lanebound.integrity.sensors.gnss_kernel import BANDS, SLOW, STATION_NOISE, gauss_markov

__all__ = ["AREA_RULES", "AREA_STREAMS", "PROCESSES", "Areas", "advance", "advance_all_drawn"]

AREA_STREAMS = ("atmosphere", "station", "network")
ATMOSPHERE, STATION, NETWORK_STREAM = range(3)  # of them
NOISE = STATION_NOISE.itemsize // 8  # numbers of a satellite
PROCESSES = 4 + BANDS  # of SLOW, one of which advances in an epoch

AREA_RULES = record(
    dt="length of an epoch [s]",
    decay=(SLOW, "of each process over PROCESSES epochs [-]"),
    gain=(SLOW, "of each process on a new draw [-]"),
    clock_11="gains of the station's clock on two draws: offset [m]",
    clock_21="drift on the first [m/s]",
    clock_22="drift on the second [m/s]",
)


class Areas(NamedTuple):
    """A areas of S satellites.

    networks (A,) of NETWORK; sites (A,) of SITE; slow (A, S) of SLOW; message (A, S) of STATION, the newest one.
    """

    networks: Records
    sites: Records
    slow: Records
    message: Records


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


@jit
def advance_drawn(a, epoch, rules, areas, atmosphere, noise, clock):  # type: ignore[no-untyped-def]
    """Area a after its network and its draws: slow processes, fresh messages, and the station's clock.

    Standard normals: atmosphere (S,), noise (S,) of STATION_NOISE, clock (2,).
    """
    network, site, slow, message = areas.networks[a], areas.sites[a], areas.slow[a], areas.message[a]
    process = (epoch - network.begun) % PROCESSES
    for s in range(slow.shape[0]):
        advance_process(process, rules, atmosphere[s], slow[s])
        if network.fresh:
            write_message(slow[s], noise[s], message[s])
    site.offset += rules.dt * site.drift + rules.clock_11 * clock[0]
    site.drift += rules.clock_21 * clock[0] + rules.clock_22 * clock[1]


@jit
def advance(epoch, rules, link_rules, areas, draws):  # type: ignore[no-untyped-def]
    """All areas to ``epoch`` of the clock, the one after the present: rules (1,) of AREA_RULES and of LINK_RULES.

    draws : Draws of AREA_STREAMS, a generator for each area
    """
    generators, table, places, satellites = draws.generators, draws.table, draws.places, areas.slow.shape[1]
    atmosphere, noise, two = np.empty(satellites), np.empty(NOISE * satellites), np.empty(2)
    for a in range(areas.networks.shape[0]):
        if link_rules[0].outages:
            fill(generators[NETWORK_STREAM, a], table, two)
        advance_network(epoch, link_rules[0], two, areas.networks[a])
        draw_normals(generators[ATMOSPHERE, a], a, places, table, atmosphere)
        if areas.networks[a].fresh:
            draw_normals(generators[STATION, a], a, places, table, noise)
        fill(generators[STATION, a], table, two)
        advance_drawn(a, epoch, rules[0], areas, atmosphere, noise.view(STATION_NOISE), two)


@jit
def advance_all_drawn(epoch, rules, areas, atmosphere, noise, clock):  # type: ignore[no-untyped-def]
    """:func:`advance_drawn` for A areas: rules (1,), atmosphere (A, S), noise (A, S), clock (A, 2)."""
    for a in range(areas.networks.shape[0]):
        advance_drawn(a, epoch, rules[0], areas, atmosphere[a], noise[a], clock[a])
