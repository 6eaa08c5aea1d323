"""RTK with one vehicle's single differences, epoch by epoch (S1 section 3: no dynamic model).

Receiver clocks are eliminated by centring: within one system and observable type, weights ``w_s`` and lines of sight
``e_s`` give the mean ``e- = sum w e / sum w``, and the clock-free normal matrix is ``sum w (e - e-)(e - e-)'``. Code
and phase of both bands share one variance factor ``f_s`` (as RTKLIB's constant code/phase ratio), so the observables of
one satellite collapse into one row of weight ``sum of weights`` without loss.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.positioning.code_errors_kernel import variance_factor
from lanebound.integrity.positioning.reflection_odds_kernel import REFLECTION_RULES

__all__ = [
    "AMBIGUITY",
    "BASE",
    "BASES",
    "FILTER_RULES",
    "MOST_AMBIGUITIES",
    "RTK_RULES",
    "SATELLITE",
    "UNUSED",
    "Carriers",
    "add_layer",
    "atmosphere_variance",
    "collapse_code",
    "collapse_phase",
    "drop_small_systems",
    "first_wavelength",
    "float_ambiguities",
    "has_atmosphere",
    "held_base",
    "held_risk",
    "is_strong",
    "leave_out_faded",
    "obliquity",
    "order_by_variance",
    "owner_of",
    "range_of",
    "weigh",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNUSED = 1e6  # variance factor of a satellite that is not used; its ambiguities may still be held
MOST_AMBIGUITIES = 80  # two bands of the most candidates that RtkConfig allows
EARTH_RATIO = 6371.0 / (6371.0 + 350.0)  # Earth's radius over that of the ionospheric layer (IS-GPS-200: 350 km)

SATELLITE = record(
    system=("i8", "its system, which is also its clock"),
    fixable=("?", "its ambiguities are integers"),
    prior="its fault probability [-]",
    wavelength=("f8", (2,), "of the bands tracked [m]"),
    further=("?", "it is one more signal of the satellite ``host``: it helps to find integers, in no position"),
    host=("i8", "that satellite"),
    first="wavelength of the first band of that satellite [m]",
)
"""What is constant of a satellite, or of one more signal of a satellite."""

BASES = 4  # of windows over which carriers are tested before they give a velocity, the newest first

AMBIGUITY = record(
    held=("?", "the integers are fixed and held"),
    integers=("f8", (2,), "by band [cycles]"),
    fix_id=("i8", "number of the fix that they came from"),
    fix_risk="failure rate of that whole fix [-]",
    last_phase=("f8", (2,), "phase of the last epoch relative to the anchor, 0: not followed [m]"),
    bases=("f8", (BASES,), "first phase at the bases of the windows, relative to theirs, 0: not followed since [m]"),
    odds="largest odds since its fix that the carrier is off, where hypotheses are monitored [-]",
    peak="C/N0 that its present one is compared with: the highest of late, which falls slowly [dB-Hz]",
)
"""The ambiguities of one satellite."""

FILTER_RULES = record(
    sequential=("?", "float ambiguities come from a filter over epochs, otherwise from one epoch"),
    interval="time between two epochs of the filter [s]",
    memory="time in which what it knows fades to 1/e [s]",
    code_tau="longest correlation time of code errors [s]",
    phase_tau="the same of phase errors [s]",
    ionosphere="residual vertical ionosphere of a single difference, 1 sigma, first band [m]",
    troposphere="residual zenith delay difference, 1 sigma [m]",
)
"""FloatConfig as kernels take it."""

RTK_RULES = record(
    bands=("i8", "bands tracked"),
    sin_mask="sine of the lowest elevation used",
    cn0_min="lowest C/N0 used [dB-Hz]",
    cn0_knee="C/N0 at which the variance doubles [dB-Hz]",
    fade="fall of the C/N0 from its peak that a carrier in use may have [dB]",
    fade_decay="fall of that peak [dB/s]",
    sigma_code="code, zenith, one band [m]",
    sigma_phase="phase, zenith, one band [m]",
    sigma_phase_integrity="phase of both bands for protection levels [m]",
    phase_bias="bound of a phase bias of one satellite [m]",
    age_sigma="growth of a satellite's error with the age of corrections [m/s]",
    max_age="oldest usable corrections [s]",
    fix_max_age="oldest corrections for new fixes [s]",
    fix_limit="largest risk of wrong integers [-]",
    ratio_min="floor of the ratio test [-]",
    posterior="variance factor with which integers may be accepted by their probability given the measurements; 0: not",
    misfit=("f8", (MOST_AMBIGUITIES + 1,), "largest squared norm of a fix by its number of ambiguities"),
    attempts=("i8", "sets without one suspect to try"),
    max_candidates=("i8", "satellites searched at once"),
    min_satellites=("i8", "satellites of a fix with one system"),
    min_further=("i8", "satellites that a further system must bring"),
    hold_failures=("i8", "rejected epochs in a row after which all integers are released"),
    retry="after a refusal, time until the next attempt [s]",
    reflections=(REFLECTION_RULES, "carriers that may not be direct"),
    filter=(FILTER_RULES, "float ambiguities"),
)
"""RtkConfig as kernels take it."""

MEAN = record(e=("f8", (3,), "weighted mean line of sight"), y="weighted mean [m]", weight="sum of weights [1/m^2]")
BASE = record(
    e=("f8", (3,), "weighted mean line of sight of the held satellites"),
    weight="sum of their weights, of one band [1/m^2]; 0: none is held",
    phase=("f8", (2,), "weighted mean of phase - lambda N, by band [m]"),
)
"""The clock of a system from its held satellites."""


class Carriers(NamedTuple):
    """Carriers of one epoch: satellites (S,) of SATELLITE, signals (S,) of OBSERVED_SIGNAL, variance (S,) of one band.

    The phases are in metres.
    """

    satellites: Records
    signals: Records
    variance: Array


@jit(borrows=True)
def weigh(signals: Records, cn0_knee: float, marks: Records) -> None:
    """Variance factor ``(1 + 1/sin^2 el)/2 * (1 + 10^((knee - C/N0)/10))`` of S satellites, UNUSED if not tracked.

    The elevation part is RTKLIB's ``a^2 + (a/sin el)^2`` scaled to 1 at the zenith; the C/N0 part doubles the
    variance at the knee (sigma-epsilon model of Hartinger and Brunner 1999). Fills ``marks[s].quality``.
    """
    for s in range(signals.shape[0]):
        signal = signals[s]
        marks[s].quality = variance_factor(signal.e[2], signal.cn0, cn0_knee) if signal.tracked else UNUSED


@jit
def is_strong(signal: Any, sin_mask: float, cn0_min: float) -> bool:
    """Whether a signal is tracked, high and strong enough to be used."""
    return bool(signal.tracked and signal.e[2] > sin_mask and signal.cn0 >= cn0_min)


@jit
def has_atmosphere(rules: Any) -> bool:
    """Whether a residual atmosphere is declared."""
    return bool(rules.filter.ionosphere > 0.0 or rules.filter.troposphere > 0.0)


@jit
def atmosphere_variance(sine: float, satellite: Any, rules: Any) -> float:
    """Variance of the residual atmosphere in the mean phase of all bands [m^2], 0 where none is declared.

    ``(mean_b mu_b m_I sigma_I)^2 + ((m_Z - 1) sigma_Z)^2``; what is common to all elevations is in the clock.
    """
    sine, total = max(sine, 0.05), 0.0
    if not has_atmosphere(rules):
        return 0.0
    for b in range(rules.bands):
        total += (satellite.wavelength[b] / satellite.wavelength[0]) ** 2 / rules.bands
    ionosphere = total * rules.filter.ionosphere * obliquity(sine)
    troposphere = rules.filter.troposphere * (1.0 / sine - 1.0)
    return float(ionosphere * ionosphere + troposphere * troposphere)


@jit
def owner_of(satellites: Records, s: int) -> int:
    """The satellite that sends signal s: itself, or the host of a further signal."""
    return int(satellites[s].host) if satellites[s].further else s


@jit
def first_wavelength(satellite: Any) -> float:
    """Wavelength [m] of the band on which the ionosphere of a satellite is counted."""
    return float(satellite.first if satellite.further else satellite.wavelength[0])


@jit
def obliquity(sine: float) -> float:
    """Slant over vertical ionosphere of a thin layer at 350 km, by the sine of the elevation."""
    return 1.0 / math.sqrt(1.0 - EARTH_RATIO**2 * (1.0 - sine * sine))


@jit(borrows=True)
def leave_out_faded(signals: Records, rules: Any, dt: float, marks: Records, ambiguities: Records) -> None:
    """Do not use carriers whose C/N0 has just fallen: a ray that bends round an edge is late as soon as it is weak.

    Knife edge, ``v = angle sqrt(2 d / lambda)``: the detour ``d angle^2 / 2 = v^2 lambda / 4`` is 1 cm at a loss of
    10 dB, 5 cm at 14 dB and 15 cm at 19 dB. A receiver sees the loss late, so that a fall counts by its beginning.
    """
    for s in range(signals.shape[0]):
        ambiguity, signal = ambiguities[s], signals[s]
        ambiguity.peak -= rules.fade_decay * dt
        if signal.tracked:
            if signal.cn0 > ambiguity.peak:
                ambiguity.peak = signal.cn0
            if signal.cn0 < ambiguity.peak - rules.fade:
                marks[s].used, marks[s].factor = False, UNUSED


@jit
def add_layer(rows: Records, normal: Array, rhs: Array) -> None:
    """Add one observable type to the clock-free normal equations ``normal x = rhs``, (3, 3) and (3,)."""
    means = np.zeros(MAX_GROUPS, MEAN)
    for s in range(rows.shape[0]):
        row = rows[s]
        if row.used:
            w, mean = 1.0 / row.variance, means[row.group]
            mean.weight += w
            mean.y += w * row.y
            for k in range(3):
                mean.e[k] += w * row.e[k]
    for c in range(MAX_GROUPS):
        mean = means[c]
        if mean.weight > 0.0:
            mean.y /= mean.weight
            for k in range(3):
                mean.e[k] /= mean.weight
    for s in range(rows.shape[0]):
        row = rows[s]
        if row.used:
            w, mean = 1.0 / row.variance, means[row.group]
            dy = row.y - mean.y
            for j in range(3):
                gj = row.e[j] - mean.e[j]
                rhs[j] -= w * gj * dy
                for k in range(3):
                    normal[j, k] += w * gj * (row.e[k] - mean.e[k])


@jit(borrows=True)
def collapse_code(signals: Records, bands: int, rows: Records) -> None:
    """Mean of the code over the bands -> ``rows[s].y`` [m]; its variance is that of one band over ``bands``."""
    for s in range(signals.shape[0]):
        code = signals[s].code
        rows[s].y = code[0] if bands == 1 else 0.5 * (code[0] + code[1])


@jit(borrows=True)
def collapse_phase(carriers: Carriers, ambiguities: Records, bands: int, rows: Records) -> None:
    """Mean over the bands of ``phase - lambda N`` -> ``rows[s].y`` [m]."""
    for s in range(rows.shape[0]):
        total, phase, satellite = 0.0, carriers.signals[s].phase, carriers.satellites[s]
        for b in range(bands):
            total += phase[b] - satellite.wavelength[b] * ambiguities[s].integers[b]
        rows[s].y = total / bands


@jit
def range_of(cycles: Any, satellite: Any, bands: int) -> float:
    """Mean over the bands of ``lambda N`` [m], N (2,) integers."""
    total = 0.0
    for b in range(bands):
        total += satellite.wavelength[b] * cycles[b]
    return total / bands


@jit(borrows=True)
def order_by_variance(candidate: Bools, variance: Array, limit: int, order: Ints) -> int:
    """Indices of the candidates, most precise first, at most ``limit`` of them: fills ``order``, returns the count."""
    n = 0
    for s in range(candidate.shape[0]):
        if not candidate[s]:
            continue
        k = n
        while k > 0 and variance[order[k - 1]] > variance[s]:
            if k < limit:
                order[k] = order[k - 1]
            k -= 1
        if k < limit:
            order[k] = s
            n = min(n + 1, limit)
    return n


@jit
def float_ambiguities(
    carriers: Carriers, order: Ints, count: int, bands: int, x: Array, q_x: Array, base: Records, ambiguity: Array,
    q_a: Array, owner: Ints,
) -> int:  # fmt: skip
    """Float ambiguities of ``count`` satellites and their covariance, given the position from all other rows.

    ``N = (phase - clock + (e - e_base) x) / lambda`` where the clock of a system and band is that of ``base``
    (MAX_GROUPS,) or, where no satellite is held, of the first of its satellites in ``order``: this reference has no
    unknown of its own. Covariance:
    ``((e_u - e-) Q_x (e_v - e-) + [same system and band] (1 / w_base + delta_uv var)) / (lambda lambda')``.
    Order of the unknowns: satellite by satellite, band by band.

    Fills ``ambiguity`` (n,), ``q_a`` (n, n) [cycles^2] and ``owner`` (n,) with satellite indices; returns n. ``base``
    is completed in place.
    """
    satellites, signals, variance = carriers
    n = 0
    for i in range(count):
        s = order[i]
        satellite = satellites[s]
        clock = base[satellite.system]
        if clock.weight <= 0.0:
            clock.weight = 1.0 / variance[s]
            for k in range(3):
                clock.e[k] = signals[s].e[k]
            for b in range(bands):
                clock.phase[b] = signals[s].phase[b]
            continue
        for b in range(bands):
            geometric = 0.0
            for k in range(3):
                geometric += (signals[s].e[k] - clock.e[k]) * x[k]
            ambiguity[n] = (signals[s].phase[b] - clock.phase[b] + geometric) / satellite.wavelength[b]
            owner[n] = s
            n += 1
    h = np.empty(3)
    for i in range(n):
        u = owner[i]
        clock_u, bu = base[satellites[u].system], i % bands
        for k in range(3):
            h[k] = 0.0
            for j in range(3):
                h[k] += q_x[k, j] * (signals[u].e[j] - clock_u.e[j])
        for i2 in range(i + 1):
            v = owner[i2]
            clock_v, bv = base[satellites[v].system], i2 % bands
            q = 0.0
            for k in range(3):
                q += h[k] * (signals[v].e[k] - clock_v.e[k])
            if satellites[u].system == satellites[v].system and bu == bv:
                q += 1.0 / clock_u.weight
                if u == v:
                    q += variance[u]
            q /= satellites[u].wavelength[bu] * satellites[v].wavelength[bv]
            q_a[i, i2] = q
            q_a[i2, i] = q
    return n


@jit
def held_base(carriers: Carriers, ambiguities: Records, bands: int, base: Records) -> None:
    """Clock of each system from its held satellites: weighted means of ``phase - lambda N`` and of ``e``.

    ``base`` (MAX_GROUPS,) is of zeros before.
    """
    satellites, signals, variance = carriers
    for s in range(variance.shape[0]):
        if ambiguities[s].held:
            satellite, w = satellites[s], 1.0 / variance[s]
            clock = base[satellite.system]
            clock.weight += w
            for k in range(3):
                clock.e[k] += w * signals[s].e[k]
            for b in range(bands):
                clock.phase[b] += w * (signals[s].phase[b] - satellite.wavelength[b] * ambiguities[s].integers[b])
    for c in range(base.shape[0]):
        clock = base[c]
        if clock.weight > 0.0:
            for k in range(3):
                clock.e[k] /= clock.weight
            for b in range(bands):
                clock.phase[b] /= clock.weight


@jit(borrows=True)
def held_risk(ambiguities: Records) -> float:
    """Probability that any held ambiguity is wrong: the union bound over the fixes that they came from."""
    total, latest = 0.0, -1
    for s in range(ambiguities.shape[0]):
        if not ambiguities[s].held or (latest >= 0 and ambiguities[s].fix_id == ambiguities[latest].fix_id):
            continue
        first, latest = True, s
        for r in range(s):
            if ambiguities[r].held and ambiguities[r].fix_id == ambiguities[s].fix_id:
                first = False
                break
        if first:
            total += ambiguities[s].fix_risk
    return total


@jit(borrows=True)
def drop_small_systems(member: Bools, satellites: Records, minimum: int) -> tuple[int, int]:
    """Leave out systems with fewer than ``minimum`` members; returns the number of satellites and of systems left.

    Further signals of satellites stay, and do not count.
    """
    counts = 0  # 8 bits for each system: a scratch array would cost more than the counting
    for s in range(member.shape[0]):
        if member[s] and not satellites[s].further:
            counts += 1 << 8 * satellites[s].system
    members, systems = 0, 0
    for c in range(MAX_GROUPS):
        count = counts >> 8 * c & 255
        if count >= minimum:
            members += count
            systems += 1
    for s in range(member.shape[0]):
        if member[s] and not satellites[s].further and counts >> 8 * satellites[s].system & 255 < minimum:
            member[s] = False
    return members, systems
