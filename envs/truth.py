"""The true state in the form of a belief: for oracles, and for scoring. Nothing that decides may be given it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lanebound.envs.cockpit import Cockpit
from lanebound.envs.records import EgoBelief, Traffic

__all__ = ["true_belief", "true_traffic"]


def true_belief(cockpit: Cockpit) -> EgoBelief:
    """What the ego would believe if it knew everything: its true pose, no protection level needed."""
    ego = cockpit.ego
    longitudinal, lateral = ego.lane.local_coordinates(ego.position)
    belief = cockpit.belief()
    return replace(
        belief,
        position_m=ego.position.copy(),
        heading_rad=float(ego.heading),
        speed_mps=float(ego.speed),
        lane_index=ego.lane_index,
        longitudinal_m=float(longitudinal),
        lateral_m=float(lateral),
        angle_rad=float(ego.lane.local_angle(ego.heading, longitudinal)),
        lane_width_m=float(ego.lane.width_at(longitudinal)),
        target_lane_index=belief.target_lane_index if cockpit.meta else ego.lane_index,
        target_speed_mps=belief.target_speed_mps if cockpit.meta else float(ego.speed),
        pl_at_m=0.0,
        pl_ct_m=0.0,
    )


def true_traffic(cockpit: Cockpit) -> Traffic:
    """All vehicles as they are, nearest first."""
    ego = cockpit.ego
    there = [v for v in cockpit.world.road.vehicles if v is not ego]
    if not there:
        return Traffic.none()
    position = np.array([v.position for v in there], dtype=np.float64)
    order = np.argsort(np.hypot(*(position - ego.position).T), kind="stable")
    rows = np.array([(v.heading, v.speed, v.LENGTH, v.WIDTH) for v in there], dtype=np.float64)[order]
    zero = np.zeros(len(there))
    return Traffic(
        key=order.astype(np.int64),
        position_m=position[order],
        heading_rad=rows[:, 0],
        speed_mps=rows[:, 1],
        pl_at_m=zero,
        pl_ct_m=zero,
        age_s=zero,
        length_m=rows[:, 2],
        width_m=rows[:, 3],
        relative=np.zeros(len(there), dtype=np.bool_),
    )
