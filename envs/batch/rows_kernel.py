"""Entry kernels: what happens to environments ``rows[first:last]`` at the end of a simulation step, epoch or policy step.

Each is called with ``run_rows`` or as a link of ``run_chain``; the formulas are in the other files of this package.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.belief_kernel import begin, coast, locate, settle, take, take_given
from lanebound.envs.batch.lanes_kernel import Lanes
from lanebound.envs.batch.motion_kernel import Whereabouts, advance, fill_motion, fill_whereabouts
from lanebound.envs.batch.perception_kernel import Radio, claim, hear, look, see_truth, sum_up
from lanebound.envs.batch.records_kernel import Cars, cars_of
from lanebound.envs.batch.route_map_kernel import RouteMap
from lanebound.envs.batch.score_kernel import count_epoch, score
from lanebound.envs.batch.sky_ahead_kernel import fill_sky, predict
from lanebound.envs.batch.view_kernel import ORACLE, derive, fill_frame, true_view
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["Ego", "Map", "Pictures", "Shown", "approach_step", "begin_rows", "carry_on", "coast_rows", "count_rows", "end_epoch",
           "finish_rows", "follow_motion", "give_rows", "hear_rows", "locate_rows", "look_rows", "predict_rows",
           "sky_rows", "sum_up_rows", "take_rows"]  # fmt: skip


class Ego(NamedTuple):
    """What is known, commanded and scored of N egos: a record of each kind of :mod:`.records_kernel` for each.

    ``shown``: BELIEF by which an agent observes; the belief itself unless an oracle shows the truth.
    """

    belief: Records
    command: Records
    score: Records
    facts: Records
    outcome: Records
    shown: Records


class Map(NamedTuple):
    """The ego's map: lanes, paths, the path from each lane by the present route (L,), and stations of the sky."""

    lanes: Lanes
    routes: RouteMap
    path_of: NDArray[np.int64]
    where: Whereabouts


class Pictures(NamedTuple):
    """Whom N egos perceive.

    picture (N,) PICTURE; perceived (N, P) PERCEIVED, nearest first; tracks (N, C + 1) SIGHTING of the sensor; slots
    (N, C + 1) SLOT; radio: of C slots, of none where the ego has no radio.
    """

    picture: Records
    perceived: Records
    tracks: Records
    slots: Records
    radio: Radio


class Shown(NamedTuple):
    """How an agent observes: what of integrity (FULL, BLIND, ORACLE), whether traffic is perceived as it is."""

    integrity: int
    sees_truth: int


@jit
def follow_motion(motions, cars, e):  # type: ignore[no-untyped-def]
    """Take the true poses of the navigating vehicles of an environment after a simulation step."""
    for v in range(cars.count[e]):
        i = 0 if v == 0 else cars.slot[e, v] + 1
        if (v == 0 or i > 0) and i < motions.shape[1]:
            advance(motions[e, i], cars.x[e, v], cars.y[e, v], cars.heading[e, v])


@jit
def give_rows(first, last, rows, cars, beliefs, lanes, passed, rules):  # type: ignore[no-untyped-def]
    """A simulation step has passed for egos whose position is given; ``passed`` [s] is 0 at a start."""
    for n in range(first, last):
        take_given(beliefs[rows[n]], cars_of(cars, rows[n]), lanes, passed, rules[0])


@jit
def coast_rows(first, last, rows, cars, motions, tracks, beliefs, lanes, rules):  # type: ignore[no-untyped-def]
    """A simulation step has passed that ends no navigation epoch; ``tracks``: None where the egos' positions are given."""
    for n in range(first, last):
        follow_motion(motions, cars, rows[n])
        if tracks is not None:
            carry_on(tracks[rows[n]], beliefs[rows[n]], lanes, rules[0])


@jit
def carry_on(track, belief, lanes, rules):  # type: ignore[no-untyped-def]
    """Carry a sensed pose on by a simulation step."""
    coast(track, rules.step_s)
    settle(track, belief, lanes, rules.step_s, rules)


@jit
def end_epoch(first, last, rows, cars, motions, lanes, where, step_s, down, truth, times, sky):  # type: ignore[no-untyped-def]
    """A simulation step has passed that ends an epoch: the truth of the epoch, and the skies over the egos now.

    ``times`` and ``sky``: see :func:`sky_rows`; 12 parameters and a range of rows.
    """
    count = motions.shape[1]
    for n in range(first, last):
        follow_motion(motions, cars, rows[n])
        fill_whereabouts(cars, lanes, where, rows[n], rows[n] * count, count, truth)
    fill_motion(motions, rows[first:last], step_s, down, truth)
    sky_rows(first, last, rows, times, sky)


@jit
def sky_rows(first, last, rows, times, sky):  # type: ignore[no-untyped-def]
    """The skies over environments; times: (table, hour (N,), knot (N,), share (N,), step [s], mask [rad])."""
    table, hour, knot, share, step, mask = times
    for n in range(first, last):
        e = rows[n]
        fill_sky(table, hour[e], knot[e], share[e], step, mask, e, sky)


@jit
def begin_rows(first, last, rows, at, fixes, shift, tracks, beliefs, lanes, rules):  # type: ignore[no-untyped-def]
    """Start egos at their first solutions, rows ``at`` (n,) of fixes; shift (n, 2): errors of their maps [m]."""
    for n in range(first, last):
        t, b = tracks[rows[n]], beliefs[rows[n]]
        begin(t, b, fixes, at[n], shift[n, 0], shift[n, 1])
        settle(t, b, lanes, 0.0, rules[0])


@jit
def take_rows(first, last, rows, at, fixes, tracks, beliefs, lanes, rules):  # type: ignore[no-untyped-def]
    """New solutions of egos, rows ``at`` (n,) of fixes."""
    for n in range(first, last):
        t, b = tracks[rows[n]], beliefs[rows[n]]
        take(t, b, fixes, at[n], rules[0])
        settle(t, b, lanes, rules[0].step_s, rules[0])


@jit
def count_rows(first, last, rows, cars, ego):  # type: ignore[no-untyped-def]
    """Count a navigation epoch of egos for scoring."""
    for n in range(first, last):
        count_epoch(ego.belief[rows[n]], ego.score[rows[n]], cars_of(cars, rows[n]))


@jit
def hear_rows(first, last, rows, at, fixes, spoken, cars, pictures, time, u, figures, lies):  # type: ignore[no-untyped-def]
    """One epoch of the radio: the others say what their solutions say of them.

    Row ``at[n] + 1 + slot`` of fixes belongs to the vehicle in a slot of environment ``rows[n]``; time (n,): of the
    episodes; u (n, C + 1, 2) uniform draws; spoken (N, C) CLAIM is filled.
    """
    for n in range(first, last):
        e = rows[n]
        for i in range(spoken.shape[1]):
            claim(fixes, at[n] + 1 + i, spoken[e, i])
        hear(pictures.picture[e], pictures.radio, e, figures[0], time[n], spoken[e], cars_of(cars, e), u[n], lies)


@jit
def look_rows(first, last, rows, cars, beliefs, pictures, noise, figures):  # type: ignore[no-untyped-def]
    """One epoch of the sensors; noise (n, C + 1, 4) standard normal."""
    ahead = np.empty((cars.x.shape[1], 2))
    for n in range(first, last):
        e = rows[n]
        look(pictures.picture[e], pictures.tracks[e], figures[0], beliefs[e], cars_of(cars, e), noise[n], ahead)


@jit
def sum_up_rows(first, last, rows, beliefs, pictures, time, figures):  # type: ignore[no-untyped-def]
    """Whom the egos perceive by radio and sensor at ``time`` (n,) of their episodes."""
    square = np.empty(pictures.perceived.shape[1] + 1)
    for n in range(first, last):
        e = rows[n]
        pictures.picture[e].seen = sum_up(
            pictures.radio, pictures.tracks[e], pictures.slots[e], e, figures[0], time[n], beliefs[e], square,
            pictures.perceived[e],
        )  # fmt: skip


@jit
def predict_rows(first, last, rows, shown, map, forecast, sky, out):  # type: ignore[no-untyped-def]
    """Satellites that the map predicts ahead of what is shown of the egos, (N, 3 D)."""
    for n in range(first, last):
        e = rows[n]
        predict(shown[e], map.lanes, map.routes, map.where, forecast, sky, e, out[e])


@jit
def locate_rows(first, last, rows, cars, ego, map, shown, rules):  # type: ignore[no-untyped-def]
    """Where the beliefs are on the egos' own maps, and what of them is shown."""
    for n in range(first, last):
        e = rows[n]
        locate(ego.belief[e], map.lanes, map.path_of, rules[0])
        if shown.integrity == ORACLE:
            ego.shown[e] = ego.belief[e]
            true_view(ego.belief[e], cars_of(cars, e), map.lanes, map.path_of, rules[0], ego.shown[e])


@jit
def finish_rows(first, last, rows, cars, ego, pictures, map, start, shown, rules, views, frames):  # type: ignore[no-untyped-def]
    """Score and observe at the end of a policy step, or at a start; ``frames``: (SOURCE (E,), Words, frame (N, E))."""
    sources, words, frame = frames
    every = cars.x.shape[1]
    order, square = np.empty(every, np.int64), np.empty(every)
    for n in range(first, last):
        e = rows[n]
        car, b, sc = cars_of(cars, e), ego.belief[e], ego.score[e]
        seen, picture = pictures.perceived[e], pictures.picture[e]
        if shown.sees_truth != 0:
            picture.seen = see_truth(car, b.x_m, b.y_m, False, order, square, seen)
        score(b, sc, car, seen, picture.seen, map.lanes, ego.facts[e], rules[0], start, ego.outcome[e])
        count = picture.seen
        if shown.integrity == ORACLE:
            seen = np.empty_like(seen)
            count = see_truth(car, car.x[0], car.y[0], True, order, square, seen)
        if start:
            sc.observed = 0
        derive(ego.shown[e], seen, count, map.lanes, map.routes, rules[0], shown.integrity, sc.observed, e, views)
        sc.observed += 1
        fill_frame(sources, words, e, views.own[e], frame[e])


@jit
def approach_step(first, last, rows, motions, begin, ahead, passed_s, end):  # type: ignore[no-untyped-def]
    """A simulation step of an approach, to where the vehicles are ``passed_s`` after its beginning; to ``end`` if given.

    begin, ahead, end (n, M, 2); ``end`` is None but for the last step.
    """
    for n in range(first, last):
        for i in range(motions.shape[1]):
            x, y = begin[n, i, 0] + passed_s * ahead[n, i, 0], begin[n, i, 1] + passed_s * ahead[n, i, 1]
            if end is not None:
                x, y = end[n, i, 0], end[n, i, 1]
            advance(motions[n, i], x, y, motions[n, i].heading_rad)
