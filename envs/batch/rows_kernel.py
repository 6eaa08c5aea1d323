"""Entry kernels, each for environments ``rows[first:last]`` at the end of a simulation, epoch or policy step.

They are the links of ``call_links``; the formulas are in the other files of this package. ``batch`` is the handle of a
bundle of :class:`Batch`, ``sensed`` that of :class:`Sensed`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.belief_kernel import begin, coast, locate, settle, take, take_given
from lanebound.envs.batch.lanes_kernel import Lanes
from lanebound.envs.batch.motion_kernel import Whereabouts, advance, fill_motion, fill_whereabouts
from lanebound.envs.batch.perception_kernel import PerceptionArrays, claim, hear, look, see_truth, sum_up
from lanebound.envs.batch.records_kernel import Cars, Ego, cars_of
from lanebound.envs.batch.route_map_kernel import RouteMap
from lanebound.envs.batch.score_kernel import count_epoch, score
from lanebound.envs.batch.sky_ahead_kernel import Forecast, HourTable, SkyRows, fill_sky, predict
from lanebound.envs.batch.view_kernel import ORACLE, Views, Words, derive, fill_frame, true_view
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle
from lanebound.integrity.core.records import Records

__all__ = ["Batch", "Sensed", "approach_step", "begin_rows", "carry_on", "coast_rows", "count_rows", "end_epoch",
           "finish_rows", "follow_motion", "give_rows", "hear_rows", "locate_rows", "look_rows", "predict_rows",
           "sky_rows", "sum_up_rows", "take_rows"]  # fmt: skip


class Batch(NamedTuple):
    """N episodes: cars, beliefs of the egos, perceived vehicles, and observations.

    rules (1,) RULES; lanes and routes of the egos' map; path_of (L,): row of the path from each lane by the present
    route; sources (E,) SOURCE, words and frame (N, E) of observations; integrity: what of it is shown (FULL, BLIND,
    ORACLE); sees_truth: 1 where traffic is perceived as it is.
    """

    cars: Cars
    ego: Ego
    pictures: PerceptionArrays
    views: Views
    words: Words
    sources: Records
    frame: NDArray[np.float32]
    rules: Records
    lanes: Lanes
    routes: RouteMap
    path_of: NDArray[np.int64]
    integrity: int
    sees_truth: int


class Sensed(NamedTuple):
    """Where N egos are under which skies: stations, the map's forecast, skies by hour and as they are now."""

    where: Whereabouts
    forecast: Forecast
    hours: HourTable
    sky: SkyRows


@jit(borrows=True)
def follow_motion(motions, cars, e):  # type: ignore[no-untyped-def]
    """Take the true poses of the navigating vehicles of an environment after a simulation step."""
    for v in range(cars.present[e]):
        i = 0 if v == 0 else cars.slot[e, v] + 1
        if (v == 0 or i > 0) and i < motions.shape[1]:
            advance(motions[e, i], cars.x[e, v], cars.y[e, v], cars.heading[e, v])


@jit(borrows=True)
def carry_on(track, belief, lanes, rules):  # type: ignore[no-untyped-def]
    """Carry a sensed pose on by a simulation step."""
    coast(track, rules.step_s)
    settle(track, belief, lanes, rules.step_s, rules)


# After a simulation step


@jit(borrows=True)
def give_rows(first, last, rows, batch, passed):  # type: ignore[no-untyped-def]
    """A simulation step has passed for egos whose position is given; ``passed`` [s] is 0 at a start."""
    a = unbundle(batch)
    for n in range(first, last):
        take_given(a.ego.belief[rows[n]], cars_of(a.cars, rows[n]), a.lanes, passed, a.rules[0])


@jit(borrows=True)
def coast_rows(first, last, rows, batch, motions, tracks):  # type: ignore[no-untyped-def]
    """A simulation step that ends no epoch; ``tracks``: None where the egos' positions are given."""
    a = unbundle(batch)
    for n in range(first, last):
        follow_motion(motions, a.cars, rows[n])
        if tracks is not None:
            carry_on(tracks[rows[n]], a.ego.belief[rows[n]], a.lanes, a.rules[0])


# After an epoch


@jit
def end_epoch(first, last, rows, batch, sensed, motions, down, times, truth):  # type: ignore[no-untyped-def]
    """A simulation step has passed that ends an epoch: the truth of the epoch, and the skies over the egos now.

    ``down`` [m/s]: what gravity adds over an epoch; times: see :func:`sky_rows`; truth (N M,) TRUTH.
    """
    a, where, count = unbundle(batch), unbundle(sensed).where, motions.shape[1]
    for n in range(first, last):
        follow_motion(motions, a.cars, rows[n])
        fill_whereabouts(a.cars, a.lanes, where, rows[n], rows[n] * count, count, truth)
    fill_motion(motions, rows[first:last], a.rules[0].step_s, down, truth)
    sky_rows(first, last, rows, sensed, times)


@jit(borrows=True)
def sky_rows(first, last, rows, sensed, times):  # type: ignore[no-untyped-def]
    """The skies over environments; times: hour (N,), and time since its beginning (N,) [s]."""
    a, (hour, clock) = unbundle(sensed), times
    for n in range(first, last):
        e = rows[n]
        fill_sky(a.hours, hour[e], clock[e], e, a.sky)


@jit(borrows=True)
def begin_rows(first, last, rows, at, fixes, shift, tracks, batch):  # type: ignore[no-untyped-def]
    """Start egos at their first solutions, rows ``at`` (n,) of fixes; shift (n, 2): errors of their maps [m]."""
    a = unbundle(batch)
    for n in range(first, last):
        t, b = tracks[rows[n]], a.ego.belief[rows[n]]
        begin(t, b, fixes[at[n]], shift[n, 0], shift[n, 1])
        settle(t, b, a.lanes, 0.0, a.rules[0])


@jit(borrows=True)
def take_rows(first, last, rows, at, fixes, tracks, batch):  # type: ignore[no-untyped-def]
    """New solutions of egos, rows ``at`` (n,) of fixes."""
    a = unbundle(batch)
    for n in range(first, last):
        t, b = tracks[rows[n]], a.ego.belief[rows[n]]
        take(t, b, fixes[at[n]], a.rules[0])
        settle(t, b, a.lanes, a.rules[0].step_s, a.rules[0])


@jit(borrows=True)
def count_rows(first, last, rows, batch):  # type: ignore[no-untyped-def]
    """Count a navigation epoch of egos for scoring."""
    a = unbundle(batch)
    for n in range(first, last):
        count_epoch(a.ego.belief[rows[n]], a.ego.score[rows[n]], cars_of(a.cars, rows[n]))


@jit(borrows=True)
def hear_rows(first, last, rows, at, fixes, batch, time, u, lies):  # type: ignore[no-untyped-def]
    """One epoch of the radio: the other vehicles broadcast their solutions.

    Row ``at[n] + 1 + slot`` of fixes belongs to the vehicle in a slot of environment ``rows[n]``; time (n,): of the
    episodes; u (n, C + 1, 2) uniform draws; lies: see :func:`.perception_kernel.hear`.
    """
    a = unbundle(batch)
    p = a.pictures
    for n in range(first, last):
        e = rows[n]
        for i in range(p.spoken.shape[1]):
            claim(fixes[at[n] + 1 + i], p.spoken[e, i])
        hear(p.picture[e], p.radio, e, p.of_radio[0], time[n], p.spoken[e], cars_of(a.cars, e), u[n], lies)


@jit
def look_rows(first, last, rows, batch, noise):  # type: ignore[no-untyped-def]
    """One epoch of the sensors; noise (n, C + 1, 4) standard normal."""
    a = unbundle(batch)
    p, ahead = a.pictures, np.empty((a.cars.x.shape[1], 2))
    for n in range(first, last):
        e = rows[n]
        look(p.picture[e], p.tracks[e], p.of_sensor[0], a.ego.belief[e], cars_of(a.cars, e), noise[n], ahead)


@jit
def sum_up_rows(first, last, rows, batch, time):  # type: ignore[no-untyped-def]
    """The vehicles that the egos perceive by radio and sensor at ``time`` (n,) of their episodes."""
    a = unbundle(batch)
    p, square = a.pictures, np.empty(a.pictures.perceived.shape[1] + 1)
    for n in range(first, last):
        e = rows[n]
        p.picture[e].seen = sum_up(
            p.radio, p.tracks[e], p.slots[e], e, p.of_tracks[0], time[n], a.ego.belief[e], square, p.perceived[e]
        )


# After a policy step


@jit(borrows=True)
def locate_rows(first, last, rows, batch):  # type: ignore[no-untyped-def]
    """Where the beliefs are on the egos' own maps, and what of them is shown."""
    a = unbundle(batch)
    for n in range(first, last):
        e = rows[n]
        locate(a.ego.belief[e], a.lanes, a.path_of, a.rules[0])
        if a.integrity == ORACLE:
            a.ego.shown[e] = a.ego.belief[e]
            true_view(a.ego.belief[e], cars_of(a.cars, e), a.lanes, a.path_of, a.rules[0], a.ego.shown[e])


@jit
def predict_rows(first, last, rows, batch, sensed):  # type: ignore[no-untyped-def]
    """Satellites that the map predicts ahead of what is shown of the egos."""
    a, s = unbundle(batch), unbundle(sensed)
    cells = np.empty((2, a.words.sky.shape[1]), np.int64)
    for n in range(first, last):
        e = rows[n]
        predict(a.ego.shown[e], a.lanes, a.routes, s.where, s.forecast, s.sky, e, cells, a.words.sky[e])


@jit
def finish_rows(first, last, rows, batch, start):  # type: ignore[no-untyped-def]
    """Score and observe at the end of a policy step, or at a start."""
    a = unbundle(batch)
    every = a.cars.x.shape[1]
    order, square, truth = np.empty(every, np.int64), np.empty(every), np.empty_like(a.pictures.perceived[0])
    for n in range(first, last):
        _finish(rows[n], a, start, order, square, truth)


@jit(borrows=True)
def _finish(e, a, start, order, square, truth):  # type: ignore[no-untyped-def]
    """:func:`finish_rows` for one environment; order, square (V,) and truth (P,) PERCEIVED are scratch."""
    car, b, sc, rules = cars_of(a.cars, e), a.ego.belief[e], a.ego.score[e], a.rules[0]
    seen, picture = a.pictures.perceived[e], a.pictures.picture[e]
    if a.sees_truth != 0:
        picture.seen = see_truth(car, b.x_m, b.y_m, False, order, square, seen)
    score(b, sc, car, seen, picture.seen, a.lanes, a.ego.facts[e], rules, start, a.ego.outcome[e])
    count = picture.seen
    if a.integrity == ORACLE:
        seen = truth
        count = see_truth(car, car.x[0], car.y[0], True, order, square, seen)
    if start:
        sc.observed = 0
    derive(a.ego.shown[e], seen, count, a.lanes, a.routes, rules, a.integrity, sc.observed, e, a.views)
    sc.observed += 1
    fill_frame(a.sources, a.words, e, a.views.own[e], a.frame[e])


# Before a start


@jit(borrows=True)
def approach_step(first, last, rows, motions, begin, ahead, passed_s, end):  # type: ignore[no-untyped-def]
    """A simulation step of an approach, to the poses ``passed_s`` after its beginning, or to ``end`` if given.

    begin, ahead, end (n, M, 2); ``end`` is None but for the last step.
    """
    for n in range(first, last):
        for i in range(motions.shape[1]):
            x, y = begin[n, i, 0] + passed_s * ahead[n, i, 0], begin[n, i, 1] + passed_s * ahead[n, i, 1]
            if end is not None:
                x, y = end[n, i, 0], end[n, i, 1]
            advance(motions[n, i], x, y, motions[n, i].heading_rad)
