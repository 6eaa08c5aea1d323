"""Perception without errors: every vehicle as it is, nearest first."""

from __future__ import annotations

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.collisions_kernel import LENGTH_M, WIDTH_M
from lanebound.integrity.accel import jit

__all__ = ["see_truth"]


@jit
def see_truth(c, x, y, order, square, t):  # type: ignore[no-untyped-def]
    """Fill ``t`` (V - 1, SEEN) with all others, nearest to (x, y) first; ``order`` and ``square`` (V,) are scratch.

    Of two at one distance the first in the world comes first.
    """
    count = c.shape[1] - 1
    for i in range(1, count + 1):
        dx, dy = c[k.X, i] - x, c[k.Y, i] - y
        distance, at = dx * dx + dy * dy, i - 1
        while at > 0 and square[at - 1] > distance:
            square[at], order[at] = square[at - 1], order[at - 1]
            at -= 1
        square[at], order[at] = distance, i
    for n in range(count):
        i = order[n]
        t[n, k.T_X], t[n, k.T_Y] = c[k.X, i], c[k.Y, i]
        t[n, k.T_HEADING], t[n, k.T_SPEED] = c[k.HEADING, i], c[k.SPEED, i]
        t[n, k.T_PL_AT] = t[n, k.T_PL_CT] = t[n, k.T_AGE] = t[n, k.T_RELATIVE] = 0.0
        t[n, k.T_LENGTH], t[n, k.T_WIDTH] = LENGTH_M, WIDTH_M
    return count
