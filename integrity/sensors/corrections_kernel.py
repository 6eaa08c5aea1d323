"""The reference link over one epoch: the network that all vehicles of an area share, and each one's own reception."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["LINK", "LINK_RULES", "NETWORK", "advance_network", "advance_networks", "quiet_epochs", "receive"]

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

NETWORK = record(
    begun=("i8", "epoch of the common clock at the start of the area's own"),
    message=("i8", "number of the newest reference epoch whose message was due, -1 before the first"),
    fresh=("?", "this message was due in the last epoch"),
    up=("?", "the network transmitted messages in the last epoch"),
    outage_left=("i8", "remaining epochs of the present outage"),
    until=("i8", "epochs until the next outage"),
)
"""The network of an area; times are counted in whole epochs, so that no rounding accumulates."""

ROUNDING = 1e-9  # share of an epoch or interval that floating-point division may be short of a whole number
FOREVER = 2**60  # epochs


@jit
def outage_epochs(rules, z):  # type: ignore[no-untyped-def]
    """Length of an outage in whole epochs, at least one: ``min(median exp(sd z), max)``."""
    length_s = min(rules.median * math.exp(rules.log_sd * z), rules.longest)
    return max(math.ceil(length_s / rules.dt - ROUNDING), 1)


@jit
def quiet_epochs(rules, z):  # type: ignore[no-untyped-def]
    """Whole epochs until the network fails again, exponential at its rate, from a standard normal."""
    if not rules.network_rate > 0.0:
        return FOREVER
    tail = max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-300)
    return math.floor(-math.log(tail) / (rules.network_rate * rules.dt))


@jit(borrows=True)
def advance_network(epoch, rules, z, network):  # type: ignore[no-untyped-def]
    """The network of an area at ``epoch`` of the clock: messages arrive, outages alternate with quiet by z (2,)."""
    own_s = (epoch - network.begun) * rules.dt
    arrived = math.floor((own_s - rules.latency) / rules.interval + ROUNDING)
    network.fresh = arrived > network.message
    network.message = max(arrived, network.message)
    if not rules.outages:
        return
    if network.outage_left == 0 and network.until == 0:
        network.outage_left = outage_epochs(rules, z[1])
    network.up = network.outage_left == 0
    if network.up:
        network.until -= 1
        return
    network.outage_left -= 1
    if network.outage_left == 0:
        network.until = quiet_epochs(rules, z[0])


@jit
def advance_networks(epoch, rules, z, networks):  # type: ignore[no-untyped-def]
    """:func:`advance_network` for A areas: z (A, 2), networks (A,) of NETWORK."""
    for a in range(networks.shape[0]):
        advance_network(epoch, rules, z[a], networks[a])


@jit(borrows=True)
def receive(epoch, rules, network, sent, chance, z, lost, link, held):  # type: ignore[no-untyped-def]
    """A vehicle's reception at ``epoch`` of the clock: the age of its reference data [s], inf without any.

    sent, held (S,): the newest message of the area, and the one that the vehicle holds; ``chance`` uniform and z
    normal, the draws of the epoch, read with outages alone; ``lost``: cut by a fault. A vehicle that receives the
    newest message keeps it until the next one. An outage of its own that would run into one of the network does not
    take place: lengths keep their law.
    """
    if rules.outages and link.outage_left == 0 and network.up and chance < rules.onset:
        length = outage_epochs(rules, z)
        if length <= network.until:
            link.outage_left = length
    link.up = network.up and link.outage_left == 0
    if link.outage_left > 0:
        link.outage_left -= 1
    if network.fresh and link.up and not lost:
        link.newest = network.message
        for s in range(held.shape[0]):
            held[s] = sent[s]
    now = (epoch - network.begun) * rules.dt
    return now - link.newest * rules.interval if link.newest >= 0 else math.inf
