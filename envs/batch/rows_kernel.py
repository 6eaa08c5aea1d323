"""Entry kernels, each for environments ``rows[first:last]``; the formulas are in the other files of this package.

cars (N, V) CAR; egos (N,) EGO; motions (N, M) MOTION of M navigating vehicles, the ego first, M = 0 where none
navigates; lanes, routes: of the road network; rules (1,) RULES.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.batch.belief_kernel import begin, coast, locate, settle, take, take_given, trust_anew
from lanebound.envs.batch.budget_kernel import budget_limits, permitted_mps
from lanebound.envs.batch.closure_kernel import place_closure, receive
from lanebound.envs.batch.cooperative_kernel import relate
from lanebound.envs.batch.costs_kernel import TOLERANCE_MPS, begin_corridor, follow_corridor
from lanebound.envs.batch.lane_sensor_kernel import body_of, look_at_lane, match, open_eye
from lanebound.envs.batch.motion_kernel import advance, fill_motion, fill_whereabouts, follow_motion
from lanebound.envs.batch.perception_kernel import claim, hear, look, see_truth, sum_up
from lanebound.envs.batch.records_kernel import BY_LEVEL, BY_ROADS, GIVEN
from lanebound.envs.batch.score_kernel import count_epoch, score
from lanebound.envs.batch.sky_ahead_kernel import fill_sky, predict
from lanebound.envs.batch.toll_kernel import follow_toll
from lanebound.envs.batch.view_kernel import ORACLE, derive, fill_frame, true_view, words_of
from lanebound.integrity.core.accel import jit
from lanebound.integrity.sensors.uwb_kernel import range_all

__all__ = ["approach_step", "begin_rows", "carry_on", "carry_rows", "claim_rows", "conclude_rows", "count_rows",
           "end_epoch", "give_rows", "hear_rows", "look_rows", "open_rows", "range_rows", "receive_rows", "relate_rows",
           "sky_rows", "sum_up_rows", "take_rows"]  # fmt: skip

EPS_S = 1e-9


# After a simulation step


@jit(borrows=True)
def carry_on(ego, cars, motions, lanes, rules, ends_epoch):  # type: ignore[no-untyped-def]
    """Carry the belief of an ego on by a simulation step; at the end of an epoch a sensed one waits for its solution.

    cars (v,) and motions (M,): of its environment.
    """
    sees = rules.camera != 0
    if sees:
        look_at_lane(ego, cars[0], lanes, rules)
    if rules.source == GIVEN:
        if sees:  # the heading of the position that is given, whose change is the turn rate
            ego.belief.heading_rad = ego.camera.fix_heading_rad
        take_given(ego.belief, ego.track, cars[0], lanes, rules.step_s, rules)
    elif not ends_epoch:
        coast(ego.track, rules.step_s)
        settle(ego.track, ego.belief, lanes, rules.step_s, rules)
    if sees and (rules.source == GIVEN or not ends_epoch):
        match(ego, lanes, rules)
    if motions.shape[0] > 0 and not ends_epoch:  # else end_epoch follows them
        follow_motion(cars, motions)


@jit(borrows=True)
def carry_rows(first, last, rows, cars, egos, motions, lanes, rules, ends_epoch):  # type: ignore[no-untyped-def]
    """A simulation step has passed."""
    for e in rows[first:last]:
        carry_on(egos[e], cars[e, : egos[e].vehicles], motions[e], lanes, rules[0], ends_epoch)


# After an epoch


@jit
def end_epoch(first, last, rows, cars, egos, motions, lanes, where, step_s, down, truth):  # type: ignore[no-untyped-def]
    """A simulation step has passed that ends an epoch: fill the truth (N M,) TRUTH of the epoch.

    ``down`` [m/s]: what gravity adds over an epoch.
    """
    count = motions.shape[1]
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        follow_motion(here, motions[e])
        fill_whereabouts(here, lanes, where, e, truth[e * count : (e + 1) * count])
    fill_motion(motions, rows[first:last], step_s, down, truth)


@jit(borrows=True)
def sky_rows(first, last, rows, hours, hour, clock, sky):  # type: ignore[no-untyped-def]
    """The skies over environments; hour (N,), and time since its beginning (N,) [s]."""
    for e in rows[first:last]:
        fill_sky(hours, hour[e], clock[e], e, sky)


@jit(borrows=True)
def open_rows(first, last, rows, cars, egos, states, lanes, rules):  # type: ignore[no-untyped-def]
    """Start the lane sensors of egos with generators, states (n, 4)."""
    for n in range(first, last):
        e = rows[n]
        open_eye(egos[e], cars[e, 0], states[n], lanes, rules[0])


@jit(borrows=True)
def _match_first(ego, lanes, rules):  # type: ignore[no-untyped-def]
    """The first belief of an ego with a lane sensor."""
    ego.camera.turned_rad = ego.belief.heading_rad
    ego.eye.speed_mps = ego.belief.speed_mps
    match(ego, lanes, rules)


@jit(borrows=True)
def give_rows(first, last, rows, cars, egos, lanes, rules):  # type: ignore[no-untyped-def]
    """Start egos whose positions are given."""
    for e in rows[first:last]:
        take_given(egos[e].belief, egos[e].track, cars[e, 0], lanes, 0.0, rules[0])
        if rules[0].camera != 0:
            _match_first(egos[e], lanes, rules[0])


@jit(borrows=True)
def begin_rows(first, last, rows, at, fixes, shift, egos, lanes, rules):  # type: ignore[no-untyped-def]
    """Start egos at their first solutions, rows ``at`` (n,) of fixes; shift (n, 2): errors of their maps [m]."""
    for n in range(first, last):
        ego = egos[rows[n]]
        begin(ego.track, ego.belief, fixes[at[n]], shift[n, 0], shift[n, 1])
        settle(ego.track, ego.belief, lanes, 0.0, rules[0])
        if rules[0].camera != 0:
            _match_first(ego, lanes, rules[0])


@jit(borrows=True)
def take_rows(first, last, rows, at, fixes, egos, lanes, rules):  # type: ignore[no-untyped-def]
    """New solutions of egos, rows ``at`` (n,) of fixes."""
    for n in range(first, last):
        ego = egos[rows[n]]
        take(ego.track, ego.belief, fixes[at[n]], rules[0])
        settle(ego.track, ego.belief, lanes, rules[0].step_s, rules[0])
        if rules[0].camera != 0:
            match(ego, lanes, rules[0])


@jit(borrows=True)
def count_rows(first, last, rows, cars, egos):  # type: ignore[no-untyped-def]
    """Count a navigation epoch of egos for scoring."""
    for e in rows[first:last]:
        count_epoch(egos[e].belief, egos[e].score, cars[e, 0])


@jit(borrows=True)
def claim_rows(first, last, rows, at, fixes, pictures):  # type: ignore[no-untyped-def]
    """What the other vehicles broadcast: their solutions.

    Row ``at[n] + 1 + slot`` of fixes belongs to the vehicle in a slot of environment ``rows[n]``.
    """
    for n in range(first, last):
        spoken = pictures.spoken[rows[n]]
        for i in range(spoken.shape[0]):
            claim(fixes[at[n] + 1 + i], spoken[i])


@jit(borrows=True)
def hear_rows(first, last, rows, cars, egos, pictures, time, u, lies):  # type: ignore[no-untyped-def]
    """One epoch of the radio: the other vehicles broadcast what they say.

    time (n,): of the episodes; u (n, C + 1, 2) uniform draws; lies: see :func:`.perception_kernel.hear`.
    """
    p = pictures
    for n in range(first, last):
        e = rows[n]
        here = cars[e, : egos[e].vehicles]
        hear(p.picture[e], p.radio, e, p.of_radio[0], time[n], p.spoken[e], here, u[n], lies)


@jit(borrows=True)
def receive_rows(first, last, rows, cars, egos, radio, time):  # type: ignore[no-untyped-def]
    """One epoch of the messages on closed lanes; radio (1,) RADIO, time (n,) of the episodes."""
    for n in range(first, last):
        receive(egos[rows[n]].closure, cars[rows[n], 0], radio[0], time[n])


@jit
def look_rows(first, last, rows, cars, egos, pictures, noise):  # type: ignore[no-untyped-def]
    """One epoch of the sensors; noise (n, C + 1, 4) standard normal."""
    ahead, p = np.empty((cars.shape[1], 2)), pictures
    for n in range(first, last):
        e = rows[n]
        here = cars[e, : egos[e].vehicles]
        look(p.picture[e], p.tracks[e], p.of_sensor[0], egos[e].belief, here, noise[n], ahead, p.walls)


@jit
def range_rows(first, last, rows, cars, egos, pictures, normal, uniform, time):  # type: ignore[no-untyped-def]
    """One epoch of ranges; normal (n, C + 1, PAIRS) and uniform (n, C + 1, 2 PAIRS): draws.

    None before an episode: what is heard then comes from an approach, on which ``cars`` are not.
    """
    ahead, scratch, p = np.empty((cars.shape[1], 2)), np.empty((10, 2)), pictures
    for n in range(first, last):
        e = rows[n]
        here, g, epoch = cars[e, : egos[e].vehicles], p.ranging, p.picture[e].epoch
        turns = g.of_ranges[0].epoch_s * g.of_ranges[0].rate_hz
        if time[n] < -EPS_S or math.floor(epoch * turns + EPS_S) == math.floor((epoch - 1) * turns + EPS_S):
            g.ranges[e] = -1.0
            continue
        range_all(
            g.of_ranges[0], here, g.modules[e], g.links[e], p.walls, normal[n], uniform[n], ahead, scratch, g.ranges[e]
        )  # fmt: skip


@jit(borrows=True)
def relate_rows(first, last, rows, egos, pictures, time):  # type: ignore[no-untyped-def]
    """One epoch of positions by ranges and broadcasts, by what the egos know alone."""
    p, g = pictures, pictures.ranging
    for n in range(first, last):
        e = rows[n]
        if time[n] >= -EPS_S:
            relate(
                p.picture[e], g.relations[e], p.radio.held[e], p.tracks[e], g.ranges[e], g.of_ranges[0],
                g.of_relations[0], p.of_tracks[0], time[n], egos[e].belief, egos[e].track,
            )  # fmt: skip


@jit
def sum_up_rows(first, last, rows, egos, pictures, time):  # type: ignore[no-untyped-def]
    """The vehicles that the egos perceive by radio and sensor at ``time`` (n,) of their episodes."""
    p, square = pictures, np.empty(pictures.perceived.shape[1] + 1)
    for n in range(first, last):
        e = rows[n]
        p.picture[e].seen = sum_up(
            p.radio, p.tracks[e], p.slots[e], e, p.of_tracks[0], time[n], egos[e].belief, square, p.perceived[e]
        )


# After a policy step


@jit
def conclude_rows(  # type: ignore[no-untyped-def]
    first, last, rows, cars, egos, picture, perceived, path_of, lanes, routes, rules, views, ahead, sources, frame,
    start,
):  # fmt: skip
    """Score a policy step, or a start, and observe: one call, as each array of a call takes 0.1 to 0.5 us.

    More than 12 parameters: with lanes, routes and views in records of records a call takes 2 us longer, of 11.

    picture (N,) PICTURE, perceived (N, P) PERCEIVED; path_of (Q, L): row of the path from each lane, by ``ego.route``;
    ahead: what satellites are predicted from, None where they are not; sources (E,) SOURCE of the frames (N, E).
    """
    truth, cells = np.empty_like(perceived[0]), np.empty((2, views.sky.shape[1]), np.int64)
    words = words_of(egos, views)
    for e in rows[first:last]:
        ego, here, seen = egos[e], cars[e, : egos[e].vehicles], perceived[e]
        _score(ego, here, picture[e], seen, path_of[ego.route], lanes, routes, rules[0], start)
        if ahead is not None:
            predict(ego.shown, lanes, routes, ahead, e, cells, views.sky[e])
        count = picture[e].seen
        if rules[0].shown == ORACLE:
            seen, count = truth, see_truth(here, here[0].x, here[0].y, True, truth)
        if start:
            ego.score.observed = 0
        derive(ego, seen, count, lanes, routes, rules[0], e, views)
        ego.score.observed += 1
        fill_frame(sources, words, e, ego.own, frame[e])


@jit(borrows=True)
def _score(ego, cars, picture, seen, path_of, lanes, routes, rules, start):  # type: ignore[no-untyped-def]
    """Place the belief on the ego's own map, set its limits, score the step, or a start, and find what is shown."""
    b = ego.belief
    locate(b, lanes, path_of, rules)
    place_closure(ego.closure, b, lanes)
    body = body_of(ego, rules)
    if rules.camera != 0 and rules.meta == 0:
        body.target_lane, body.target_speed_mps = body.lane, b.speed_mps
    if start:
        begin_corridor(ego.score, body, lanes)
    else:
        follow_corridor(ego.score, body, cars[0], lanes, rules, rules.policy_s)
    if rules.sees_truth != 0:
        picture.seen = see_truth(cars, b.x_m, b.y_m, False, seen)
    if rules.budgets != 0:
        b.al_at_m, b.al_ct_m = budget_limits(
            b, b.speed_mps, ego.score, cars[0], seen, picture.seen, lanes, routes, rules
        )
        trust_anew(b, ego.track, rules)
    follow_toll(ego, cars[0], lanes, rules, start)
    score(b, body, ego.score, cars, seen, picture.seen, lanes, ego.facts, ego.closure, rules, start, ego.outcome)
    if ego.toll.wrong != 0:
        ego.outcome.is_success = 0.0
    if rules.permits == BY_LEVEL:  # after the score: a step is judged by the speed that was shown before it
        b.permitted_mps = permitted_mps(b, ego.score, cars[0], seen, picture.seen, lanes, routes, rules)
    elif rules.permits == BY_ROADS:
        limit = lanes.table[b.lane].speed_limit_mps
        limit = limit if limit > 0.0 else math.inf
        b.permitted_mps = (b.possible_mps if b.alert != 0 else limit) + TOLERANCE_MPS
    ego.shown = b
    if rules.shown == ORACLE:
        true_view(cars[0], lanes, path_of, rules, ego.shown)
        place_closure(ego.closure, ego.shown, lanes)


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
