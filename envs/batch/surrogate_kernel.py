"""Broadcasts of other vehicles with recorded errors, in place of a navigator for each.

A recorded episode holds, for each vehicle and epoch, the error of what its navigator broadcast and its levels (SAID). A
broadcast with them is the true position, course and speed of another vehicle plus that error. Errors along and across
are along the true heading and to the right of it. Courses and speeds are those of the epoch: the course contains the
side slip of a turn, and the speed is its mean, as the wheels count it. What their errors have in common with yaw rate
and braking, such as the lag of an epoch, is a figure of the recordings (TRAITS), and SAID holds the rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.perception_kernel import COURSE_FROM_MPS
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.positioning.filters.odometry_kernel import rolling_slip

__all__ = ["MOVE", "NOTE", "SAID", "TRAITS", "Recordings", "StandIns", "note", "stand_in_rows"]

SAID = record(
    along_m=("f4", "error along the true heading"),
    across_m=("f4", "error to the right of it"),
    turn_rad=("f4", "error of the course, or of the heading at low speed"),
    speed_mps=("f4", "error of the speed"),
    pl_at_m=("f4", "protection level along the heading, inf when missing"),
    pl_ct_m=("f4", "protection level across the heading, inf when missing"),
    sends=("i4", "1 where the vehicle has a position and broadcasts it"),
)
MOVE = record(
    key=("i8", "name of the vehicle, 0 for none"),
    heading_rad="at the last epoch",
    last_mps="speed at the last epoch",
    course_rad="true course now, the heading at low speed",
    speed_mps="mean speed of the epoch",
    yaw_radps="mean yaw rate of the epoch",
    braking_mps2="mean deceleration of the epoch",
)
TRAITS = record(
    still_mps="mean speed below which wheels show rest",
    speed_s="error of the speed by a deceleration [m/s by m/s^2]",
    course_s="error of the course by a yaw rate [rad by rad/s]",
)
NOTE = record(said=(SAID, "what a vehicle broadcasts"), move=(MOVE, "how it moves"))


class Recordings(NamedTuple):
    """Broadcasts of the vehicles of E recorded episodes.

    said (E, P, K) SAID: by epoch since the start of the episode, or since the vehicle has entered it; epochs (E, P): of
    each vehicle; began (E,): vehicles at the start, which come first; vehicles (E,): all of them; traits (1,) TRAITS.
    """

    said: Records
    epochs: NDArray[np.int64]
    began: NDArray[np.int64]
    vehicles: NDArray[np.int64]
    traits: Records


class StandIns(NamedTuple):
    """The recorded vehicles that stand in for those of N environments with C slots.

    episode (N,): the recorded one; now (N,): epochs since the start; since (N, C): epoch in which the vehicle of a slot
    has entered; began (N,): vehicles at the start; moves (N, C) MOVE.
    """

    episode: NDArray[np.int64]
    now: NDArray[np.int64]
    since: NDArray[np.int64]
    began: NDArray[np.int64]
    moves: Records


@jit(borrows=True)
def stand_in_rows(first, last, rows, cars, egos, pictures, recordings, stand_ins, time):  # type: ignore[no-untyped-def]
    """Fill what the vehicles of environments broadcast at ``time`` (n,) of their episodes.

    Before an episode they are on a straight approach. The n-th vehicle of an episode has the errors of the n-th of the
    recorded one, those that have entered of others that have.
    """
    r, own, p = recordings, stand_ins, pictures
    epoch_s = p.of_radio[0].epoch_s
    for n in range(first, last):
        e = rows[n]
        k, ago = own.episode[e], min(time[n], 0.0)
        own.now[e] = max(round(time[n] / epoch_s), 0)
        for v in range(1, egos[e].vehicles):
            car, slot = cars[e, v], cars[e, v].slot
            if slot < 0 or slot >= p.spoken.shape[1]:
                continue
            key, move = p.slots[e, slot].key, own.moves[e, slot]
            _follow(move, car, key, epoch_s)
            place = _place(key - 1, own.began[e], r.began[k], r.vehicles[k])
            epoch = _epoch(own.now[e] - own.since[e, slot], r.epochs[k, place])
            _fill_claim(p.spoken[e, slot], car, move, r.said[k, place, epoch], ago, r.traits[0])


@jit(inline=True)
def _follow(move, car, key, epoch_s):  # type: ignore[no-untyped-def]
    """Fill how a vehicle moves in the epoch that ends now; one that has just come goes straight on."""
    if move.key != key:
        move.key, move.heading_rad, move.last_mps = key, car.heading, car.speed
    turn = car.heading - move.heading_rad
    move.yaw_radps = (turn - 2.0 * math.pi * round(turn / (2.0 * math.pi))) / epoch_s
    move.speed_mps, move.braking_mps2 = 0.5 * (car.speed + move.last_mps), (move.last_mps - car.speed) / epoch_s
    move.course_rad = car.heading
    if car.speed > COURSE_FROM_MPS:  # where a receiver's course is broadcast, see claim()
        move.course_rad += rolling_slip(0.5 * car.length, move.yaw_radps, car.speed)
    move.heading_rad, move.last_mps = car.heading, car.speed


@jit(inline=True)
def _place(place, began, recorded, count):  # type: ignore[no-untyped-def]
    """The recorded vehicle of the ``place``-th of an episode in which ``began`` vehicles were at the start.

    ``recorded`` vehicles were at the start of the recorded episode, of ``count`` in all. Where one kind is missing
    there, one of the other kind serves.
    """
    if place >= began and count > recorded:
        return recorded + (place - began) % (count - recorded)
    return place % (recorded if recorded > 0 else count)


@jit(inline=True)
def _epoch(age, epochs):  # type: ignore[no-untyped-def]
    """The recorded epoch for a vehicle's ``age``; one that stays longer than the recorded one goes back and forth."""
    if epochs < 2:
        return 0
    turn = max(age, 0) % (2 * epochs - 2)
    return turn if turn < epochs else 2 * epochs - 2 - turn


@jit(inline=True)
def _fill_claim(c, car, move, said, ago_s, traits):  # type: ignore[no-untyped-def]
    """Fill a CLAIM of a true vehicle, ``ago_s`` <= 0 before it is where it is; wheels at rest show no error."""
    cos, sin = math.cos(car.heading), math.sin(car.heading)
    along = said.along_m + car.speed * ago_s
    c.x_m = car.x + along * cos - said.across_m * sin
    c.y_m = car.y + along * sin + said.across_m * cos
    c.heading_rad, c.speed_mps = move.course_rad + said.turn_rad, 0.0
    if car.speed > COURSE_FROM_MPS:
        c.heading_rad += traits.course_s * move.yaw_radps
    if abs(move.speed_mps) >= traits.still_mps:
        c.speed_mps = move.speed_mps + said.speed_mps + traits.speed_s * move.braking_mps2
    c.pl_at_m, c.pl_ct_m, c.sends = said.pl_at_m, said.pl_ct_m, said.sends


@jit
def note(rows, cars, egos, pictures, notes):  # type: ignore[no-untyped-def]
    """Note the errors of what vehicles of environments ``rows`` broadcast now: notes (N, C) NOTE of the last epoch."""
    for e in rows:
        there = np.zeros(notes.shape[1], np.bool_)
        for v in range(1, egos[e].vehicles):
            car, slot = cars[e, v], cars[e, v].slot
            if slot < 0 or slot >= notes.shape[1]:
                continue
            there[slot] = True
            c, row = pictures.spoken[e, slot], notes[e, slot]
            said, move = row.said, row.move
            _follow(move, car, pictures.slots[e, slot].key, pictures.of_radio[0].epoch_s)
            cos, sin, x, y = math.cos(car.heading), math.sin(car.heading), c.x_m - car.x, c.y_m - car.y
            said.along_m, said.across_m = x * cos + y * sin, y * cos - x * sin
            turn = c.heading_rad - move.course_rad
            said.turn_rad = turn - 2.0 * math.pi * round(turn / (2.0 * math.pi))
            said.speed_mps = c.speed_mps - move.speed_mps
            said.pl_at_m, said.pl_ct_m, said.sends = c.pl_at_m, c.pl_ct_m, c.sends
        for i in range(notes.shape[1]):
            if not there[i]:
                notes[e, i].move.key = 0
