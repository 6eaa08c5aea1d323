"""Undetected cycle slips of held carriers, found at their epoch and repaired or released.

Between two epochs each held phase changes by ``-e.dx``, the clocks, and whatever its integers do. ``dx`` comes from
the Doppler velocities of both epochs, the clocks are the median of each system and band, and
:mod:`.cycle_slips_kernel` tests what remains. The lines of sight turn from epoch to epoch: phases are stored relative
to a point near the vehicle (``phase + e.anchor``), which leaves of the turn only its product with the distance to that
point.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.positioning.cycle_slips_kernel import (
    GEOMETRY_FREE,
    NO_SLIP,
    REPAIRED,
    Changes,
    Deviations,
    detect_slip,
    remove_common,
    repair_slip,
)
from lanebound.integrity.positioning.rtk_kernel import Carriers, held_risk

__all__ = ["SLIP_RULES", "SLIP_WATCH", "DopplerMotion", "watch_slips"]

Array = NDArray[np.float64]

REPAIR_SHARE = 0.1  # of the risk of wrong integers, for one repair

SLIP_WATCH = record(
    velocity=("f8", (3,), "of the last epoch, zeros without one [m/s]"),
    moving=("?", "the last epoch had a velocity"),
    anchor=("f8", (3,), "point to which the last phases are relative [m]"),
    age="age of the corrections at the last epoch [s]",
)
"""What the slip test stores of the last epoch; zeros before the first one. The phases are in AMBIGUITY."""

SLIP_RULES = record(
    k="standard deviations at which a test rejects [-]",
    ionosphere="standard deviation of the rate of phase 1 - phase 2 [m/s]",
    fit="largest squared norm of a repair [-]",
    failure="failure rate of a repair [-]",
)
"""CycleSlipConfig as the kernel takes it."""


class DopplerMotion(NamedTuple):
    """dt [s], Doppler velocity (3,) and its covariance (3, 3) when ``solved``, and a point near the vehicle (3,)."""

    dt: float
    solved: bool
    velocity: Array
    q: Array
    anchor: Array


@jit(borrows=True)
def _changes(
    carriers: Carriers, ambiguities: Records, rows: NDArray[np.int64], n: int, motion: DopplerMotion, watch: Any,
    moved: Array,
) -> bool:  # fmt: skip
    """Changes (2, n) of the phases in ``rows`` beyond those that the Doppler motion explains; whether it is known."""
    velocity, half = motion.velocity, 0.5 * motion.dt
    known = motion.solved and watch.moving
    x = watch.anchor[0] + (half * (watch.velocity[0] + velocity[0]) if known else 0.0)
    y = watch.anchor[1] + (half * (watch.velocity[1] + velocity[1]) if known else 0.0)
    z = watch.anchor[2] + (half * (watch.velocity[2] + velocity[2]) if known else 0.0)
    for i in range(n):
        signal, last = carriers.signals[rows[i]], ambiguities[rows[i]].last_phase
        along = signal.e[0] * x + signal.e[1] * y + signal.e[2] * z
        moved[0, i], moved[1, i] = signal.phase[0] + along - last[0], signal.phase[1] + along - last[1]
    return known


@jit(borrows=True)
def _store(
    carriers: Carriers, marks: Records, age: float, motion: DopplerMotion, ambiguities: Records, watch: Any
) -> None:
    """Store this epoch for the next one."""
    anchor = motion.anchor
    for k in range(3):
        watch.velocity[k] = motion.velocity[k] if motion.solved else 0.0
        watch.anchor[k] = anchor[k]
    watch.moving = motion.solved
    watch.age = age
    for s in range(marks.shape[0]):
        last, signal = ambiguities[s].last_phase, carriers.signals[s]
        last[0], last[1] = 0.0, 0.0
        if marks[s].phase_ok and age < math.inf:
            along = signal.e[0] * anchor[0] + signal.e[1] * anchor[1] + signal.e[2] * anchor[2]
            last[0], last[1] = signal.phase[0] + along, signal.phase[1] + along


@jit
def _predicted_sigma(x: float, y: float, z: float, q: Array, dt: float, known: bool, drift: float) -> float:
    """Standard deviation of the predicted change along (x, y, z), ``drift`` [m] that of the ageing corrections."""
    if not known:
        return math.inf
    variance = x * x * q[0, 0] + y * y * q[1, 1] + z * z * q[2, 2]
    variance += 2.0 * (x * y * q[0, 1] + x * z * q[0, 2] + y * z * q[1, 2])
    return math.sqrt(variance * dt * dt + drift * drift)


@jit(inline=True)
def _repair(
    s: int, change: Changes, deviation: Deviations, carriers: Carriers, ambiguities: Records, rtk: Any, slips: Any,
    next_id: int,
) -> None:  # fmt: skip
    """Move the integers of satellite s by the slip if only one explains the jump and the risk allows; else release it.

    A repaired satellite has a fix of its own, with the risk of the old one and that of the repair.
    """
    held, found = ambiguities[s], np.zeros(2)
    failure = min(slips.failure, REPAIR_SHARE * rtk.fix_limit)
    risk = held.fix_risk + failure
    held.held = False
    if not deviation.predicted < math.inf or held_risk(ambiguities) + risk > rtk.fix_limit:
        return
    wavelength = carriers.satellites[s].wavelength
    second = wavelength[1] if rtk.bands == 2 else 0.0
    if repair_slip(change, wavelength[0], second, deviation, failure, slips.fit, found) != REPAIRED:
        return
    held.held, held.fix_id, held.fix_risk = True, next_id, risk
    for b in range(2):
        held.integers[b] += found[b]


@jit(borrows=True)
def _judge(
    carriers: Carriers, rows: NDArray[np.int64], n: int, moved: Array, known: bool, drift: float,
    motion: DopplerMotion, rtk: Any, slips: Any, flags: NDArray[np.int64], s_p: Array,
) -> None:  # fmt: skip
    """Flags (n,) of :func:`~.cycle_slips_kernel.detect_slip` for the changes ``moved`` (2, n); fills ``s_p`` (n,) too.

    A prediction that most carriers contradict is itself wrong and is not used. The code is not tested: in a street its
    reflections change from epoch to epoch.
    """
    q, dt, ionosphere = motion.q, motion.dt, slips.ionosphere * motion.dt
    contradicted = 0
    for attempt in range(2):
        for i in range(n):
            s, e = rows[i], carriers.signals[rows[i]].e
            s_p[i] = _predicted_sigma(e[0], e[1], e[2], q, dt, known, drift)
            wavelength = carriers.satellites[s].wavelength
            second = wavelength[1] if rtk.bands == 2 else 0.0
            change = Changes(moved[0, i], moved[1, i], 0.0, 0.0, 0.0, 0.0)
            deviation = Deviations(math.sqrt(carriers.variance[s]), s_p[i], ionosphere, math.inf)
            flags[i] = detect_slip(change, wavelength[0], second, deviation, slips.k)
            contradicted += flags[i] & ~GEOMETRY_FREE != 0
        if attempt == 1 or 2 * contradicted <= n:
            return
        known = False


@jit(inline=True)
def watch_slips(
    carriers: Carriers, marks: Records, age: float, motion: DopplerMotion, ambiguities: Records, rtk: Any,
    slips: Any, watch: Any, next_id: int,
) -> int:  # fmt: skip
    """Test all held carriers for slips since the last epoch, in place.

    marks (S,) of MARK, rtk of RTK_RULES, slips of SLIP_RULES, watch of SLIP_WATCH. Returns how many were found;
    ``next_id`` and the numbers after it name the repaired ones.
    """
    n_sat = marks.shape[0]
    rows, n = np.empty(n_sat, dtype=np.int64), 0
    for s in range(n_sat):
        if ambiguities[s].held and marks[s].phase_ok and ambiguities[s].last_phase[0] != 0.0:
            rows[n] = s
            n += 1
    found = 0
    if n > 0 and age < math.inf:
        moved, group, everything = np.empty((2, n)), np.empty(n, dtype=np.int64), np.ones(n, dtype=np.bool_)
        known, systems = _changes(carriers, ambiguities, rows, n, motion, watch, moved), 0
        for i in range(n):
            group[i] = carriers.satellites[rows[i]].system
            systems = max(systems, group[i] + 1)
        for b in range(rtk.bands):
            remove_common(moved[b], everything, group, systems, moved[b])
        flags, s_p = np.empty(n, dtype=np.int64), np.empty(n)
        drift = rtk.age_sigma * abs(age - watch.age)
        _judge(carriers, rows, n, moved, known, drift, motion, rtk, slips, flags, s_p)
        for i in range(n):
            if flags[i] != NO_SLIP:
                change = Changes(moved[0, i], moved[1, i], 0.0, 0.0, 0.0, 0.0)
                deviation = Deviations(
                    math.sqrt(carriers.variance[rows[i]]), s_p[i], slips.ionosphere * motion.dt, math.inf
                )
                _repair(rows[i], change, deviation, carriers, ambiguities, rtk, slips, next_id + found)
                found += 1
    _store(carriers, marks, age, motion, ambiguities, watch)
    return found
