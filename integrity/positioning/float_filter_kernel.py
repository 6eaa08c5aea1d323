"""Float ambiguities from a sequence of epochs: sequential least squares whose covariance allows for correlated errors.

State of one vehicle: for each of K slots (one satellite each) the ambiguities of two bands ``N_1, N_2`` [cycles] and
the vertical residual ionosphere ``I`` [m on band 1]; and the zenith delay difference ``Z`` [m]. Single differences of a
satellite and band b, with clocks for each system, band and observable, and a position x that is free in each epoch:

``code = -e.x + clock + mu_b m_I I + m_Z Z``, ``phase = -e.x + clock - mu_b m_I I + m_Z Z + lambda_b N_b``,
``mu_b = (lambda_b / lambda_1)^2``.

A filter with three more states before Z is that of a receiver that stands: x is then one of its states, the same in
all epochs. A further signal of a satellite has a slot of its own with one ambiguity, and the ionosphere of the slot of
its host. It is followed only while its host is.

With P the weight matrix of an epoch after elimination of clocks and position, H the design of the lasting states and
R the variances, ``B = H'P``, normal matrix and right-hand side grow by ``BH`` and ``By`` and fade by
``gamma = exp(-gap / memory)``. The weights are those of white errors, but the covariance is that under first-order
Gauss-Markov errors, independent between measurements, of variance R and correlation ``rho`` from one epoch to the next:

``Q = (sum BH)^-1 S (sum BH)^-1``, ``S = gamma^2 S + B R B' + gamma rho (W R^1/2 B' + B R^1/2 W')``,
``W = gamma rho W + B R^1/2``.

The prior information of I and Z is counted once, but multiplied by ``kappa = c / n``, the ratio of what white errors
would tell to what errors of this correlation tell: ``n = gamma n + 1``, ``c = gamma^2 c + 1 + 2 gamma rho m``,
``m = gamma rho m + 1``. Without it many correlated epochs would outweigh the prior; S contains ``kappa^2`` times it.

As B is nearly constant, all products in S are positive, so that Q grows with rho: Q bounds errors of every shorter
correlation time, down to white ones. The first epoch alone gives ``Q = (BH)^-1``. A filter that takes the errors as
white is overconfident instead (Petovello, O'Keefe, Lachapelle and Cannon 2009, J. Geodesy 83, 51-56).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_3x3
from lanebound.integrity.positioning.rtk_kernel import Carriers, first_wavelength, obliquity, owner_of

__all__ = [
    "FILTER_ROW", "MEASURED", "SLOT", "STATES", "FloatFilters", "add_epoch", "assign_slots", "drop_slot",
    "fade", "filter_of", "filtered_ambiguities", "find_searchable", "follows", "invert_positive",
]  # fmt: skip

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STATES = 3  # of a slot: two ambiguities and the ionosphere
MEASURED = 4  # of a slot: code and phase of two bands
NEGLIGIBLE = 1e-9  # [1/cycle^2], [1/m^2] information below it is none
LOST_RANK = 1e-12  # pivot below this share of its diagonal

SLOT = record(
    satellite=("i8", "its satellite"),
    assigned=("?", "it has had a satellite"),
    followed=("?", "the ambiguities of that satellite are estimated"),
    held=("?", "its integers were held in the last epoch"),
    fix_id=("i8", "number of the fix that they came from"),
    broken=("?", "lock was lost, or the integers were released, since then"),
    whole=("f8", (2,), "cycles taken off the phases, so that the ambiguities are small"),
    last_phase=("f8", (2,), "phase of the last epoch added, relative to the point of linearization [m]"),
    white="n of the module, since it is followed",
    lasting="m of the module",
    both="c of the module",
)
"""What the filter stores of one satellite."""

FILTER_ROW = record(
    since_s="time since the last epoch added [s]",
    age_s="age of the corrections at that epoch [s]",
    added=("?", "this epoch has been added"),
)
"""What it stores of one vehicle."""


class FloatFilters(NamedTuple):
    """Filters of B vehicles, or, without the first axis, of one; n = 3 K + 1 states, 3 K + 4 of a receiver that stands.

    slots (B, K) of SLOT; normal (B, n, n), rhs (B, n); spread (B, n, n), the S of the module; memory (B, 4 K, n), its W
    with a row for each measurement.
    """

    slots: Records
    normal: Array
    rhs: Array
    spread: Array
    memory: Array


MEASUREMENT = record(
    row=("i8", "row of the memory"),
    slot=("i8", "slot of its ionosphere"),
    state=("i8", "of the ambiguity, -1 for codes"),
    wavelength="factor of the ambiguity [m]",
    ionosphere="factor of the ionosphere [-]",
    zenith="factor of the zenith delay [-]",
    los=("f8", (3,), "unit vector from the satellite"),
    weight="[1/m^2]",
    y="[m]",
    group=("i8", "clock"),
)
"""A measurement of an epoch."""


@jit
def filter_of(filters: FloatFilters | None, v: int) -> FloatFilters | None:
    """The filter of vehicle v; None where floats come from single epochs."""
    if filters is None:
        return None
    return FloatFilters(filters.slots[v], filters.normal[v], filters.rhs[v], filters.spread[v], filters.memory[v])


@jit
def stands(own: FloatFilters) -> bool:
    """Whether the position is a state of the filter."""
    return bool(own.rhs.shape[0] > STATES * own.slots.shape[0] + 1)


@jit
def follows(slots: Records, s: int) -> int:
    """The slot in which satellite s is followed, -1 for none."""
    for k in range(slots.shape[0]):
        if slots[k].followed and slots[k].satellite == s:
            return k
    return -1


@jit
def prior_factor(slot: Any) -> float:
    """``kappa = c / n`` of a slot; 1 before its first epoch."""
    return slot.both / slot.white if slot.white > 0.0 else 1.0


@jit
def find_searchable(candidate: Bools, satellites: Records, ambiguities: Records, slots: Records, out: Bools) -> None:
    """The candidates whose integers the filter can give: ``out`` (S,), those followed.

    Where a system has held satellites, one of them must be followed too, or their numbers have nothing in common.
    """
    held, anchored = np.zeros(MAX_GROUPS, np.bool_), np.zeros(MAX_GROUPS, np.bool_)
    for s in range(candidate.shape[0]):
        held[satellites[s].system] = held[satellites[s].system] or ambiguities[s].held
    for k in range(slots.shape[0]):
        s = slots[k].satellite
        if slots[k].followed and ambiguities[s].held:
            anchored[satellites[s].system] = True
    for s in range(candidate.shape[0]):
        system = satellites[s].system
        out[s] = candidate[s] and (anchored[system] or not held[system]) and follows(slots, s) >= 0


@jit
def fade(own: FloatFilters, gap_s: float, rules: Any) -> None:
    """Fade what is known by ``gap_s`` [s]; rules of RTK_RULES."""
    gamma = math.exp(-gap_s / rules.filter.memory)
    keep = gamma * math.exp(-gap_s / rules.filter.code_tau), gamma * math.exp(-gap_s / rules.filter.phase_tau)
    n, rho = own.rhs.shape[0], max(keep[0], keep[1])
    for k in range(own.slots.shape[0]):
        slot = own.slots[k]
        slot.white *= gamma
        slot.lasting *= rho
        slot.both *= gamma * gamma
    for i in range(n):
        own.rhs[i] *= gamma
        for j in range(n):
            own.normal[i, j] *= gamma
            own.spread[i, j] *= gamma * gamma
    for r in range(own.memory.shape[0]):
        factor = keep[0] if r % MEASURED < 2 else keep[1]
        for j in range(n):
            own.memory[r, j] *= factor


@jit
def drop_slot(own: FloatFilters, k: int, rules: Any) -> None:
    """Take the states of a slot out of the filter; what they tell of the other states stays (Schur complement)."""
    slots, normal, rhs, spread, memory = own
    n, sigma = rhs.shape[0], rules.filter.ionosphere
    factor = np.empty(n)
    for j in range(STATES * k, STATES * (k + 1)):
        ionosphere = j == STATES * k + 2
        if ionosphere and sigma > 0.0:
            kappa = prior_factor(slots[k])
            normal[j, j] += kappa / sigma**2
            spread[j, j] += kappa**2 / sigma**2
        pivot = normal[j, j]
        if pivot > NEGLIGIBLE and not (ionosphere and sigma == 0.0):
            for i in range(n):
                factor[i] = normal[i, j] / pivot if i != j else 0.0
            for i in range(n):
                if factor[i] != 0.0:
                    rhs[i] -= factor[i] * rhs[j]
                    for c in range(n):
                        normal[i, c] -= factor[i] * normal[j, c]
                        spread[i, c] -= factor[i] * spread[j, c]
            for r in range(n):
                last = spread[r, j]
                for i in range(n):
                    spread[r, i] -= factor[i] * last
            for r in range(memory.shape[0]):
                last = memory[r, j]
                for i in range(n):
                    memory[r, i] -= factor[i] * last
        rhs[j] = 0.0
        normal[j, :], normal[:, j], spread[j, :], spread[:, j], memory[:, j] = 0.0, 0.0, 0.0, 0.0, 0.0
    slots[k].followed = False


@jit
def assign_slots(
    own: FloatFilters, carriers: Carriers, order: Ints, count: int, ambiguities: Records, rules: Any
) -> None:
    """Begin to follow satellites of ``order`` (count,), held ones first, further signals last, where a slot is free.

    A satellite gets the slot that it had before, if that is free: errors of its measurements may last.
    """
    slots = own.slots
    for turn in range(4):
        for i in range(count):
            s = order[i]
            if ambiguities[s].held != (turn % 2 == 0) or follows(slots, s) >= 0:
                continue
            owner = owner_of(carriers.satellites, s)
            if (owner != s) != (turn >= 2) or (owner != s and follows(slots, owner) < 0):
                continue
            free = -1
            for k in range(slots.shape[0]):
                if slots[k].assigned and not slots[k].followed and slots[k].satellite == s:
                    free = k
                    break
                if not slots[k].followed and (free < 0 or (slots[free].assigned and not slots[k].assigned)):
                    free = k
            if free < 0:
                return
            slot = slots[free]
            if not (slot.assigned and slot.satellite == s):
                own.memory[MEASURED * free : MEASURED * (free + 1), :] = 0.0
            slot.satellite, slot.assigned, slot.followed, slot.broken = s, True, True, False
            slot.held, slot.fix_id = ambiguities[s].held, ambiguities[s].fix_id
            slot.white, slot.lasting, slot.both = 0.0, 0.0, 0.0
            signal = carriers.signals[s]
            for b in range(2):
                slot.last_phase[b], slot.whole[b] = 0.0, 0.0
                if b < rules.bands:
                    cycles = (signal.phase[b] - signal.code[b]) / carriers.satellites[s].wavelength[b]
                    slot.whole[b] = math.floor(cycles + 0.5)


@jit
def _measurements(
    own: FloatFilters, carriers: Carriers, variance_code: Array, coded: Bools, used: Bools, rules: Any
) -> tuple[Records, int]:
    """The measurements of an epoch of all satellites that are followed and used, and their number."""
    slots, most = own.slots, MEASURED * own.slots.shape[0]
    out, n = np.zeros(most, MEASUREMENT), 0
    for k in range(slots.shape[0]):
        s = slots[k].satellite
        owner = owner_of(carriers.satellites, s)
        if not (slots[k].followed and used[s] and used[owner]):
            continue
        host = k if owner == s else follows(slots, owner)
        satellite, signal = carriers.satellites[s], carriers.signals[s]
        sine = max(signal.e[2], 0.05)
        oblique = obliquity(sine)
        for phase in range(2):
            if phase == 0 and not coded[s]:
                continue
            for b in range(rules.bands):
                wavelength = satellite.wavelength[b]
                sign = 1.0 if phase == 0 else -1.0
                m = out[n]
                m.row, m.slot = MEASURED * k + 2 * phase + b, host
                m.state = STATES * k + b if phase == 1 else -1
                m.wavelength = wavelength
                m.ionosphere = sign * oblique * (wavelength / first_wavelength(satellite)) ** 2
                m.zenith = 1.0 / sine
                for c in range(3):
                    m.los[c] = -signal.e[c]
                m.weight = 1.0 / (carriers.variance[s] if phase == 1 else variance_code[s])
                m.y = signal.phase[b] - wavelength * slots[k].whole[b] if phase == 1 else signal.code[b]
                m.group = 4 * satellite.system + 2 * phase + b
                n += 1
    return out, n


@jit
def _projected(rows: Records, n: int, stands: bool, out: Array) -> bool:
    """Weight matrix ``out`` (n, n) after elimination of clocks and, unless it is a state, of the position; False where
    the position is singular."""
    total, mean = np.zeros(4 * MAX_GROUPS), np.zeros((4 * MAX_GROUPS, 3))
    for r in range(n):
        total[rows[r].group] += rows[r].weight
        for c in range(3):
            mean[rows[r].group, c] += rows[r].weight * rows[r].los[c]
    pull, normal, q = np.empty((n, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for r in range(n):
        g, w, los = rows[r].group, rows[r].weight, rows[r].los
        for c in range(3):
            pull[r, c] = w * (los[c] - mean[g, c] / total[g])
        for c in range(3):
            for d in range(3):
                normal[c, d] += pull[r, c] * (los[d] - mean[g, d] / total[g])
    q[:] = 0.0
    if not stands and not invert_3x3(normal, q):
        return False
    for r in range(n):
        a = q[0, 0] * pull[r, 0] + q[0, 1] * pull[r, 1] + q[0, 2] * pull[r, 2]
        b = q[1, 0] * pull[r, 0] + q[1, 1] * pull[r, 1] + q[1, 2] * pull[r, 2]
        c = q[2, 0] * pull[r, 0] + q[2, 1] * pull[r, 1] + q[2, 2] * pull[r, 2]
        for r2 in range(n):
            value = -(a * pull[r2, 0] + b * pull[r2, 1] + c * pull[r2, 2])
            if rows[r].group == rows[r2].group:
                value -= rows[r].weight * rows[r2].weight / total[rows[r].group]
            out[r, r2] = value
        out[r, r] += rows[r].weight
    return True


@jit
def add_epoch(
    own: FloatFilters, carriers: Carriers, variance_code: Array, coded: Bools, used: Bools, rules: Any
) -> bool:
    """Add the measurements of an epoch; :func:`fade` comes before. False: too few satellites, nothing is added.

    variance_code (S,) of one band; coded, used (S,): whose code, and which satellites, are taken.
    """
    normal, rhs, spread, memory = own.normal, own.rhs, own.spread, own.memory
    rows, n = _measurements(own, carriers, variance_code, coded, used, rules)
    weight, size = np.empty((n, n)), rhs.shape[0]
    position = STATES * own.slots.shape[0] if stands(own) else size  # its states
    if n == 0 or not _projected(rows, n, stands(own), weight):
        return False
    influence = np.zeros((n, size))  # B'
    for r in range(n):
        zenith, row = size - 1, rows[r]
        for r2 in range(n):
            if row.state >= 0:
                influence[r2, row.state] += row.wavelength * weight[r, r2]
            influence[r2, STATES * row.slot + 2] += row.ionosphere * weight[r, r2]
            influence[r2, zenith] += row.zenith * weight[r, r2]
            for i in range(position, zenith):
                influence[r2, i] += row.los[i - position] * weight[r, r2]
    for r in range(n):
        row = rows[r]
        for i in range(size):
            pull = influence[r, i]
            rhs[i] += pull * row.y
            if row.state >= 0:
                normal[i, row.state] += row.wavelength * pull
            normal[i, STATES * row.slot + 2] += row.ionosphere * pull
            normal[i, size - 1] += row.zenith * pull
            for j in range(position, size - 1):
                normal[i, j] += row.los[j - position] * pull
    for k in range(own.slots.shape[0]):
        slot = own.slots[k]
        if slot.followed and used[slot.satellite]:
            slot.both += 1.0 + 2.0 * slot.lasting
            slot.lasting += 1.0
            slot.white += 1.0
    for r in range(n):
        last, now, deviation = memory[rows[r].row], influence[r], 1.0 / math.sqrt(rows[r].weight)
        for i in range(size):
            now[i] *= deviation
        for i in range(size):
            both, new = last[i] + now[i], now[i]
            for j in range(size):
                spread[i, j] += both * now[j] + new * last[j]
        for i in range(size):
            last[i] += now[i]
    return True


@jit
def invert_positive(matrix: Array, n: int, out: Array) -> bool:
    """Inverse ``out`` (n, n) of a symmetric positive definite matrix (>= n, >= n) by Cholesky; False for others."""
    lower = np.zeros((n, n))
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= lower[j, k] * lower[j, k]
        if not pivot > LOST_RANK * matrix[j, j]:
            return False
        lower[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            lower[i, j] = value / lower[j, j]
    inverse = np.zeros((n, n))  # of the factor
    for j in range(n):
        inverse[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= lower[i, k] * inverse[k, j]
            inverse[i, j] = value / lower[i, i]
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, n):
                value += inverse[k, i] * inverse[k, j]
            out[i, j] = out[j, i] = value
    return True


@jit
def _references(
    own: FloatFilters, carriers: Carriers, order: Ints, count: int, ambiguities: Records, out: Ints
) -> None:
    """The slot in each system (MAX_GROUPS,) from which ambiguities count: a held one, or the most precise one."""
    slots, satellites = own.slots, carriers.satellites
    out[:] = -1
    for k in range(slots.shape[0]):
        s = slots[k].satellite
        if slots[k].followed and ambiguities[s].held and out[satellites[s].system] < 0:
            out[satellites[s].system] = k
    for i in range(count):
        if out[satellites[order[i]].system] < 0:
            out[satellites[order[i]].system] = follows(slots, order[i])
    for k in range(slots.shape[0]):
        s = slots[k].satellite
        if slots[k].followed and out[satellites[s].system] < 0:
            out[satellites[s].system] = k


@jit
def _unknowns(
    own: FloatFilters, carriers: Carriers, order: Ints, count: int, ambiguities: Records, reference: Ints, rules: Any,
    owner: Ints, unknown: Ints, known: Array,
) -> tuple[int, int]:  # fmt: skip
    """The states to estimate: fills ``unknown`` (n,), those of the candidates of ``order`` first, whose satellites are
    ``owner``; and ``known`` (n,) with the values of all others. Returns their number and that of the candidates'.
    """
    slots, normal, bands = own.slots, own.normal, rules.bands
    n, candidates = 0, 0
    searched = np.zeros(slots.shape[0], np.bool_)
    known[:] = 0.0
    for i in range(count):
        s = order[i]
        k = follows(slots, s)
        searched[k] = True
        if reference[carriers.satellites[s].system] == k or not normal[STATES * k, STATES * k] > NEGLIGIBLE:
            continue
        for b in range(bands):
            unknown[n], owner[n] = STATES * k + b, s
            n += 1
    candidates = n
    for k in range(slots.shape[0]):
        s = slots[k].satellite
        if not slots[k].followed:
            continue
        base = reference[carriers.satellites[s].system]
        for b in range(bands):
            state = STATES * k + b
            if ambiguities[s].held and base != k:
                ours, theirs = ambiguities[s].integers, ambiguities[slots[base].satellite].integers
                known[state] = ours[b] - slots[k].whole[b] - theirs[b] + slots[base].whole[b]
            elif base != k and not searched[k] and normal[state, state] > NEGLIGIBLE:
                unknown[n] = state
                n += 1
        if rules.filter.ionosphere > 0.0 and not carriers.satellites[s].further:
            unknown[n] = STATES * k + 2
            n += 1
    for state in range(STATES * slots.shape[0], own.rhs.shape[0] - 1):  # the position of a receiver that stands
        unknown[n] = state
        n += 1
    if rules.filter.troposphere > 0.0:
        unknown[n] = own.rhs.shape[0] - 1
        n += 1
    return n, candidates


@jit
def filtered_ambiguities(
    carriers: Carriers, order: Ints, count: int, ambiguities: Records, own: FloatFilters, rules: Any, ambiguity: Array,
    q_a: Array, owner: Ints,
) -> int:  # fmt: skip
    """Float ambiguities of ``count`` satellites, all followed, and their covariance, as ``float_ambiguities`` does.

    They count from a held satellite of their system where there is one, whose and whose fellows' integers are taken as
    known; otherwise from the first of the system in ``order``, which has no ambiguity of its own. Fills ``ambiguity``
    (n,), ``q_a`` (n, n) [cycles^2] and ``owner`` (n,), the satellites; returns n, 0 where nothing can be estimated.
    """
    slots, size = own.slots, own.rhs.shape[0]
    reference, unknown, known = np.empty(MAX_GROUPS, np.int64), np.empty(size, np.int64), np.empty(size)
    _references(own, carriers, order, count, ambiguities, reference)
    n, candidates = _unknowns(own, carriers, order, count, ambiguities, reference, rules, owner, unknown, known)
    normal, spread, rhs, inverse = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty((n, n))
    for i in range(n):
        rhs[i] = own.rhs[unknown[i]]
        for j in range(size):
            rhs[i] -= own.normal[unknown[i], j] * known[j]
        for j in range(n):
            normal[i, j] = own.normal[unknown[i], unknown[j]]
            spread[i, j] = own.spread[unknown[i], unknown[j]]
        sigma, kappa = 0.0, 1.0
        if unknown[i] == size - 1:
            sigma = rules.filter.troposphere
            for k in range(slots.shape[0]):
                kappa = max(kappa, prior_factor(slots[k]) if slots[k].followed else 0.0)
        elif unknown[i] % STATES == 2 and unknown[i] < STATES * slots.shape[0]:
            sigma, kappa = rules.filter.ionosphere, prior_factor(slots[unknown[i] // STATES])
        if sigma > 0.0:
            normal[i, i] += kappa / sigma**2
            spread[i, i] += kappa**2 / sigma**2
    if candidates == 0 or not invert_positive(normal, n, inverse):
        return 0
    product = np.zeros((candidates, n))
    for i in range(candidates):
        s = owner[i]
        base = reference[carriers.satellites[s].system]
        k, b = unknown[i] // STATES, unknown[i] % STATES
        value = slots[k].whole[b] - slots[base].whole[b]
        if ambiguities[slots[base].satellite].held:
            value += ambiguities[slots[base].satellite].integers[b]
        for j in range(n):
            value += inverse[i, j] * rhs[j]
            for c in range(n):
                product[i, c] += inverse[i, j] * spread[j, c]
        ambiguity[i] = value
    for i in range(candidates):
        for i2 in range(i + 1):
            value = 0.0
            for c in range(n):
                value += product[i, c] * inverse[c, i2]
            q_a[i, i2] = q_a[i2, i] = value
    return int(candidates)
