"""Signals of receivers over one epoch: which satellites are tracked, how strongly, and with which errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sensors.arrival_kernel import (
    BANDS,
    DIRECT,
    MULTIPATH,
    NOTHING,
    PATH_RULES,
    TRACKED,
    WORK,
    SignalGeometry,
    find_arrivals,
    track,
)
from lanebound.integrity.sensors.near_objects_kernel import NEAR, NEAR_RULES, advance_near
from lanebound.integrity.sky.mask_kernel import BLOCKED, LOS, REFLECTED
from lanebound.integrity.sky.systems_kernel import N_SYSTEMS

__all__ = [
    "BANDS",
    "GNSS_RULES",
    "NORMALS",
    "RECEIVER",
    "SIGNAL",
    "SITE",
    "SLOW",
    "STATION",
    "STATION_NOISE",
    "UNIFORMS",
    "Effects",
    "Receiver",
    "ReceiverDraws",
    "Sensed",
    "observe",
    "observe_vehicle",
]

GNSS_RULES = record(
    dt="length of an epoch [s]",
    bands=("i8", "number of bands"),
    cn0_zenith="C/N0 at the zenith [dB-Hz]",
    cn0_horizon="C/N0 at the horizon [dB-Hz]",
    cn0_sigma="fading, 1 sigma [dB]",
    cn0_decay="its decay over an epoch [-]",
    cn0_gain="its gain on a new draw [-]",
    track_min="lowest C/N0 of code tracking [dB-Hz]",
    least_snr="lowest T C/N0 of carrier tracking, T of a coherent interval [-]",
    lock_intervals="coherent intervals in its window [-]",
    code_delay="time to reacquire the code [s]",
    phase_delay="time to reacquire the carrier [s]",
    code_sigma="code noise, zenith [m]",
    phase_sigma="phase noise, zenith [m]",
    rate_sigma="range-rate error, zenith [m/s]",
    rate_decay="its decay over an epoch [-]",
    rate_gain="its gain on a new draw [-]",
    code_multipath="zenith, 1 sigma [m]",
    phase_multipath="zenith, 1 sigma [m]",
    multipath_decay="decay of multipath over an epoch at rest [-]",
    multipath_per_m="faster decay by the speed [1/m]",
    iono_sigma="differential ionosphere, 1 sigma [m]",
    age_rate="growth of a satellite's error with the age of corrections [m/s]",
    tropo_sigma="differential troposphere, zenith, 1 sigma [m]",
    orbit_sigma="differential orbit error [m]",
    slip_rate="cycle slips at the reference C/N0 [1/s]",
    slip_cn0="the reference C/N0 [dB-Hz]",
    slip_decade="loss that makes slips ten times as frequent [dB]",
    unannounced="share of slips that the receiver does not notice [-]",
    half_share="share of half-cycle slips [-]",
    half_resolve="time until a half cycle is corrected [s]",
    station_code="the station's part of code_sigma [m]",
    station_phase="the station's part of phase_sigma [m]",
    station_code_multipath="the station's part of code_multipath [m]",
    station_phase_multipath="the station's part of phase_multipath [m]",
    clock_11="gains of the receiver's clock on two draws: offset [m]",
    clock_21="drift on the first [m/s]",
    clock_22="drift on the second [m/s]",
    wavelength=("f8", (N_SYSTEMS, BANDS), "of the bands tracked [m]"),
    dispersion=("f8", (N_SYSTEMS, BANDS), "ionospheric delay, first band = 1 [-]"),
    chip=("f8", (N_SYSTEMS, BANDS), "length of a chip [m]"),
    paths=(PATH_RULES, "figures of propagation and loops"),
    near=(NEAR_RULES, "figures of near objects"),
    detects=("i8", "how reflected signals are detected: NEVER, BY_RATES, BY_ANGLE, BY_SPLIT or BY_JUMP"),
    excludes=("?", "whether the receiver leaves out what it flags"),
    finds="probability that a reflected signal is flagged [-]",
    mistakes="probability that a direct one is [-]",
    detector_sigma="error of the angle [rad], of the C/N0 [dB] or, at the zenith, of the delay [m] tested, 1 sigma",
    detector_limit="threshold of a test, over the deviation of its statistic [-]",
    renews="probability that a verdict is drawn anew in an epoch [-]",
)
"""Figures of :class:`~lanebound.integrity.sensors.gnss.GnssConfig`."""

SIGNAL = record(
    cn0="fading, Gauss-Markov of unit variance [-]",
    code_multipath="the same of code multipath [-]",
    phase_multipath=("f8", (BANDS,), "the same of phase multipath, by band [-]"),
    rate="the same of the range-rate error [-]",
    code_s="time since the code is received [s]",
    phase_s="time since the carrier is received [s]",
    half_cycle_s="time for which a half cycle is in doubt [s]",
    ambiguity=("f8", (BANDS,), "half cycles, by band"),
    tracked=(TRACKED, "the arrival that is tracked"),
    near=(NEAR, "multipath of near objects"),
    reflected=("?", "the tracked arrival was a reflection when the detector last judged"),
    flagged=("?", "its verdict"),
    code_m="code of the first band at the last epoch [m]",
    late_m="how late the code is by its jumps [m]",
    e=("f8", (3,), "unit vector to the satellite at the last epoch"),
)
"""What lasts of a satellite's signal from epoch to epoch."""

RECEIVER = record(
    offset="of the clock [m]",
    drift="of the clock [m/s]",
    code_delay=("f8", (N_SYSTEMS, BANDS), "delay of codes, by system and band [m]"),
    phase_delay=("f8", (N_SYSTEMS, BANDS), "delay of phases [m]"),
)
"""What lasts of a receiver from epoch to epoch."""

NORMALS = record(
    cn0="[-]",
    code=("f8", (BANDS,), "noise of codes [-]"),
    phase=("f8", (BANDS,), "noise of phases [-]"),
    code_multipath="[-]",
    phase_multipath=("f8", (BANDS,), "[-]"),
    rate="[-]",
    lock="noise of the lock detector [-]",
)
"""Standard normal draws of a satellite and epoch."""

UNIFORMS = record(slip="whether the carrier slips [-]", kind="how it slips [-]")
"""Uniform draws of a satellite and epoch."""

SLOW = record(
    iono="ionosphere",
    age="rate of the satellite's error",
    tropo="troposphere and orbit",
    code_multipath="code multipath of the station",
    phase_multipath=("f8", (BANDS,), "phase multipath of the station, by band"),
)
"""Processes of unit variance that last for minutes, of a satellite in an area."""

SITE = record(
    offset="of its clock [m]",
    drift="of its clock [m/s]",
    reference=("f8", (3,), "error of its coordinates, ENU [m]"),
)
"""The reference station of an area."""

STATION = record(
    code_multipath="code multipath when the station measured",
    phase_multipath=("f8", (BANDS,), "phase multipath, by band"),
    code=("f8", (BANDS,), "noise of codes"),
    phase=("f8", (BANDS,), "noise of phases"),
)
"""The station's own errors in a message, of unit variance, of a satellite."""

STATION_NOISE = record(code=("f8", (BANDS,), "[-]"), phase=("f8", (BANDS,), "[-]"))
"""Standard normal draws of a satellite in a message."""

NEVER, BY_RATES, BY_ANGLE, BY_SPLIT, BY_JUMP = 0, 1, 2, 3, 4  # how reflected signals are detected
LATE_FORGET_S = 10.0  # in which codes average what a jump is compared with; chosen, three times multipath_tau_s
LN10 = math.log(10.0)
COHERENT_S = 0.02  # of a correlation: a bit of the GPS L1 C/A message


class ReceiverDraws(NamedTuple):
    """Draws of an epoch: normals (..., S) of NORMALS, uniforms of UNIFORMS, near of NEAR, clock (..., 2)."""

    normals: Records
    uniforms: Records
    near: Records
    clock: NDArray[np.float64]


class Receiver(NamedTuple):
    """What lasts of receivers (...): clock of RECEIVER; signals (..., S) of SIGNAL; held (..., S) of STATION, the
    message held."""

    clock: Records
    signals: Records
    held: Records


class Effects(NamedTuple):
    """Effects of faults: signals (..., S) of SIGNAL_EFFECTS, vehicles (...) of VEHICLE_EFFECTS."""

    signals: Records
    vehicles: Records


class Sensed(NamedTuple):
    """What vehicles (...) measure: signals (..., S) of OBSERVED_SIGNAL, vehicles of OBSERVED_VEHICLE."""

    signals: Records
    vehicles: Records


class _Path(NamedTuple):
    """What all bands have in common [m]; power and clear of :func:`noise_power`."""

    common: float
    code_error: float
    phase_error: float
    power: float
    clear: float


@jit(inline=True)
def gauss_markov(value, decay, gain, z):  # type: ignore[no-untyped-def]
    """The next value of a Gauss-Markov process of unit variance: ``gain = sqrt(1 - decay^2)``."""
    return decay * value + gain * z


@jit
def advance(rules, decay, gain, z, signal):  # type: ignore[no-untyped-def]
    """Advance what lasts in a signal by the draws ``z`` (NORMALS); ``decay`` and ``gain`` are those of multipath."""
    signal.cn0 = gauss_markov(signal.cn0, rules.cn0_decay, rules.cn0_gain, z.cn0)
    signal.rate = gauss_markov(signal.rate, rules.rate_decay, rules.rate_gain, z.rate)
    signal.code_multipath = gauss_markov(signal.code_multipath, decay, gain, z.code_multipath)
    for b in range(BANDS):
        signal.phase_multipath[b] = gauss_markov(signal.phase_multipath[b], decay, gain, z.phase_multipath[b])


@jit
def open_level(rules, sine, drop, fluctuation):  # type: ignore[no-untyped-def]
    """C/N0 of an unobstructed signal [dB-Hz]: antenna pattern over elevation, slow fading, ``drop`` by jamming [dB]."""
    return rules.cn0_horizon + (rules.cn0_zenith - rules.cn0_horizon) * sine - drop + rules.cn0_sigma * fluctuation


@jit
def sees_lock(rules, level, noise, tracked):  # type: ignore[no-untyped-def]
    """Whether the lock detector finds a carrier above ``least_snr``; ``level`` of the unobstructed signal [dB-Hz].

    It estimates the power in a window of K coherent intervals T. With ``s = T C/N0`` and complex noise of variance 1,
    a correlation has the power ``abs(sqrt(s) + n)^2``, of mean s + 1 and variance 1 + 2 s.
    """
    snr = COHERENT_S * math.exp(LN10 * 0.1 * level) * tracked.power
    estimate = snr + math.sqrt((1.0 + 2.0 * snr) / rules.lock_intervals) * noise
    return estimate >= rules.least_snr


@jit
def digits(u, place):  # type: ignore[no-untyped-def]
    """A further uniform draw out of the lower digits of another one."""
    return (u * place) % 1.0


@jit
def slip(rules, kind, signal):  # type: ignore[no-untyped-def]
    """Let the carrier slip by one half or by 1 to 4 whole cycles, on one or both bands; whether that is noticed."""
    size = math.floor(8.0 * digits(kind, 1e6)) - 4.0
    half_cycles = 1.0 if kind < rules.half_share else 2.0 * (size if size < 0.0 else size + 1.0)
    signal.ambiguity[0] += half_cycles
    if digits(kind, 1e2) > 0.5:
        signal.ambiguity[1] += half_cycles
    return digits(kind, 1e4) >= rules.unannounced


@jit
def whole(half_cycles):  # type: ignore[no-untyped-def]
    """The next even number of half cycles at or below."""
    return 2.0 * math.floor(0.5 * half_cycles)


@jit
def settle_half_cycle(rules, signal):  # type: ignore[no-untyped-def]
    """Count how long a half cycle is in doubt; once the data have shown their sign, correct it and return True."""
    if whole(signal.ambiguity[0]) == signal.ambiguity[0] and whole(signal.ambiguity[1]) == signal.ambiguity[1]:
        signal.half_cycle_s = 0.0
        return False
    signal.half_cycle_s += rules.dt
    if signal.half_cycle_s <= rules.half_resolve:
        return False
    signal.half_cycle_s = 0.0
    for b in range(BANDS):
        signal.ambiguity[b] = whole(signal.ambiguity[b])
    return True


@jit(inline=True)
def _exceeds(shift, limit):  # type: ignore[no-untyped-def]
    """Probability ``P(abs(N(shift, 1)) > limit)``."""
    return 0.5 * (math.erfc((limit - shift) / math.sqrt(2.0)) + math.erfc((limit + shift) / math.sqrt(2.0)))


@jit
def judge(rules, reflected, angle, u, signal):  # type: ignore[no-untyped-def]
    """The verdict of the detector on a signal; it lasts until the path changes or, by chance, it is judged anew.

    ``angle``: of the tracked arrival to the direction of the satellite [rad]. Tests of the angle and of the difference
    of C/N0 between two bands have normal errors, so that their power follows from the size. A signal that the receiver
    has just found is judged too. ``u`` are UNIFORMS, of which lower digits are used, so that a detector changes no
    other draw.
    """
    new = signal.code_s <= rules.dt
    if new or reflected != signal.reflected or digits(u.kind, 1e8) < rules.renews:
        chance = rules.finds if reflected else rules.mistakes
        if rules.detects == BY_ANGLE:
            chance = _exceeds(angle / rules.detector_sigma, rules.detector_limit)
        elif rules.detects == BY_SPLIT:
            chance = _exceeds(abs(signal.tracked.split) / rules.detector_sigma, rules.detector_limit)
        signal.reflected = reflected
        signal.flagged = digits(u.slip, 1e8) < chance
    return signal.flagged


@jit
def comes_late(rules, power, position, signal, out):  # type: ignore[no-untyped-def]
    """Whether the code has become later than its Doppler says, as where a reflection takes the place of the direct ray.

    Tested is the sum of ``code_k - code_(k-1) - dt range_rate + (e_k - e_(k-1)).x``, a code less what the range rates
    add up to, against its mean over some LATE_FORGET_S. The last term is what the satellite's motion adds; it takes a
    position within 100 m, for it turns by 1e-4 rad/s. A code that comes earlier is believed at once: reflections only
    delay it. Signals that begin late are not found, and a delay J is found for ``LATE_FORGET_S ln(J / limit)``.
    """
    e, x = out.e, position
    limit = rules.detector_limit * rules.detector_sigma * math.sqrt(power)
    if signal.code_s - rules.dt < rules.code_delay:
        signal.late_m = 0.0
    else:
        turned = (e[0] - signal.e[0]) * x[0] + (e[1] - signal.e[1]) * x[1] + (e[2] - signal.e[2]) * x[2]
        signal.late_m *= 1.0 - rules.dt / LATE_FORGET_S
        signal.late_m += out.code[0] - signal.code_m - rules.dt * out.range_rate + turned
        if signal.late_m < -limit:
            signal.late_m = 0.0
    signal.code_m = out.code[0]
    for k in range(3):
        signal.e[k] = e[k]
    return signal.late_m > limit


@jit
def weakness(rules, level):  # type: ignore[no-untyped-def]
    """Rate of slips at ``level`` [dB-Hz] against that at the reference C/N0."""
    return math.exp(LN10 * (rules.slip_cn0 - level) / rules.slip_decade)


@jit
def follow(rules, level, received, locked, u, signal):  # type: ignore[no-untyped-def]
    """Advance the tracking of a signal; whether code and carrier are followed now, and whether a lock was lost.

    ``level`` is the present C/N0 [dB-Hz], ``received``: the code is received, ``locked``: the receiver sees lock.
    A carrier that comes back brings new integers, and the receiver knows; so it does when it corrects a half cycle. A
    weak signal slips more often. ``u`` are UNIFORMS.
    """
    had_phase = signal.phase_s >= rules.phase_delay
    signal.code_s = signal.code_s + rules.dt if received else 0.0
    signal.phase_s = signal.phase_s + rules.dt if locked else 0.0
    has_phase, lost = locked and signal.phase_s >= rules.phase_delay, False
    if has_phase and not had_phase:
        lost = True
        signal.ambiguity[0] = whole(signal.ambiguity[0]) + 2.0 * math.floor(2000.0 * digits(u.kind, 1e6) - 1000.0)
        signal.ambiguity[1] = whole(signal.ambiguity[1]) + 2.0 * math.floor(2000.0 * digits(u.kind, 1e3) - 1000.0)
    elif has_phase:
        reference = rules.dt * rules.slip_rate
        if level < rules.slip_cn0 or u.slip < reference:  # a stronger signal slips at most as often as at slip_cn0
            lost = u.slip < reference * weakness(rules, level) and slip(rules, u.kind, signal)
        if settle_half_cycle(rules, signal):
            lost = True
    return received and signal.code_s >= rules.code_delay, has_phase, lost


@jit
def advance_clock(rules, z, receiver):  # type: ignore[no-untyped-def]
    """Advance a clock of two states, offset [m] and drift [m/s], by an epoch with two standard normals."""
    receiver.offset += rules.dt * receiver.drift + rules.clock_11 * z[0]
    receiver.drift += rules.clock_21 * z[0] + rules.clock_22 * z[1]


@jit
def noise_power(slant, level):  # type: ignore[no-untyped-def]
    """Noise variance against that of a strong signal at the zenith, and what elevation alone makes of it.

    ``slant`` is 1 / sin elevation, ``level`` the C/N0 [dB-Hz].
    """
    clear = 0.5 * (1.0 + slant * slant)
    return clear * (1.0 + math.exp(LN10 * 0.1 * (35.0 - level))), clear


@jit
def own_part(sigma, station, power, clear):  # type: ignore[no-untyped-def]
    """1 sigma of the receiver alone, ``sqrt(sigma^2 power - station^2 clear)``, of a single difference's ``sigma``."""
    return math.sqrt(sigma * sigma * power - station * station * clear)


@jit
def common_delay(rules, slant, age, slow):  # type: ignore[no-untyped-def]
    """What delays code and carrier of all bands alike [m]: ageing corrections, troposphere and orbit."""
    mapped = rules.tropo_sigma * slant
    delay = math.sqrt(mapped * mapped + rules.orbit_sigma * rules.orbit_sigma)
    return rules.age_rate * age * slow.age + delay * slow.tropo


@jit(forceinline=True)  # calls cost a third of the time of a signal
def fill_bands(c, has_phase, path, rules, receiver, signal, z, slow, station, work, out):  # type: ignore[no-untyped-def]
    """Code and phase of a satellite of system c: what is common to all, and what each band adds."""
    iono, root = rules.iono_sigma * slow.iono, math.sqrt(path.clear)
    code_error = path.code_error - rules.station_code_multipath * root * station.code_multipath
    own_code = own_part(rules.code_sigma, rules.station_code, path.power, path.clear)
    own_phase = own_part(rules.phase_sigma, rules.station_phase, path.power, path.clear)
    own_multipath = own_part(rules.phase_multipath, rules.station_phase_multipath, path.power, path.clear)
    for b in range(rules.bands):
        delay = iono * rules.dispersion[c, b]
        noise = own_code * z.code[b] - rules.station_code * root * station.code[b]
        out.code[b] = path.common + receiver.code_delay[c, b] + delay + code_error + noise + work.code[b]
        if has_phase:
            noise = own_phase * z.phase[b] + own_multipath * signal.phase_multipath[b]
            theirs = rules.station_phase * station.phase[b] + rules.station_phase_multipath * station.phase_multipath[b]
            cycles = 0.5 * rules.wavelength[c, b] * signal.ambiguity[b]
            out.phase[b] = (
                path.common
                + receiver.phase_delay[c, b]
                - delay
                + path.phase_error
                + cycles
                + noise
                - root * theirs
                + work.carrier[b]
            )


@jit(forceinline=True)  # calls cost a third of the time of a signal
def by_paths(rules, reception, way, system, u, signal, work):  # type: ignore[no-untyped-def]
    """Reception by the paths of ray casting: (received, lock broken, range rate error [m/s], present power over that of
    the unobstructed signal [dB]); sets ``reception.path``.

    The errors by band are in ``work`` (WORK), the smoothed powers in the signal.
    """
    memory, wave = signal.tracked, rules.wavelength[system, 0]
    count, kind = find_arrivals(rules.paths, reception, way, signal.cn0, wave, work.arrivals)
    if count == 0:
        memory.arrival = NOTHING
        for b in range(BANDS):
            work.code[b] = work.carrier[b] = 0.0
        reception.path = BLOCKED
        return False, False, 0.0, 0.0
    broken, strongest, rate, fade = track(
        rules.paths, rules.wavelength[system], rules.chip[system], rules.bands, reception.edge, digits(u.slip, 1e4),
        memory, count, work,
    )  # fmt: skip
    work.angle = work.arrivals[strongest].angle_rad
    if work.arrivals[strongest].source != DIRECT:
        reception.path = REFLECTED
    else:
        reception.path = MULTIPATH if count > 1 and kind == LOS else kind
    return True, broken, rate, fade


@jit(inline=True)
def _leave_out(out):  # type: ignore[no-untyped-def]
    out.tracked, out.cn0, out.range_rate = False, 0.0, 0.0
    for b in range(BANDS):
        out.code[b] = out.phase[b] = 0.0


@jit(borrows=True)
def observe_vehicle(rules, site, slows, own, draws, sky, reception, truth, of_faults, observed, work):  # type: ignore[no-untyped-def]
    """Advance the receiver of a vehicle and fill what it observes of S satellites.

    Entries of untracked signals are 0. Those tracked describe the position plus the spoofing.

    Parameters
    ----------
    rules, site, slows : GNSS_RULES; SITE and (S,) of SLOW of the area
    own, draws : Receiver, whose clock and signals advance by ReceiverDraws
    sky : SatelliteRows
    reception : (S,) of RECEPTION, how each signal arrives; its path becomes what is tracked
    truth : TRUTH of the antenna
    of_faults, observed : Effects; Sensed, whose signals are filled, and of whose vehicle sight and age are read
    work : WORK, scratch
    """
    receiver, memory, held = own
    effects, moved = of_faults
    signals, vehicle = observed
    los, above = sky.los[vehicle.sight], sky.above[vehicle.sight]
    used_age = vehicle.age if vehicle.age < 1e6 else 0.0
    vx, vy, vz = truth.velocity[0], truth.velocity[1], truth.velocity[2]
    antenna, velocity = (truth.position[0], truth.position[1], truth.position[2]), (vx, vy, vz)
    speed = math.sqrt(vx * vx + vy * vy)
    decay = rules.multipath_decay * math.exp(-rules.dt * speed * rules.multipath_per_m)
    gain = math.sqrt(1.0 - decay * decay)
    advance_clock(rules, draws.clock, receiver)
    offset = receiver.offset - site.offset
    spoof, reference, shift = moved.spoof_enu_m, site.reference, moved.reference_enu_m
    x = (truth.position[0] + spoof[0]) + (reference[0] + shift[0])
    y = (truth.position[1] + spoof[1]) + (reference[1] + shift[1])
    h = (truth.position[2] + spoof[2]) + (reference[2] + shift[2])
    for s in range(reception.shape[0]):
        signal, out, effect = memory[s], signals[s], effects[s]
        out.lock_lost = out.reflected = False
        _leave_out(out)
        for b in range(BANDS):
            out.integer_error[b] = effect.integer_error[b]
        for k in range(3):
            out.e[k] = los[s, k]
        if not above[s]:
            signal.code_s, signal.phase_s, signal.tracked.arrival = 0.0, 0.0, NOTHING
            continue
        z, slow, uniform, c = draws.normals[s], slows[s], draws.uniforms[s], sky.system[s]
        advance(rules, decay, gain, z, signal)
        e, n, u = los[s, 0], los[s, 1], los[s, 2]
        way = SignalGeometry((e, n, u), antenna, velocity)
        arrives, broken, late_rate, fade = by_paths(rules, reception[s], way, c, uniform, signal, work)
        clear_level = open_level(rules, u, effect.cn0_drop_db, signal.cn0)
        level = clear_level + signal.tracked.fade
        received = arrives and level >= rules.track_min
        locked = received and not broken and sees_lock(rules, clear_level, z.lock, signal.tracked)
        for b in range(BANDS):
            signal.ambiguity[b] += 2.0 * effect.slip_cycles[b]
        has_code, has_phase, lost = follow(rules, clear_level + fade, received, locked, uniform, signal)
        out.lock_lost = lost
        slant = 1.0 / u
        if rules.near.fitted:
            root = math.sqrt(0.5 * (1.0 + slant * slant))
            late_rate += advance_near(rules.near, speed, root, draws.near[s], signal.near, work)
        if arrives and rules.detects != NEVER and rules.detects != BY_JUMP:
            out.reflected = judge(rules, reception[s].path == REFLECTED, work.angle, uniform, signal)
        # A signal that the detector flags is left out, right or wrong: its code may be late by tens of metres.
        if not has_code or (out.reflected and rules.excludes):
            continue
        out.tracked, out.cn0 = True, level
        power, clear = noise_power(slant, level)
        multipath = own_part(rules.code_multipath, rules.station_code_multipath, power, clear) * signal.code_multipath
        common = common_delay(rules, slant, used_age, slow) - (e * x + n * y + u * h) + offset
        path = _Path(common, multipath + effect.code_bias_m, effect.phase_bias_m, power, clear)
        fill_bands(c, has_phase, path, rules, receiver, signal, z, slow, held[s], work, out)
        motion = e * vx + n * vy + u * vz
        rate_error = rules.rate_sigma * math.sqrt(power) * signal.rate
        out.range_rate = receiver.drift - motion + effect.range_rate_bias_mps + rate_error + late_rate
        if rules.detects == BY_JUMP:
            signal.flagged = out.reflected = comes_late(rules, power, truth.position, signal, out)
            if out.reflected and rules.excludes:
                _leave_out(out)


@jit
def observe(rules, sites, slows, receivers, draws, sky, reception, truths, effects, observed):  # type: ignore[no-untyped-def]
    """:func:`observe_vehicle` for B vehicles in A areas, A is 1 or B: a row for each, rules (1,)."""
    work = np.zeros(1, WORK)
    for v in range(truths.shape[0]):
        a = v % sites.shape[0]
        observe_vehicle(
            rules[0], sites[a], slows[a], Receiver(receivers.clock[v], receivers.signals[v], receivers.held[v]),
            ReceiverDraws(draws.normals[v], draws.uniforms[v], draws.near[v], draws.clock[v]), sky, reception[v],
            truths[v], Effects(effects.signals[v], effects.vehicles[v]),
            Sensed(observed.signals[v], observed.vehicles[v]), work[0],
        )  # fmt: skip
