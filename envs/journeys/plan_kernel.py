"""Routes to all places of a city at one hour, and what is observed of the streets ahead."""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.journeys.course_kernel import class_of
from lanebound.envs.journeys.records import MOST_STREETS
from lanebound.integrity.core.accel import jit

__all__ = ["HERE", "STREET", "observe_rows", "plan_routes", "preview_rows"]

HERE, STREET = 12, 21  # entries of a journey, and of each street


@jit(borrows=True)
def plan_routes(goals, edges, ahead, weight, order, simple, best, aware, fast, short):  # type: ignore[no-untyped-def]
    """The best option after each edge towards each place: by integrity, time and length.

    Label correcting in the order of the time to go. The integrity-aware cost is time and ``weight`` times the expected
    time without a usable position, which depends on the class of the gap at the end of the edge.

    Parameters
    ----------
    goals, edges, ahead : (P, 2) edges that end at a place, -1: none; (E,) EDGE; (E, G) AHEAD
    order, simple, best : room, (E,) int64, (E,), (E, G)
    aware, fast, short : (P, E, G), (P, E), (P, E) int8, the result
    """
    for p in range(goals.shape[0]):
        follow(goals[p], edges, False, simple, short[p])
        follow(goals[p], edges, True, simple, fast[p])
        by_time(simple, order)
        settle(goals[p], edges, ahead, weight, order, best, aware[p])


@jit(borrows=True)
def follow(goals, edges, by_time_s, cost, choice):  # type: ignore[no-untyped-def]
    """Cost to go from the end of each edge (E,) by time or length, and the best option."""
    cost[:], choice[:] = np.inf, -1
    changed = True
    while changed:
        changed = False
        for e in range(edges.shape[0]):
            least = cost[e]
            if e == goals[0] or e == goals[1]:
                least = 0.0
            else:
                for k in range(edges[e].options.shape[0]):
                    b = edges[e].options[k]
                    if b < 0:
                        continue
                    there = edges[b].length_m
                    if by_time_s:
                        there = there / edges[b].limit_mps + edges[e].turn_s[k]
                    if there + cost[b] < least:
                        least, choice[e] = there + cost[b], k
            if least < cost[e]:
                cost[e], changed = least, True


@jit(borrows=True)
def by_time(cost, order):  # type: ignore[no-untyped-def]
    """Sort edges (E,) by cost, by insertion: orders of places that follow one another are alike."""
    for i in range(1, order.shape[0]):
        own, j = order[i], i
        while j > 0 and cost[order[j - 1]] > cost[own]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = own


@jit(borrows=True)
def settle(goals, edges, ahead, weight, order, best, choice):  # type: ignore[no-untyped-def]
    """The integrity-aware cost to go from the end of each edge with each class of gaps (E, G), and the best option."""
    best[:], choice[:] = np.inf, -1
    changed = True
    while changed:
        changed = False
        for i in range(order.shape[0]):
            e = order[i]
            goal = e == goals[0] or e == goals[1]
            for g in range(best.shape[1]):
                least = 0.0 if goal else best[e, g]
                for k in range(0 if goal else edges[e].options.shape[0]):
                    b = edges[e].options[k]
                    if b < 0:
                        continue
                    into, turn_s = ahead[b, g], edges[e].turn_s[k]
                    there = edges[b].length_m / edges[b].limit_mps + turn_s
                    there += weight * (into.lost_s + turn_s * into.risk) + best[b, into.leaves]
                    if there < least:
                        least, choice[e, g] = there, k
                if least < best[e, g]:
                    best[e, g], changed = least, True


@jit(borrows=True)
def rest_of(goals, edges, ahead, edge, g, aware, fast, short, by, out):  # type: ignore[no-untyped-def]
    """Time, expected time without a position and length of a route after an edge, left with a class of gaps.

    by : 0 the integrity-aware route, 1 the fastest, 2 the shortest; out (3,)
    """
    out[:] = 0.0
    while edge != goals[0] and edge != goals[1]:
        k = aware[edge, g] if by == 0 else (fast[edge] if by == 1 else short[edge])
        turn_s, b = edges[edge].turn_s[k], edges[edge].options[k]
        into = ahead[b, g]
        out[0] += turn_s + edges[b].length_m / edges[b].limit_mps
        out[1] += turn_s * into.risk + into.lost_s
        out[2] += edges[b].length_m
        edge, g = b, into.leaves


@jit(borrows=True)
def bounded(value, scale):  # type: ignore[no-untyped-def]
    """A quantity by its scale, within [-1, 1]."""
    return min(max(value / scale, -1.0), 1.0)


@jit(borrows=True)
def observe_rows(  # type: ignore[no-untyped-def]
    rows, journeys, places, origins, goals, edges, ahead, gaps_s, aware, fast, short, scales, hour, weight, rest, out
):
    """The observation of journeys in one city at one hour, in the order of ``HERE`` and, for each option, ``STREET``.

    Parameters
    ----------
    places : (P, 2) East, North [m]
    aware, fast, short : (P, E, G), (P, E), (P, E) best options
    scales : (5,) of times, lengths, gaps [s], levels and speeds
    hour : of the day
    weight : of time without a usable position
    rest, out : room (3,); (B, n) float32
    """
    time_, length_, gap_, level_, speed_ = scales[0], scales[1], scales[2], scales[3], scales[4]
    for i in range(rows.shape[0]):
        b = rows[i]
        journey, row = journeys[b], out[b]
        row[:] = 0.0
        at, facing = places[journey.origin], 0.0
        east, north = at[0], at[1]
        if journey.edge >= 0:
            e = edges[journey.edge]
            east, north, facing = e.east_m, e.north_m, e.azimuth_rad
        goal = places[journey.goal]
        bearing = math.atan2(goal[0] - east, goal[1] - north)
        row[0] = bounded(journey.time_s, time_)
        row[1] = bounded(math.hypot(goal[0] - east, goal[1] - north), length_)
        row[2], row[3] = math.sin(bearing - facing), math.cos(bearing - facing)
        row[4], row[5] = journey.rtk, journey.usable
        row[6] = bounded(journey.level_m, level_)
        row[7] = bounded(journey.gap_s, gap_)
        row[8], row[9] = bounded(journey.unusable_s, time_), bounded(journey.predicted_s, time_)
        row[10], row[11] = math.sin(hour * math.pi / 12.0), math.cos(hour * math.pi / 12.0)
        if journey.arrived == 1:
            continue
        g = class_of(journey.gap_s, gaps_s)
        options = origins[journey.origin] if journey.edge < 0 else edges[journey.edge].options
        for k in range(options.shape[0]):
            o = options[k]
            if o < 0:
                continue
            street, into = row[HERE + STREET * k :], ahead[o, g]
            turn_s = edges[journey.edge].turn_s[k] if journey.edge >= 0 else 0.0
            ends = o == goals[journey.goal, 0] or o == goals[journey.goal, 1]
            street[0] = 1.0
            street[1], street[2] = math.sin(edges[o].away_rad - facing), math.cos(edges[o].away_rad - facing)
            street[3] = bounded(edges[o].limit_mps, speed_)
            street[4] = bounded(edges[o].length_m, length_)
            street[5] = bounded(edges[o].length_m / edges[o].limit_mps + turn_s, time_)
            street[6] = bounded(into.lost_s + turn_s * into.risk, time_)
            street[7], street[8] = bounded(into.level_m[0], level_), bounded(into.level_m[1], level_)
            street[9] = 1.0 if ends else 0.0
            place = journey.goal
            for by in range(3):
                rest_of(goals[place], edges, ahead, o, into.leaves, aware[place], fast[place], short[place], by, rest)
                street[10 + 3 * by], street[11 + 3 * by] = bounded(rest[0], time_), bounded(rest[1], time_)
                street[12 + 3 * by] = bounded(rest[2], length_)
        excess(row, time_, weight)


@jit(borrows=True)
def excess(row, time_s, weight):  # type: ignore[no-untyped-def]
    """By how many minutes each street with its rest exceeds the best one, by integrity and by time."""
    for by in range(2):
        factor, least = weight * (1 - by), np.inf
        for again in range(2):
            for k in range(MOST_STREETS):
                street = row[HERE + STREET * k :]
                if street[0] == 0.0:
                    continue
                cost = time_s * (street[5] + street[10 + 3 * by] + factor * (street[6] + street[11]))
                if again == 0:
                    least = min(least, cost)
                else:
                    street[19 + by] = bounded(cost - least, 60.0)


@jit(borrows=True)
def preview_rows(  # type: ignore[no-untyped-def]
    rows, journeys, origins, goals, edges, ahead, weight, aware, fast, short, time_s, column, rest, out
):
    """Time and expected time without a position of the integrity-aware route at one hour, before departure.

    column : of ``out`` (B, n) float32 where the two are written
    """
    for i in range(rows.shape[0]):
        b = rows[i]
        place, least = journeys[b].goal, np.inf
        origin = origins[journeys[b].origin]
        for k in range(origin.shape[0]):
            if origin[k] < 0:
                continue
            o, into = origin[k], ahead[origin[k], 0]
            rest_of(goals[place], edges, ahead, o, into.leaves, aware[place], fast[place], short[place], 0, rest)
            time, lost = rest[0] + edges[o].length_m / edges[o].limit_mps, rest[1] + into.lost_s
            if time + weight * lost < least:
                least = time + weight * lost
                out[b, column], out[b, column + 1] = bounded(time, time_s), bounded(lost, time_s)
