"""Crashes between the vehicles of one environment, by highway-env's rule: boxes that meet, or will within a step.

Pairs are taken in the order of the vehicles, for the last one decides where a vehicle is thrown. Two boxes of equal
size are apart when their shadows on the normal of a side are. All sides are looked at: where one shadow holds the
other, opposite sides give different ways out.
"""

from __future__ import annotations

import math

from lanebound.envs.vector.columns_kernel import (
    COS,
    CRASHED,
    IMPACT_X,
    IMPACT_Y,
    ORDER,
    SIN,
    SPEED,
    STRUCK,
    X,
    Y,
    population,
)
from lanebound.integrity.core.accel import jit

__all__ = ["LENGTH_M", "WIDTH_M", "collide_all"]

LENGTH_M, WIDTH_M = 5.0, 2.0  # Vehicle.LENGTH and Vehicle.WIDTH of highway-env
DIAGONAL_M = math.sqrt(LENGTH_M**2 + WIDTH_M**2)
SPEED_MOST_MPS = 60.0  # no vehicle is faster: they are held at 40 m/s, which a step of full throttle can exceed


@jit(inline=True)
def _apart(low_a, high_a, low_b, high_b):  # type: ignore[no-untyped-def]
    """Distance between two intervals, negative when they overlap: from the end of the lower one to the other."""
    return low_b - high_a if low_a < low_b else low_a - high_b


@jit(inline=True)
def _reach(nx, ny, cosine, sine):  # type: ignore[no-untyped-def]
    """Half the shadow of a body on a unit normal."""
    return 0.5 * LENGTH_M * abs(nx * cosine + ny * sine) + 0.5 * WIDTH_M * abs(ny * cosine - nx * sine)


@jit
def collide(c, w, i, j, dt):  # type: ignore[no-untyped-def]
    """Let two vehicles meet: who overlaps has crashed, who will within ``dt`` is pushed apart half the way each."""
    dx, dy = c[X, i] - c[X, j], c[Y, i] - c[Y, j]
    swept_x = (c[SPEED, i] * c[COS, i] - c[SPEED, j] * c[COS, j]) * dt
    swept_y = (c[SPEED, i] * c[SIN, i] - c[SPEED, j] * c[SIN, j]) * dt
    now, soon, least, axis_x, axis_y = True, True, math.inf, 0.0, 0.0
    for side in range(8):
        k, flip = i if side < 4 else j, -1.0 if side % 4 >= 2 else 1.0
        across = side % 2 == 1
        nx = flip * (-c[SIN, k] if across else -c[COS, k])
        ny = flip * (c[COS, k] if across else -c[SIN, k])
        half_i, half_j = _reach(nx, ny, c[COS, i], c[SIN, i]), _reach(nx, ny, c[COS, j], c[SIN, j])
        centre = nx * dx + ny * dy
        low, high = centre - half_i, centre + half_i
        if _apart(low, high, -half_j, half_j) > 0.0:
            now = False
        move = nx * swept_x + ny * swept_y
        if move < 0.0:
            low += move
        else:
            high += move
        distance = _apart(low, high, -half_j, half_j)
        if distance > 0.0:
            soon = False
        if not (now or soon):
            return
        if abs(distance) < least:
            least = abs(distance)
            sign = 1.0 if centre > 0.0 else -1.0
            axis_x, axis_y = sign * nx, sign * ny
    if soon:
        c[IMPACT_X, i], c[IMPACT_Y, i] = 0.5 * least * axis_x, 0.5 * least * axis_y
        c[IMPACT_X, j], c[IMPACT_Y, j] = -0.5 * least * axis_x, -0.5 * least * axis_y
        w[STRUCK, i] = w[STRUCK, j] = 1
    if now:
        w[CRASHED, i] = w[CRASHED, j] = 1


@jit
def near(c, i, j, dt):  # type: ignore[no-untyped-def]
    """Whether a pair is looked at: middles nearer than the diagonals and the way of the first vehicle in a step."""
    dx, dy, reach = c[X, j] - c[X, i], c[Y, j] - c[Y, i], DIAGONAL_M + c[SPEED, i] * dt
    return reach >= 0.0 and dx * dx + dy * dy <= reach * reach


@jit
def collide_all(c, w, sorted_by_x, dt, pairs):  # type: ignore[no-untyped-def]
    """All pairs of an environment; ``pairs`` (P,) is scratch. ``sorted_by_x``: ``ORDER`` is that along x.

    Along x the search for partners ends where nobody can be near any more.
    """
    count = population(w)
    if not sorted_by_x or count * count > 2 * pairs.shape[0]:
        for i in range(count - 1):
            for j in range(i + 1, count):
                if near(c, i, j, dt):
                    collide(c, w, i, j, dt)
        return
    found, reach = 0, DIAGONAL_M + SPEED_MOST_MPS * dt
    for a in range(count - 1):
        k = w[ORDER, a]
        for b in range(a + 1, count):
            m = w[ORDER, b]
            if c[X, m] - c[X, k] > reach:
                break
            i, j = min(k, m), max(k, m)
            if near(c, i, j, dt):
                key, at = i * count + j, found
                while at > 0 and pairs[at - 1] > key:
                    pairs[at] = pairs[at - 1]
                    at -= 1
                pairs[at] = key
                found += 1
    for a in range(found):
        collide(c, w, pairs[a] // count, pairs[a] % count, dt)
