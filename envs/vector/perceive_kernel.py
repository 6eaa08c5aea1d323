"""Whom the egos perceive: everybody as they are, or those that they hear by radio or see with a sensor of their own."""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.perception.tracks_kernel import AGE, N_COLUMNS, bring_forward, measure
from lanebound.envs.perception.tracks_kernel import HEADING as TRACK_HEADING
from lanebound.envs.perception.tracks_kernel import PL_AT as TRACK_PL_AT
from lanebound.envs.perception.tracks_kernel import PL_CT as TRACK_PL_CT
from lanebound.envs.perception.tracks_kernel import SPEED as TRACK_SPEED
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.collisions_kernel import LENGTH_M, WIDTH_M
from lanebound.integrity.core.accel import jit

__all__ = ["hear_all", "look_all", "see_truth", "sum_up"]

SENDS = N_COLUMNS  # column of claims: whether the vehicle says anything
LATENCY_S, JITTER_S, LATENCY_MAX_S, LOSS, RANGE_M, EPOCH_S, RATE_HZ = range(7)  # columns of the radio's figures
DROP_S, ALONG_MPS2, ACROSS_MPS2, COURSE_SIN = range(4)  # of those of all tracks
ROUNDING = 1e-9


@jit
def see_truth(c, w, x, y, order, square, t):  # type: ignore[no-untyped-def]
    """Fill ``t`` (V - 1, SEEN) with all others, nearest to (x, y) first; ``order`` and ``square`` (V,) are scratch.

    Of two at one distance the first in the world comes first.
    """
    count = k.population(w) - 1
    for i in range(1, count + 1):
        dx, dy = c[k.X, i] - x, c[k.Y, i] - y
        distance, at = dx * dx + dy * dy, i - 1
        while at > 0 and square[at - 1] > distance:
            square[at], order[at] = square[at - 1], order[at - 1]
            at -= 1
        square[at], order[at] = distance, i
    for n in range(count):
        i = order[n]
        t[n, k.T_X], t[n, k.T_Y] = c[k.X, i], c[k.Y, i]
        t[n, k.T_HEADING], t[n, k.T_SPEED] = c[k.HEADING, i], c[k.SPEED, i]
        t[n, k.T_PL_AT] = t[n, k.T_PL_CT] = t[n, k.T_AGE] = t[n, k.T_RELATIVE] = 0.0
        t[n, k.T_LENGTH], t[n, k.T_WIDTH] = LENGTH_M, WIDTH_M
    return count


@jit
def _reaches(figures, c, i, u):  # type: ignore[no-untyped-def]
    """Whether a message of vehicle ``i`` gets through: ``P = (1 - loss) (1 - (d / range)^4)`` within the range."""
    x, y = (c[k.X, 0] - c[k.X, i]) / figures[RANGE_M], (c[k.Y, 0] - c[k.Y, i]) / figures[RANGE_M]
    fade = min(x * x + y * y, 1.0)
    return u < (1.0 - figures[LOSS]) * (1.0 - fade * fade)


@jit
def _hear(figures, epoch, sent, time, claims, c, u, broadcasts, arriving, origin, held, told):  # type: ignore[no-untyped-def]
    """One epoch of the radio to one ego, as :func:`~lanebound.integrity.sensors.v2v.exchange`; returns what is sent."""
    slots, count = arriving.shape
    at, due = epoch % slots, math.floor(epoch * figures[EPOCH_S] * figures[RATE_HZ] + ROUNDING)
    broadcasts[at, :, :AGE], broadcasts[at, :, AGE] = claims[:, :AGE], time
    if due > sent:
        for i in range(count):
            delay = figures[LATENCY_S] - figures[JITTER_S] * math.log1p(-u[i, 1])
            if claims[i, SENDS] > 0.0 and delay <= figures[LATENCY_MAX_S] and _reaches(figures, c, i + 1, u[i, 0]):
                wait = math.ceil(delay / figures[EPOCH_S] - ROUNDING)
                arriving[(epoch + wait) % slots, i] = epoch
    for i in range(count):
        if arriving[at, i] > origin[i]:
            origin[i] = arriving[at, i]
            held[i] = broadcasts[origin[i] % slots, i]
        arriving[at, i] = -1
        told[i, :AGE], told[i, AGE] = held[i, :AGE], time - held[i, AGE]
    return max(due, sent)


@jit
def hear_all(  # type: ignore[no-untyped-def]
    rows, figures, epoch, sent, time, claims, cars, u, broadcasts, arriving, origin, held, told
):  # fmt: skip
    """Bring the radio of environments ``rows`` (n,) to their next epoch, at ``time`` (n,) of their episodes.

    claims (n, C, 8): tracks that the others tell of themselves, and whether they do; u (n, C + 1, 2) uniform draws.
    The state has a row for each environment: epoch, sent (N,); broadcasts (N, L, C, 7) of the last L epochs; arriving
    (N, L, C), epoch of origin of what arrives in a coming one; origin (N, C), held (N, C, 7): of what is held, with its
    time in place of its age. ``told`` (N, C + 1, 7) is filled.
    """
    for n in range(rows.shape[0]):
        e = rows[n]
        epoch[e] += 1
        sent[e] = _hear(
            figures, epoch[e], sent[e], time[n], claims[n], cars[e], u[n], broadcasts[e], arriving[e], origin[e],
            held[e], told[e],
        )  # fmt: skip


@jit
def _look(figures, b, c, w, noise, dt, last, held):  # type: ignore[no-untyped-def]
    """The sensor of one ego, as :class:`~lanebound.envs.perception.sensor.Sensor`; ``last`` (2,) is where it was."""
    count = k.population(w)
    tracks = held[:count]
    slot, place = np.arange(count), np.empty((count, 2))
    heading, speed = np.empty(count), np.empty(count)
    length, width = np.full(count, LENGTH_M), np.full(count, WIDTH_M)
    for i in range(count):
        of = (i + 1) % count
        place[i, 0], place[i, 1], heading[i], speed[i] = c[k.X, of], c[k.Y, of], c[k.HEADING, of], c[k.SPEED, of]
    travelled = b[k.B_SPEED] * dt
    east, south = math.cos(b[k.B_HEADING]) * travelled, math.sin(b[k.B_HEADING]) * travelled
    for i in range(count):
        tracks[i, 0] += b[k.B_X] - last[0] - east
        tracks[i, 1] += b[k.B_Y] - last[1] - south
        tracks[i, AGE] += dt
    last[0], last[1] = b[k.B_X], b[k.B_Y]
    ego = np.array([b[k.B_X], b[k.B_Y], b[k.B_HEADING], b[k.B_SPEED]])
    measure(figures, ego, count - 1, slot, place, heading, speed, length, width, noise, tracks)


@jit
def look_all(rows, figures, belief, cars, whole, noise, dt, last, seen):  # type: ignore[no-untyped-def]
    """Let the egos of ``rows`` (n,) look: noise (n, C + 1, 4); last (N, 2), seen (N, C + 1, 7) advance in place."""
    for n in range(rows.shape[0]):
        e = rows[n]
        _look(figures, belief[e], cars[e], whole[e], noise[n], dt, last[e], seen[e])


@jit
def sum_up(rows, figures, told, seen, belief, traffic, counts):  # type: ignore[no-untyped-def]
    """Fill ``traffic`` (N, C, SEEN) and ``counts`` (N,): tracks young enough, brought forward, nearest first."""
    slots = told.shape[1]
    tracks, whose, relative = np.empty((slots, N_COLUMNS)), np.empty(slots, np.int64), np.empty(slots, np.bool_)
    for e in rows:
        count = bring_forward(
            told[e], seen[e], figures[DROP_S], figures[ALONG_MPS2], figures[ACROSS_MPS2], figures[COURSE_SIN],
            np.array([belief[e, k.B_X], belief[e, k.B_Y]]), tracks, whose, relative,
        )  # fmt: skip
        counts[e] = count
        for n in range(count):
            t = traffic[e, n]
            t[k.T_X], t[k.T_Y] = tracks[n, 0], tracks[n, 1]
            t[k.T_HEADING], t[k.T_SPEED] = tracks[n, TRACK_HEADING], tracks[n, TRACK_SPEED]
            t[k.T_PL_AT], t[k.T_PL_CT] = tracks[n, TRACK_PL_AT], tracks[n, TRACK_PL_CT]
            t[k.T_AGE], t[k.T_RELATIVE] = tracks[n, AGE], k.flag(relative[n])
            t[k.T_LENGTH], t[k.T_WIDTH] = LENGTH_M, WIDTH_M
