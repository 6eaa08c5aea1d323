"""The reference link over one epoch: the network that all vehicles of an area share, and each one's own reception."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

# columns of ``par``
LATENCY_S, INTERVAL_S, ONSET_PROBABILITY, NETWORK_RATE, MEDIAN_S, LOG_SD, MAX_S = range(7)
ROUNDING = 1e-9  # share of an epoch or interval that floating-point division may be short of a whole number
FOREVER = 2**60  # epochs


@jit
def outage_epochs(par, dt, z):  # type: ignore[no-untyped-def]
    """Length of an outage in whole epochs, at least one: ``min(median exp(sd z), max)``."""
    length_s = min(par[MEDIAN_S] * math.exp(par[LOG_SD] * z), par[MAX_S])
    return max(math.ceil(length_s / dt - ROUNDING), 1)


@jit
def quiet_epochs(par, dt, z):  # type: ignore[no-untyped-def]
    """Whole epochs until the network fails again, exponential at its rate, from a standard normal."""
    if not par[NETWORK_RATE] > 0.0:
        return FOREVER
    tail = max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-300)
    return math.floor(-math.log(tail) / (par[NETWORK_RATE] * dt))


@jit
def advance_network(par, dt, z, outage_left, until, up):  # type: ignore[no-untyped-def]
    """The networks of A areas, (A,) each, z (A, 2): outages alternate with quiet; ``up`` is filled."""
    for a in range(up.shape[0]):
        if outage_left[a] == 0 and until[a] == 0:
            outage_left[a] = outage_epochs(par, dt, z[a, 1])
        up[a] = outage_left[a] == 0
        if up[a]:
            until[a] -= 1
            continue
        outage_left[a] -= 1
        if outage_left[a] == 0:
            until[a] = quiet_epochs(par, dt, z[a, 0])


@jit
def advance(  # type: ignore[no-untyped-def]
    par, now, dt, message, fresh, u, z, lost, network_up, until, newest, outage_left, up, sent, held, age
):  # fmt: skip
    """All vehicles, (B,) each, at time ``now`` (A,) of their areas: state advances in place, ``age`` is filled.

    Empty ``u``: no outages. Who receives the newest message, ``sent`` (A, ...), keeps it in ``held`` (B, ...) until the
    next one.

    An outage of one's own that would run into one of the network does not take place: lengths keep their law.
    """
    areas = network_up.shape[0]
    for v in range(up.shape[0]):
        a = v % areas
        if u.shape[0] > 0 and outage_left[v] == 0 and network_up[a] and u[v] < par[ONSET_PROBABILITY]:
            length = outage_epochs(par, dt, z[v])
            if length <= until[a]:
                outage_left[v] = length
        up[v] = network_up[a] and outage_left[v] == 0
        if outage_left[v] > 0:
            outage_left[v] -= 1
        if fresh[a] and up[v] and not lost[v]:
            newest[v] = message[a]
            held[v] = sent[a]
        age[v] = now[a] - newest[v] * par[INTERVAL_S] if newest[v] >= 0 else math.inf
