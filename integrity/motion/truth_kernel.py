"""Numba kernels that compute the true motion of an epoch from the poses at its start and end."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import remainder
from lanebound.integrity.core.records import record

__all__ = ["END", "TRUTH", "all_finite", "between", "between_rows"]

TRUTH = record(
    position=("f8", (3,), "ENU, of the reference point at the end of the epoch [m]"),
    velocity=("f8", (3,), "the same [m/s]"),
    heading="azimuth at the end [rad]",
    turn=("f8", (3,), "rotation over the epoch in body axes, forward right down [rad]"),
    delta_v=("f8", (3,), "integrated specific force in the body axes at the middle of the epoch [m/s]"),
    distance="signed length of the chord [m]",
    arc="along the centre line of the street [m]",
    lane=("i8", "index of the lane, 0 is the rightmost"),
)
"""The true motion of a vehicle over an epoch, as in :class:`~lanebound.integrity.motion.truth.Truth`."""

END = record(
    position=("f8", (2,), "East, North [m]"),
    velocity=("f8", (2,), "East, North [m/s]"),
    heading="azimuth [rad]",
)
"""A vehicle at one end of an epoch."""


@jit
def between(start, end, down, truth):  # type: ignore[no-untyped-def]
    """Fill the motion of a vehicle (TRUTH) from both ends (END) of an epoch; ``down`` [m/s] is what gravity adds.

    ``turn`` and ``delta_v`` are in body axes, forward, right, down, of the middle of the epoch.
    """
    turned = remainder(end.heading - start.heading)
    s, c = math.sin(start.heading + 0.5 * turned), math.cos(start.heading + 0.5 * turned)
    de, dn = end.position[0] - start.position[0], end.position[1] - start.position[1]
    we, wn = end.velocity[0] - start.velocity[0], end.velocity[1] - start.velocity[1]
    for k in range(2):
        truth.position[k], truth.velocity[k] = end.position[k], end.velocity[k]
    truth.position[2] = truth.velocity[2] = truth.turn[0] = truth.turn[1] = 0.0
    truth.heading = remainder(end.heading)
    truth.turn[2] = turned
    truth.delta_v[0], truth.delta_v[1], truth.delta_v[2] = s * we + c * wn, c * we - s * wn, down
    truth.distance = math.copysign(math.hypot(de, dn), s * de + c * dn)


@jit
def between_rows(starts, ends, down, truths):  # type: ignore[no-untyped-def]
    """:func:`between` for B vehicles, (B,) each."""
    for b in range(truths.shape[0]):
        between(starts[b], ends[b], down, truths[b])


@jit
def all_finite(truths):  # type: ignore[no-untyped-def]
    """Whether position, velocity, heading and arc of all vehicles, (B,) of TRUTH, are finite."""
    for b in range(truths.shape[0]):
        truth = truths[b]
        total = truth.heading + truth.arc
        for k in range(3):
            total += truth.position[k] + truth.velocity[k]
        if not math.isfinite(total):  # a sum with an infinity or NaN is not finite
            return False
    return True
