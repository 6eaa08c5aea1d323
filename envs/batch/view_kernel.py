"""Observations: the quantities of all entries, and the bounded frame that is made of them.

:func:`derive` fills the records VIEW, AHEAD and BESIDE of an environment; :func:`fill_frame` picks the entries from
these, from the belief and from the predicted sky, by the table that :mod:`..observation.index` declares, and scales
and bounds them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import local, width_at
from lanebound.envs.batch.route_map_kernel import path_at, project
from lanebound.envs.batch.toll_kernel import show_toll
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import Records, record

__all__ = ["AHEAD", "BESIDE", "BLIND", "EGO_NUMBER", "EGO_WHOLE", "FULL", "ORACLE", "PREVIEW", "SKY", "SOURCE",
           "VEHICLE", "Views", "Words", "derive", "fill_frame", "true_view", "words_of"]  # fmt: skip

FULL, BLIND, ORACLE = 0, 1, 2  # what is shown of integrity
UNKNOWN = -math.inf  # a number of satellites that no map predicts

AHEAD = record(
    exists="1 where the map goes on so far ahead",
    ahead_m="point of the route's centreline, along the ego's heading",
    right_m="to the ego's right",
    heading_rad="direction of the centreline less the ego's heading",
    curvature_pm="of the centreline, positive turning right",
)
BESIDE = record(
    present="1 where a vehicle is perceived",
    ahead_m="middle to middle along the ego's heading",
    right_m="middle to middle to the ego's right",
    velocity_ahead_mps="relative velocity along the ego's heading",
    velocity_right_mps="relative velocity to the ego's right",
    heading_sin="sine of its heading less the ego's",
    heading_cos="cosine of its heading less the ego's",
    lane_gap_m="along the ego's route, middle to middle; infinite when not beside it",
    lane_offset_m="from the route's centreline; infinite when not beside it",
    own_lane="1 within half a lane width of the route's centreline",
    left_lane="1 within the next lane width to the left",
    right_lane="1 within the next lane width to the right",
    length_m="of the vehicle",
    width_m="of the vehicle",
    age_s="since the measurement behind it",
    sensor="1 when seen by the ego's own sensor",
    pl_exists="1 when both have the protection levels that the next two need",
    pl_at_m="along the ego's heading: the ego's level and half the extent of the vehicle's own box",
    pl_ct_m="across the ego's heading: the ego's level and half the extent of the vehicle's own box",
)
EGO_NUMBER, EGO_WHOLE, PREVIEW, SKY, VEHICLE = 0, 1, 2, 3, 4  # blocks that entries come from
SOURCE = record(
    block=("i8", "which block the entry comes from; -1 for an entry that is filled outside"),
    word=("i8", "which 8 bytes of the row of that block"),
    code="the entry is 1 where the field is this code, else 0; NaN: the entry is the field itself",
    factor="1 / scale",
    low="lower bound",
    high="upper bound",
)


class Words(NamedTuple):
    """The blocks of N environments as 8-byte words, the memory of the records.

    ego (N EGO,) and ego_whole are the same memory, read as numbers and as whole numbers; preview (N, D AHEAD); sky
    (N, 3 D); vehicles (N, R BESIDE).
    """

    ego: NDArray[np.float64]
    ego_whole: NDArray[np.int64]
    preview: NDArray[np.float64]
    sky: NDArray[np.float64]
    vehicles: NDArray[np.float64]


class Views(NamedTuple):
    """What is derived for N environments: preview (N, D) AHEAD, vehicles (N, R) BESIDE; distances (D,).

    sky (N, 3 D): satellites predicted on the lanes left, own and right, negative for unknown; trail (N, n + 1, 2):
    clipped levels of the last n observations.
    """

    preview: Records
    vehicles: Records
    sky: NDArray[np.float64]
    trail: NDArray[np.float64]
    distances: NDArray[np.float64]


@jit
def words_of(egos: Records, views: Views) -> Words:
    """The memory of egos (N,) EGO and of views."""
    number = np.float64
    return Words(
        egos.view(number), egos.view(np.int64), views.preview.view(number), views.sky, views.vehicles.view(number)
    )


@jit(inline=True)
def _flag(condition):  # type: ignore[no-untyped-def]
    """1.0 or 0.0."""
    return 1.0 if condition else 0.0


@jit(borrows=True)
def true_view(car, lanes, path_of, rules, view):  # type: ignore[no-untyped-def]
    """Make ``view``, a copy of the belief, that of an ego with perfect knowledge: the true pose and levels of 0."""
    n = car.lane
    s, r, direction = local(lanes, n, car.x, car.y)
    view.x_m, view.y_m, view.heading_rad, view.speed_mps = car.x, car.y, car.heading, car.speed
    view.lane, view.path, view.longitudinal_m, view.lateral_m = n, path_of[n], s, r
    view.angle_rad, view.lane_width_m = wrap(car.heading - direction), width_at(lanes, n, s)
    view.pl_at_m = view.pl_ct_m = 0.0
    limit = lanes.table[n].speed_limit_mps
    view.fix_x_m, view.fix_y_m, view.road_offset_m = car.x, car.y, 0.0
    view.possible_mps, view.other_road_m, view.other_limit_mps = limit if limit > 0.0 else math.inf, math.inf, math.inf
    view.lane_seen, view.roads_agree, view.route_shift = 1, 1, lanes.table[n].goal_shift
    if rules.meta == 0:
        view.target_lane, view.target_speed_mps = n, car.speed


@jit(borrows=True)
def derive(ego, seen, count, lanes, routes, rules, e, views):  # type: ignore[no-untyped-def]
    """Fill the view, the preview and the vehicles of environment e from what is shown of its ego and of the traffic."""
    b, shown = ego.shown, rules.shown
    _derive_ego(b, lanes, routes, ego.own)
    show_toll(ego, lanes, ego.own)
    _derive_levels(b, rules, shown, ego.score.observed, views.trail[e], ego.own)
    cosine, sine = math.cos(b.heading_rad), math.sin(b.heading_rad)
    for n in range(views.distances.shape[0]):
        _derive_point(b, lanes, routes, cosine, sine, b.longitudinal_m + views.distances[n], views.preview[e, n])
    for n in range(views.vehicles.shape[1]):
        if n < count:
            _derive_vehicle(b, lanes, routes, seen[n], shown, views.vehicles[e, n])
        else:
            _derive_nobody(views.vehicles[e, n])


@jit(inline=True)
def _derive_ego(b, lanes, routes, view):  # type: ignore[no-untyped-def]
    """The ego on its lane and route."""
    path = routes.paths[b.path]
    view.heading_sin, view.heading_cos = math.sin(b.angle_rad), math.cos(b.angle_rad)
    view.lateral_share = b.lateral_m / (0.5 * b.lane_width_m)
    view.lane_share, view.left_exists, view.right_exists = path.lane_share, path.left_exists, path.right_exists
    view.speed_limit_mps = path.speed_limit_mps
    view.junction_m, view.lane_end_m = path.junction_m - b.longitudinal_m, path.lane_end_m - b.longitudinal_m
    change = 0
    if b.target_lane != b.lane:
        target = lanes.table[b.target_lane]
        for k in range(path.following_first, path.following_last):
            other = lanes.table[routes.following[k]]
            if other.road == target.road:
                change = target.side - other.side
                break
    view.target_left, view.target_right = _flag(change < 0), _flag(change > 0)


@jit(inline=True)
def _derive_levels(b, rules, shown, observed, trail, view):  # type: ignore[no-untyped-def]
    """Levels, their ratio and margin to the limits, their trend, and the alert; an oracle has levels of 0."""
    oracle, size = shown == ORACLE, trail.shape[0]
    view.trend_at_m = view.trend_ct_m = 0.0
    if shown == FULL:
        at, ct = min(b.pl_at_m, rules.pl_most_m), min(b.pl_ct_m, rules.pl_most_m)
        trail[observed % size, 0], trail[observed % size, 1] = at, ct
        oldest = max(observed - size + 1, 0) % size
        view.trend_at_m, view.trend_ct_m = at - trail[oldest, 0], ct - trail[oldest, 1]
    level, limit = 0.0 if oracle else b.pl_at_m, b.al_at_m
    exists = level < math.inf
    view.pl_at_m, view.pl_at_exists = level, _flag(exists)
    view.ratio_at = level / limit if exists and limit > 0.0 else math.inf
    view.margin_at_m = limit - level if exists else -math.inf
    level, limit = 0.0 if oracle else b.pl_ct_m, b.al_ct_m
    exists = level < math.inf
    view.pl_ct_m, view.pl_ct_exists = level, _flag(exists)
    view.ratio_ct = level / limit if exists and limit > 0.0 else math.inf
    view.margin_ct_m = limit - level if exists else -math.inf
    view.available, view.alert = _flag(oracle or b.available != 0), _flag(b.alert != 0 and not oracle)
    view.permitted_mps = math.inf if oracle else b.permitted_mps
    view.alert_age_s, view.reason = 0.0 if oracle else b.alert_age_s, float(rules.reason_none if oracle else b.reason)


@jit(inline=True)
def _derive_point(b, lanes, routes, cosine, sine, station, point):  # type: ignore[no-untyped-def]
    """A point of the route's centreline."""
    x, y, direction, curvature = path_at(routes, lanes, b.path, station)
    dx, dy = x - b.x_m, y - b.y_m
    point.exists = _flag(station <= routes.paths[b.path].end_m)
    point.ahead_m, point.right_m = dx * cosine + dy * sine, dy * cosine - dx * sine
    point.heading_rad, point.curvature_pm = wrap(direction - b.heading_rad), curvature


@jit(borrows=True)
def _derive_vehicle(b, lanes, routes, other, shown, row):  # type: ignore[no-untyped-def]
    """A vehicle that is perceived; combined levels: own plus half the extent of its box, turned, on the ego's axes."""
    half, cosine, sine = 0.5 * b.lane_width_m, math.cos(b.heading_rad), math.sin(b.heading_rad)
    dx, dy = other.x_m - b.x_m, other.y_m - b.y_m
    ahead, right = dx * cosine + dy * sine, dy * cosine - dx * sine
    turn = other.heading_rad - b.heading_rad
    tc, ts = math.cos(turn), math.sin(turn)
    s, r, found = project(routes, lanes, b.path, other.x_m, other.y_m, b.longitudinal_m + ahead)
    gap, offset = s - b.longitudinal_m, r
    if not found:
        gap, offset = (math.inf if ahead >= 0.0 else -math.inf), (math.inf if right >= 0.0 else -math.inf)
    row.present, row.ahead_m, row.right_m = 1.0, ahead, right
    row.velocity_ahead_mps, row.velocity_right_mps = other.speed_mps * tc - b.speed_mps, other.speed_mps * ts
    row.heading_sin, row.heading_cos, row.lane_gap_m, row.lane_offset_m = ts, tc, gap, offset
    row.own_lane = _flag(-half <= offset <= half)
    row.left_lane, row.right_lane = _flag(-3.0 * half <= offset < -half), _flag(half < offset <= 3.0 * half)
    row.length_m, row.width_m, row.age_s, row.sensor = other.length_m, other.width_m, other.age_s, other.relative
    relative, at, ct = other.relative != 0, other.pl_at_m, other.pl_ct_m
    own_at, own_ct = (0.0, 0.0) if relative else (b.pl_at_m, b.pl_ct_m)
    exists = at < math.inf and ct < math.inf and own_at < math.inf and own_ct < math.inf
    row.pl_exists = _flag(shown == ORACLE or exists)
    row.pl_at_m = row.pl_ct_m = 0.0 if shown == ORACLE else math.inf
    if exists and shown != ORACLE:
        row.pl_at_m = own_at + abs(tc) * at + abs(ts) * ct
        row.pl_ct_m = own_ct + abs(ts) * at + abs(tc) * ct


@jit(inline=True)
def _derive_nobody(row):  # type: ignore[no-untyped-def]
    """A row without a vehicle: far ahead, old and unbounded."""
    row.present = row.right_m = row.velocity_ahead_mps = row.velocity_right_mps = 0.0
    row.heading_sin = row.heading_cos = row.lane_offset_m = row.own_lane = row.left_lane = row.right_lane = 0.0
    row.length_m = row.width_m = row.sensor = row.pl_exists = 0.0
    row.ahead_m = row.lane_gap_m = row.age_s = row.pl_at_m = row.pl_ct_m = math.inf


@jit(borrows=True)
def fill_frame(sources, words, e, view, frame):  # type: ignore[no-untyped-def]
    """Fill ``frame`` (E,) float32 of environment e: ``clip(field / scale, low, high)``, field by field.

    sources (E,) SOURCE; ``view``: VIEW of its ego, by which predictions on missing lanes are left out.
    """
    ego = e * (words.ego.shape[0] // words.sky.shape[0])  # its first word
    for n in range(frame.shape[0]):
        source = sources[n]
        block, word = source.block, source.word
        value = 0.0
        if block == EGO_NUMBER:
            value = words.ego[ego + word]
        elif block == VEHICLE:
            value = words.vehicles[e, word]
        elif block == PREVIEW:
            value = words.preview[e, word]
        elif block == EGO_WHOLE:
            value = float(words.ego_whole[ego + word])
        elif block == SKY:
            value = words.sky[e, word]
            side = word % 3
            if value < 0.0 or (side == 0 and view.left_exists == 0.0) or (side == 2 and view.right_exists == 0.0):
                value = UNKNOWN
        if source.code == source.code:
            value = 1.0 if value == source.code else 0.0
        bounded = min(max(value * source.factor, source.low), source.high)
        frame[n] = np.float32(bounded if value == value else value)  # a NaN stays one
