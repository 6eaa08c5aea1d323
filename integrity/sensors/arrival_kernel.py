"""How the signal of one satellite arrives: direct or diffracted, and by reflections; and what a receiver makes of it.

Letters: ``e`` unit vector to the satellite, ``x`` antenna [m] and ``v`` its velocity [m/s], all in the frame of the
street; ``n . x = c`` the plane of a face; ``p`` a point and ``t`` the direction of the line of an edge.

An arrival is the direct ray, a diffracted ray or a reflection: its amplitude over that of an unobstructed direct ray,
its extra path L and rate dL/dt, and the phase of its reflection. The receiver tracks the strongest arrival r; the
others disturb it. With ``a_i = A_i / A_r``, ``l_i = L_i - L_r`` and ``p_i = 2 pi l_i / lambda + phase_i - phase_r``:

- code: ``L_r + t``, t the zero of the coherent early-minus-late discriminator of the sum (:func:`code_delay`); for one
  short reflection ``a l cos p / (1 + a cos p)``, at most ``a D / 2`` chips, 0 beyond ``1 + D / 2`` chips;
- carrier: the phase of the sum, ``L_r + lambda / 2 pi angle(1 + sum a_i exp(j p_i))``, followed from epoch to epoch
  (:func:`follow_carrier`);
- range rate: the time derivative of the carrier;
- amplitude: ``A_r abs(1 + sum a_i exp(j p_i))``.

The carrier counts whole cycles: where reflections of a total amplitude above that of the tracked arrival encircle it,
the phase of the sum turns on, and the loop with it. A cycle is lost only in a fade: while the sum is more than 20 dB
below the tracked arrival, the loop holds its phase, and it pulls in at the nearest cycle when the fade is over. The
same holds where an arrival begins or ends at the edge of an obstacle. A loop that the present C/N0 is too low for loses
its lock, whatever the smoothed estimate still says.

In motion the phases turn by ``f_i = (dl_i/dt) / lambda`` cycles a second. A tracking loop of noise bandwidth B averages
over turns that are faster than it follows: the loop sees ``a_i / sqrt(1 + (f_i / B)^2)``, the gain of a first-order low
pass. Sources: van Nee 1993; Braasch 1996 (code and carrier error of one reflection); Kaplan and Hegarty 2017, ch. 9.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.sky.mask_kernel import BLOCKED, FOLIAGE, LOS, REFLECTED, STRONGEST
from lanebound.integrity.sky.propagation_kernel import (
    antenna_amplitude,
    diffraction_loss_db,
    edge_detour,
    excess_path,
    excess_rate,
    fresnel_parameter,
)

__all__ = [
    "ARRIVAL",
    "BANDS",
    "DIFFRACTED",
    "MOST_ARRIVALS",
    "MULTIPATH",
    "PATH_RULES",
    "TRACKED",
    "WORK",
    "Composite",
    "Loops",
    "SignalGeometry",
    "code_delay",
    "combine",
    "find_arrivals",
    "follow_carrier",
    "strongest_of",
    "track",
]


ARRIVAL = record(
    amplitude="over that of an unobstructed direct ray [-]",
    phase_rad="delay of the phase at the face [rad]",
    excess_m="extra path L [m]",
    rate_mps="dL/dt [m/s]",
    before_m="L at the last epoch; of a new arrival L [m]",
    angle_rad="between its direction and that of the satellite [rad]",
    source="what it is: a value of arrival_kernel.TRACKED.arrival",
)
TWO_PI = 2.0 * math.pi
MOST_ARRIVALS = 3  # the direct or diffracted ray, and two reflections
STEPS, SETTLED, LEAST_SLOPE = 8, 1e-12, 0.05
UNKNOWN_ANGLE_RAD = math.pi / 3.0  # of a reflection at an unknown face, as where e.n is 0.5; chosen
LEAST_POWER = 0.01  # a loop of some 15 Hz follows no deeper fade: the rate of its phase would exceed the bandwidth
STEP_RAD, MOST_STEPS = TWO_PI / 128.0, 2048  # of the phase of a sum that may encircle the origin


class Loops(NamedTuple):
    """Figures of a receiver: wavelength and chip [m], correlator spacing D [chips], bandwidths of the loops [Hz]."""

    wavelength_m: Any
    chip_m: Any
    spacing_chips: Any
    code_hz: Any
    carrier_hz: Any


class Composite(NamedTuple):
    """Errors of code [m] and range rate [m/s] of the sum of arrivals, and its amplitude [-]."""

    code_m: Any
    rate_mps: Any
    amplitude: Any


@jit
def _early_less_late(x, half):  # type: ignore[no-untyped-def]
    """``R(x - D/2) - R(x + D/2)`` of the triangular correlation R, and its slope; x and D/2 = ``half`` in chips."""
    early, late = abs(x - half), abs(x + half)
    value = max(1.0 - early, 0.0) - max(1.0 - late, 0.0)
    slope = 0.0
    if early < 1.0:
        slope += 1.0 if x < half else -1.0
    if late < 1.0:
        slope -= 1.0 if x < -half else -1.0
    return value, slope


@jit
def code_delay(weights, delays, half):  # type: ignore[no-untyped-def]
    """Delay at which a code loop settles, in chips after the tracked arrival; weights and delays are tuples.

    Zero of ``S(t) = E(t) + sum w_i E(t - l_i)`` nearest to 0, E the discriminator's curve, ``w_i = a_i cos p_i``, l_i
    in chips; by Newton's method on straight pieces. A loop cannot be farther off than half the spacing for each unit
    of relative amplitude, which bounds what an almost complete cancellation would give.
    """
    t, most = 0.0, 0.0
    for weight in weights:
        most += abs(weight) * half
    if most == 0.0:
        return 0.0
    for _ in range(STEPS):
        value, slope = _early_less_late(t, half)
        for i in range(len(weights)):
            v, s = _early_less_late(t - delays[i], half)
            value += weights[i] * v
            slope += weights[i] * s
        if abs(value) < SETTLED or not slope > LEAST_SLOPE:
            break
        t -= value / slope
    return min(max(t, -most), most)


@jit
def strongest_of(arrivals, count):  # type: ignore[no-untyped-def]
    """Index of the arrival of most amplitude among the first ``count`` >= 1."""
    best = 0
    for i in range(1, count):
        if arrivals[i].amplitude > arrivals[best].amplitude:
            best = i
    return best


@jit
def _disturbance(other, main, loops):  # type: ignore[no-untyped-def]
    """Effect of another arrival on the tracked one: (amplitude in the carrier loop, in the code loop, delay [m], phase,
    turns of the phase [1/s])."""
    a = other.amplitude / main.amplitude
    delay, turns = other.excess_m - main.excess_m, (other.rate_mps - main.rate_mps) / loops.wavelength_m
    phase = TWO_PI * (delay / loops.wavelength_m) + other.phase_rad - main.phase_rad
    in_code = a / math.sqrt(1.0 + (turns / loops.code_hz) ** 2)
    in_carrier = a / math.sqrt(1.0 + (turns / loops.carrier_hz) ** 2)
    return in_carrier, in_code, delay, phase, turns


@jit
def combine(arrivals, count, tracked, loops):  # type: ignore[no-untyped-def]
    """The composite of the first ``count`` arrivals (records ARRIVAL), 1 to MOST_ARRIVALS, of which one is tracked."""
    main, wave = arrivals[tracked], loops.wavelength_m
    if count == 1:
        return Composite(main.excess_m, main.rate_mps, main.amplitude)
    re, im, re_rate, im_rate = 1.0, 0.0, 0.0, 0.0
    weights, delays = (0.0, 0.0), (0.0, 0.0)
    for i in range(count):
        if i == tracked:
            continue
        seen, in_code, delay, phase, turns = _disturbance(arrivals[i], main, loops)
        cosine, sine = math.cos(phase), math.sin(phase)
        weights, delays = (weights[1], in_code * cosine), (delays[1], delay / loops.chip_m)
        re += seen * cosine
        im += seen * sine
        re_rate -= seen * sine * TWO_PI * turns
        im_rate += seen * cosine * TWO_PI * turns
    power = max(re * re + im * im, LEAST_POWER)
    code = loops.chip_m * code_delay(weights, delays, 0.5 * loops.spacing_chips)
    rate = wave / TWO_PI * (re * im_rate - im * re_rate) / power
    return Composite(main.excess_m + code, main.rate_mps + rate, main.amplitude * math.sqrt(power))


@jit
def follow_carrier(arrivals, count, tracked, loops, last_m):  # type: ignore[no-untyped-def]
    """Delay of the carrier of the sum of arrivals [m], continued from that of the last epoch, ``last_m``; NaN: a new
    lock.

    The phase of the sum is followed from the extra paths of the last epoch to those of this one. One step is enough
    unless the others together exceed the tracked arrival.
    """
    main, wave = arrivals[tracked], loops.wavelength_m
    first, angle = _turn(arrivals, count, tracked, loops) if count > 1 else (0.0, 0.0)
    carrier = main.excess_m + wave * (main.phase_rad + angle) / TWO_PI
    if not last_m == last_m:
        return carrier
    began = main.before_m + wave * (main.phase_rad + first) / TWO_PI
    return carrier + wave * math.floor((last_m - began) / wave + 0.5)


@jit
def _turn(arrivals, count, tracked, loops):  # type: ignore[no-untyped-def]
    """Phase of the sum against the tracked arrival at the last epoch, and now, followed in between."""
    main, wave = arrivals[tracked], loops.wavelength_m
    sizes, phases, changes = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)
    for i in range(count):
        if i == tracked:
            continue
        seen, _, delay, phase, _ = _disturbance(arrivals[i], main, loops)
        change = TWO_PI * (delay - (arrivals[i].before_m - main.before_m)) / wave
        sizes, phases, changes = (sizes[1], seen), (phases[1], phase - change), (changes[1], change)
    steps = 1
    if sizes[0] + sizes[1] >= 1.0:
        steps = int(min(max(abs(changes[0]), abs(changes[1])) / STEP_RAD + 1.0, MOST_STEPS))
    first, angle = 0.0, 0.0
    for k in range(steps + 1):
        p, q = phases[0] + changes[0] * k / steps, phases[1] + changes[1] * k / steps
        re = 1.0 + sizes[0] * math.cos(p) + sizes[1] * math.cos(q)
        im = sizes[0] * math.sin(p) + sizes[1] * math.sin(q)
        if k == 0:
            first = angle = math.atan2(im, re)
        elif re * re + im * im >= LEAST_POWER:
            turn = math.atan2(im, re) - angle
            angle += turn - TWO_PI * math.floor(turn / TWO_PI + 0.5)
    return first, angle


BANDS = 2  # that a receiver has at most
MATERIALS = 4  # members of materials.Material
MULTIPATH, DIFFRACTED = 4, 5  # further values of visibility.SignalPath
NOTHING, DIRECT = -2.0, -1.0  # values of TRACKED.arrival that are no indices of faces
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
    split="power in the first band over that in the second, smoothed as fade is [dB]",
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
    angle="of the tracked arrival to the direction of the satellite [rad]",
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
    arrival.excess_m = arrival.rate_mps = arrival.phase_rad = arrival.angle_rad = 0.0
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

    It comes from the mirrored direction ``e - 2 (e.n) n``, at the angle ``2 asin(e.n)`` to e. The normal is turned to
    the side of the antenna, which is ``d`` in front of the face.
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
    arrival.angle_rad = 2.0 * math.asin(min(cosine, 1.0))
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
        last.phase_rad, last.rate_mps, last.angle_rad = 0.0, 0.0, UNKNOWN_ANGLE_RAD
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


@jit(inline=True)
def _decibel(amplitude):  # type: ignore[no-untyped-def]
    return 20.0 * math.log10(max(amplitude, 1e-6)) if amplitude != 1.0 else 0.0


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
        new = old == NOTHING
        if b == 0:
            rate = sum_.rate_mps
            fade = _decibel(sum_.amplitude)
            memory.fade += (1.0 if new else rules.fade_gain) * (fade - memory.fade)
            memory.power += (1.0 if new else rules.lock_gain) * (sum_.amplitude * sum_.amplitude - memory.power)
        else:
            memory.split += (1.0 if new else rules.fade_gain) * (fade - _decibel(sum_.amplitude) - memory.split)
    return broken, r, rate, fade
