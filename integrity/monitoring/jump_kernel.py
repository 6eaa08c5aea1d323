"""The jump monitor: RTK against the position expected of it, and a quarantine after repeated contradictions.

Each epoch the position first moves on from the last RTK fix by Doppler or odometer, with the protection level that it
would have without RTK. When both levels hold, the new RTK position lies within their sum of it, on either axis. A wrong
fix, wrong reference coordinates or a spoofer that moves all satellites together violate this condition and no other:
their residuals are perfect. A slow drift violates it in no single epoch. Against drifts a backup solution dead-reckons
in parallel with RTK, for up to ``rtk.backup_s`` seconds, and then restarts at the RTK position. Where changes of
carriers move the position, which drift with the reference and with a spoofer as RTK does, it moves by gyro and
odometer, and RTK is also compared with it at the end of an outage. A contradiction
between the backup solution and RTK counts as a jump at the time when the backup solution started, and the position
returns to the backup solution. What follows a contradiction:

1. The first contradiction refuses RTK and releases the integers, so that a wrong fix does not last.
2. When integers resolved anew contradict as well, or lie nearer to the first ones than to the expected position, one of
   the two histories is wrong and the measurements do not show which. RTK is then in quarantine: a long one after a jump
   from one epoch to the next, a short one after the end of an outage, because odometers, gyros and reflections fail
   more often than all signals together. Meanwhile Doppler, which uses the same signals, neither moves the position nor
   calibrates the heading.
3. The same follows when Doppler and odometer contradict each other while RTK continues: one of them is wrong, and RTK
   may be wrong together with Doppler. It follows, too, when RTK drifts away from the path by gyro and odometer
   (:mod:`lanebound.integrity.positioning.drift_watch_kernel`). Either RTK drifts or gyro and odometer are wrong by as
   much in a second: the levels also cover the misfit of the window that showed it. They grow by the drift rate found,
   or by the present rate between RTK and the position if that is larger. The quarantine is the short one where the
   odometer explains the drift within its declared scale and Doppler agrees with RTK.
4. In all these cases the position continues with the remaining sensors, under an alert, and the levels cover both
   histories: that of dead reckoning, which grows, and that of RTK at the difference ``D``.
5. After the quarantine RTK is used again, wherever it is: the monitor cannot distinguish a spoofer that waits as long
   from a repair.

Not detected: a fault that exists at the first fix; a drift that stays within the levels of RTK and of the backup
solution for ten seconds, and within the limits of the drift watch.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = [
    "JUMP",
    "along_across",
    "begin_epoch",
    "bounded",
    "contradicts",
    "follow_drift",
    "grow_drift",
    "is_suspicious",
    "judge_jump",
    "suspects_signals",
    "widen",
]

Array = NDArray[np.float64]

# stages: no contradiction; one while RTK lasted, or at the end of an outage; in quarantine; after the quarantine
TRUSTED, JUMPED, RETURNED, WAITING, RELEASED = 0, 1, 2, 3, 4
LEAST_SPEED_MPS = 1.0  # to which the rate of a drift refers
SETTLED_S = 0.5  # of D, until a rate stands out of the noise of RTK
ACCEPTED, REFUSED, QUARANTINED = 0, 1, 2  # verdicts; REFUSED: release the integers

JUMP = record(
    stage=("i8", "TRUSTED, JUMPED, RETURNED, WAITING or RELEASED"),
    left_s="remaining time of the quarantine [s]",
    d_e="D, RTK position less the expected one, East [m]",
    d_n="D, North [m]",
    drifts=("?", "the drift watch contradicts RTK in this epoch"),
    drift_e="by how much RTK had drifted when it was found, East [m]",
    drift_n="the same, North [m]",
    rate_at="at what rate, along the track [m/s]",
    rate_ct="across [m/s]",
    drift_speed="speed at that time [m/s]",
    off_e="error of dead reckoning since, if gyro and odometer have that rate and not RTK, East [m]",
    off_n="the same, North [m]",
    by_odometer=("?", "the odometer explains the drift, and Doppler agrees with RTK"),
    found_s="time since the drift was found [s]",
    found_e="D at that time, East [m]",
    found_n="the same, North [m]",
)
"""State of the jump monitor."""


@jit
def along_across(east: float, north: float, sin_h: float, cos_h: float) -> tuple[float, float]:
    """Lengths along and across the track of a vector in E and N."""
    return abs(sin_h * east + cos_h * north), abs(cos_h * east - sin_h * north)


@jit
def contradicts(east: float, north: float, sin_h: float, cos_h: float, expected: Array, found: Array) -> bool:
    """Whether two positions (east, north) [m] apart cannot both be within their levels (2,) AT, CT [m]."""
    at, ct = along_across(east, north, sin_h, cos_h)
    return bool(at > expected[0] + found[0] or ct > expected[1] + found[1])


@jit
def bounded(level: Array) -> bool:
    """Whether there is a level on both axes, (2,)."""
    return bool(level[0] < np.inf and level[1] < np.inf)


@jit
def is_suspicious(jump: Any) -> bool:
    """Whether RTK has contradicted the expected position and has not been accepted since."""
    return bool(jump.stage != TRUSTED)


@jit
def suspects_signals(jump: Any) -> bool:
    """Whether Doppler must not be used either."""
    return bool(jump.stage == WAITING or jump.stage == JUMPED)


@jit
def clear(jump: Any) -> None:
    """No contradiction is known."""
    jump.stage, jump.left_s, jump.d_e, jump.d_n = TRUSTED, 0.0, 0.0, 0.0
    jump.drift_e, jump.drift_n, jump.rate_at, jump.rate_ct = 0.0, 0.0, 0.0, 0.0
    jump.off_e, jump.off_n, jump.by_odometer = 0.0, 0.0, False
    jump.found_s, jump.found_e, jump.found_n = 0.0, 0.0, 0.0


@jit
def grow_drift(dt: float, speed: float, sin_h: float, cos_h: float, jump: Any) -> None:
    """Advance by an epoch what gyro and odometer add if the drift that was found is theirs.

    An error of scale or course grows with the distance: its rate follows the speed [m/s], above that of the finding.
    """
    jump.found_s += dt
    time = dt * max(1.0, abs(speed) / max(jump.drift_speed, LEAST_SPEED_MPS))
    jump.off_e += time * (jump.rate_at * sin_h + jump.rate_ct * cos_h)
    jump.off_n += time * (jump.rate_at * cos_h - jump.rate_ct * sin_h)


@jit
def follow_drift(sin_h: float, cos_h: float, jump: Any) -> None:
    """Raise the rate of a drift to that of D since it was found: windows that began before it show a smaller one."""
    if jump.found_s < SETTLED_S or (jump.rate_at == 0.0 and jump.rate_ct == 0.0):
        return
    east, north = (jump.d_e - jump.found_e) / jump.found_s, (jump.d_n - jump.found_n) / jump.found_s
    along, across = sin_h * east + cos_h * north, cos_h * east - sin_h * north
    if abs(along) > abs(jump.rate_at):
        jump.rate_at = along
    if abs(across) > abs(jump.rate_ct):
        jump.rate_ct = across


@jit
def begin_epoch(dt: float, jump: Any) -> None:
    """Count down a quarantine by an epoch of ``dt`` [s]; RELEASED when it is over."""
    if jump.stage == WAITING:
        jump.left_s -= dt
        if not jump.left_s > 0.5 * dt:
            jump.left_s, jump.stage = 0.0, RELEASED


@jit(borrows=True)
def judge_jump(
    east: float, north: float, sin_h: float, cos_h: float, expected: Array, found: Array, lasting: bool, conflict: bool,
    after_jump_s: float, after_outage_s: float, jump: Any,
) -> int:  # fmt: skip
    """Verdict ACCEPTED, REFUSED or QUARANTINED on an RTK position (east, north) [m] from the expected one.

    Parameters
    ----------
    expected, found : (2,) levels AT, CT of the expected and of the RTK position [m], inf where there is none.
    lasting : the epoch before had an RTK position as well.
    conflict : Doppler and odometer have contradicted each other for a while, or RTK has drifted.
    after_jump_s, after_outage_s : lengths of the two quarantines [s].
    jump : JUMP, advanced in place.
    """
    if jump.stage == WAITING:
        jump.d_e, jump.d_n = east, north
        follow_drift(sin_h, cos_h, jump)
        return QUARANTINED
    if jump.stage == RELEASED:
        clear(jump)
        return ACCEPTED
    jumped = jump.stage == JUMPED
    together = conflict and (lasting or jumped)
    proven = bounded(expected) or not jumped  # without a level nothing refutes an earlier jump
    if jump.stage != TRUSTED:  # nor does a level that has only grown over the difference
        proven = proven and math.hypot(east, north) < math.hypot(east - jump.d_e, north - jump.d_n)
    if proven and not (together or contradicts(east, north, sin_h, cos_h, expected, found)):
        clear(jump)
        return ACCEPTED
    jump.d_e, jump.d_n = east, north
    if jump.stage == TRUSTED and not together:
        jump.stage = JUMPED if lasting else RETURNED
        return REFUSED
    short = jump.stage == RETURNED or (jump.drifts and jump.by_odometer)
    jump.left_s = after_outage_s if short else after_jump_s
    if jump.left_s > 0.0:
        jump.stage = WAITING
        jump.found_s, jump.found_e, jump.found_n = 0.0, east, north
        return QUARANTINED
    clear(jump)
    return ACCEPTED


@jit(borrows=True)
def widen(sin_h: float, cos_h: float, found: Array, jump: Any, pl: Array) -> None:
    """Widen the levels of dead reckoning pl (R, 2) in place to cover RTK's history too, of levels ``found`` (R, 2).

    A drift that was found may have begun before the backup solution did: its size is added, as its window showed it.
    So is what gyro and odometer add since, if the rate is theirs.
    """
    at, ct = along_across(jump.d_e, jump.d_n, sin_h, cos_h)
    drift_at, drift_ct = along_across(jump.drift_e, jump.drift_n, sin_h, cos_h)
    off_at, off_ct = along_across(jump.off_e, jump.off_n, sin_h, cos_h)
    for r in range(pl.shape[0]):
        pl[r, 0] += at + drift_at + off_at + found[r, 0]
        pl[r, 1] += ct + drift_ct + off_ct + found[r, 1]
