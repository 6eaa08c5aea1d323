"""One policy step of each environment: traffic and ego move, the ego perceives, truth scores, the agent sees.

What changes is in :class:`World`, what does not in :class:`Rules`; every array of a World has a row for each
environment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.city_kernel import decide_all, drive_city, place_everybody
from lanebound.envs.vector.collisions_kernel import collide_all
from lanebound.envs.vector.course_kernel import drive_leads
from lanebound.envs.vector.ego_kernel import command, decide, know, move, show_intent
from lanebound.envs.vector.motorway_kernel import accelerate, change_lanes, drive_others, sort_along, survey
from lanebound.envs.vector.observe_kernel import ORACLE, observe, true_view
from lanebound.envs.vector.perceive_kernel import see_truth
from lanebound.envs.vector.score_kernel import locate, score
from lanebound.integrity.core.accel import jit

__all__ = ["CITY", "COURSE", "MOTORWAY", "Rules", "World", "run_some"]

MOTORWAY, COURSE, CITY = range(3)  # whose drivers the others are
DECIDE, FINISH, START = 1, 2, 4  # parts of a run: new commands first; score and observe last, as at a start


class World(NamedTuple):
    """N environments of up to V vehicles, the ego first: columns as in :mod:`.columns_kernel`.

    cars (N, CAR, V), whole (N, WHOLE, V), belief (N, BELIEF), score (N, SCORE), out (N, OUT); traffic (N, C, SEEN) and
    seen (N,): whom the egos perceive, and how many; profile (N, S): speeds of the leads; trail (N, n + 1, 2) and
    observed (N,): levels of the last observations and their number; sky (N, 3 D); frame (N, E) float32.
    """

    cars: NDArray[np.float64]
    whole: NDArray[np.int64]
    belief: NDArray[np.float64]
    score: NDArray[np.float64]
    out: NDArray[np.float64]
    traffic: NDArray[np.float64]
    seen: NDArray[np.int64]
    profile: NDArray[np.float64]
    trail: NDArray[np.float64]
    observed: NDArray[np.int64]
    sky: NDArray[np.float64]
    frame: NDArray[np.float32]


class Rules(NamedTuple):
    """What all environments share beside their lanes and chart.

    figures (FIGURES,); speeds: target speeds of meta-actions; scale (3, E): factor, low and high of every entry;
    preview (D,) [m]; reasons, modes, rtks: codes; drivers of the others, what is shown of integrity, rows of traffic,
    whether the truth is perceived; most [m]: largest level shown.
    """

    figures: NDArray[np.float64]
    speeds: NDArray[np.float64]
    scale: NDArray[np.float64]
    preview: NDArray[np.float64]
    reasons: NDArray[np.int64]
    modes: NDArray[np.int64]
    rtks: NDArray[np.int64]
    drivers: int
    shown: int
    rows: int
    sees_truth: bool
    most: float


class Scratch(NamedTuple):
    """What an environment's step leaves behind and nobody reads: one for each run, not for each environment.

    newest (L + 1,); held (2, V); pairs (P,); places (V, L); slip, square (V,); order (V,); ego (BELIEF,); values (E,).
    """

    newest: NDArray[np.int64]
    held: NDArray[np.int64]
    pairs: NDArray[np.int64]
    places: NDArray[np.float64]
    slip: NDArray[np.float64]
    square: NDArray[np.float64]
    order: NDArray[np.int64]
    ego: NDArray[np.float64]
    values: NDArray[np.float64]


@jit
def _scratch(vehicles, lanes, entries):  # type: ignore[no-untyped-def]
    return Scratch(
        np.empty(lanes + 1, np.int64), np.empty((2, vehicles), np.int64),
        np.empty(vehicles * vehicles // 2 + 1, np.int64), np.empty((vehicles, lanes)), np.empty(vehicles),
        np.empty(vehicles), np.empty(vehicles, np.int64), np.empty(k.BELIEF), np.empty(entries),
    )  # fmt: skip


@jit
def _frame(c, w, b, sc, profile, lanes, rules, scratch):  # type: ignore[no-untyped-def]
    """One simulation step of an environment: all decide by where everybody is, then all move, then they may crash."""
    figures, dt = rules.figures, rules.figures[k.F_STEP_S]
    motorway, city = rules.drivers == MOTORWAY, rules.drivers == CITY
    steering, acceleration, hold = command(b, lanes, figures)
    if motorway or city:
        show_intent(b, c, w, figures)
    if motorway:
        survey(c, w, lanes.table, scratch.newest, scratch.held)
        change_lanes(c, w, lanes.table, figures[k.F_META] > 0.0)
        accelerate(c, w, lanes.table)
    elif city:
        place_everybody(c, w, lanes, scratch.places)
        decide_all(c, w, lanes, scratch.places, figures[k.F_META] > 0.0)
    move(c, w, steering, acceleration, hold, lanes, figures)
    if motorway:
        drive_others(c, w, lanes.table, dt, scratch.slip)
        sort_along(c, w)
    elif city:
        drive_city(c, w, lanes, dt)
    else:
        drive_leads(c, w, lanes, profile, int(sc[k.S_STEPS]) + 1, dt)
    collide_all(c, w, motorway, dt, scratch.pairs)
    sc[k.S_STEPS] += 1.0
    if figures[k.F_PERFECT] > 0.0:
        know(b, c, w, lanes, dt)


@jit
def _finish(e, world, lanes, chart, rules, start, scratch):  # type: ignore[no-untyped-def]
    """Perceive, judge and observe an environment at the end of a policy step, or at its start."""
    c, w, b, sc = world.cars[e], world.whole[e], world.belief[e], world.score[e]
    order, square, view = scratch.order, scratch.square, scratch.ego
    locate(b, lanes, rules.figures[k.F_META])
    if rules.sees_truth:
        world.seen[e] = see_truth(c, w, b[k.B_X], b[k.B_Y], order, square, world.traffic[e])
    score(b, sc, c, w, world.traffic[e], world.seen[e], lanes, rules.figures, start, world.out[e])
    shown, traffic, count = b, world.traffic[e], world.seen[e]
    if rules.shown == ORACLE:
        true_view(b, c, w, lanes, rules.figures[k.F_META], view)
        shown = view
        traffic = np.empty((c.shape[1] - 1, k.SEEN))
        count = see_truth(c, w, c[k.X, 0], c[k.Y, 0], order, square, traffic)
    if start:
        world.observed[e] = 0
    observe(
        shown, traffic, count, lanes, chart, rules.figures, rules.shown, rules.rows, rules.preview,
        (rules.reasons, rules.modes, rules.rtks), world.trail[e], world.observed[e], rules.most, world.sky[e],
        rules.scale, scratch.values, world.frame[e],
    )  # fmt: skip
    world.observed[e] += 1


@jit
def run_some(first, last, rows, frames, parts, actions, world, lanes, chart, rules):  # type: ignore[no-untyped-def]
    """Simulate ``frames`` steps of the environments ``rows[first:last]``.

    ``parts`` adds up DECIDE (take up ``actions`` (N,), codes of meta-actions, first), FINISH (score and observe after)
    and START (with FINISH: no time has passed).
    """
    scratch = _scratch(world.cars.shape[2], lanes.table.shape[0], rules.scale.shape[1])
    for n in range(first, last):
        e = rows[n]
        c, w, b, sc = world.cars[e], world.whole[e], world.belief[e], world.score[e]
        if parts & DECIDE and rules.figures[k.F_META] > 0.0:
            decide(b, actions[e], lanes, rules.speeds)
        for _ in range(frames):
            _frame(c, w, b, sc, world.profile[e], lanes, rules, scratch)
        if parts & FINISH:
            _finish(e, world, lanes, chart, rules, parts & START != 0, scratch)
