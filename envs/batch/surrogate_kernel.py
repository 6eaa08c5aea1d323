"""Other vehicles that speak with recorded errors: what a receiver of their own has said in a recorded episode.

A recorded episode holds, for each vehicle and epoch, the error of what it broadcast and its levels (SAID). A vehicle
that speaks with them says its own true pose and speed plus that error. Errors along and across are along its true
heading and to the right of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["NOTE", "SAID", "SLOWEST_MPS", "Recordings", "Speakers", "note", "recite_rows"]

SLOWEST_MPS = 1.0  # of the speed that an error of the odometer's scale is taken of

SAID = record(
    along_m=("f4", "error along the true heading"),
    across_m=("f4", "error to the right of it"),
    turn_rad=("f4", "error of the heading"),
    scale=("f4", "error of the speed over the true one, or over 1 m/s below that"),
    pl_at_m=("f4", "protection level along the heading, inf when missing"),
    pl_ct_m=("f4", "protection level across the heading, inf when missing"),
    sends=("i4", "1 where the vehicle has a position and broadcasts it"),
)
NOTE = record(said=(SAID, "what it says"), key=("i8", "name of the vehicle, 0 for an empty slot"))


class Recordings(NamedTuple):
    """What the vehicles of E recorded episodes have said.

    said (E, P, K) SAID: by epoch since the start of the episode, or since the vehicle has entered it; epochs (E, P): of
    each vehicle; began (E,): vehicles at the start, which come first; count (E,): all vehicles.
    """

    said: Records
    epochs: NDArray[np.int64]
    began: NDArray[np.int64]
    count: NDArray[np.int64]


class Speakers(NamedTuple):
    """Who speaks in N environments with C slots.

    episode (N,): the recorded one; now (N,): epochs since the start; since (N, C): epoch in which the vehicle of a slot
    has entered; began (N,): vehicles at the start.
    """

    episode: NDArray[np.int64]
    now: NDArray[np.int64]
    since: NDArray[np.int64]
    began: NDArray[np.int64]


@jit(borrows=True)
def recite_rows(first, last, rows, cars, egos, pictures, recordings, speakers, time):  # type: ignore[no-untyped-def]
    """Fill what the vehicles of environments broadcast at ``time`` (n,) of their episodes.

    Before an episode they are on a straight approach. The n-th vehicle of an episode speaks as the n-th of the recorded
    one, those that have entered as others that have.
    """
    r, who, p = recordings, speakers, pictures
    for n in range(first, last):
        e = rows[n]
        k, ago = who.episode[e], min(time[n], 0.0)
        who.now[e] = max(round(time[n] / p.of_radio[0].epoch_s), 0)
        for v in range(1, egos[e].vehicles):
            car, slot = cars[e, v], cars[e, v].slot
            if slot < 0 or slot >= p.spoken.shape[1]:
                continue
            place = _place(p.slots[e, slot].key - 1, who.began[e], r.began[k], r.count[k])
            epoch = _epoch(who.now[e] - who.since[e, slot], r.epochs[k, place])
            _say(p.spoken[e, slot], car, r.said[k, place, epoch], ago)


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
def _say(c, car, said, ago_s):  # type: ignore[no-untyped-def]
    """Fill a CLAIM of a true vehicle, ``ago_s`` <= 0 before it is where it is."""
    cos, sin = math.cos(car.heading), math.sin(car.heading)
    along = said.along_m + car.speed * ago_s
    c.x_m = car.x + along * cos - said.across_m * sin
    c.y_m = car.y + along * sin + said.across_m * cos
    c.heading_rad = car.heading + said.turn_rad
    c.speed_mps = car.speed + said.scale * max(abs(car.speed), SLOWEST_MPS)
    c.pl_at_m, c.pl_ct_m, c.sends = said.pl_at_m, said.pl_ct_m, said.sends


@jit(borrows=True)
def note(rows, cars, egos, pictures, notes):  # type: ignore[no-untyped-def]
    """Note what the vehicles of environments ``rows`` say now, with its errors: notes (N, C) NOTE."""
    for e in rows:
        for i in range(notes.shape[1]):
            notes[e, i].key = 0
        for v in range(1, egos[e].vehicles):
            car, slot = cars[e, v], cars[e, v].slot
            if slot < 0 or slot >= notes.shape[1]:
                continue
            c, row = pictures.spoken[e, slot], notes[e, slot]
            said, cos, sin = row.said, math.cos(car.heading), math.sin(car.heading)
            x, y = c.x_m - car.x, c.y_m - car.y
            said.along_m, said.across_m = x * cos + y * sin, y * cos - x * sin
            turn = c.heading_rad - car.heading
            said.turn_rad = turn - 2.0 * math.pi * round(turn / (2.0 * math.pi))
            said.scale = (c.speed_mps - car.speed) / max(abs(car.speed), SLOWEST_MPS)
            said.pl_at_m, said.pl_ct_m, said.sends = c.pl_at_m, c.pl_ct_m, c.sends
            row.key = pictures.slots[e, slot].key
