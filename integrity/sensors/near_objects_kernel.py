"""Multipath by objects that move with a vehicle or stand beside it: its roof, other vehicles, the ground.

For each satellite and band a process of unit variance on the code and one on the carrier, each a first-order
Gauss-Markov process. With the speed v over an epoch of length dt a process decays by ``exp(-dt / tau - v dt / L)``: it
changes with the path driven, and slowly at rest. Both errors have the law of multipath over elevation,
``sigma sqrt((1 + 1 / sin^2) / 2)``, and the Doppler is that of the first band's carrier: its change over the epoch, by
the time.
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["NEAR", "NEAR_BANDS", "NEAR_RULES", "advance_near"]

NEAR_BANDS = 2

NEAR_RULES = record(
    fitted=("?", "whether there are near objects"),
    dt="length of an epoch [s]",
    code="code multipath, zenith, 1 sigma [m]",
    phase="carrier multipath, zenith, 1 sigma [m]",
    code_rest="decay of the code's over an epoch at rest [-]",
    phase_rest="decay of the carrier's [-]",
    code_per_m="faster decay of the code's by the speed [1/m]",
    phase_per_m="the same of the carrier's [1/m]",
)
"""Figures of :class:`~lanebound.integrity.sensors.gnss.NearObjectsConfig`."""

NEAR = record(
    code=("f8", (NEAR_BANDS,), "of codes, by band [-]"),
    phase=("f8", (NEAR_BANDS,), "of carriers, by band [-]"),
)
"""The processes of unit variance of a satellite's signals at a vehicle; also their standard normal draws."""


@jit
def advance_near(rules, speed, root, z, near, work):  # type: ignore[no-untyped-def]
    """Advance ``near`` by the draws z (both NEAR), and add its errors to ``work`` (WORK).

    ``root`` is the factor of the elevation, ``speed`` is in m/s. Returns the error of the range rate [m/s].
    """
    path, sizes = rules.dt * speed, (rules.code * root, rules.phase * root)
    of_code = rules.code_rest * math.exp(-path * rules.code_per_m)
    of_phase = rules.phase_rest * math.exp(-path * rules.phase_per_m)
    new_code, new_phase = math.sqrt(1.0 - of_code * of_code), math.sqrt(1.0 - of_phase * of_phase)
    before = near.phase[0]
    for b in range(NEAR_BANDS):
        near.code[b] = of_code * near.code[b] + new_code * z.code[b]
        near.phase[b] = of_phase * near.phase[b] + new_phase * z.phase[b]
        work.code[b] += sizes[0] * near.code[b]
        work.carrier[b] += sizes[1] * near.phase[b]
    return sizes[1] * (near.phase[0] - before) / rules.dt
