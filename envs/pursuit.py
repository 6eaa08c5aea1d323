"""Steering under meta-actions for a car whose wheels turn at a limited rate: pure pursuit of a lane.

highway-env's own control answers an offset of centimetres at walking pace with the wheels at their stop, which is
stable only where they turn at once.
"""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.records import LaneIndex

__all__ = ["pursuit_rad"]

LOOK_M, LOOK_S = 6.0, 1.2  # how far ahead: one and a half times the way the wheels need to swing over
SLOPE = 0.25  # at which a lane is approached, across per along


def pursuit_rad(network: RoadNetwork, lane_index: LaneIndex, route: list[LaneIndex] | None, car: Vehicle) -> float:
    """Steering angle [rad] of a car with its centre half way between the axles, right positive.

    The arc from the centre, along its velocity, through a point of the lane at distance l has the curvature
    ``2 sin(alpha - beta) / l`` with alpha the point's bearing off the car's heading and beta the slip angle,
    ``sin(beta) = kappa L / 2``: together ``kappa = 2 sin(alpha) / (l + L)``, to first order in beta. The point lies
    beside the lane's middle while the car is far from it (R. C. Coulter, CMU-RI-TR-92-01, 1992, for the law).
    """
    lane = network.get_lane(lane_index)
    place, aside = lane.local_coordinates(car.position)
    look = max(LOOK_M, LOOK_S * abs(float(car.speed)))
    along, beside = place + look, aside - min(max(float(aside), -SLOPE * look), SLOPE * look)
    if along > lane.length:
        end = lane.position(lane.length, 0.0)
        onward = network.next_lane(lane_index, list(route or ()), end, np.random.default_rng(0))
        if onward != lane_index:
            lane, along = network.get_lane(onward), along - lane.length
    x, y = lane.position(along, beside) - car.position
    distance = math.hypot(x, y)
    alpha = math.remainder(math.atan2(y, x) - float(car.heading), 2.0 * math.pi)
    sine = 0.5 * float(car.LENGTH) * 2.0 * math.sin(min(max(alpha, -1.5), 1.5)) / (distance + float(car.LENGTH))
    return math.atan(2.0 * math.tan(math.asin(min(max(sine, -0.99), 0.99))))
