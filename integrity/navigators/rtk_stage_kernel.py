"""The RTK epoch of one vehicle: keep lock, resolve what is not held, solve with the held phases, test and exclude.

``par`` (NP,) are the declared figures of RTK and ``x`` (NX,) what lasts, flat with the columns named below.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED as FDE_EXCLUDED
from lanebound.integrity.monitoring.detection_kernel import UNRESOLVED as FDE_UNRESOLVED
from lanebound.integrity.monitoring.detection_kernel import detect_and_exclude
from lanebound.integrity.monitoring.geometry_kernel import SOLVED, capacity, find_geometry, geometry_scratch, solve
from lanebound.integrity.monitoring.separation_kernel import mode_scratch, moment_scratch
from lanebound.integrity.positioning.resolve_kernel import Carriers, Rules, resolve
from lanebound.integrity.positioning.rtk_kernel import collapse_code, collapse_phase, drop_small_systems
from lanebound.integrity.positioning.slip_watch_kernel import NW, SlipRules, watch_slips

TENTH = math.log(10.0) / 10.0
UNUSED = 1e6  # variance factor of a satellite out of use: held perhaps, but without a say
FIXED, NO_CORRECTIONS, TOO_FEW, NOT_CONVERGED, FAULT = 0, 1, 2, 3, 5  # codes of RtkStatus

# state
REJECTED, FIXES, REFUSED_S, WATCH = range(4)  # WATCH: NW entries of slip_watch_kernel
NX = WATCH + NW

# declared figures
(
    BANDS, SIN_MASK, CN0_MIN, SIGMA_CODE, SIGMA_PHASE, SIGMA_PHASE_PL, PHASE_BIAS, AGE_SIGMA, MAX_AGE,
    FIX_MAX_AGE, FIX_LIMIT, RATIO_MIN, MAX_CANDIDATES, MIN_SATELLITES, MIN_FURTHER, HOLD_FAILURES, ATTEMPTS,
    SLIP_K, SLIP_IONO, SLIP_FIT, SLIP_FAILURE, RETRY,
) = range(22)  # fmt: skip
NP = 22


class Signals(NamedTuple):
    """One epoch: e (S, 3), system, quality, tracked, cn0 (S,), code, phase (S, 2), lock_lost (S,), age []."""

    e: Any
    system: Any
    quality: Any
    tracked: Any
    cn0: Any
    code: Any
    phase: Any
    lock_lost: Any
    age: Any


class Tables(NamedTuple):
    """par (NP,), wavelength (systems, 2), fixable (S,), fit of Rules; chi2, normal and fde (3,) of the fault test."""

    par: Any
    wavelength: Any
    fixable: Any
    fit: Any
    chi2: Any
    normal: Any
    fde: Any


class Fixed(NamedTuple):
    """Of the fixed solution: geo, its rows (4, W), their e (W, 3) and group (W,); moments and modes of its levels."""

    geo: Any
    rows: Any
    e: Any
    group: Any
    moments: Any
    modes: Any


@jit
def fixed_scratch(n):  # type: ignore[no-untyped-def]
    """Allocate a Fixed for up to n satellites."""
    w = capacity(n)
    return Fixed(
        geometry_scratch(n), np.zeros((4, w)), np.zeros((w, 3)), np.zeros(w, dtype=np.int64), moment_scratch(n),
        mode_scratch(n),
    )  # fmt: skip


@jit
def weigh(e, tracked, cn0, cn0_knee, quality):  # type: ignore[no-untyped-def]
    """Variance factor ``(1 + 1/sin^2 el)/2 * (1 + 10^((knee - C/N0)/10))`` of S satellites, UNUSED if not tracked.

    The elevation part is RTKLIB's ``a^2 + (a/sin el)^2`` scaled to 1 at the zenith; the C/N0 part doubles the
    variance at the knee (sigma-epsilon model of Hartinger and Brunner 1999).
    """
    for s in range(tracked.shape[0]):
        quality[s] = UNUSED
        if tracked[s]:
            sine = e[s, 2]
            quality[s] = 0.5 * (1.0 + 1.0 / (sine * sine)) * (1.0 + math.exp(TENTH * (cn0_knee - cn0[s])))


@jit
def select(e, tracked, cn0, quality, sin_mask, cn0_min, factor, used):  # type: ignore[no-untyped-def]
    """Who of S satellites is used: high and strong enough; their variance factors, UNUSED of the others."""
    for s in range(tracked.shape[0]):
        used[s] = tracked[s] and e[s, 2] > sin_mask and cn0[s] >= cn0_min
        factor[s] = quality[s] if used[s] else UNUSED


@jit
def keep_lock(signals, bands, held, phase_ok):  # type: ignore[no-untyped-def]
    """Which carriers are locked on every band; a satellite that lost its lock loses its held integers."""
    phase, tracked, lost = signals.phase, signals.tracked, signals.lock_lost
    for s in range(phase_ok.shape[0]):
        locked = tracked[s] and phase[s, 0] != 0.0 and (bands == 1 or phase[s, 1] != 0.0)
        if not locked or lost[s]:
            held[s] = False
        phase_ok[s] = locked


@jit
def test(e, system, variance, y, member, tables, x, q):  # type: ignore[no-untyped-def]
    """Detect and exclude among the members in place: FDE outcome and number excluded; x (3,), q (3, 3) are filled."""
    fde = tables.fde
    outcome, _, _, _, excluded = detect_and_exclude(
        e, system, variance, y, member, tables.chi2, tables.normal, fde[0] > 0.0, int(fde[1]), int(fde[2]), x, q
    )
    return outcome, excluded


@jit
def let_slips_go(signals, tables, fixes, x, last, motion, factor, phase_ok):  # type: ignore[no-untyped-def]
    """Repair or let go what slipped unseen by the receiver since the last epoch, before it biases the position."""
    par = tables.par
    rules = SlipRules(
        int(par[BANDS]), tables.wavelength, par[SLIP_K], par[SLIP_IONO], par[SLIP_FIT], par[SLIP_FAILURE],
        par[FIX_LIMIT], par[AGE_SIGMA],
    )  # fmt: skip
    x[FIXES] += watch_slips(
        signals.e, signals.system, signals.phase, factor * par[SIGMA_PHASE] ** 2, phase_ok, signals.age, motion,
        fixes, rules, x[WATCH:], last, int(x[FIXES]) + 1,
    )  # fmt: skip


@jit
def find_candidates(used, phase_ok, fixable, held, candidate):  # type: ignore[no-untyped-def]
    """Which carriers could be fixed that are not; whether there are any."""
    found = False
    for s in range(used.shape[0]):
        candidate[s] = used[s] and phase_ok[s] and fixable[s] and not held[s]
        found = found or candidate[s]
    return found


@jit
def find_members(held, used, system, par, member):  # type: ignore[no-untyped-def]
    """The fixed carriers in use, without systems that bring too few: how many, and whether they make a position."""
    for s in range(used.shape[0]):
        member[s] = held[s] and used[s]
    count, systems = drop_small_systems(member, system, int(par[MIN_FURTHER]))
    return count, systems > 0 and count >= par[MIN_SATELLITES] + par[MIN_FURTHER] * (systems - 1)


@jit
def is_due(x, dt, positioned):  # type: ignore[no-untyped-def]
    """Whether to resolve now: always without a position, else when RETRY has passed since a refusal."""
    x[REFUSED_S] = max(x[REFUSED_S] - dt, 0.0)
    return not positioned or not x[REFUSED_S] > 0.5 * dt


@jit
def rtk(signals, tables, fixes, x, last, motion, sin_h, cos_h, fixed):  # type: ignore[no-untyped-def]
    """One epoch of RTK: keep lock, resolve what is not held, solve with the held phases, test and exclude.

    The fixed position takes the phases alone: the code's share of the weight is the inverse square of the code/phase
    ratio, 1/5000, and would only bring in its multipath. On success ``fixed`` holds the fault-free solution. ``last``
    (S, 2) and the end of ``x`` are what :mod:`.positioning.slip_watch_kernel` keeps.

    Returns the status, satellites in the solution, excluded, and HDOP.
    """
    par, held, n_sat = tables.par, fixes.held, signals.system.shape[0]
    flags, factor = np.empty((4, n_sat), dtype=np.bool_), np.empty(n_sat)
    phase_ok, used, candidate, member = flags[0], flags[1], flags[2], flags[3]
    keep_lock(signals, int(par[BANDS]), held, phase_ok)
    select(signals.e, signals.tracked, signals.cn0, signals.quality, par[SIN_MASK], par[CN0_MIN], factor, used)
    let_slips_go(signals, tables, fixes, x, last, motion, factor, phase_ok)
    if not signals.age <= par[MAX_AGE]:
        x[REJECTED] = 0.0
        return NO_CORRECTIONS, 0, 0, math.inf
    aged = (par[AGE_SIGMA] * signals.age) ** 2  # of the whole range, common to the bands
    status, new = FIXED, find_candidates(used, phase_ok, tables.fixable, held, candidate)
    count, positioned = find_members(held, used, signals.system, par, member)
    due = is_due(x, motion.dt, positioned)
    if due and new and signals.age <= par[FIX_MAX_AGE]:
        status = resolve_now(signals, tables, fixes, used, candidate, factor, aged, x)
        x[REFUSED_S] = par[RETRY] if status != FIXED else 0.0
        count, positioned = find_members(held, used, signals.system, par, member)
    if not positioned:
        return (status if status != FIXED else TOO_FEW), count, 0, math.inf
    return solve_fixed(signals, tables, fixes, member, count, factor, aged, x, sin_h, cos_h, fixed)


@jit
def resolve_now(signals, tables, fixes, used, candidate, factor, aged, x):  # type: ignore[no-untyped-def]
    """Check the code by its own residuals, then fix what the risk allows; returns a status."""
    par = tables.par
    bands = int(par[BANDS])
    y, position, q = np.empty(used.shape[0]), np.empty(3), np.empty((3, 3))
    collapse_code(signals.code, bands, y)
    variance_code = factor * (par[SIGMA_CODE] ** 2 / bands)
    outcome, _ = test(signals.e, signals.system, variance_code, y, used.copy(), tables, position, q)
    if outcome > FDE_EXCLUDED:
        return NOT_CONVERGED
    x[FIXES] += 1.0
    rules = Rules(
        bands, tables.wavelength, par[FIX_LIMIT], par[RATIO_MIN], tables.fit, int(par[ATTEMPTS]),
        int(par[MAX_CANDIDATES]), int(par[MIN_SATELLITES]), int(par[MIN_FURTHER]),
    )  # fmt: skip
    carriers = Carriers(signals.e, signals.system, signals.phase, factor * par[SIGMA_PHASE] ** 2 + aged)
    return resolve(carriers, candidate, fixes, rules, position, q, int(x[FIXES]))


@jit
def solve_fixed(  # type: ignore[no-untyped-def]
    signals, tables, fixes, member, count, factor, aged, x, sin_h, cos_h, fixed
):
    """Test the members of the fixed solution, let go of what is excluded, and fill ``fixed`` with the rest.

    The rows hold variance for integrity, bias bound, measurement, and variance for accuracy. Returns as :func:`rtk`.
    """
    par, bands = tables.par, int(tables.par[BANDS])
    y, position, q, tried = np.empty(factor.shape[0]), np.empty(3), np.empty((3, 3)), member.copy()
    collapse_phase(signals.phase, fixes.integers, tables.wavelength, signals.system, bands, y)
    variance = factor * (par[SIGMA_PHASE] ** 2 / bands) + aged
    outcome, excluded = test(signals.e, signals.system, variance, y, member, tables, position, q)
    if outcome == FDE_UNRESOLVED:
        x[REJECTED] += 1.0
        if x[REJECTED] >= par[HOLD_FAILURES]:
            fixes.held[:] = False
            x[REJECTED] = 0.0
        return FAULT, count, excluded, math.inf
    x[REJECTED] = 0.0
    if outcome > FDE_EXCLUDED:
        return TOO_FEW, count, excluded, math.inf
    n, rows, e, group = 0, fixed.rows, fixed.e, fixed.group
    held, los, system, nominal = fixes.held, signals.e, signals.system, par[SIGMA_PHASE_PL] ** 2
    for s in range(member.shape[0]):
        if tried[s] and not member[s]:
            held[s] = False
        if member[s]:
            e[n, 0], e[n, 1], e[n, 2], group[n] = los[s, 0], los[s, 1], los[s, 2], system[s]
            rows[0, n], rows[1, n] = factor[s] * nominal + aged, par[PHASE_BIAS]
            rows[2, n], rows[3, n] = y[s], variance[s]
            n += 1
    if find_geometry(e, group, rows[0], rows[1], n, sin_h, cos_h, fixed.geo) != SOLVED:
        return TOO_FEW, n, excluded, math.inf
    solve(rows[2], group, n, fixed.geo)
    return FIXED, n, excluded, hdop_of(signals.e, signals.system, member)
