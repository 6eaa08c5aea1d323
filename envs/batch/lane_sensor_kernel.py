"""The lane sensor of the ego: a camera keeps the car in its lane, while the position says which road and lane it is.

The camera measures offset and heading in the lane that the car is truly in, the number of that lane from the left, the
lanes beside it, and how the lane bends ahead. It knows neither the road nor the place along it. So the ego has two
poses:

``eye``     the pose in the physical lane: the true one, displaced across the lane and turned by the errors of the
            camera. Steering, lane changes and forks follow it. Its place along the road is read for the bend of the
            lane ahead alone, which the camera sees, and is never shown. During a dropout it is carried on by the
            odometer and the turns of the navigator, and its bound grows.
``belief``  the position of the navigator, put on the road that fits it best (:func:`match`), on the lane of the
            camera's number, with the camera's offset and heading. Its place along the road is the navigator's.

The road that fits best has the least ``|r - r_eye| + beyond its ends + |angle - angle_eye|`` of the navigator's pose on
the lane of that number; the road believed so far is preferred by ``switch_m``.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import NONE, local, nearest, of_side, place, width_at
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.streams_kernel import uniform

__all__ = ["beside_m", "body_of", "look_at_lane", "match", "open_eye"]

TINY = 1e-300  # the logarithm of 0 is none


@jit(inline=True)
def body_of(ego, rules):  # type: ignore[no-untyped-def]
    """The pose by which the car moves in its lane: that of the camera, or the belief where there is none."""
    return ego.eye if rules.camera != 0 else ego.belief


@jit(borrows=True)
def _two_normals(state):  # type: ignore[no-untyped-def]
    """Two standard normal draws by the method of Box and Muller."""
    r = math.sqrt(-2.0 * math.log(max(1.0 - uniform(state), TINY)))
    turn = 2.0 * math.pi * uniform(state)
    return r * math.cos(turn), r * math.sin(turn)


@jit(borrows=True)
def open_eye(ego, car, state, lanes, rules):  # type: ignore[no-untyped-def]
    """Begin an episode: the generator (4,) of the camera, the errors that stay, and a first look with markings."""
    cam, eye, f = ego.camera, ego.eye, rules.lane_sensor
    for k in range(4):
        cam.state[k] = state[k]
    offset, heading = _two_normals(cam.state)
    cam.offset_m, cam.heading_rad = f.offset_bias_sigma_m * offset, f.heading_bias_sigma_rad * heading
    cam.road, eye.target_lane, eye.target_speed_mps = NONE, car.lane, car.speed
    offset, heading = _two_normals(cam.state)
    _measure(ego, car, offset, heading, lanes, f)
    _settle_eye(ego, lanes)


@jit(borrows=True)
def look_at_lane(ego, car, lanes, rules):  # type: ignore[no-untyped-def]
    """Measure the lane after a simulation step, or carry the pose on during a dropout.

    ``car``: the true one, whose pose the camera measures. As many numbers are drawn in each step.
    """
    cam, eye, f = ego.camera, ego.eye, rules.lane_sensor
    chance = uniform(cam.state)
    offset, heading = _two_normals(cam.state)
    turned = cam.fix_heading_rad - cam.turned_rad
    cam.turned_rad = cam.fix_heading_rad
    if cam.out == 0:
        cam.out = 1 if chance < f.leave else 0
    else:
        cam.out = 0 if chance < f.back else 1
    if cam.out == 0:
        _measure(ego, car, offset, heading, lanes, f)
    else:
        way = rules.step_s * ego.belief.speed_mps
        eye.heading_rad += turned
        eye.x_m += way * math.cos(eye.heading_rad)
        eye.y_m += way * math.sin(eye.heading_rad)
        cam.bound_rad += rules.step_s * f.gyro_bound_radps
        eye.pl_ct_m += abs(way) * math.sin(min(cam.bound_rad, 0.5 * math.pi))
    _settle_eye(ego, lanes)


@jit(borrows=True)
def _measure(ego, car, offset, heading, lanes, f):  # type: ignore[no-untyped-def]
    """The pose that the camera shows, with standard normal draws of its noise."""
    cam, eye = ego.camera, ego.eye
    _, _, direction = local(lanes, car.lane, car.x, car.y)
    aside = cam.offset_m + f.offset_sigma_m * offset
    eye.x_m, eye.y_m = car.x - math.sin(direction) * aside, car.y + math.cos(direction) * aside
    eye.heading_rad = car.heading + cam.heading_rad + f.heading_sigma_rad * heading
    eye.pl_ct_m = f.bound_sigmas * math.hypot(f.offset_sigma_m, f.offset_bias_sigma_m)
    cam.bound_rad = f.bound_sigmas * math.hypot(f.heading_sigma_rad, f.heading_bias_sigma_rad)


@jit(borrows=True)
def _settle_eye(ego, lanes):  # type: ignore[no-untyped-def]
    """Lane, offset and angle of the pose of the camera."""
    eye = ego.eye
    eye.lane, eye.speed_mps = nearest(lanes, eye.x_m, eye.y_m, eye.heading_rad), ego.belief.speed_mps
    s, r, direction = local(lanes, eye.lane, eye.x_m, eye.y_m)
    eye.longitudinal_m, eye.lateral_m, eye.angle_rad = s, r, wrap(eye.heading_rad - direction)
    eye.lane_width_m = width_at(lanes, eye.lane, s)


@jit(borrows=True)
def match(ego, lanes, rules):  # type: ignore[no-untyped-def]
    """Put the navigator's pose, which the belief holds, on the road that fits it best, and find the other roads.

    The car wants the lane as far to the side of its believed one as the lane that it steers to is in truth.
    """
    b, eye, cam, table = ego.belief, ego.eye, ego.camera, lanes.table
    cam.fix_heading_rad, b.lane_seen = b.heading_rad, 1 - cam.out
    side, best, least, n = table[eye.lane].side, 0, math.inf, 0
    while n < table.shape[0]:
        m = of_side(lanes, n, side)
        s, r, direction = local(lanes, m, b.x_m, b.y_m)
        misfit = abs(r - eye.lateral_m) + max(s - table[m].length_m, 0.0, -s)
        misfit += abs(wrap(b.heading_rad - direction - eye.angle_rad))
        if n == cam.road:
            misfit -= rules.lane_sensor.switch_m
        if misfit < least:
            best, least = n, misfit
        n += table[n].count
    cam.road, b.lane = best, of_side(lanes, best, side)
    wanted = table[eye.target_lane]
    shift = wanted.side - side if wanted.road == table[eye.lane].road else 0
    b.target_lane = of_side(lanes, best, max(table[b.lane].side + shift, 0))
    b.target_speed_mps = eye.target_speed_mps
    _survey(b, best, side, lanes)
    s, r, _ = local(lanes, b.lane, b.x_m, b.y_m)
    b.road_offset_m = r - eye.lateral_m
    b.x_m, b.y_m = place(lanes, b.lane, s, eye.lateral_m)
    _, _, direction = local(lanes, b.lane, b.x_m, b.y_m)
    b.heading_rad += wrap(direction + eye.angle_rad - b.heading_rad)


@jit(borrows=True)
def _survey(b, road, side, lanes):  # type: ignore[no-untyped-def]
    """The roads beside the navigator's pose: the nearest, and those that its levels leave possible.

    A road is possible whose pavement the level across reaches, on a stretch that the level along reaches. Fills the
    least limit of all possible roads, and whether they ask for the same change of lanes.
    """
    table, n = lanes.table, 0
    b.other_road_m, b.other_limit_mps, b.roads_agree = math.inf, math.inf, 1
    b.route_shift = shift = table[b.lane].goal_shift
    limit = table[b.lane].speed_limit_mps
    b.possible_mps = limit if limit > 0.0 else math.inf
    while n < table.shape[0]:
        lane = table[n]
        if n != road:
            s, _, direction = local(lanes, n, b.x_m, b.y_m)
            limit = lane.speed_limit_mps if lane.speed_limit_mps > 0.0 else math.inf
            away = max(beside_m(lanes, n, b.x_m, b.y_m), 0.0)
            along = max(s - lane.length_m, -s, 0.0)
            same_way = abs(wrap(b.heading_rad - direction)) < 0.5 * math.pi
            if same_way and along == 0.0 and away < b.other_road_m:
                b.other_road_m, b.other_limit_mps = away, limit
            if same_way and along <= b.pl_at_m and away <= b.pl_ct_m and along < math.inf:
                b.possible_mps = min(b.possible_mps, limit)
                if table[of_side(lanes, n, side)].goal_shift != shift:
                    b.roads_agree = 0
        n += lane.count


@jit(borrows=True)
def beside_m(lanes, road, x, y):  # type: ignore[no-untyped-def]
    """How far a point is across from the pavement of a road or its straight extension, negative on it."""
    last = road + lanes.table[road].count - 1
    s, left, _ = local(lanes, road, x, y)
    s_last, right, _ = local(lanes, last, x, y)
    return max(-left - 0.5 * width_at(lanes, road, s), right - 0.5 * width_at(lanes, last, s_last))
