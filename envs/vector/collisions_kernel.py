"""Crashes between the vehicles of one environment, by highway-env's rule: boxes that meet, or will within a step.

Pairs are taken in the order of the vehicles, as the last one decides where a vehicle is thrown. Two boxes are apart
when their shadows on the normal of a side are. All sides are looked at: where one shadow holds the other, opposite
sides give different ways out.
"""

from __future__ import annotations

import math

from lanebound.envs.vector.drivers_kernel import SPEED_MOST_MPS
from lanebound.integrity.core.accel import jit

__all__ = ["collide_all", "collide_ego", "collide_sorted"]

SPARE_MPS = 20.0  # by which a step of full throttle may exceed the largest speed
FIRST_BITS = 32  # a pair of vehicles in one number: the first one above, the second one below these bits


@jit(inline=True)
def _apart(low_a, high_a, low_b, high_b):  # type: ignore[no-untyped-def]
    """Distance between two intervals, negative when they overlap: from the end of the lower one to the other."""
    return low_b - high_a if low_a < low_b else low_a - high_b


@jit(inline=True)
def _reach(nx, ny, cosine, sine, length, width):  # type: ignore[no-untyped-def]
    """Half the shadow of a body on a unit normal."""
    return 0.5 * length * abs(nx * cosine + ny * sine) + 0.5 * width * abs(ny * cosine - nx * sine)


@jit(borrows=True)
def collide(v, i, j, dt):  # type: ignore[no-untyped-def]
    """Let two vehicles meet: those that overlap have crashed, those that will within ``dt`` part half the way each."""
    dx, dy = v.x[i] - v.x[j], v.y[i] - v.y[j]
    swept_x = (v.speed[i] * v.cos[i] - v.speed[j] * v.cos[j]) * dt
    swept_y = (v.speed[i] * v.sin[i] - v.speed[j] * v.sin[j]) * dt
    now, soon, least, axis_x, axis_y = True, True, math.inf, 0.0, 0.0
    for side in range(8):
        k, flip = i if side < 4 else j, -1.0 if side % 4 >= 2 else 1.0
        across = side % 2 == 1
        nx = flip * (-v.sin[k] if across else -v.cos[k])
        ny = flip * (v.cos[k] if across else -v.sin[k])
        half_i = _reach(nx, ny, v.cos[i], v.sin[i], v.length[i], v.width[i])
        half_j = _reach(nx, ny, v.cos[j], v.sin[j], v.length[j], v.width[j])
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
        v.impact_x[i], v.impact_y[i] = 0.5 * least * axis_x, 0.5 * least * axis_y
        v.impact_x[j], v.impact_y[j] = -0.5 * least * axis_x, -0.5 * least * axis_y
        v.struck[i] = v.struck[j] = 1
    if now:
        v.crashed[i] = v.crashed[j] = 1


@jit(inline=True)
def _near(v, i, j, dt, diagonal):  # type: ignore[no-untyped-def]
    """Whether a pair is looked at: middles nearer than the diagonals and the way of the first vehicle in a step."""
    dx, dy = v.x[j] - v.x[i], v.y[j] - v.y[i]
    reach = diagonal + v.speed[i] * dt
    return reach >= 0.0 and dx * dx + dy * dy <= reach * reach


@jit(inline=True)
def _diagonal(v):  # type: ignore[no-untyped-def]
    """Of all vehicles: those of compiled traffic are as large as the ego."""
    return math.sqrt(v.length[0] ** 2 + v.width[0] ** 2)


@jit(inline=True)
def collide_all(v, count, ego_place, dt):  # type: ignore[no-untyped-def]
    """All pairs of the first ``count`` vehicles, in the order of the world's list, and of them with the objects beyond.

    ``ego_place``: of the ego in that list; the others are in their own order.
    """
    diagonal = _diagonal(v)
    for a in range(count):
        i = _listed(a, ego_place)
        for b in range(a + 1, count):
            j = _listed(b, ego_place)
            if _near(v, i, j, dt, diagonal):
                collide(v, i, j, dt)
        for j in range(count, v.x.shape[0]):
            if _near(v, i, j, dt, 0.5 * (diagonal + math.sqrt(v.length[j] ** 2 + v.width[j] ** 2))):
                _hit(v, i, j, dt)


@jit(inline=True)
def collide_ego(v, dt):  # type: ignore[no-untyped-def]
    """The pairs with the ego alone, which is the first in the world's list."""
    diagonal = _diagonal(v)
    for i in range(1, v.x.shape[0]):
        if _near(v, 0, i, dt, diagonal):
            collide(v, 0, i, dt)


@jit(inline=True)
def _listed(place, ego_place):  # type: ignore[no-untyped-def]
    """The vehicle in a place of the world's list."""
    return place + 1 if place < ego_place else place if place > ego_place else 0


@jit(borrows=True)
def _hit(v, i, j, dt):  # type: ignore[no-untyped-def]
    """Let a vehicle meet an object that stands: the vehicle parts all the way."""
    v.struck[j] = 0
    collide(v, i, j, dt)
    if v.struck[j] != 0:
        v.impact_x[i] *= 2.0
        v.impact_y[i] *= 2.0


@jit(inline=True)
def collide_sorted(v, dt, pairs):  # type: ignore[no-untyped-def]
    """All pairs, where ``order`` is that along x: the search for partners ends where no vehicle can be near any more.

    ``pairs`` (P,) is scratch; with more vehicles than fit all pairs are looked at.
    """
    count = v.x.shape[0]
    if count * count > 2 * pairs.shape[0]:
        collide_all(v, count, 0, dt)
        return
    found, diagonal = 0, _diagonal(v)
    reach = diagonal + (SPEED_MOST_MPS + SPARE_MPS) * dt
    for a in range(count - 1):
        k = v.order[a]
        for b in range(a + 1, count):
            m = v.order[b]
            if v.x[m] - v.x[k] > reach:
                break
            i, j = min(k, m), max(k, m)
            if _near(v, i, j, dt, diagonal):
                key, at = i << FIRST_BITS | j, found
                while at > 0 and pairs[at - 1] > key:
                    pairs[at] = pairs[at - 1]
                    at -= 1
                pairs[at] = key
                found += 1
    for a in range(found):
        collide(v, pairs[a] >> FIRST_BITS, pairs[a] & (1 << FIRST_BITS) - 1, dt)
