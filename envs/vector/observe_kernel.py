"""The numbers of an observation in the order of the published index, before scale and bounds, and after."""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.chart_kernel import (
    END_M,
    JUNCTION_M,
    LANE_END_M,
    LEFT_EXISTS,
    LIMIT,
    RIGHT_EXISTS,
    SHARE,
    path_at,
    project,
)
from lanebound.envs.vector.columns_kernel import flag
from lanebound.envs.vector.lanes_kernel import ROAD, SIDE, WIDTH, local, wrap
from lanebound.integrity.core.accel import jit

__all__ = ["BLIND", "FULL", "ORACLE", "observe", "true_view"]

FULL, BLIND, ORACLE = range(3)  # what is shown of integrity
UNKNOWN = -math.inf  # a number of satellites that nobody predicts


@jit
def true_view(b, c, w, lanes, meta, view):  # type: ignore[no-untyped-def]
    """Fill ``view`` with the belief of an ego that knows everything: its true pose, no level needed."""
    view[:] = b
    lane = w[k.LANE, 0]
    s, r, direction = local(lanes, lane, c[k.X, 0], c[k.Y, 0])
    view[k.B_X], view[k.B_Y], view[k.B_HEADING], view[k.B_SPEED] = (
        c[k.X, 0], c[k.Y, 0], c[k.HEADING, 0], c[k.SPEED, 0],
    )  # fmt: skip
    view[k.B_LANE], view[k.B_ALONG], view[k.B_LATERAL] = lane, s, r
    view[k.B_ANGLE], view[k.B_WIDTH] = wrap(c[k.HEADING, 0] - direction), lanes.table[lane, WIDTH]
    view[k.B_PL_AT] = view[k.B_PL_CT] = 0.0
    if not meta > 0.0:
        view[k.B_TARGET_LANE], view[k.B_TARGET_SPEED] = lane, c[k.SPEED, 0]


@jit
def _ego(b, chart, table, out):  # type: ignore[no-untyped-def]
    """Group ``ego``; returns where the next group begins."""
    lane = int(b[k.B_LANE])
    out[0], out[1], out[2], out[3] = b[k.B_SPEED], b[k.B_TARGET_SPEED], b[k.B_ACCELERATION], b[k.B_YAW_RATE]
    out[4], out[5], out[6] = b[k.B_STEERING], math.sin(b[k.B_ANGLE]), math.cos(b[k.B_ANGLE])
    out[7], out[8], out[9] = b[k.B_LATERAL], b[k.B_LATERAL] / (0.5 * b[k.B_WIDTH]), b[k.B_WIDTH]
    out[10], out[11] = chart.facts[lane, SHARE], chart.facts[lane, LEFT_EXISTS]
    out[12] = chart.facts[lane, RIGHT_EXISTS]
    change, target = 0, int(b[k.B_TARGET_LANE])
    if target != lane:
        for n in range(chart.following.shape[1]):
            other = chart.following[lane, n]
            if other >= 0 and table[other, ROAD] == table[target, ROAD]:
                change = int(table[target, SIDE]) - int(table[other, SIDE])
                break
    out[13], out[14] = flag(change < 0), flag(change > 0)
    return 15


@jit
def _axis(level, limit, trend, out, at):  # type: ignore[no-untyped-def]
    """Level, whether it exists, limit, ratio, margin and trend of one axis."""
    exists = level < math.inf
    out[at], out[at + 1], out[at + 2] = level, flag(exists), limit
    out[at + 3] = level / limit if exists and limit > 0.0 else math.inf
    out[at + 4] = limit - level if exists else -math.inf
    out[at + 5] = trend
    return at + 6


@jit
def _one_hot(code, codes, out, at):  # type: ignore[no-untyped-def]
    for n in range(codes.shape[0]):
        out[at + n] = flag(codes[n] == code)
    return at + codes.shape[0]


@jit
def _integrity(b, figures, oracle, trend_at, trend_ct, reasons, modes, rtks, out, at):  # type: ignore[no-untyped-def]
    """Group ``integrity``."""
    at = _axis(0.0 if oracle else b[k.B_PL_AT], figures[k.F_AL_AT], trend_at, out, at)
    at = _axis(0.0 if oracle else b[k.B_PL_CT], figures[k.F_AL_CT], trend_ct, out, at)
    out[at] = 1.0 if oracle else b[k.B_AVAILABLE]
    out[at + 1] = 0.0 if oracle else b[k.B_ALERT]
    out[at + 2] = 0.0 if oracle else b[k.B_ALERT_AGE]
    at = _one_hot(0.0 if oracle else b[k.B_REASON], reasons, out, at + 3)
    at = _one_hot(b[k.B_RTK], rtks, out, _one_hot(b[k.B_MODE], modes, out, at))
    out[at], out[at + 1], out[at + 2] = b[k.B_SINCE_RTK], b[k.B_SINCE_CALIBRATION], b[k.B_CORRECTIONS_AGE]
    out[at + 3], out[at + 4] = b[k.B_SATELLITES], b[k.B_DOPPLER]
    out[at + 5], out[at + 6] = b[k.B_EXCLUDED], b[k.B_HDOP]
    return at + 7


@jit
def _road(b, chart, preview, sky, out, at):  # type: ignore[no-untyped-def]
    """Group ``road``; ``sky`` (3 D,) satellites predicted on the lanes left, own and right, negative for unknown."""
    lane, here, heading = int(b[k.B_LANE]), b[k.B_ALONG], b[k.B_HEADING]
    cosine, sine = math.cos(heading), math.sin(heading)
    out[at], out[at + 1] = chart.facts[lane, LIMIT], chart.facts[lane, JUNCTION_M] - here
    out[at + 2] = chart.facts[lane, LANE_END_M] - here
    at += 3
    for n in range(preview.shape[0]):
        station = here + preview[n]
        x, y, direction, curvature = path_at(chart, lane, station)
        dx, dy = x - b[k.B_X], y - b[k.B_Y]
        out[at] = flag(station <= chart.facts[lane, END_M])
        out[at + 1], out[at + 2] = dx * cosine + dy * sine, dy * cosine - dx * sine
        out[at + 3], out[at + 4] = wrap(direction - heading), curvature
        at += 5
    for n in range(sky.shape[0]):
        missing = (n % 3 == 0 and chart.facts[lane, LEFT_EXISTS] == 0.0) or (
            n % 3 == 2 and chart.facts[lane, RIGHT_EXISTS] == 0.0
        )
        out[at + n] = UNKNOWN if missing or sky[n] < 0.0 else sky[n]
    return at + sky.shape[0]


@jit
def _vehicle(b, chart, row, shown, out, at):  # type: ignore[no-untyped-def]
    """One row of group ``traffic``."""
    heading, half = b[k.B_HEADING], 0.5 * b[k.B_WIDTH]
    cosine, sine = math.cos(heading), math.sin(heading)
    dx, dy = row[k.T_X] - b[k.B_X], row[k.T_Y] - b[k.B_Y]
    ahead, right = dx * cosine + dy * sine, dy * cosine - dx * sine
    turn = row[k.T_HEADING] - heading
    tc, ts = math.cos(turn), math.sin(turn)
    s, r, found = project(chart, int(b[k.B_LANE]), row[k.T_X], row[k.T_Y], b[k.B_ALONG] + ahead)
    gap, offset = s - b[k.B_ALONG], r
    if not found:
        gap, offset = (math.inf if ahead >= 0.0 else -math.inf), (math.inf if right >= 0.0 else -math.inf)
    out[at], out[at + 1], out[at + 2] = 1.0, ahead, right
    out[at + 3], out[at + 4] = row[k.T_SPEED] * tc - b[k.B_SPEED], row[k.T_SPEED] * ts
    out[at + 5], out[at + 6], out[at + 7], out[at + 8] = ts, tc, gap, offset
    out[at + 9] = flag(-half <= offset <= half)
    out[at + 10], out[at + 11] = flag(-3.0 * half <= offset < -half), flag(half < offset <= 3.0 * half)
    out[at + 12], out[at + 13], out[at + 14] = row[k.T_LENGTH], row[k.T_WIDTH], row[k.T_AGE]
    out[at + 15] = row[k.T_RELATIVE]
    at += 16
    if shown == BLIND:
        return at
    relative, level_at, level_ct = row[k.T_RELATIVE] > 0.0, row[k.T_PL_AT], row[k.T_PL_CT]
    own_at, own_ct = (0.0, 0.0) if relative else (b[k.B_PL_AT], b[k.B_PL_CT])
    exists = level_at < math.inf and level_ct < math.inf and own_at < math.inf and own_ct < math.inf
    out[at] = flag(shown == ORACLE or exists)
    out[at + 1] = out[at + 2] = 0.0 if shown == ORACLE else math.inf
    if exists and shown != ORACLE:
        out[at + 1] = own_at + abs(tc) * level_at + abs(ts) * level_ct
        out[at + 2] = own_ct + abs(ts) * level_at + abs(tc) * level_ct
    return at + 3


@jit
def _nobody(shown, out, at):  # type: ignore[no-untyped-def]
    """A row of group ``traffic`` without a vehicle."""
    out[at : at + 16] = 0.0
    out[at + 1] = out[at + 7] = out[at + 14] = math.inf
    if shown == BLIND:
        return at + 16
    out[at + 16] = 0.0
    out[at + 17] = out[at + 18] = math.inf
    return at + 19


@jit
def _trends(b, figures, trail, observed, most):  # type: ignore[no-untyped-def]
    """Change of the clipped levels over the last window; ``trail`` (n + 1, 2) holds those of the last n steps."""
    size = trail.shape[0]
    at, ct = min(b[k.B_PL_AT], most), min(b[k.B_PL_CT], most)
    trail[observed % size, 0], trail[observed % size, 1] = at, ct
    oldest = max(observed - size + 1, 0) % size
    return at - trail[oldest, 0], ct - trail[oldest, 1]


@jit
def observe(  # type: ignore[no-untyped-def]
    b, t, count, lanes, chart, figures, shown, rows, preview, codes, trail, observed, most, sky, scale, values, frame
):  # fmt: skip
    """Fill ``frame`` (E,) float32 with the bounded observation of a belief b and its traffic t (C, SEEN).

    codes : the codes of reasons, modes and RTK states in the order of the index; scale (3, E): factor, low, high
    trail, observed : levels of the last steps, and how many observations the episode has had
    sky : (3 D,) see :func:`_road`; values (E,) is scratch
    """
    at = _ego(b, chart, lanes.table, values)
    if shown != BLIND:
        trend_at = trend_ct = 0.0
        if shown == FULL:
            trend_at, trend_ct = _trends(b, figures, trail, observed, most)
        at = _integrity(b, figures, shown == ORACLE, trend_at, trend_ct, codes[0], codes[1], codes[2], values, at)
    at = _road(b, chart, preview, sky, values, at)
    for n in range(rows):
        at = _vehicle(b, chart, t[n], shown, values, at) if n < count else _nobody(shown, values, at)
    for n in range(frame.shape[0]):
        frame[n] = np.float32(min(max(values[n] * scale[0, n], scale[1, n]), scale[2, n]))
