"""What driving costs, by cause: the constraints of an agent. All are for scoring; truth may enter here and only here.

Symbols: v speed over ground [m/s], dt length of a policy step [s], W and L width and length of the car, w width of the
lane, d lateral offset from the middle of the lane, psi heading less the lane's. Costs are >= 0, and but for misleading
information 0 for a car at rest in its lane; each is an integral over time, or 1 once, so that halving the policy's rate
leaves an episode's cost as it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from pydantic import Field

from lanebound.envs.records import EgoBelief, LaneIndex, Traffic
from lanebound.integrity.core.config import Config

__all__ = ["CAUSES", "Corridor", "CostConfig", "Lead", "costs_of", "lead_of", "rss_distance_m", "shortfall", "weighted"]

CAUSES = (
    "cost_collision",
    "cost_off_road",
    "cost_lane",
    "cost_lane_integrity",
    "cost_headway",
    "cost_alert",
    "cost_hmi",
)
CHANGE_S = 8.0  # two lane changes in a row; one takes 3 to 5 s in traffic, about 3 s by highway-env's control
JOINT_M = 1.0  # lanes that follow each other do not meet exactly in every world of highway-env
UNKNOWN_GAP_M = 40.0  # what a missing level of the gap counts as; as far as observations show levels
EXCESS_MAX_M = 2.0  # beyond a lane's width being further out is no worse; also what a missing level counts as


class CostConfig(Config):
    """Weights of the causes and the figures of their formulas."""

    collision: float = Field(
        200.0, ge=0, description="weight of cost_collision [-]; more than careless drives cost that go on to their end"
    )
    off_road: float = Field(200.0, ge=0, description="weight of cost_off_road [-]; as a crash")
    lane: float = Field(1.0, ge=0, description="weight of cost_lane [1/m^2]")
    lane_integrity: float = Field(0.1, ge=0, description="weight of cost_lane_integrity [1/m^2]; a risk, no harm yet")
    headway: float = Field(0.5, ge=0, description="weight of cost_headway [1/s]")
    alert: float = Field(0.5, ge=0, description="weight of cost_alert [1/s]")
    hmi: float = Field(5.0, ge=0, description="weight of cost_hmi [1/s]; what integrity is there to prevent")
    response_s: float = Field(0.5, gt=0, le=3, description="response time rho of the RSS distance; Shalev-Shwartz 2017")
    accelerate_mps2: float = Field(2.0, ge=0, description="acceleration during the response; RSS, comfort")
    brake_min_mps2: float = Field(4.0, gt=0, description="braking that the ego is sure to reach; RSS, IEEE 2846 survey")
    brake_max_mps2: float = Field(6.0, gt=0, description="braking of the leader at most; our leads brake 2.5 to 6")
    alert_speed_share: float = Field(
        0.5, ge=0, le=1, description="share of the lane's speed limit permitted while an alert is on [-]; argued"
    )
    time_to_alert_s: float = Field(1.0, ge=0, description="TTA, allowed for a reaction to an alert; S3 II.B")


@dataclass(frozen=True)
class Lead:
    """The nearest vehicle perceived ahead in the ego's lane: gap bumper to bumper, speed, bound of the gap's error."""

    gap_m: float
    speed_mps: float
    bound_m: float


def rss_distance_m(ego_mps: float, lead_mps: float, c: CostConfig) -> float:
    """Longitudinal distance that is always safe (Shalev-Shwartz et al. 2017, definition 1), 0 at least.

    ``v rho + a rho^2 / 2 + (v + a rho)^2 / (2 b_min) - v_lead^2 / (2 b_max)``; a car at rest stays so: 0.
    """
    v, lead = max(ego_mps, 0.0), max(lead_mps, 0.0)
    if v < 0.1:
        return 0.0
    after = v + c.accelerate_mps2 * c.response_s
    travel = v * c.response_s + 0.5 * c.accelerate_mps2 * c.response_s**2 + after * after / (2.0 * c.brake_min_mps2)
    return max(travel - lead * lead / (2.0 * c.brake_max_mps2), 0.0)


def lead_of(network: RoadNetwork, belief: EgoBelief, traffic: Traffic, length_m: float) -> Lead | None:
    """Whom the ego believes to follow: the nearest perceived vehicle ahead within half a lane width of its lane.

    The lane goes on straight past its end here, as highway-env's local coordinates do.
    """
    lane = network.get_lane(belief.lane_index)
    own = 0.0 if not math.isfinite(belief.pl_at_m) else belief.pl_at_m
    best: Lead | None = None
    for i in range(traffic.count):
        s, d = lane.local_coordinates(traffic.position_m[i])
        ahead = float(s) - belief.longitudinal_m
        if ahead <= 0.0 or abs(d) > 0.5 * belief.lane_width_m:
            continue
        gap = ahead - 0.5 * (length_m + float(traffic.length_m[i]))
        if best is None or gap < best.gap_m:
            bound = float(traffic.pl_at_m[i]) + (0.0 if traffic.relative[i] else own)
            missing = not traffic.relative[i] and not math.isfinite(belief.pl_at_m)
            best = Lead(gap, float(traffic.speed_mps[i]), math.inf if missing else bound)
    return best


def shortfall(ego: Vehicle, others: Iterable[Vehicle], c: CostConfig) -> float:
    """Share of the RSS distance that in truth lacks to a vehicle ahead, within half the lane's width; 0 to 1."""
    lane, worst = ego.lane, 0.0
    place, _ = lane.local_coordinates(ego.position)
    half = 0.5 * float(lane.width_at(place))
    for other in others:
        s, d = lane.local_coordinates(other.position)
        if other is ego or s <= place or abs(d) > half:
            continue
        gap = float(s - place) - 0.5 * float(ego.LENGTH + other.LENGTH)
        worst = max(worst, _lacking(gap, rss_distance_m(float(ego.speed), float(other.speed), c)))
    return worst


def _lacking(gap_m: float, needed_m: float) -> float:
    return min(max(1.0 - gap_m / needed_m, 0.0), 1.0) if needed_m > 0.0 else 0.0


@dataclass
class Corridor:
    """The lanes that the ego may be in: its own, and during a commanded change the one that it comes from.

    Where a road ends, the lanes that lead to its lane and on from it count as well, and where several roads meet, all
    of theirs: a junction has one pavement. ``whole_road`` allows every lane of the road; without ``commanded``
    (continuous actions, which command no lane) the lane is the one it started in.
    """

    whole_road: bool
    commanded: bool
    lane_index: LaneIndex
    leaving: LaneIndex | None = None
    change_s: float = 0.0

    def update(self, belief: EgoBelief, vehicle: Vehicle, dt_s: float) -> None:
        """Follow what is commanded, by belief; ``vehicle`` is asked for its size alone.

        A change is over when the car believes to be inside its new lane with its whole body; it goes on where the road
        does with lanes of the same number. The time spent changing may not exceed that
        spent in a lane by more than CHANGE_S: commands withdrawn and repeated close the lane that is left.
        """
        target = belief.target_lane_index
        if not self.commanded:
            target = (*target[:2], self.lane_index[2])
        if target[:2] != self.lane_index[:2]:
            self.leaving = None if self.leaving is None else (*target[:2], self.leaving[2])
        elif target != self.lane_index:
            self.leaving = self.lane_index
        self.lane_index = target
        reach = abs(belief.lateral_m) + half_width_m(vehicle, belief.angle_rad)
        arrived = belief.lane_index == target and reach < 0.5 * belief.lane_width_m
        self.change_s = max(self.change_s + (dt_s if self.changing and not arrived else -dt_s), 0.0)
        if arrived or self.change_s > CHANGE_S:
            self.leaving = None

    @property
    def changing(self) -> bool:
        """Whether a lane change is under way."""
        return self.leaving is not None

    def lanes(self, network: RoadNetwork) -> list[tuple[AbstractLane, AbstractLane]]:
        """The outermost lanes, left and right, of each stretch that the car may be on."""
        start, end, _ = self.lane_index
        here = network.graph[start][end]
        own = min(self.lane_index[2] or 0, len(here) - 1)
        left = min(self.leaving[2], len(here) - 1) if self.leaving else own
        ids = range(len(here)) if self.whole_road else {own, left}
        stretches = [(here[min(ids)], here[max(ids)])]
        leading, onward = [to[start] for to in network.graph.values() if start in to], network.graph.get(end, {})
        for lanes, junction in [(lanes, len(leading) > 1) for lanes in leading] + [(v, False) for v in onward.values()]:
            whole = self.whole_road or junction or len(lanes) != len(here)
            stretches.append((lanes[0], lanes[-1]) if whole else (lanes[own], lanes[own]))
        return stretches


def half_width_m(vehicle: Vehicle, angle_rad: float) -> float:
    """Half of what a body takes of a straight lane's width at an angle to it."""
    return float(0.5 * (vehicle.WIDTH * abs(math.cos(angle_rad)) + vehicle.LENGTH * abs(math.sin(angle_rad))))


def overhang_m(network: RoadNetwork, corridor: Corridor, position: Any, heading_rad: float, vehicle: Vehicle) -> float:
    """How far the worst corner of a car's body is beyond its corridor, 0 inside.

    A corner is as far out as it is from the stretch that it is nearest to: where stretches meet or fork the body may
    stand on several of them. Beyond the ends of all it is that of the corridor's own lane.
    """
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    stretches = corridor.lanes(network)
    worst = 0.0
    for along, across in ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)):
        x, y = 0.5 * along * float(vehicle.LENGTH), 0.5 * across * float(vehicle.WIDTH)
        corner = position + np.array([c * x - s * y, s * x + c * y])
        found = [out for out in (_beyond_m(*lanes, corner) for lanes in stretches) if out is not None]
        own = _beyond_m(*stretches[0], corner, endless=True) if not found else min(found)
        worst = max(worst, own or 0.0)
    return worst


def _beyond_m(low: AbstractLane, high: AbstractLane, point: Any, endless: bool = False) -> float | None:
    """How far a point is outside of the lanes from ``low`` to ``high``, negative inside; None beyond their ends."""
    beyond, on = -math.inf, endless
    for lane, side in ((low, -1.0), (high, 1.0)):
        s, d = lane.local_coordinates(point)
        on = on or -JOINT_M <= s <= lane.length + JOINT_M
        beyond = max(beyond, side * float(d) - 0.5 * float(lane.width_at(s)))
    return beyond if on else None


def doubt_m(network: RoadNetwork, corridor: Corridor, belief: EgoBelief, width_m: float) -> float:
    """How far beyond its corridor the estimate and its level allow the car to be, negative inside."""
    if corridor.leaving is None:
        return abs(belief.lateral_m) + belief.pl_ct_m + 0.5 * width_m - 0.5 * belief.lane_width_m
    start, end, _ = belief.lane_index
    lanes = network.graph[start][end]
    beyond = -math.inf
    for index, side in ((min, -1.0), (max, 1.0)):
        lane = lanes[min(index(corridor.lane_index[2], corridor.leaving[2]), len(lanes) - 1)]
        s, d = lane.local_coordinates(belief.position_m)
        beyond = max(beyond, side * float(d) + belief.pl_ct_m + 0.5 * width_m - 0.5 * float(lane.width_at(s)))
    return beyond


def costs_of(
    c: CostConfig,
    network: RoadNetwork,
    corridor: Corridor,
    ego: Vehicle,
    belief: EgoBelief,
    lead: Lead | None,
    others: Iterable[Vehicle],
    crashed_now: bool,
    astray_now: bool,
    hmi_share: float,
    dt_s: float,
) -> dict[str, float]:
    """Costs of one policy step by cause, unweighted.

    ``cost_collision``  1 in the step of a crash.
    ``cost_off_road``  1 in the step in which the car has left the road, or driven against its lane for too long.
    ``cost_lane``  ``max(0, |d| + half body - w / 2) v dt`` of the TRUE car beyond its corridor, at most 2 m.
    ``cost_lane_integrity``  ``max(0, |d_est| + PL_CT + W / 2 - w / 2) v dt`` of the belief, at most 2 m, also without
    PL_CT; about the outer edges of both lanes during a change; 0 without a lane to keep (``keep_lane`` off).
    ``cost_headway``  ``max(0, 1 - (gap_est - PL_AT of both) / d_RSS) dt``, at most dt; a missing level counts as 40 m.
    No less than ``max(0, 1 - gap / d_RSS) dt`` in TRUTH, and dt while somebody is that near and nobody perceived ahead.
    To lose sight of a leader, or its level, saves nothing, and to be alone costs nothing.
    ``cost_alert``  dt while an alert is older than the TTA and the car drives faster than permitted or changes lane.
    ``cost_hmi``  dt times the share of the step's epochs whose information is hazardously misleading on either axis.
    """
    v = abs(float(ego.speed))
    out = min(max(overhang_m(network, corridor, ego.position, float(ego.heading), ego), 0.0), EXCESS_MAX_M)
    doubt = 0.0 if corridor.whole_road else doubt_m(network, corridor, belief, float(ego.WIDTH))
    doubt = min(max(doubt, 0.0), EXCESS_MAX_M)
    late = belief.alert and belief.alert_age_s > c.time_to_alert_s
    limit = float(network.get_lane(belief.lane_index).speed_limit or 0.0)
    fast = limit > 0.0 and v > c.alert_speed_share * limit
    return {
        "cost_collision": float(crashed_now),
        "cost_off_road": float(astray_now),
        "cost_lane": out * v * dt_s,
        "cost_lane_integrity": doubt * v * dt_s,
        "cost_headway": _short_headway(c, belief, lead, ego, others) * dt_s,
        "cost_alert": float(late and (fast or corridor.changing)) * dt_s,
        "cost_hmi": hmi_share * dt_s,
    }


def _short_headway(
    c: CostConfig, belief: EgoBelief, lead: Lead | None, ego: Vehicle, others: Iterable[Vehicle]
) -> float:
    truly = shortfall(ego, others, c)
    if lead is None:
        return float(truly > 0.0)
    gap_m = lead.gap_m - min(lead.bound_m, UNKNOWN_GAP_M)
    return max(truly, _lacking(gap_m, rss_distance_m(belief.speed_mps, lead.speed_mps, c)))


def weighted(c: CostConfig, costs: dict[str, float]) -> float:
    """The sum of the costs by their weights: ``info["cost"]``."""
    return float(sum(getattr(c, cause.removeprefix("cost_")) * costs[cause] for cause in CAUSES))
