"""Journeys from junction to junction: the realised course along streets, for rows of a batch in one city and hour."""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.streams_kernel import fill, uniform

__all__ = ["class_of", "drive_rows"]

ROOT_HALF = math.sqrt(0.5)


@jit(borrows=True)
def class_of(gap_s, gaps_s):  # type: ignore[no-untyped-def]
    """The class of a gap: the nearest one of ``gaps_s`` (G,), ascending."""
    g = 0
    while g + 1 < gaps_s.shape[0] and 2.0 * gap_s > gaps_s[g] + gaps_s[g + 1]:
        g += 1
    return g


@jit(borrows=True)
def option_of(journey, origin, edges, action):  # type: ignore[no-untyped-def]
    """The edge of an action, and what the turn into it costs [s].  origin (K,) edges that leave the origin."""
    if journey.edge < 0:
        return origin[action], 0.0
    return edges[journey.edge].options[action], edges[journey.edge].turn_s[action]


@jit(borrows=True)
def only_option(options):  # type: ignore[no-untyped-def]
    """The number of the only option (K,); -1 where there are several, or none."""
    found, count = -1, 0
    for k in range(options.shape[0]):
        if options[k] >= 0:
            found, count = k, count + 1
    return found if count == 1 else -1


@jit(borrows=True)
def drive_rows(  # type: ignore[no-untyped-def]
    rows, actions, paces, journeys, states, drawn, table, origins, goals, edges, stations, ahead, gaps_s, law, car
):
    """Drive journeys into the streets of their actions, and on to the next junction with a choice, or to the end.

    Parameters
    ----------
    rows : (n,) of the batch, all in this city at this hour
    actions, paces : (B,) option; share of the speed limit
    journeys, states, drawn : (B,) JOURNEY, (B, 4) generators of the realised course, (1,) room for a normal draw
    table : of the ziggurat
    origins, goals : (P, K), (P, 2) edges that leave a place, and that end there; -1: none
    edges, stations, ahead, gaps_s : (E,) EDGE, (N,) STATION, (E, G) AHEAD of the map, (G,) classes
    law, car : (1,) LAW, CAR
    """
    own, moves = law[0], car[0]
    for i in range(rows.shape[0]):
        b = rows[i]
        journey, g = journeys[b], states[b]
        k = actions[b]
        passed, began = 0, journey.edge < 0
        while k >= 0:
            edge, turn_s = option_of(journey, origins[journey.origin], edges, k)
            e = edges[edge]
            ends = edge == goals[journey.goal, 0] or edge == goals[journey.goal, 1]
            into = ahead[edge, class_of(journey.gap_s, gaps_s)]
            journey.predicted_s += into.lost_s + turn_s * into.risk
            speed = e.limit_mps * paces[b]
            if journey.edge < 0:  # it has stood: RTK is as likely as in the long run, by the class of long runs alone
                turn_s += 0.5 * speed / moves.acceleration_mps2
                long = own.run_edges.shape[0]
                free, held = stations[e.first].rtk_after[0, long], stations[e.first].rtk_after[1, long]
                journey.rtk = 1 if uniform(g) * (1.0 + free - held) < free else 0
                journey.usable = 1
                journey.rtk_run = journey.usable_run = own.run_edges[long - 1] + 1
            for s in range(e.first, e.last):
                station = stations[s]
                stay_s = station.part_m / speed
                if s == e.first:
                    stay_s += turn_s
                if ends and s == e.last - 1:
                    stay_s += 0.5 * speed / moves.braking_mps2
                journey.gap_s += 0.5 * stay_s
                run = np.searchsorted(own.run_edges, journey.rtk_run)
                now = 1 if uniform(g) < station.rtk_after[journey.rtk, run] else 0
                journey.rtk_run = journey.rtk_run + 1 if now == journey.rtk else 1
                journey.rtk = now
                run = np.searchsorted(own.run_edges, journey.usable_run)
                if now == 1:
                    journey.gap_s = 0.0
                    chance = station.usable_after[journey.usable, run]
                else:
                    gap = np.searchsorted(own.gap_edges_s, journey.gap_s)
                    chance = own.bridged[journey.usable, run, station.satellites, gap]
                now = 1 if uniform(g) < chance else 0
                journey.usable_run = journey.usable_run + 1 if now == journey.usable else 1
                journey.usable = now
                if journey.usable == 0:
                    journey.unusable_s += stay_s
                journey.time_s += stay_s
                journey.gap_s += 0.5 * stay_s
            passed += e.last - e.first
            journey.length_m += e.length_m
            journey.energy_kwh += e.length_m * (moves.rolling + moves.drag * speed**2)
            journey.edge = edge
            if ends:
                journey.arrived = 1
            k = -1 if ends else only_option(e.options)
        kept = 0.0 if began else own.correlation**passed  # the first score is a draw of N(0, 1)
        meet_level(journey, g, drawn, table, kept, stations[edges[journey.edge].last - 1].satellites, own)


@jit(borrows=True)
def meet_level(journey, g, drawn, table, kept, satellites, law):  # type: ignore[no-untyped-def]
    """Draw the level where a journey is; ``kept``: correlation of its score with the last one that was drawn."""
    fill(g, table, drawn)
    journey.score = kept * journey.score + math.sqrt(1.0 - kept * kept) * drawn[0]
    share = 0.5 * math.erfc(-ROOT_HALF * journey.score)
    by = float(satellites) if journey.rtk == 1 else journey.gap_s
    cell = np.searchsorted(law.level_edges[journey.rtk], by)
    n = law.levels.shape[3]
    journey.level_m = law.levels[journey.rtk, journey.usable, cell, min(int(share * n), n - 1)]
