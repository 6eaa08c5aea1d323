"""How the signal of one satellite arrives: direct or diffracted, and by reflections; and what a receiver makes of it.

Letters: ``e`` unit vector to the satellite, ``x`` antenna [m] and ``v`` its velocity [m/s], all in the frame of the
street; ``n . x = c`` the plane of a face; ``p`` a point and ``t`` the direction of the line of an edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.sensors.multipath_kernel import (
    ARRIVAL,
    MOST_ARRIVALS,
    Loops,
    combine,
    follow_carrier,
    strongest_of,
)
from lanebound.integrity.sky.propagation_kernel import (
    antenna_amplitude,
    diffraction_loss_db,
    edge_detour,
    excess_path,
    excess_rate,
    fresnel_parameter,
)
from lanebound.integrity.sky.raytrace_kernel import BLOCKED, FOLIAGE, LOS, REFLECTED, STRONGEST

__all__ = [
    "ARRIVAL",
    "BANDS",
    "DIFFRACTED",
    "MULTIPATH",
    "PATH_RULES",
    "TRACKED",
    "WORK",
    "SignalGeometry",
    "find_arrivals",
    "track",
]

BANDS = 2  # that a receiver has at most
MATERIALS = 4  # members of materials.Material
MULTIPATH, DIFFRACTED = 4, 5  # further values of visibility.SignalPath
NOTHING, DIRECT = -2.0, -1.0  # values of TRACKED.arrival beside indices of faces
UNKNOWN_FACE = -0.5  # a reflection whose face is not known
CELL_RAD = 0.06  # the mask says 'free' or 'blocked' for a cell of 3 degrees: so near the edge decides
MOST_LOSS_DB = 30.0  # of a diffracted ray that is followed

PATH_RULES = record(
    permittivity=("c16", (MATERIALS,), "of the materials, complex and relative [-]"),
    roughness=("f8", (MATERIALS,), "of the materials [m]"),
    cross_polar="voltage response of the antenna to left-handed signals, over that to right-handed ones [-]",
    reflection_loss="loss of a reflection at an unknown face [dB]",
    foliage_loss="mean loss of a tree [dB]",
    spacing="of early and late correlator [chips]",
    code_loop="bandwidth of the code loop [Hz]",
    carrier_loop="bandwidth of the carrier loop [Hz]",
    fade_gain="of the smoothed C/N0 on that of an epoch [-]",
    lock_gain="of the lock detector on the power of an epoch [-]",
    keep_lock="probability that the carrier loop keeps lock when the tracked arrival changes [-]",
)
"""Figures of the propagation and of the receiver's loops."""

TRACKED = record(
    arrival="what the receiver tracks: NOTHING, DIRECT, or the index of the face of a reflection",
    fade="power over that of the unobstructed signal, as the C/N0 estimate smooths it [dB]",
    power="the same in the window of the lock detector [-]",
    carrier=("f8", (BANDS,), "delay of the carrier that the loop follows, by band [m]"),
    sources=("f8", (MOST_ARRIVALS,), "all arrivals of the last epoch, as arrival"),
    excess=("f8", (MOST_ARRIVALS,), "their extra paths [m]"),
    edge=("i8", "index of the edge that the direct ray of the last epoch passed, -1 for none"),
)
"""What lasts of a satellite's arrival from epoch to epoch."""


WORK = record(
    arrivals=(ARRIVAL, (MOST_ARRIVALS,), "direct or diffracted ray, and reflections"),
    code=("f8", (BANDS,), "what they and near objects add to codes, by band [m]"),
    carrier=("f8", (BANDS,), "the same of carriers [m]"),
)
"""The signal at hand."""


class SignalGeometry(NamedTuple):
    """A signal at an antenna: unit vector to the satellite, antenna [m], velocity [m/s]."""

    e: tuple[float, float, float]
    x: tuple[float, float, float]
    v: tuple[float, float, float]


@jit
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def _add_direct(rules, reception, way, fluctuation, wavelength, arrival):  # type: ignore[no-untyped-def]
    """Fill the arrival of the direct or diffracted ray; its kind, BLOCKED for none.

    The mask says free or blocked for a whole cell; within a cell of its edge the line of the edge decides.
    """
    path, line = reception.path, reception.line
    clear = path == LOS or path == FOLIAGE
    kind, loss = (path, 0.0) if clear else (BLOCKED, 0.0)
    arrival.excess_m = arrival.rate_mps = arrival.phase_rad = 0.0
    if reception.edge >= 0:
        below, excess, rate = edge_detour(way.e, line.along, line.point, way.x, way.v)
        if abs(below) <= CELL_RAD or (below > 0.0) != clear:
            kind = path if clear else LOS
            loss = diffraction_loss_db(math.copysign(fresnel_parameter(excess, wavelength), below))
            if loss > MOST_LOSS_DB:
                return BLOCKED
            if below > 0.0:
                kind, arrival.excess_m, arrival.rate_mps = DIFFRACTED, excess, rate
    if path == FOLIAGE:
        loss += rules.foliage_loss - 2.0 * fluctuation  # with cn0_sigma of the receiver: tripled below trees
    arrival.amplitude = 10.0 ** (-0.05 * loss) if loss != 0.0 else 1.0
    return kind


@jit
def _add_reflection(rules, face, way, wavelength, arrival):  # type: ignore[no-untyped-def]
    """Fill the arrival of a reflection at a face (FACE): ``L = 2 d (e.n)``, ``dL/dt = 2 (e.n)(n.v)``; False for none.

    The normal is turned to the side of the antenna, which is ``d`` in front of the face.
    """
    d = face.normal[0] * way.x[0] + face.normal[1] * way.x[1] + face.normal[2] * way.x[2] - face.offset
    side = 1.0 if d >= 0.0 else -1.0
    n = side * face.normal[0], side * face.normal[1], side * face.normal[2]
    cosine = _dot(way.e, n)
    if cosine <= 0.0:
        return False
    m = face.material
    gamma = antenna_amplitude(cosine, rules.permittivity[m], rules.cross_polar, rules.roughness[m], wavelength)
    arrival.amplitude, arrival.phase_rad = abs(gamma), -math.atan2(gamma.imag, gamma.real)
    arrival.excess_m, arrival.rate_mps = excess_path(way.e, n, abs(d)), excess_rate(way.e, n, way.v)
    return arrival.amplitude > 0.0


@jit(forceinline=True)  # calls cost a third of the time of a signal
def find_arrivals(rules, reception, way, fluctuation, wavelength, arrivals):  # type: ignore[no-untyped-def]
    """Fill the arrivals of a signal (ARRIVAL), at most 3: their number, and the kind of the direct one.

    reception of RECEPTION, way of SignalGeometry. A reflection at an unknown face keeps the excess of the mask.
    """
    kind, count = _add_direct(rules, reception, way, fluctuation, wavelength, arrivals[0]), 0
    if kind != BLOCKED:
        arrivals[0].source, count = DIRECT, 1
    for k in range(STRONGEST):
        face = reception.face[k]
        if face >= 0 and _add_reflection(rules, reception.planes[k], way, wavelength, arrivals[count]):
            arrivals[count].source = face
            count += 1
    if reception.path == REFLECTED and count == 0 and reception.face[0] < 0:
        last = arrivals[0]
        last.amplitude, last.excess_m = 10.0 ** (-0.05 * rules.reflection_loss), reception.excess
        last.phase_rad = last.rate_mps = 0.0
        last.source, count = UNKNOWN_FACE, 1
    return count, kind


@jit
def _recall(memory, arrivals, count, edge):  # type: ignore[no-untyped-def]
    """Set the extra paths of the last epoch in the arrivals, and remember the present ones.

    A ray over another edge than in the last epoch is a new arrival: its path has no past.
    """
    for i in range(count):
        arrival = arrivals[i]
        arrival.before_m = arrival.excess_m
        if arrival.source == DIRECT and memory.edge != edge:
            continue
        for k in range(MOST_ARRIVALS):
            if memory.arrival != NOTHING and memory.sources[k] == arrival.source:
                arrival.before_m = memory.excess[k]
    memory.edge = edge
    for i in range(MOST_ARRIVALS):
        there = i < count
        memory.sources[i], memory.excess[i] = (arrivals[i].source, arrivals[i].excess_m) if there else (NOTHING, 0.0)


@jit(forceinline=True)  # calls cost a third of the time of a signal
def track(rules, wavelength, chip, bands, edge, chance, memory, count, work):  # type: ignore[no-untyped-def]
    """Track the strongest of the arrivals; whether the lock of the carrier breaks, which arrival, error of range rate,
    and the present power over that of an unobstructed signal [dB].

    wavelength and chip (2,) [m] of the ``bands`` tracked; edge of the direct ray, -1 for none; ``work`` (WORK) has the
    arrivals and gets the errors. When another arrival becomes the strongest, the lock is kept with probability
    ``rules.keep_lock`` (``chance``, a uniform draw): the loop follows the phase of the sum. Otherwise the receiver
    notices.
    """
    arrivals = work.arrivals
    r = strongest_of(arrivals, count)
    old, rate, fade = memory.arrival, 0.0, 0.0
    broken = old != NOTHING and old != arrivals[r].source and chance >= rules.keep_lock
    _recall(memory, arrivals, count, edge)
    memory.arrival = arrivals[r].source
    for b in range(bands):
        loops = Loops(wavelength[b], chip[b], rules.spacing, rules.code_loop, rules.carrier_loop)
        sum_, last = combine(arrivals, count, r, loops), memory.carrier[b] if old != NOTHING else math.nan
        memory.carrier[b] = follow_carrier(arrivals, count, r, loops, last)
        work.code[b], work.carrier[b] = sum_.code_m, memory.carrier[b]
        if b == 0:
            rate = sum_.rate_mps
            fade = 20.0 * math.log10(max(sum_.amplitude, 1e-6)) if sum_.amplitude != 1.0 else 0.0
            new = old == NOTHING
            memory.fade += (1.0 if new else rules.fade_gain) * (fade - memory.fade)
            memory.power += (1.0 if new else rules.lock_gain) * (sum_.amplitude * sum_.amplitude - memory.power)
    return broken, r, rate, fade
