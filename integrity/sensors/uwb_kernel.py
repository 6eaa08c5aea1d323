"""Ranges between the modules of two vehicles: noise, delays by bodies in the way, link budget and loss.

A range in free sight is ``r = d + a_i + b_j + l + n``: distance d, constant errors a_i and b_j of both modules, white
noise n, and an excess l >= 0, exponential, in a share of the time when the receiver has taken a later path for the
first one. Pairs change their path at random, independently, after ``late_s`` in the mean. That the noise does not grow
with the distance follows from the Cramer-Rao bound ``c / (2 pi B sqrt(2 SNR))``: 2 cm at 10 dB with an effective
bandwidth B of 0.5 GHz, below the precision of the module at any usable distance.

A body in the way is passed by diffraction along the shortest string around it: over it, where it is higher than the
modules, or past its sides. The string exceeds the straight line by D, which is the delay. It also is the measure of the
loss: Fresnel's parameter is ``nu = 2 sqrt(D / lambda)``, and a knife edge costs ``J(nu) = 6.9 + 20 lg(sqrt((nu -
0.1)^2 + 1) + nu - 0.1)`` dB (ITU-R P.526-15, eq. 31). Delays and losses of several bodies add up. A range is lost when
its losses exceed the margin ``20 lg(range / d)``. So whatever is in the way, a range that arrives is late by at most
the D for which J is the margin (:func:`most_excess`), which a receiver knows without knowing what is in the way.

Of signal strength the losses themselves are the error: ``r = d 10^((J + x) / (10 n))`` with shadowing x, a first-order
Gauss-Markov process of ``late_s``.
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["LINK", "MODULE", "PAIRS", "RANGING", "around", "crosses_body", "crosses_wall", "knife_edge_db",
           "most_excess", "range_all"]  # fmt: skip

PAIRS = 4  # pairs of modules of two vehicles at most: pair 2 i + j is of the ego's module i and the other's j
ROUNDING = 1e-9
GRAZING_DB = 6.9 + 20.0 * math.log10(math.sqrt(1.01) - 0.1)  # J(0): an edge on the line

RANGING = record(
    modules=("i8", "of a vehicle"),
    arms=("f8", (2, 2), "places of the modules forward and right of the middle"),
    epoch_s="length of an epoch",
    rate_hz="ranges of a pair in a second",
    sigma_m="noise",
    module_sigma_m="constant error of a module",
    range_m="distance without a margin",
    wave_m="wavelength",
    loss="share lost in free space",
    late_share="share of ranges of a later path",
    late_mean_m="mean excess of these",
    late_s="mean time on one path",
    shadow_db="shadowing of the signal's strength, 0 for times",
    path="exponent of the path loss",
    height_m="of the modules",
    body_m="height of cars",
    tall_share="share of vans",
    tall_m="height of vans",
)
MODULE = record(
    error_m=("f8", (2,), "constant errors of the modules of a vehicle"),
    height_m="of the body",
)
LINK = record(
    known=("i8", "1 after the first range"),
    late_m="excess of the path that a pair is on, or its shadowing [dB]",
)


@jit(borrows=True)
def crosses_body(start_x, start_y, line_x, line_y, cos, sin, length, width):  # type: ignore[no-untyped-def]
    """Whether a line crosses a vehicle, from whose middle its start is at (start_x, start_y).

    Exact: a line and a rectangle are apart when their shadows on an axis of the rectangle, or on the normal of the
    line, are.
    """
    along, across = cos * line_x + sin * line_y, cos * line_y - sin * line_x
    if abs(2.0 * (cos * start_x + sin * start_y) + along) > abs(along) + length:
        return False
    if abs(2.0 * (cos * start_y - sin * start_x) + across) > abs(across) + width:
        return False
    twist = 2.0 * (start_x * line_y - start_y * line_x)
    return abs(twist) <= abs(across) * length + abs(along) * width


@jit(borrows=True)
def crosses_wall(x, y, line_x, line_y, wall):  # type: ignore[no-untyped-def]
    """Whether a line from (x, y) crosses a building: wall (4,), least and largest x, least and largest y.

    Of the line ``p + t d``, t in [0, 1], the parts between the two sides of a building along x and along y are found;
    it crosses the building where these have more than a point in common.
    """
    first, last = 0.0, 1.0
    for axis in range(2):
        start = x if axis == 0 else y
        way = line_x if axis == 0 else line_y
        low, high = wall[2 * axis] - start, wall[2 * axis + 1] - start
        if way == 0.0:
            if low >= 0.0 or high <= 0.0:
                last = -math.inf
        else:
            one, other = low / way, high / way
            first, last = max(first, min(one, other)), min(last, max(one, other))
    return first < last


@jit(borrows=True)
def around(line, corners, string):  # type: ignore[no-untyped-def]
    """How much longer the shortest way around a convex quadrangle is than a line of length ``line`` that crosses it.

    corners (4, 2): counterclockwise, by their distance along the line and beside it; string (6, 2) is scratch. On each
    side the way is a string pulled tight: end points and the corners of that side, less those where it would bend in.
    """
    least = math.inf
    for side in (1.0, -1.0):
        count, step, at = 1, 3 if side > 0.0 else 1, -1  # corners go round counterclockwise
        string[0, 0] = string[0, 1] = 0.0
        for k in range(4):  # the corner of this side that comes first on the way
            if side * corners[k, 1] > 0.0 and side * corners[(k + 4 - step) % 4, 1] <= 0.0:
                at = k
        if at < 0:
            return 0.0
        for k in range(4):
            corner = corners[(at + step * k) % 4]
            if side * corner[1] <= 0.0:
                break
            string[count, 0], string[count, 1] = corner[0], side * corner[1]
            count += 1
        string[count, 0], string[count, 1] = line, 0.0
        count += 1
        k = 1
        while k < count - 1:
            ax, ay = string[k, 0] - string[k - 1, 0], string[k, 1] - string[k - 1, 1]
            bx, by = string[k + 1, 0] - string[k, 0], string[k + 1, 1] - string[k, 1]
            if ax * by - ay * bx >= 0.0:  # it bends inwards
                for n in range(k, count - 1):
                    string[n, 0], string[n, 1] = string[n + 1, 0], string[n + 1, 1]
                count -= 1
                k = max(k - 1, 1)
            else:
                k += 1
        length = 0.0
        for n in range(1, count):
            length += math.hypot(string[n, 0] - string[n - 1, 0], string[n, 1] - string[n - 1, 1])
        least = min(least, length)
    return max(least - line, 0.0)


@jit(borrows=True)
def knife_edge_db(excess, wave):  # type: ignore[no-untyped-def]
    """Loss of a signal that passes an edge on a way ``excess`` longer than the line; ITU-R P.526-15, eq. 31."""
    bent = 2.0 * math.sqrt(excess / wave) - 0.1
    return 6.9 + 20.0 * math.log10(math.sqrt(bent * bent + 1.0) + bent)


@jit(borrows=True)
def most_excess(figures, distance):  # type: ignore[no-untyped-def]
    """The largest delay with which a diffracted signal still arrives: the excess at which J is the margin."""
    margin = 20.0 * math.log10(figures.range_m / max(distance, 1.0))
    if margin <= GRAZING_DB:
        return 0.0
    sum_of = 10.0 ** ((margin - 6.9) / 20.0)
    bent = 0.5 * (sum_of - 1.0 / sum_of) + 0.1
    return 0.25 * bent * bent * figures.wave_m


@jit(borrows=True)
def _body_excess(figures, line, along, across, car, height, cos, sin, start_x, start_y, corners, string):  # type: ignore[no-untyped-def]
    """Excess of the shortest way over or around a vehicle; (along, across): unit vector of the line."""
    first, last = math.inf, -math.inf
    for k in range(4):
        front = 0.5 * car.length if k in (0, 3) else -0.5 * car.length
        right = 0.5 * car.width if k < 2 else -0.5 * car.width
        x, y = cos * front - sin * right - start_x, sin * front + cos * right - start_y
        corners[k, 0], corners[k, 1] = x * along + y * across, y * along - x * across
    for k in range(4):  # where the line enters the body and leaves it
        a, b = corners[k], corners[(k + 1) % 4]
        if (a[1] > 0.0) != (b[1] > 0.0):
            at = a[0] + (b[0] - a[0]) * a[1] / (a[1] - b[1])
            first, last = min(first, at), max(last, at)
    first, last = max(first, 0.0), min(last, line)
    rise = height - figures.height_m
    over = math.hypot(first, rise) + math.hypot(line - last, rise) - first - (line - last) if last >= first else 0.0
    return min(over, around(line, corners, string))


@jit(borrows=True)
def _in_the_way(figures, x, y, line_x, line_y, cars, modules, ahead, walls, i, corners, string):  # type: ignore[no-untyped-def]
    """Delay [m] and loss [dB] of the line from (x, y) to vehicle ``i`` by third vehicles and by buildings."""
    delay, loss, line = 0.0, 0.0, math.hypot(line_x, line_y)
    along, across = line_x / line, line_y / line
    for j in range(1, cars.shape[0]):
        if j == i or cars[j].slot < 0 or modules[cars[j].slot].height_m <= figures.height_m:
            continue
        car, cos, sin = cars[j], ahead[j, 0], ahead[j, 1]
        dx, dy = x - car.x, y - car.y
        if crosses_body(dx, dy, line_x, line_y, cos, sin, car.length, car.width):
            height = modules[car.slot].height_m
            excess = _body_excess(figures, line, along, across, car, height, cos, sin, dx, dy, corners, string)
            delay += excess
            loss += knife_edge_db(excess, figures.wave_m)
    for k in range(walls.shape[0]):
        if crosses_wall(x, y, line_x, line_y, walls[k]):
            for n in range(4):
                dx = walls[k, 1 if n in (0, 3) else 0] - x
                dy = walls[k, 3 if n < 2 else 2] - y
                corners[n, 0], corners[n, 1] = dx * along + dy * across, dy * along - dx * across
            excess = around(line, corners, string)
            delay += excess
            loss += knife_edge_db(excess, figures.wave_m)
    return delay, loss


@jit(borrows=True)
def range_all(figures, cars, modules, links, walls, normal, uniform, ahead, scratch, out):  # type: ignore[no-untyped-def]
    """Ranges between an ego and the vehicles of C slots at one epoch, out (C, PAIRS), -1 for none.

    modules (C + 1,) MODULE by slot, the ego's last; links (C, PAIRS) LINK; walls (W, 4) buildings; normal (C + 1,
    PAIRS) and uniform (C + 1, 2 PAIRS): draws; ahead (V, 2) and scratch (10, 2) are scratch.
    """
    out[:] = -1.0
    ego, own, stays = cars[0], modules[modules.shape[0] - 1], math.exp(-1.0 / (figures.rate_hz * figures.late_s))
    for v in range(cars.shape[0]):
        ahead[v, 0], ahead[v, 1] = math.cos(cars[v].heading), math.sin(cars[v].heading)
    for v in range(1, cars.shape[0]):
        slot = cars[v].slot
        if slot < 0 or slot >= out.shape[0]:
            continue
        for i in range(figures.modules):
            x = ego.x + ahead[0, 0] * figures.arms[i, 0] - ahead[0, 1] * figures.arms[i, 1]
            y = ego.y + ahead[0, 1] * figures.arms[i, 0] + ahead[0, 0] * figures.arms[i, 1]
            for j in range(figures.modules):
                pair = 2 * i + j
                line_x = cars[v].x + ahead[v, 0] * figures.arms[j, 0] - ahead[v, 1] * figures.arms[j, 1] - x
                line_y = cars[v].y + ahead[v, 1] * figures.arms[j, 0] + ahead[v, 0] * figures.arms[j, 1] - y
                distance, link = math.hypot(line_x, line_y), links[slot, pair]
                n, u = normal[slot, pair], uniform[slot, 2 * pair]
                _change_path(figures, link, stays, n, uniform[slot, 2 * pair + 1])
                if distance >= figures.range_m or distance < ROUNDING:
                    continue
                delay, loss = _in_the_way(
                    figures, x, y, line_x, line_y, cars, modules, ahead, walls, v, scratch[:4], scratch[4:]
                )
                if u < figures.loss or loss > 20.0 * math.log10(figures.range_m / distance):
                    continue
                if figures.shadow_db > 0.0:
                    out[slot, pair] = distance * 10.0 ** ((loss + link.late_m) / (10.0 * figures.path))
                else:
                    constant = own.error_m[i] + modules[slot].error_m[j]
                    out[slot, pair] = max(distance + delay + link.late_m + constant + figures.sigma_m * n, 0.0)


@jit(borrows=True)
def _change_path(figures, link, stays, normal, uniform):  # type: ignore[no-untyped-def]
    """The path of a pair at the next range, or its shadowing."""
    stays = stays if link.known != 0 else 0.0
    link.known = 1
    if figures.shadow_db > 0.0:
        link.late_m = stays * link.late_m + math.sqrt(1.0 - stays * stays) * figures.shadow_db * normal
    elif uniform >= stays:
        late = (uniform - stays) / (1.0 - stays)
        taken = late < figures.late_share
        link.late_m = -figures.late_mean_m * math.log1p(-late / figures.late_share) if taken else 0.0
