"""Geo-objects of a road network: which is open, what is claimed of it, and what a wrong charge costs.

A geo-object is a stretch at which one of several links beside each other is tolled (S3 V, S5 2.1). It opens where the
believed place is on one of its links, and closes ``WINDOW_S`` after that place has left them, or where the next one
opens. In between an agent may claim once that the car is on the tolled link (CHARGE) or that it is not (SPARE); an
object without a claim is not charged. Truth enters where it is settled alone: by the link that the true car has driven,
when the true car has left the object and it is closed, or the episode ends.

Shown of an open object are the distances across from the navigator's position to the lane of the tolled link and to
the nearest one of the other links, in which the car would be by what the camera sees: ``max(|r - r_eye| - bound, 0)``,
bound: of the camera. As long as the levels hold, the distance to the link of the car is at most the level across, so a
level excludes each link that is farther away. After the car has passed, the last distances stay.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import NONE, local, of_side
from lanebound.integrity.core.accel import jit

__all__ = ["CHARGE", "DEFER", "SPARE", "WINDOW_S", "follow_toll", "show_toll"]

DEFER, CHARGE, SPARE = 0, 1, 2  # claims
WINDOW_S = 5.0  # to decide after an object is passed; chosen: 100 m at 20 m/s, more than positions err along the track
ROUNDING_S = 1e-9


@jit(borrows=True)
def follow_toll(ego, car, lanes, rules, start):  # type: ignore[no-untyped-def]
    """Take up a claim, close the geo-object that is over, and open the next; at the end of a step, or at a start."""
    t, out, facts = ego.toll, ego.outcome, ego.facts
    out.cost_overcharge = out.cost_undercharge = out.toll = 0.0
    if t.objects == 0:
        return
    there = lanes.table[car.lane].geo_object
    if there >= 0:
        t.driven[there] = lanes.table[car.lane].road
    if t.open >= 0 and t.claims[t.open] == DEFER and not start:
        t.claims[t.open] = ego.command.claim
    here = lanes.table[ego.belief.lane].geo_object
    t.inside = 1 if here >= 0 and here == t.open else 0
    t.passed_s = 0.0 if t.inside != 0 else t.passed_s + rules.policy_s
    if t.open >= 0 and (here > t.open or t.passed_s >= WINDOW_S - ROUNDING_S):
        t.open = NONE
    if here >= t.next:
        t.open, t.next, t.inside = here, here + 1, 1
        t.positions, t.near, t.passed_s = 0, 0, 0.0
    # A place that errs by more than the window is long closes an object before the car is there, or not at all.
    over = facts.terminated != 0 or facts.truncated != 0
    while t.settled < t.objects and t.driven[t.settled] >= 0:
        if t.settled == there or (not over and (t.settled >= t.next or t.settled == t.open)):
            break
        _settle(t, t.claims[t.settled], out)


@jit(inline=True)
def _settle(t, claim, out):  # type: ignore[no-untyped-def]
    """Judge the claim about the next object by the link that was driven."""
    due = t.driven[t.settled] == t.tolled[t.settled]
    if claim == CHARGE and not due:
        out.cost_overcharge += 1.0
    elif claim != CHARGE and due:
        out.cost_undercharge += 1.0
    elif claim != DEFER:
        out.toll += 1.0
    if due != (claim == CHARGE):
        t.wrong = 1
    t.settled += 1


@jit(borrows=True)
def show_toll(ego, lanes, view):  # type: ignore[no-untyped-def]
    """What an agent observes of the open geo-object: the fields ``toll_*`` of VIEW; by the truth for an oracle."""
    t, b, eye, table = ego.toll, ego.shown, ego.eye, lanes.table
    view.toll_open = 1.0 if t.open >= 0 and t.claims[t.open] == DEFER else 0.0
    view.toll_inside = 1.0 if t.inside != 0 else 0.0
    view.toll_passed_s = t.passed_s if t.open >= 0 else 0.0
    if t.open < 0:
        view.toll_m = view.toll_free_m = math.inf
        view.toll_share = 0.0
    elif t.inside != 0:
        side, n = table[eye.lane].side, 0
        view.toll_m = view.toll_free_m = math.inf
        while n < table.shape[0]:
            if table[n].geo_object == t.open:
                _, r, _ = local(lanes, of_side(lanes, n, side), b.fix_x_m, b.fix_y_m)
                away = max(abs(r - eye.lateral_m) - eye.pl_ct_m, 0.0)
                if n == t.tolled[t.open]:
                    view.toll_m = away
                else:
                    view.toll_free_m = min(view.toll_free_m, away)
            n += table[n].count
        t.positions += 1
        t.near += 1 if view.toll_m < view.toll_free_m else 0
        view.toll_share = t.near / t.positions
