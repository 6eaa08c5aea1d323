"""Signals of one receiver at one epoch: who is tracked, how strongly, and with which errors.

``cfg`` (NC,) holds the figures of :class:`~lanebound.integrity.sensors.gnss.GnssConfig`; ``z`` (S, N_NORMAL) standard
normal and ``u`` (S, N_UNIFORM) uniform draws of this epoch; ``memory`` (S, NM) what lasts from epoch to epoch;
``area`` (S, N_SLOW) what all receivers of an area have in common, and ``station`` (S, N_STATION) what the station's
message that the receiver holds brings of the station's own errors, both of unit variance (:mod:`.area` makes them).
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

# figures
(
    DT, BANDS, CN0_ZENITH, CN0_HORIZON, CN0_SIGMA, CN0_DECAY, CN0_GAIN, FOLIAGE_LOSS, REFLECTION_LOSS,
    TRACK_MIN, PHASE_MIN, CODE_DELAY, PHASE_DELAY, CODE_SIGMA, PHASE_SIGMA, RATE_SIGMA, RATE_DECAY, RATE_GAIN,
    CODE_MULTIPATH, PHASE_MULTIPATH, MULTIPATH_DECAY, MULTIPATH_PER_M, NLOS_SCALE, IONO_SIGMA, AGE_RATE, TROPO_SIGMA,
    ORBIT_SIGMA, SLIP_RATE, SLIP_CN0, SLIP_DECADE, SLIP_MOST, UNANNOUNCED, HALF_SHARE, HALF_RESOLVE,
    STATION_CODE, STATION_PHASE, STATION_CODE_MP, STATION_PHASE_MP, CLOCK_11, CLOCK_21, CLOCK_22,
) = range(41)  # fmt: skip
NC = 41

# draws
Z_CN0, Z_CODE0, Z_CODE1, Z_PHASE0, Z_PHASE1, Z_CODE_MP, Z_PHASE_MP0, Z_PHASE_MP1, Z_RATE, Z_EXCESS = range(10)
N_NORMAL = 10
U_SLIP, U_KIND = range(2)
N_UNIFORM = 2

# memory: AR(1) states of unit variance, time with the code, with the carrier and with a half cycle in doubt
M_CN0, M_CODE_MP, M_PHASE_MP0, M_PHASE_MP1, M_RATE, M_EXCESS, M_CODE_S, M_PHASE_S, M_HALF_S = range(9)
N_INITIAL = 6  # columns that start from a draw
NM = 9

# area: AR(1) states that last for minutes, of the atmosphere, the satellite's clock and the station's multipath
A_IONO, A_AGE, A_TROPO, A_CODE_MP, A_PHASE_MP0, A_PHASE_MP1 = range(6)
N_SLOW = 6

# station: its multipath when it measured, in the area's order, and its noise
S_CODE_MP, S_PHASE_MP0, S_PHASE_MP1, S_CODE0, S_CODE1, S_PHASE0, S_PHASE1 = range(7)
N_NOISE = 4  # columns that are new with each message
N_STATION = 7

LN10 = math.log(10.0)

LOS, FOLIAGE, REFLECTED, BLOCKED = 0, 1, 2, 3  # values of visibility.Path

# Code error of a consumer receiver in a city given its C/N0: N(0, CORE^2) plus, with probability p, a Weibull excess.
# Fitted to medians, robust sigmas, quantiles and shares above 15 m of 15,780 pseudoranges of a single-frequency u-blox
# at Berlin, Potsdamer Platz (smartLoc data set, TU Chemnitz), in six C/N0 bins; d = C/N0 - 35 dB-Hz.
URBAN_CORE_M, URBAN_OFFSET_M = 3.161, -0.193
URBAN_P_CENTRE, URBAN_P_SCALE = 40.51, 2.663
URBAN_SIZE, URBAN_SIZE_SLOPE, URBAN_SIZE_CURVE = 3.6588, 0.07552, -0.0012285
URBAN_SHAPE, URBAN_SHAPE_SLOPE = 0.25544, 0.042607


@jit
def urban_share(cn0):  # type: ignore[no-untyped-def]
    """Probability that a code at ``cn0`` [dB-Hz] carries an excess delay."""
    return 1.0 / (1.0 + math.exp((cn0 - URBAN_P_CENTRE) / URBAN_P_SCALE))


@jit
def urban_excess(cn0, z):  # type: ignore[no-untyped-def]
    """Excess delay [m] at ``cn0`` [dB-Hz] for a standard normal ``z`` (Gaussian copula): 0 or a Weibull quantile."""
    if (z < 0.0 and cn0 > URBAN_P_CENTRE) or (z < 1.0 and cn0 > URBAN_P_CENTRE + 1.7 * URBAN_P_SCALE):
        return 0.0  # the tail, above 0.5 or 0.158, exceeds the share: saves the special functions
    share = urban_share(cn0)
    tail = 0.5 * math.erfc(z / math.sqrt(2.0))  # probability above z
    if tail >= share:
        return 0.0
    d = cn0 - 35.0
    low = max(-d, 0.0)
    size = math.exp(URBAN_SIZE - URBAN_SIZE_SLOPE * d + URBAN_SIZE_CURVE * low * low)
    shape = math.exp(URBAN_SHAPE - URBAN_SHAPE_SLOPE * d)
    return size * (-math.log(max(tail / share, 1e-12))) ** (1.0 / shape)


@jit
def urban_code_error(cn0, z_core, z_excess):  # type: ignore[no-untyped-def]
    """Code error [m] of a consumer receiver in a city at ``cn0`` [dB-Hz] from two standard normals."""
    return URBAN_OFFSET_M + URBAN_CORE_M * z_core + urban_excess(cn0, z_excess)


@jit
def ar1(memory, s, m, decay, gain, z):  # type: ignore[no-untyped-def]
    """Advance state m of satellite s, a Gauss-Markov process of unit variance: ``gain = sqrt(1 - decay^2)``."""
    memory[s, m] = decay * memory[s, m] + gain * z


@jit
def advance(cfg, s, decay, gain, z, memory):  # type: ignore[no-untyped-def]
    """Advance what lasts in the signal of satellite s; ``decay`` and ``gain`` are those of multipath."""
    ar1(memory, s, M_CN0, cfg[CN0_DECAY], cfg[CN0_GAIN], z[s, Z_CN0])
    ar1(memory, s, M_RATE, cfg[RATE_DECAY], cfg[RATE_GAIN], z[s, Z_RATE])
    ar1(memory, s, M_CODE_MP, decay, gain, z[s, Z_CODE_MP])
    ar1(memory, s, M_PHASE_MP0, decay, gain, z[s, Z_PHASE_MP0])
    ar1(memory, s, M_PHASE_MP1, decay, gain, z[s, Z_PHASE_MP1])
    ar1(memory, s, M_EXCESS, decay, gain, z[s, Z_EXCESS])


@jit
def carrier_to_noise(cfg, sine, path, drop, fluctuation):  # type: ignore[no-untyped-def]
    """C/N0 [dB-Hz]: antenna pattern over elevation, losses of foliage and reflection, slow fading."""
    cn0 = cfg[CN0_HORIZON] + (cfg[CN0_ZENITH] - cfg[CN0_HORIZON]) * sine - drop
    if path == FOLIAGE:
        cn0 -= cfg[FOLIAGE_LOSS] + 2.0 * fluctuation
    if path == REFLECTED:
        cn0 -= cfg[REFLECTION_LOSS] + 2.0 * fluctuation
    return cn0 + cfg[CN0_SIGMA] * fluctuation


@jit
def digits(u, place):  # type: ignore[no-untyped-def]
    """A further uniform draw out of the lower digits of another one."""
    return (u * place) % 1.0


@jit
def slip(cfg, kind, s, ambiguity):  # type: ignore[no-untyped-def]
    """Let the carrier slip by one half or by 1 to 4 whole cycles, on one or both bands; whether that is noticed."""
    size = math.floor(8.0 * digits(kind, 1e6)) - 4.0
    half_cycles = 1.0 if kind < cfg[HALF_SHARE] else 2.0 * (size if size < 0.0 else size + 1.0)
    ambiguity[s, 0] += half_cycles
    if digits(kind, 1e2) > 0.5:
        ambiguity[s, 1] += half_cycles
    return digits(kind, 1e4) >= cfg[UNANNOUNCED]


@jit
def whole(half_cycles):  # type: ignore[no-untyped-def]
    """The next even number of half cycles at or below."""
    return 2.0 * math.floor(0.5 * half_cycles)


@jit
def settle_half_cycle(cfg, s, memory, ambiguity):  # type: ignore[no-untyped-def]
    """Count how long a half cycle is in doubt; once the data have shown their sign, correct it and return True."""
    if whole(ambiguity[s, 0]) == ambiguity[s, 0] and whole(ambiguity[s, 1]) == ambiguity[s, 1]:
        memory[s, M_HALF_S] = 0.0
        return False
    memory[s, M_HALF_S] += cfg[DT]
    if memory[s, M_HALF_S] <= cfg[HALF_RESOLVE]:
        return False
    memory[s, M_HALF_S] = 0.0
    for b in range(2):
        ambiguity[s, b] = whole(ambiguity[s, b])
    return True


@jit
def weakness(cfg, level):  # type: ignore[no-untyped-def]
    """Rate of slips at ``level`` [dB-Hz] against that at the reference C/N0."""
    return math.exp(LN10 * (cfg[SLIP_CN0] - level) / cfg[SLIP_DECADE])


@jit
def follow(cfg, s, level, path, slips, u, memory, ambiguity, lock_lost):  # type: ignore[no-untyped-def]
    """Advance the tracking of satellite s; whether its (code, carrier) are followed now.

    A carrier that comes back brings new integers, and the receiver knows; so it does when it corrects a half cycle. A
    weak signal slips more often.
    """
    received = path != BLOCKED and level >= cfg[TRACK_MIN]
    locked = received and path != REFLECTED and level >= cfg[PHASE_MIN]
    had_phase = memory[s, M_PHASE_S] >= cfg[PHASE_DELAY]
    memory[s, M_CODE_S] = memory[s, M_CODE_S] + cfg[DT] if received else 0.0
    memory[s, M_PHASE_S] = memory[s, M_PHASE_S] + cfg[DT] if locked else 0.0
    has_phase = memory[s, M_PHASE_S] >= cfg[PHASE_DELAY]
    kind = u[s, U_KIND]
    for b in range(2):
        ambiguity[s, b] += 2.0 * slips[s, b]
    if has_phase and not had_phase:
        lock_lost[s] = True
        ambiguity[s, 0] = whole(ambiguity[s, 0]) + 2.0 * math.floor(2000.0 * digits(kind, 1e6) - 1000.0)
        ambiguity[s, 1] = whole(ambiguity[s, 1]) + 2.0 * math.floor(2000.0 * digits(kind, 1e3) - 1000.0)
    elif has_phase:
        chance = cfg[DT] * cfg[SLIP_RATE]
        if u[s, U_SLIP] < cfg[SLIP_MOST] and u[s, U_SLIP] < chance * weakness(cfg, level):
            lock_lost[s] = slip(cfg, kind, s, ambiguity)
        if settle_half_cycle(cfg, s, memory, ambiguity):
            lock_lost[s] = True
    return memory[s, M_CODE_S] >= cfg[CODE_DELAY], has_phase


@jit
def advance_clock(cfg, z, oscillator):  # type: ignore[no-untyped-def]
    """Advance a clock of two states, offset [m] and drift [m/s], by an epoch with two standard normals."""
    oscillator[0] += cfg[DT] * oscillator[1] + cfg[CLOCK_11] * z[0]
    oscillator[1] += cfg[CLOCK_21] * z[0] + cfg[CLOCK_22] * z[1]


@jit
def noise_power(slant, level):  # type: ignore[no-untyped-def]
    """Noise variance against that of a strong signal at the zenith, and what elevation alone makes of it.

    ``slant`` is 1 / sin elevation, ``level`` the C/N0 [dB-Hz].
    """
    clear = 0.5 * (1.0 + slant * slant)
    return clear * (1.0 + math.exp(LN10 * 0.1 * (35.0 - level))), clear


@jit
def own_part(sigma, station, power, clear):  # type: ignore[no-untyped-def]
    """The receiver's part of a single difference of ``sigma``, whose other part is the station's, in the clear."""
    return math.sqrt(sigma * sigma * power - station * station * clear)


@jit
def common_delay(cfg, s, slant, age, area):  # type: ignore[no-untyped-def]
    """What delays code and carrier of all bands alike [m]: ageing corrections, troposphere and orbit."""
    mapped = cfg[TROPO_SIGMA] * slant
    delay = math.sqrt(mapped * mapped + cfg[ORBIT_SIGMA] * cfg[ORBIT_SIGMA])
    return cfg[AGE_RATE] * age * area[s, A_AGE] + delay * area[s, A_TROPO]


@jit
def fill_bands(  # type: ignore[no-untyped-def]
    cfg, wavelength, dispersion, s, c, common, power, clear, code_error, phase_error, has_phase, clock, z, area,
    station, memory, ambiguity, code, phase,
):  # fmt: skip
    """Code and phase of satellite s of system c: what is common to all, and what each band adds."""
    iono, root = cfg[IONO_SIGMA] * area[s, A_IONO], math.sqrt(clear)
    code_error -= cfg[STATION_CODE_MP] * root * station[s, S_CODE_MP]
    own_code = own_part(cfg[CODE_SIGMA], cfg[STATION_CODE], power, clear)
    own_phase = own_part(cfg[PHASE_SIGMA], cfg[STATION_PHASE], power, clear)
    own_multipath = own_part(cfg[PHASE_MULTIPATH], cfg[STATION_PHASE_MP], power, clear)
    for b in range(int(cfg[BANDS])):
        delay = iono * dispersion[c, b]
        noise = own_code * z[s, Z_CODE0 + b] - cfg[STATION_CODE] * root * station[s, S_CODE0 + b]
        code[s, b] = common + clock[c, b] + delay + code_error + noise
        if has_phase:
            noise = own_phase * z[s, Z_PHASE0 + b] + own_multipath * memory[s, M_PHASE_MP0 + b]
            theirs = cfg[STATION_PHASE] * station[s, S_PHASE0 + b] + cfg[STATION_PHASE_MP] * station[s, S_PHASE_MP0 + b]
            whole = 0.5 * wavelength[c, b] * ambiguity[s, b]
            phase[s, b] = common + clock[c, 2 + b] - delay + phase_error + whole + noise - root * theirs


@jit
def observe_vehicle(  # type: ignore[no-untyped-def]
    cfg, wavelength, dispersion, e, above, system, path, excess, position, velocity, reference, age,
    code_bias, phase_bias, rate_bias, cn0_drop, slips, clock, z_clock, station_clock, z, u, area, station, oscillator,
    memory, ambiguity, tracked, code, phase, range_rate, cn0, lock_lost,
):  # fmt: skip
    """Fill the outputs of one vehicle, zeros before: tracked (S,), code, phase (S, 2), range_rate, cn0, lock_lost (S,).

    position (3,) is what the signals describe, ``reference`` (3,) the error of the reference coordinates; clock
    (systems, 4) holds the delays of code and phase of both bands, ``oscillator`` (2,) and ``station_clock`` (2,) offset
    and drift of the two clocks. ``ambiguity`` (S, 2) in half cycles is advanced by slips in place. Untracked entries
    stay 0.
    """
    used_age = age if age < 1e6 else 0.0
    speed = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    decay = cfg[MULTIPATH_DECAY] * math.exp(-cfg[DT] * speed * cfg[MULTIPATH_PER_M])
    gain = math.sqrt(1.0 - decay * decay)
    advance_clock(cfg, z_clock, oscillator)
    offset = oscillator[0] - station_clock[0]
    x, y, h = position[0] + reference[0], position[1] + reference[1], position[2] + reference[2]
    for s in range(e.shape[0]):
        if not above[s]:
            memory[s, M_CODE_S], memory[s, M_PHASE_S] = 0.0, 0.0
            continue
        advance(cfg, s, decay, gain, z, memory)
        slant, drop = 1.0 / e[s, 2], cn0_drop[s]
        level = carrier_to_noise(cfg, e[s, 2], path[s], drop, memory[s, M_CN0])
        has_code, has_phase = follow(cfg, s, level, path[s], slips, u, memory, ambiguity, lock_lost)
        if not has_code:
            continue
        tracked[s], cn0[s] = True, level
        power, clear = noise_power(slant, level)
        # jamming weakens a signal but sends it on no detour
        late = (
            excess[s] if path[s] == REFLECTED and excess[s] > 0.0 else urban_excess(level + drop, memory[s, M_EXCESS])
        )
        multipath = own_part(cfg[CODE_MULTIPATH], cfg[STATION_CODE_MP], power, clear) * memory[s, M_CODE_MP]
        code_error = multipath + cfg[NLOS_SCALE] * late + code_bias[s]
        common = common_delay(cfg, s, slant, used_age, area) - (e[s, 0] * x + e[s, 1] * y + e[s, 2] * h) + offset
        fill_bands(
            cfg, wavelength, dispersion, s, system[s], common, power, clear, code_error, phase_bias[s], has_phase,
            clock, z, area, station, memory, ambiguity, code, phase,
        )  # fmt: skip
        motion = e[s, 0] * velocity[0] + e[s, 1] * velocity[1] + e[s, 2] * velocity[2]
        range_rate[s] = oscillator[1] - motion + rate_bias[s] + cfg[RATE_SIGMA] * math.sqrt(power) * memory[s, M_RATE]


@jit
def observe_serial(  # type: ignore[no-untyped-def]
    cfg, wavelength, dispersion, los, above, system, index, path, excess, position, velocity, reference, age,
    code_bias, phase_bias, rate_bias, cn0_drop, slips, clock, z_clock, station_clock, z, u, area, station, oscillator,
    memory, ambiguity, tracked, code, phase, range_rate, cn0, lock_lost,
):  # fmt: skip
    """:func:`observe_vehicle` for B vehicles, one after another, in one area or each in its own."""
    areas = area.shape[0]
    for v in range(index.shape[0]):
        k, a = index[v], v % areas
        observe_vehicle(
            cfg, wavelength, dispersion, los[k], above[k], system, path[v], excess[v], position[v], velocity[v],
            reference[v], age[v], code_bias[v], phase_bias[v], rate_bias[v], cn0_drop[v], slips[v], clock[v],
            z_clock[v], station_clock[a], z[v], u[v], area[a], station[v], oscillator[v], memory[v], ambiguity[v],
            tracked[v], code[v], phase[v], range_rate[v], cn0[v], lock_lost[v],
        )  # fmt: skip
