"""Undetected cycle slips of held carriers, found at their epoch and repaired or let go.

Between two epochs each held phase changes by ``-e.dx``, the clocks, and whatever its integers do. ``dx`` comes from
the Doppler velocities of both epochs, the clocks are the median of each system and band, and what remains is judged by
:mod:`.cycle_slips_kernel`. The lines of sight turn from epoch to epoch: phases are kept relative to a point near the
vehicle (``phase + e.anchor``), which leaves of the turn only its product with the distance to that point.

``watch`` (NW,) and ``last`` (S, 2), zeros before the first epoch, are what lasts: the last velocity, anchor and age of
corrections, and the last phases relative to the anchor (0: not followed).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.positioning.cycle_slips_kernel import (
    GEOMETRY_FREE,
    NO_SLIP,
    REPAIRED,
    detect_slip,
    remove_common,
    repair_slip,
)
from lanebound.integrity.positioning.rtk_kernel import held_risk

__all__ = ["NW", "Motion", "SlipRules", "watch_slips"]

W_E, W_N, W_U, W_MOVING, W_ANCHOR, W_AGE = 0, 1, 2, 3, 4, 7
NW = 8
REPAIR_SHARE = 0.1  # of the risk of wrong integers, for one repair


class Motion(NamedTuple):
    """dt [s], Doppler velocity (3,) and its covariance (3, 3) when ``solved``, and a point near the vehicle (3,)."""

    dt: Any
    solved: Any
    velocity: Any
    q: Any
    anchor: Any


class SlipRules(NamedTuple):
    """Thresholds of CycleSlipConfig, and what they stand on.

    bands, wavelength (systems, 2) [m]; ``k`` standard deviations of a test; ``iono`` [m/s]; ``fit`` of a repair;
    ``failure`` rate of a repair; ``limit`` of the risk of all integers; ``aged`` [m/s] growth of errors with the age.
    """

    bands: Any
    wavelength: Any
    k: Any
    iono: Any
    fit: Any
    failure: Any
    limit: Any
    aged: Any


@jit
def changes(e, phase, rows, n, motion, watch, last, moved):  # type: ignore[no-untyped-def]
    """Changes (2, n) of the phases in ``rows`` beyond those that the Doppler motion explains; whether it is known."""
    known, velocity, half = motion.solved and watch[W_MOVING] > 0.0, motion.velocity, 0.5 * motion.dt
    place = np.empty(3)
    for k in range(3):
        place[k] = watch[W_ANCHOR + k] + (half * (watch[W_E + k] + velocity[k]) if known else 0.0)
    for i in range(n):
        s = rows[i]
        along = e[s, 0] * place[0] + e[s, 1] * place[1] + e[s, 2] * place[2]
        moved[0, i], moved[1, i] = phase[s, 0] + along - last[s, 0], phase[s, 1] + along - last[s, 1]
    return known


@jit
def remember(e, phase, phase_ok, age, motion, watch, last):  # type: ignore[no-untyped-def]
    """Keep this epoch for the next one."""
    velocity, anchor = motion.velocity, motion.anchor
    for k in range(3):
        watch[W_E + k] = velocity[k] if motion.solved else 0.0
        watch[W_ANCHOR + k] = anchor[k]
    watch[W_MOVING] = 1.0 if motion.solved else 0.0
    watch[W_AGE] = age
    for s in range(phase_ok.shape[0]):
        last[s, 0], last[s, 1] = 0.0, 0.0
        if phase_ok[s] and age < math.inf:
            along = e[s, 0] * anchor[0] + e[s, 1] * anchor[1] + e[s, 2] * anchor[2]
            last[s, 0], last[s, 1] = phase[s, 0] + along, phase[s, 1] + along


@jit
def predicted_sigma(x, y, z, q, dt, known, drift):  # type: ignore[no-untyped-def]
    """Standard deviation of the predicted change along (x, y, z), ``drift`` [m] that of the ageing corrections."""
    if not known:
        return math.inf
    variance = x * x * q[0, 0] + y * y * q[1, 1] + z * z * q[2, 2]
    variance += 2.0 * (x * y * q[0, 1] + x * z * q[0, 2] + y * z * q[1, 2])
    return math.sqrt(variance * dt * dt + drift * drift)


@jit
def repair(s, d1, d2, s_phase, s_p, s_iono, system, fixes, rules, next_id):  # type: ignore[no-untyped-def]
    """Move the integers of satellite s by the slip if only one explains the jump and the risk allows; else let it go.

    A repaired satellite has a fix of its own, with the risk of the old one and that of the repair.
    """
    slips, failure = np.zeros(2), min(rules.failure, REPAIR_SHARE * rules.limit)
    c, risk = system[s], fixes.fix_risk[s] + failure
    fixes.held[s] = False
    if not s_p < math.inf or held_risk(fixes.held, fixes.fix_id, fixes.fix_risk) + risk > rules.limit:
        return
    wave_2 = rules.wavelength[c, 1] if rules.bands == 2 else 0.0
    if repair_slip(
        d1, d2, rules.wavelength[c, 0], wave_2, 0.0, 0.0, s_phase, s_p, s_iono, failure, rules.fit, slips
    ) != REPAIRED:  # fmt: skip
        return
    fixes.held[s], fixes.fix_id[s], fixes.fix_risk[s] = True, next_id, risk
    for b in range(2):
        fixes.integers[s, b] += slips[b]


@jit
def judge(e, system, variance, rows, n, moved, known, drift, motion, rules, flags, s_p):  # type: ignore[no-untyped-def]
    """Flags (n,) of :func:`~.cycle_slips_kernel.detect_slip` for the changes ``moved`` (2, n); fills ``s_p`` (n,) too.

    A prediction that most carriers contradict is itself wrong, and counts for nothing. The code is not asked: in a
    street its reflections come and go from epoch to epoch.
    """
    wavelength, q, dt, k, iono = rules.wavelength, motion.q, motion.dt, rules.k, rules.iono * motion.dt
    wave_2, contradicted = 0.0, 0
    for attempt in range(2):
        for i in range(n):
            s, c = rows[i], system[rows[i]]
            s_p[i] = predicted_sigma(e[s, 0], e[s, 1], e[s, 2], q, dt, known, drift)
            if rules.bands == 2:
                wave_2 = wavelength[c, 1]
            flags[i] = detect_slip(
                moved[0, i], moved[1, i], wavelength[c, 0], wave_2, 0.0, 0.0, 0.0, 0.0,
                math.sqrt(variance[s]), s_p[i], iono, math.inf, k,
            )  # fmt: skip
            contradicted += flags[i] & ~GEOMETRY_FREE != 0
        if attempt == 1 or 2 * contradicted <= n:
            return
        known = False


@jit
def watch_slips(e, system, phase, variance, phase_ok, age, motion, fixes, rules, watch, last, next_id):  # type: ignore[no-untyped-def]
    """Test all held carriers for slips since the last epoch, in place; ``variance`` (S,) is that of one band [m^2].

    Returns how many were found; ``next_id`` and the numbers after it name the repaired ones.
    """
    rows, n, held = np.empty(phase_ok.shape[0], dtype=np.int64), 0, fixes.held
    for s in range(phase_ok.shape[0]):
        if held[s] and phase_ok[s] and last[s, 0] != 0.0:
            rows[n] = s
            n += 1
    found = 0
    if n > 0 and age < math.inf:
        moved, group, everything = np.empty((2, n)), np.empty(n, dtype=np.int64), np.ones(n, dtype=np.bool_)
        known = changes(e, phase, rows, n, motion, watch, last, moved)
        for i in range(n):
            group[i] = system[rows[i]]
        for b in range(rules.bands):
            remove_common(moved[b], everything, group, rules.wavelength.shape[0], moved[b])
        flags, s_p = np.empty(n, dtype=np.int64), np.empty(n)
        drift = rules.aged * abs(age - watch[W_AGE])
        judge(e, system, variance, rows, n, moved, known, drift, motion, rules, flags, s_p)
        for i in range(n):
            if flags[i] != NO_SLIP:
                repair(
                    rows[i], moved[0, i], moved[1, i], math.sqrt(variance[rows[i]]), s_p[i], rules.iono * motion.dt,
                    system, fixes, rules, next_id + found,
                )  # fmt: skip
                found += 1
    remember(e, phase, phase_ok, age, motion, watch, last)
    return found
