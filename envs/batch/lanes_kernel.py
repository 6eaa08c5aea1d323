"""Lanes as records: where a point lies on a lane, which point lies where, and which lane is nearest to a pose.

Frame ``xy``: x ahead along the first road, y to its right; headings, offsets and curvatures are positive to the right.
The geometry of each kind is that of its class: highway-env's straight, sine and circular lanes, and ``CurveLane``,
which runs at a constant offset beside a path of cells with linear curvature (:mod:`..worlds.paths`). A lane of any
other class is known by samples of its centreline, 2 m apart, with cubic Hermite curves between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import Records, record

__all__ = [
    "ADVICE_STEP_M", "CELL", "CIRCLE", "CURVE", "JOINT", "LANE", "NODE", "NONE", "NOWHERE_M", "PAST_END_M", "SAMPLED",
    "SINE", "SQUARE_M", "STRAIGHT", "Lanes", "advised", "centre", "closest", "ends", "heading_at", "local", "nearest",
    "of_side", "on_lane", "place", "reachable", "stations", "straight", "width_at",
]  # fmt: skip

STRAIGHT, SINE, CIRCLE, CURVE, SAMPLED = 0, 1, 2, 3, 4  # kinds of lanes
NONE = -1  # no lane
PAST_END_M = 5.0  # AbstractLane.VEHICLE_LENGTH of highway-env: a lane holds vehicles so far past its ends
NOWHERE_M = -math.inf  # station on a lane that does not hold a point
CLOTHOID_STEPS, SAMPLED_STEPS = 6, 8
SQUARE_M = 8.0  # of the grid about a path, by which the search for a foot begins
ADVICE_STEP_M = 2.0  # between the speeds that a curve advises
NEAR_M = 1e-12
FEW = 8  # lanes of a loop
CLOSE = 1e-6  # relative to 1 m and the distance; rounding is a thousand times smaller up to 1000 km from the origin
GAUSS_1, GAUSS_2, GAUSS_3 = 0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)

LANE = record(
    kind=("i8", "STRAIGHT, SINE, CIRCLE, CURVE or SAMPLED"),
    x_m="first point of the centreline, x",
    y_m="first point of the centreline, y",
    heading_rad="direction at the first point",
    east="x of the unit vector along the axis of a straight or sine lane",
    south="y of that vector",
    length_m="along the centreline",
    width_m="of the lane; see width_at for sampled lanes",
    speed_limit_mps="0 for none",
    forbidden=("i8", "1 where vehicles may not change to the lane"),
    goal_shift=(
        "i8",
        "lanes to change to the right, negative to the left, to reach the goal of the network; 0 without",
    ),
    lost=("i8", "1 where no lane of the road leads to that goal"),
    geo_object=("i8", "number of the geo-object of which the road is a link, NONE for none"),
    side=("i8", "number on its road, 0 leftmost"),
    road=("i8", "row of the leftmost lane of the road, which names the road"),
    count=("i8", "number of lanes of the road"),
    onward=("i8", "lane of the same number on the only road that goes on, NONE where there is no such lane"),
    crossed=("i8", "1 where a lane of another road overlaps this one at more than 30 degrees"),
    joint_first=("i8", "first row of the joints of the road: roads that lead to it, then those that go on from it"),
    joint_onward=("i8", "row of the first of those that go on"),
    joint_last=("i8", "row after the last joint"),
    amplitude_m="of a sine lane",
    pulsation_radpm="of a sine lane",
    phase_rad="of a sine lane at its first point; of a circular lane the phase of its first point",
    centre_x_m="of a circular lane",
    centre_y_m="of a circular lane",
    radius_m="of a circular lane",
    turn="of a circular lane: 1 clockwise (to the right), -1 otherwise",
    offset_m="of a curve from its path, to the right",
    cell_first=("i8", "first cell of the path"),
    cell_last=("i8", "row after the last cell"),
    grid_x_m="corner of the grid of squares about the path of a curve, or about a sine or circular lane, x",
    grid_y_m="corner of the grid, y",
    grid_columns=("i8", "squares of the grid along x"),
    grid_rows=("i8", "squares of the grid along y"),
    grid_first=("i8", "first entry of the grid in near"),
    advice_first=("i8", "first entry in advice"),
    advice_last=("i8", "row after the last entry, advice_first for none"),
    node_first=("i8", "first node of the sampled centreline"),
    node_count=("i8", "number of nodes, 0 where the centreline is known in closed form"),
    node_step_m="between nodes",
)
CELL = record(
    x_m="first point, x",
    y_m="first point, y",
    heading_rad="direction at the first point",
    kappa_pm="curvature at the first point [1/m]",
    slope_pm2="change of curvature along the cell [1/m^2]",
    span_m="length of the cell",
    station_m="arc length of the path at the first point",
)
NODE = record(
    x=("f8", (4,), "coefficients of x in the share of the step, constant first [m]"),
    y=("f8", (4,), "coefficients of y [m]"),
    heading_rad="direction at the node",
    turn_rad="change of direction over the step",
    curvature_pm="mean over the step [1/m]",
    width_m="width of the lane at the node",
)
JOINT = record(
    road=("i8", "row of the leftmost lane of a road that meets an end of this one"),
    whole=("i8", "1 where all its lanes count as joined (junctions), 0 where the lane of the same number does"),
)


class Lanes(NamedTuple):
    """The lanes of a road network.

    table (L,) LANE, road by road from the left; cells (C,) CELL of paths; nodes (K,) NODE of sampled centrelines; near
    (G,) int: cell of its path to begin a search at, by square; joints (J,) JOINT; advice (A,): speed that the bends
    ahead allow [m/s], every 2 m of a lane.
    """

    table: Records
    cells: Records
    nodes: Records
    near: NDArray[np.int64]
    joints: Records
    advice: NDArray[np.float64]


# Curves beside a path


@jit(borrows=True)
def _advance(cell, into):  # type: ignore[no-untyped-def]
    """Pose at a distance into a cell: a chord on straights and arcs, three Gauss points on clothoids."""
    x, y, heading = cell.x_m, cell.y_m, cell.heading_rad
    kappa, slope = cell.kappa_pm, cell.slope_pm2
    if slope == 0.0:
        half = 0.5 * kappa * into
        chord = into if half == 0.0 else into * math.sin(half) / half
        return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2.0 * half
    for k in range(3):
        share = GAUSS_1 if k == 0 else GAUSS_2 if k == 1 else GAUSS_3
        weight = 8.0 / 18.0 if k == 1 else 5.0 / 18.0
        u = share * into
        angle = heading + (kappa + 0.5 * slope * u) * u
        x += weight * into * math.cos(angle)
        y += weight * into * math.sin(angle)
    return x, y, heading + (kappa + 0.5 * slope * into) * into


@jit(borrows=True)
def _foot(cell, x, y):  # type: ignore[no-untyped-def]
    """Distance into a cell of the foot of the normal through a point, which may lie outside it, and the offset."""
    heading = cell.heading_rad
    cosine, sine = math.cos(heading), math.sin(heading)
    dx, dy = x - cell.x_m, y - cell.y_m
    along, right = dx * cosine + dy * sine, dy * cosine - dx * sine
    kappa, slope = cell.kappa_pm, cell.slope_pm2
    if slope != 0.0:
        into, span = along / max(1.0 - kappa * right, 0.1), cell.span_m
        for _ in range(CLOTHOID_STEPS):
            into = min(max(into, -span), 2.0 * span)
            x0, y0, heading = _advance(cell, into)
            cosine, sine = math.cos(heading), math.sin(heading)
            ahead, right = (x - x0) * cosine + (y - y0) * sine, (y - y0) * cosine - (x - x0) * sine
            kappa = cell.kappa_pm + slope * into
            move = ahead / max(1.0 - kappa * right, 0.1)
            into += move
            if abs(move) < NEAR_M:
                break
        return into, right
    if kappa == 0.0:
        return along, right
    a, b = kappa * along, 1.0 - kappa * right
    gap = (kappa * right * (1.0 + b) - a * a) / (1.0 + math.hypot(a, b))
    return math.atan2(a, b) / kappa, gap / kappa


@jit(borrows=True)
def _project(lanes, lane, x, y):  # type: ignore[no-untyped-def]
    """Cell, distance into it and offset of the nearest point of a path: a walk from the cell that the grid names."""
    cells, low, last = lanes.cells, lane.cell_first, lane.cell_last - 1
    column = min(max(math.floor((x - lane.grid_x_m) / SQUARE_M), 0), lane.grid_columns - 1)
    row = min(max(math.floor((y - lane.grid_y_m) / SQUARE_M), 0), lane.grid_rows - 1)
    c, way = low + lanes.near[lane.grid_first + column * lane.grid_rows + row], 0
    while True:
        into, lateral = _foot(cells[c], x, y)
        if into < 0.0 and c > low:
            c -= 1
            if way > 0:
                c += 1
                break
            way = -1
        elif into > cells[c].span_m and c < last:
            c += 1
            if way < 0:
                break
            way = 1
        else:
            return c, into, lateral
    heading = cells[c].heading_rad  # a point on the outside of a joint: its foot is the first point of the cell
    return c, 0.0, (y - cells[c].y_m) * math.cos(heading) - (x - cells[c].x_m) * math.sin(heading)


@jit(inline=True)
def _station(cells, lane, c):  # type: ignore[no-untyped-def]
    """Distance along a curve of the beginning of a cell of its path."""
    return cells[c].station_m - lane.offset_m * (cells[c].heading_rad - cells[lane.cell_first].heading_rad)


@jit(borrows=True)
def _on_path(cells, lane, c, into, lateral):  # type: ignore[no-untyped-def]
    """What :func:`local` gives for a point with a given foot on the path of a curve."""
    turned = (cells[c].kappa_pm + 0.5 * cells[c].slope_pm2 * into) * into
    s = _station(cells, lane, c) + into - lane.offset_m * turned
    return s, lateral - lane.offset_m, cells[c].heading_rad + turned


@jit(borrows=True)
def _into(cells, lane, s):  # type: ignore[no-untyped-def]
    """Cell and distance along the path into it, of a distance along a curve."""
    low, high = lane.cell_first, lane.cell_last
    while high - low > 1:
        middle = (low + high) // 2
        if _station(cells, lane, middle) <= s:
            low = middle
        else:
            high = middle
    rest = s - _station(cells, lane, low)
    factor = 1.0 - lane.offset_m * cells[low].kappa_pm
    under = factor * factor - 2.0 * lane.offset_m * cells[low].slope_pm2 * rest
    return low, 2.0 * rest / (factor + math.sqrt(max(under, 0.0)))


# Any lane


@jit(inline=True)
def straight(lane, x, y):  # type: ignore[no-untyped-def]
    """Distance along the axis of a straight or sine lane, and offset to its right."""
    dx, dy = x - lane.x_m, y - lane.y_m
    return dx * lane.east + dy * lane.south, dy * lane.east - dx * lane.south


@jit(borrows=True)
def local(lanes, n, x, y):  # type: ignore[no-untyped-def]
    """Distance along a lane, offset to its right, and the lane's direction there: (s, r, heading)."""
    lane = lanes.table[n]
    if lane.kind == STRAIGHT:
        s, r = straight(lane, x, y)
        return s, r, lane.heading_rad
    if lane.kind == CURVE:
        foot, into, lateral = _project(lanes, lane, x, y)
        return _on_path(lanes.cells, lane, foot, into, lateral)
    return _local_of_others(lanes, lane, x, y)


@jit(borrows=True)
def _local_of_others(lanes, lane, x, y):  # type: ignore[no-untyped-def]
    """:func:`local` on sine, circular and sampled lanes."""
    if lane.kind == SINE:
        s, r = straight(lane, x, y)
        phase = lane.pulsation_radpm * s + lane.phase_rad
        turned = math.atan(lane.amplitude_m * lane.pulsation_radpm * math.cos(phase))
        return s, r - lane.amplitude_m * math.sin(phase), math.atan2(lane.south, lane.east) + turned
    if lane.kind == CIRCLE:
        dx, dy = x - lane.centre_x_m, y - lane.centre_y_m
        past = wrap(math.atan2(dy, dx) - lane.phase_rad)
        s, r = lane.turn * past * lane.radius_m, lane.turn * (lane.radius_m - math.hypot(dx, dy))
        return s, r, past + lane.phase_rad + 0.5 * math.pi * lane.turn
    k, least = 0, math.inf
    for m in range(lane.node_count):
        node = lanes.nodes[lane.node_first + m]
        square = (x - node.x[0]) ** 2 + (y - node.y[0]) ** 2
        if square < least:
            k, least = m, square
    s, r, heading = k * lane.node_step_m, 0.0, 0.0
    for _ in range(SAMPLED_STEPS):
        px, py, heading, curvature = _on_nodes(lanes, lane, s)
        cosine, sine = math.cos(heading), math.sin(heading)
        along, r = (x - px) * cosine + (y - py) * sine, (y - py) * cosine - (x - px) * sine
        move = along / max(1.0 - curvature * r, 0.5)
        s += move
        if abs(move) < NEAR_M:
            break
    return s, r, heading


@jit(borrows=True)
def _on_nodes(lanes, lane, s):  # type: ignore[no-untyped-def]
    """Point, direction and curvature of a sampled centreline at a station; straight on past its ends."""
    inside = min(max(s, 0.0), lane.length_m)
    k = min(int(inside / lane.node_step_m), lane.node_count - 1)
    node, u = lanes.nodes[lane.node_first + k], inside / lane.node_step_m - k
    x = node.x[0] + u * (node.x[1] + u * (node.x[2] + u * node.x[3]))
    y = node.y[0] + u * (node.y[1] + u * (node.y[2] + u * node.y[3]))
    heading = node.heading_rad + u * node.turn_rad
    if s == inside:
        return x, y, heading, node.curvature_pm
    return x + (s - inside) * math.cos(heading), y + (s - inside) * math.sin(heading), heading, 0.0


@jit(borrows=True)
def centre(lanes, n, s):  # type: ignore[no-untyped-def]
    """Point, direction and curvature of a lane's centreline at a station: (x, y, heading, curvature)."""
    lane = lanes.table[n]
    if lane.kind == STRAIGHT:
        return lane.x_m + s * lane.east, lane.y_m + s * lane.south, lane.heading_rad, 0.0
    if lane.kind == CIRCLE:
        curvature = lane.turn / lane.radius_m
        heading = lane.heading_rad + s * curvature
        x = lane.centre_x_m + math.sin(heading) / curvature
        return x, lane.centre_y_m - math.cos(heading) / curvature, heading, curvature
    return _on_nodes(lanes, lane, s)


@jit(borrows=True)
def place(lanes, n, s, r):  # type: ignore[no-untyped-def]
    """The point at a distance along a lane and to the right of it: (x, y)."""
    lane = lanes.table[n]
    if lane.kind == CURVE:
        c, into = _into(lanes.cells, lane, s)
        x, y, heading = _advance(lanes.cells[c], into)
        aside = r + lane.offset_m
        return x - aside * math.sin(heading), y + aside * math.cos(heading)
    if lane.kind == STRAIGHT or lane.kind == SINE:
        if lane.kind == SINE:
            r += lane.amplitude_m * math.sin(lane.pulsation_radpm * s + lane.phase_rad)
        return lane.x_m + s * lane.east - r * lane.south, lane.y_m + s * lane.south + r * lane.east
    x, y, heading, _ = centre(lanes, n, s)
    return x - r * math.sin(heading), y + r * math.cos(heading)


@jit(borrows=True)
def heading_at(lanes, n, s):  # type: ignore[no-untyped-def]
    """Direction of a lane, not wrapped."""
    lane = lanes.table[n]
    if lane.kind == STRAIGHT:
        return lane.heading_rad
    if lane.kind == CURVE:
        c, into = _into(lanes.cells, lane, s)
        cell = lanes.cells[c]
        return cell.heading_rad + (cell.kappa_pm + 0.5 * cell.slope_pm2 * into) * into
    if lane.kind == SINE:
        phase = lane.pulsation_radpm * s + lane.phase_rad
        turned = math.atan(lane.amplitude_m * lane.pulsation_radpm * math.cos(phase))
        return math.atan2(lane.south, lane.east) + turned
    _, _, heading, _ = centre(lanes, n, s)
    return heading


@jit(inline=True)
def width_at(lanes, n, s):  # type: ignore[no-untyped-def]
    """Width of a lane at a station [m]."""
    lane = lanes.table[n]
    width = lane.width_m
    if lane.kind == SAMPLED:
        k = min(max(int(s / lane.node_step_m), 0), lane.node_count - 1)
        width = lanes.nodes[lane.node_first + k].width_m
    return width


@jit(borrows=True)
def _away(lane, x, y):  # type: ignore[no-untyped-def]
    """A distance that the lane is not nearer than, and past 0 holds no point: to its squares; not of other kinds."""
    beyond_x, beyond_y = x - lane.grid_x_m - SQUARE_M * lane.grid_columns, y - lane.grid_y_m - SQUARE_M * lane.grid_rows
    return max(lane.grid_x_m - x, beyond_x, lane.grid_y_m - y, beyond_y, 0.0)


@jit(borrows=True)
def _at_most(lane, x, y):  # type: ignore[no-untyped-def]
    """A distance as of :func:`nearest` that that to a curve does not exceed: twice to the far side of its squares."""
    return 2.0 * (_away(lane, x, y) + SQUARE_M * (lane.grid_columns + lane.grid_rows)) + math.pi


@jit(borrows=True)
def _bound(lanes, x, y):  # type: ignore[no-untyped-def]
    """A distance that that to the nearest lane does not exceed, by which lanes of other sites are skipped."""
    found = math.inf
    if lanes.table.shape[0] > FEW:  # fewer lanes are searched as fast without it
        for n in range(lanes.table.shape[0]):
            lane = lanes.table[n]
            if lane.kind != CURVE:
                return math.inf
            found = min(found, _at_most(lane, x, y))
    return found


@jit(borrows=True)
def _on_circle(lane, x, y):  # type: ignore[no-untyped-def]
    """:func:`local` on a circular lane, rounded as by highway-env, so that ties of two lanes of a circle end alike."""
    dx, dy = x - lane.centre_x_m, y - lane.centre_y_m
    phase = lane.phase_rad + wrap(math.atan2(dy, dx) - lane.phase_rad)
    s = lane.turn * (phase - lane.phase_rad) * lane.radius_m
    direction = lane.turn * s / lane.radius_m + lane.phase_rad + 0.5 * math.pi * lane.turn
    return s, lane.turn * (lane.radius_m - math.hypot(dx, dy)), direction


@jit(borrows=True)
def nearest(lanes, x, y, heading):  # type: ignore[no-untyped-def]
    """The lane with the least ``|r| + beyond its ends + |angle|``; the first of equals.

    The lanes of a road that share a path share the search for the foot. A road is skipped whose path is farther away
    than the best lane so far.
    """
    best, least, projected = 0, math.inf, -1
    foot, into, lateral = 0, 0.0, 0.0
    bound = _bound(lanes, x, y)
    for n in range(lanes.table.shape[0]):
        lane = lanes.table[n]
        if lane.kind == STRAIGHT:
            s, r = straight(lane, x, y)
            direction = lane.heading_rad
        elif lane.kind == CURVE:
            if projected != lane.cell_first:
                if _away(lane, x, y) > min(least, bound):
                    continue
                foot, into, lateral = _project(lanes, lane, x, y)
                projected = lane.cell_first
            s, r, direction = _on_path(lanes.cells, lane, foot, into, lateral)
        elif lane.kind != SAMPLED and _away(lane, x, y) > least * (1.0 + abs(lane.amplitude_m * lane.pulsation_radpm)):
            continue  # past its ends a sine lane goes on as steeply as it may
        elif lane.kind == CIRCLE:
            s, r, direction = _on_circle(lane, x, y)
        else:
            s, r, direction = _local_of_others(lanes, lane, x, y)
        distance = abs(r) + max(s - lane.length_m, 0.0, -s) + abs(wrap(heading - direction))
        if distance < least:
            best, least = n, distance
    return best


@jit(borrows=True)
def closest(lanes, x, y, heading, extra_m):  # type: ignore[no-untyped-def]
    """The lane with the least distance as in :func:`nearest` plus ``extra_m`` (L,), and whether no other is as near.

    Not so where two distances are equal but for rounding, where a distance is not a number, and behind a circular lane,
    where the station jumps.
    """
    best, least, second, clear = 0, math.inf, math.inf, True
    bound, most = _bound(lanes, x, y), 0.0
    if bound < math.inf:
        for n in range(extra_m.shape[0]):
            most = max(most, extra_m[n])
    for n in range(lanes.table.shape[0]):
        lane = lanes.table[n]
        if bound < math.inf and _away(lane, x, y) > bound + most + 1.0:  # no second nearest either
            continue
        s, r, direction = local(lanes, n, x, y)
        distance = abs(r) + max(s - lane.length_m, 0.0) + max(-s, 0.0) + abs(wrap(heading - direction)) + extra_m[n]
        behind = lane.kind == CIRCLE and abs(s) >= (math.pi - CLOSE) * lane.radius_m
        clear = clear and distance < math.inf and not behind
        if distance < least:
            best, least, second = n, distance, least
        elif distance < second:
            second = distance
    return best, clear and second - least > CLOSE * (1.0 + least)


@jit(borrows=True)
def stations(lanes, x, y, margin, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` (L,): station of a point on each lane, ``NOWHERE_M`` on lanes that do not hold it by a margin.

    margin: 1 m at most.
    """
    projected, foot, into, lateral = -1, 0, 0.0, 0.0
    for n in range(lanes.table.shape[0]):
        lane = lanes.table[n]
        out[n] = NOWHERE_M
        if lane.kind == CURVE:
            if projected != lane.cell_first:
                if _away(lane, x, y) > 0.0:
                    continue
                foot, into, lateral = _project(lanes, lane, x, y)
                projected = lane.cell_first
            s, r, _ = _on_path(lanes.cells, lane, foot, into, lateral)
        elif (lane.kind == CIRCLE or lane.kind == SINE) and _away(lane, x, y) > 0.0:
            continue
        else:
            s, r, _ = local(lanes, n, x, y)
        if on_lane(lanes, n, s, r, margin):
            out[n] = s


@jit(borrows=True)
def advised(lanes, n, s):  # type: ignore[no-untyped-def]
    """Speed that the bends ahead on a curve allow, as ``CurveLane.advised_speed``."""
    first, last = lanes.table[n].advice_first, lanes.table[n].advice_last - 1
    return lanes.advice[min(first + max(int(s / ADVICE_STEP_M), 0), last)]


@jit(inline=True)
def ends(lanes, n):  # type: ignore[no-untyped-def]
    """Whether a lane ends: no road goes on from it, or the only one that does has no such lane."""
    lane = lanes.table[n]
    return lane.onward < 0 and lane.joint_last - lane.joint_onward <= 1


@jit(inline=True)
def on_lane(lanes, n, s, r, margin):  # type: ignore[no-untyped-def]
    """Whether a point at (s, r) is on a lane, or beside it by no more than a margin."""
    beside = abs(r) <= 0.5 * width_at(lanes, n, s) + margin
    return beside and -PAST_END_M <= s < lanes.table[n].length_m + PAST_END_M


@jit(inline=True)
def reachable(lanes, n, s, r):  # type: ignore[no-untyped-def]
    """Whether a vehicle may change to a lane from (s, r) on it."""
    lane = lanes.table[n]
    beside = lane.forbidden == 0 and abs(r) <= 2.0 * width_at(lanes, n, s)
    return beside and 0.0 <= s < lane.length_m + PAST_END_M


@jit(inline=True)
def of_side(lanes, road, side):  # type: ignore[no-untyped-def]
    """The lane of a number on a road, its last lane if there are fewer."""
    return road + min(side, lanes.table[road].count - 1)
