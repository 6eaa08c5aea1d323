"""Signals of one receiver at one epoch: who is tracked, how strongly, and with which errors.

``cfg`` (NC,) holds the figures of :class:`~lanebound.integrity.sensors.gnss.GnssConfig`; ``z`` (S, N_NORMAL) standard
normal and ``u`` (S, N_UNIFORM) uniform draws of this epoch; ``memory`` (S, NM) what lasts from epoch to epoch.
"""

from __future__ import annotations

import math

from lanebound.integrity.accel import jit, prange

# figures
(
    DT, BANDS, CN0_ZENITH, CN0_HORIZON, CN0_SIGMA, CN0_TAU, FOLIAGE_LOSS, REFLECTION_LOSS,
    TRACK_MIN, PHASE_MIN, CODE_DELAY, PHASE_DELAY, CODE_SIGMA, PHASE_SIGMA, RATE_SIGMA, RATE_TAU,
    CODE_MULTIPATH, PHASE_MULTIPATH, MULTIPATH_TAU, NLOS_SCALE, IONO_SIGMA, IONO_TAU, AGE_RATE, AGE_TAU,
    SLIP_RATE, SLIP_CN0, SLIP_DECADE, UNANNOUNCED, HALF_SHARE,
) = range(29)  # fmt: skip
NC = 29

# draws
(
    Z_CN0, Z_CODE0, Z_CODE1, Z_PHASE0, Z_PHASE1, Z_CODE_MP, Z_PHASE_MP0, Z_PHASE_MP1, Z_RATE, Z_IONO, Z_AGE, Z_SLIP,
    Z_EXCESS,
) = range(13)  # fmt: skip
N_NORMAL = 13
U_SLIP, U_KIND = range(2)
N_UNIFORM = 2

# memory: AR(1) states of unit variance, time with the code and with the carrier
M_CN0, M_CODE_MP, M_PHASE_MP0, M_PHASE_MP1, M_RATE, M_IONO, M_AGE, M_EXCESS, M_CODE_S, M_PHASE_S = range(10)
NM = 10

LOS, FOLIAGE, REFLECTED, BLOCKED = 0, 1, 2, 3  # values of visibility.Path

# Code error of a consumer receiver in a city given its C/N0: N(0, CORE^2) plus, with probability p, a Weibull excess.
# Least-squares fit to medians, robust sigmas, quantiles and shares above 15 m of 15,780 pseudoranges of a single-frequency
# u-blox receiver at Berlin, Potsdamer Platz (smartLoc data set, TU Chemnitz), in six C/N0 bins; d = C/N0 - 35 dB-Hz.
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
def ar1(memory, s, m, tau, dt, z):  # type: ignore[no-untyped-def]
    """Advance state m of satellite s, a Gauss-Markov process of unit variance, by ``dt``; returns it."""
    rho = math.exp(-dt / tau)
    memory[s, m] = rho * memory[s, m] + math.sqrt(1.0 - rho * rho) * z
    return memory[s, m]


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
def observe_vehicle(  # type: ignore[no-untyped-def]
    cfg, wavelength, e, elevation, above, system, path, excess, position, velocity, reference, age,
    code_bias, phase_bias, rate_bias, cn0_drop, slips, clock, z, u, memory, ambiguity,
    tracked, code, phase, range_rate, cn0, lock_lost,
):  # fmt: skip
    """Fill the outputs of one vehicle: tracked (S,), code, phase (S, 2), range_rate, cn0, lock_lost (S,).

    position (3,) is what the signals describe, ``reference`` (3,) the error of the reference coordinates; clock (systems, 4)
    holds the code and phase clocks of both bands, its last entry (row 0, column 4) the drift. ``ambiguity`` (S, 2) in half
    cycles is advanced by slips in place. Untracked entries are 0.
    """
    dt = cfg[DT]
    bands = int(cfg[BANDS])
    used_age = age if age < 1e6 else 0.0
    for s in range(e.shape[0]):
        sine = math.sin(elevation[s])
        fading = ar1(memory, s, M_CN0, cfg[CN0_TAU], dt, z[s, Z_CN0])
        code_mp = ar1(memory, s, M_CODE_MP, cfg[MULTIPATH_TAU], dt, z[s, Z_CODE_MP])
        ar1(memory, s, M_PHASE_MP0, cfg[MULTIPATH_TAU], dt, z[s, Z_PHASE_MP0])
        ar1(memory, s, M_PHASE_MP1, cfg[MULTIPATH_TAU], dt, z[s, Z_PHASE_MP1])
        rate = ar1(memory, s, M_RATE, cfg[RATE_TAU], dt, z[s, Z_RATE])
        iono = ar1(memory, s, M_IONO, cfg[IONO_TAU], dt, z[s, Z_IONO]) * cfg[IONO_SIGMA]
        drift = ar1(memory, s, M_AGE, cfg[AGE_TAU], dt, z[s, Z_AGE]) * cfg[AGE_RATE]
        late = ar1(memory, s, M_EXCESS, cfg[MULTIPATH_TAU], dt, z[s, Z_EXCESS])
        level = carrier_to_noise(cfg, sine, path[s], cn0_drop[s], fading)
        received = above[s] and path[s] != BLOCKED and level >= cfg[TRACK_MIN]
        had_phase = memory[s, M_PHASE_S] >= cfg[PHASE_DELAY]
        memory[s, M_CODE_S] = memory[s, M_CODE_S] + dt if received else 0.0
        locked = received and path[s] != REFLECTED and level >= cfg[PHASE_MIN]
        memory[s, M_PHASE_S] = memory[s, M_PHASE_S] + dt if locked else 0.0
        has_phase = memory[s, M_PHASE_S] >= cfg[PHASE_DELAY]
        lock_lost[s] = has_phase and not had_phase
        if lock_lost[s]:
            for b in range(2):
                ambiguity[s, b] += 2.0 * math.floor(1000.0 * z[s, Z_SLIP] * (b + 1.0))
        tracked[s] = memory[s, M_CODE_S] >= cfg[CODE_DELAY]
        for b in range(2):
            ambiguity[s, b] += 2.0 * slips[s, b]
            code[s, b], phase[s, b] = 0.0, 0.0
        range_rate[s], cn0[s] = 0.0, 0.0
        if not tracked[s]:
            continue
        if has_phase and u[s, U_SLIP] < dt * cfg[SLIP_RATE] * 10.0 ** ((cfg[SLIP_CN0] - level) / cfg[SLIP_DECADE]):
            slip(cfg, z[s, Z_SLIP], u[s, U_KIND], s, ambiguity, lock_lost)
        scale = math.sqrt(0.5 * (1.0 + 1.0 / (sine * sine)) * (1.0 + 10.0 ** (0.1 * (35.0 - level))))
        geometric = 0.0
        for k in range(3):
            geometric -= e[s, k] * (position[k] + reference[k])
        common = geometric + drift * used_age
        multipath = excess[s] if path[s] == REFLECTED and excess[s] > 0.0 else urban_excess(level, late)
        code_error = cfg[CODE_MULTIPATH] * scale * code_mp + cfg[NLOS_SCALE] * multipath
        c = system[s]
        cn0[s] = level
        for b in range(bands):
            dispersion = iono * (wavelength[c, b] / wavelength[c, 0]) ** 2
            code[s, b] = common + clock[c, b] + dispersion + code_error + cfg[CODE_SIGMA] * scale * z[s, Z_CODE0 + b]
            code[s, b] += code_bias[s]
            if has_phase:
                phase[s, b] = common + clock[c, 2 + b] - dispersion + phase_bias[s]
                phase[s, b] += 0.5 * wavelength[c, b] * ambiguity[s, b]
                phase[s, b] += scale * cfg[PHASE_SIGMA] * z[s, Z_PHASE0 + b]
                phase[s, b] += scale * cfg[PHASE_MULTIPATH] * memory[s, M_PHASE_MP0 + b]
        for k in range(3):
            range_rate[s] -= e[s, k] * velocity[k]
        range_rate[s] += clock[0, 4] + rate_bias[s] + cfg[RATE_SIGMA] * scale * rate


@jit
def slip(cfg, z, kind, s, ambiguity, lock_lost):  # type: ignore[no-untyped-def]
    """Let the carrier slip by whole or half cycles on one or both bands, announced or not."""
    size = math.floor(abs(z) * 3.0) + 1.0
    if z < 0.0:
        size = -size
    half = kind < cfg[HALF_SHARE]
    ambiguity[s, 0] += 1.0 if half else 2.0 * size
    if kind > 0.5:
        ambiguity[s, 1] += 1.0 if half else 2.0 * size
    lock_lost[s] = lock_lost[s] or (kind * 10.0) % 1.0 >= cfg[UNANNOUNCED]


def _observe(  # type: ignore[no-untyped-def]
    cfg, wavelength, los, elevation, above, system, index, path, excess, position, velocity, reference, age,
    code_bias, phase_bias, rate_bias, cn0_drop, slips, clock, z, u, memory, ambiguity,
    tracked, code, phase, range_rate, cn0, lock_lost,
):  # fmt: skip
    for v in prange(index.shape[0]):
        k = index[v]
        observe_vehicle(
            cfg, wavelength, los[k], elevation[k], above[k], system, path[v], excess[v], position[v], velocity[v],
            reference[v], age[v], code_bias[v], phase_bias[v], rate_bias[v], cn0_drop[v], slips[v], clock[v],
            z[v], u[v], memory[v], ambiguity[v], tracked[v], code[v], phase[v], range_rate[v], cn0[v], lock_lost[v],
        )  # fmt: skip


observe_serial = jit(_observe)
observe_parallel = jit(parallel=True)(_observe)
