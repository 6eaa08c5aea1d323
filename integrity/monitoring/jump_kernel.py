"""RTK against the position that was expected of it: a jump that the levels of both do not allow.

Each epoch the position first goes on from the last RTK fix by Doppler or odometer, with the protection level it would
have had without RTK. When both levels hold, the new RTK position lies within their sum of it, on either axis. A wrong
fix, wrong reference coordinates or a spoofer that moves all satellites together break this and nothing else: their
residuals are perfect. What is done then:

1. The first contradiction refuses RTK and gives up the integers, so that a wrong fix heals by itself.
2. When integers resolved anew contradict as well, one of the two histories is wrong and nobody can say which. RTK is
   then used for how the vehicle *moves*, ``position = RTK - doubt``, so that nothing jumps in the driver's hands, and
   both histories are covered: every level grows by ``abs(doubt_q) + box_q``, where the box bounds what was expected.
3. When RTK jumps back, so that what is left of the doubt contradicts nothing, the doubt is gone.

A fault that is there from the first fix on, or creeps slower than the levels grow, does not jump and is not seen.

``doubt`` (DOUBT_SIZE,): DISPUTED 1 after a first contradiction; D_E, D_N [m] the sum of the jumps; BOX_E, BOX_N [m].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.accel import jit

__all__ = ["DOUBT_SIZE", "add_doubt", "contradicts", "judge_jump"]

Array = NDArray[np.float64]

DISPUTED, D_E, D_N, BOX_E, BOX_N = range(5)
DOUBT_SIZE = 5


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
def judge_jump(
    east: float, north: float, sin_h: float, cos_h: float, expected: Array, found: Array, doubt: Array
) -> bool:
    """Whether the RTK position may be used, (east, north) [m] from where it was expected; keeps the doubt.

    ``expected`` and ``found`` (2,) are the levels AT, CT of either [m], infinite where there is none.
    """
    if not contradicts(east, north, sin_h, cos_h, expected, found):
        doubt[DISPUTED] = 0.0
        return True
    if doubt[DISPUTED] == 0.0:
        doubt[DISPUTED] = 1.0
        return False
    east, north = doubt[D_E] + east, doubt[D_N] + north
    doubt[:] = 0.0
    if contradicts(east, north, sin_h, cos_h, expected, found):
        doubt[D_E], doubt[D_N] = east, north
        doubt[BOX_E] = abs(sin_h) * expected[0] + abs(cos_h) * expected[1]
        doubt[BOX_N] = abs(cos_h) * expected[0] + abs(sin_h) * expected[1]
    return True


@jit
def add_doubt(sin_h: float, cos_h: float, doubt: Array, pl: Array) -> None:
    """Widen the levels pl (R, 2) in place, so that they hold whichever history is the right one."""
    if doubt[D_E] == 0.0 and doubt[D_N] == 0.0:
        return
    at, ct = along_across(doubt[D_E], doubt[D_N], sin_h, cos_h)
    pl[:, 0] += at + abs(sin_h) * doubt[BOX_E] + abs(cos_h) * doubt[BOX_N]
    pl[:, 1] += ct + abs(cos_h) * doubt[BOX_E] + abs(sin_h) * doubt[BOX_N]
