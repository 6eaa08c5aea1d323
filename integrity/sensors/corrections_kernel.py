"""The reference link over one epoch: the network that all vehicles of an area share, and each one's own reception."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["LINK", "LINK_RULES", "LinkRows", "NetworkRows", "advance", "advance_network", "quiet_epochs"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LINK_RULES = record(
    dt="length of an epoch [s]",
    latency="of a message [s]",
    interval="between reference epochs [s]",
    outages=("?", "there are outages"),
    onset="probability that an outage of a vehicle's own begins in an epoch [-]",
    network_rate="outages of the network [1/s]",
    median="of the length of an outage [s]",
    log_sd="1 sigma of its logarithm [-]",
    longest="outage [s]",
)

LINK = record(
    newest=("i8", "number of the newest reference epoch received, -1 before the first"),
    outage_left=("i8", "epochs for which the present outage of the vehicle's own still lasts"),
    up=("?", "the link carried messages in the last epoch"),
)
"""Reception of a vehicle."""

ROUNDING = 1e-9  # share of an epoch or interval that floating-point division may be short of a whole number
FOREVER = 2**60  # epochs


class NetworkRows(NamedTuple):
    """Networks of A areas, (A,) each, as in :class:`~lanebound.integrity.sensors.corrections.NetworkState`."""

    begun: Ints
    message: Ints
    fresh: Bools
    up: Bools
    outage_left: Ints
    until: Ints


class LinkRows(NamedTuple):
    """Reception of B vehicles in A areas.

    rules (1,) of LINK_RULES; network; sent (A, S), the newest message of each area; links (B,) of LINK; held (B, S),
    the message that each vehicle holds; uniforms, normals (B, 1), the draws of the epoch, read with outages alone.
    """

    rules: Records
    network: NetworkRows
    sent: Records
    links: Records
    held: Records
    uniforms: Array
    normals: Array


@jit(borrows=True)
def outage_epochs(rules, z):  # type: ignore[no-untyped-def]
    """Length of an outage in whole epochs, at least one: ``min(median exp(sd z), max)``."""
    length_s = min(rules.median * math.exp(rules.log_sd * z), rules.longest)
    return max(math.ceil(length_s / rules.dt - ROUNDING), 1)


@jit(borrows=True)
def quiet_epochs(rules, z):  # type: ignore[no-untyped-def]
    """Whole epochs until the network fails again, exponential at its rate, from a standard normal."""
    if not rules.network_rate > 0.0:
        return FOREVER
    tail = max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-300)
    return math.floor(-math.log(tail) / (rules.network_rate * rules.dt))


@jit(borrows=True)
def advance_network(epoch, rules, z, network):  # type: ignore[no-untyped-def]
    """Networks at ``epoch`` of the clock: messages arrive, outages alternate with quiet by the draws z (A, 2)."""
    for a in range(network.up.shape[0]):
        own_s = (epoch - network.begun[a]) * rules.dt
        arrived = math.floor((own_s - rules.latency) / rules.interval + ROUNDING)
        network.fresh[a] = arrived > network.message[a]
        network.message[a] = max(arrived, network.message[a])
        if not rules.outages:
            continue
        if network.outage_left[a] == 0 and network.until[a] == 0:
            network.outage_left[a] = outage_epochs(rules, z[a, 1])
        network.up[a] = network.outage_left[a] == 0
        if network.up[a]:
            network.until[a] -= 1
            continue
        network.outage_left[a] -= 1
        if network.outage_left[a] == 0:
            network.until[a] = quiet_epochs(rules, z[a, 0])


@jit(borrows=True)
def advance(first, last, epoch, rows, lost, age):  # type: ignore[no-untyped-def]
    """Vehicles ``first`` to ``last - 1`` at ``epoch`` of the clock; lost (B,): cut by a fault; ``age`` (B,) is filled.

    A vehicle that receives the newest message keeps it until the next one. An outage of its own that would run into one
    of the network does not take place: lengths keep their law.
    """
    rules, network = rows.rules[0], rows.network
    areas = network.up.shape[0]
    for v in range(first, last):
        a, link = v % areas, rows.links[v]
        if rules.outages and link.outage_left == 0 and network.up[a] and rows.uniforms[v, 0] < rules.onset:
            length = outage_epochs(rules, rows.normals[v, 0])
            if length <= network.until[a]:
                link.outage_left = length
        link.up = network.up[a] and link.outage_left == 0
        if link.outage_left > 0:
            link.outage_left -= 1
        if network.fresh[a] and link.up and not lost[v]:
            link.newest = network.message[a]
            for s in range(rows.held.shape[1]):
                rows.held[v, s] = rows.sent[a, s]
        now = (epoch - network.begun[a]) * rules.dt
        age[v] = now - link.newest * rules.interval if link.newest >= 0 else math.inf
