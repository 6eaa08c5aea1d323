"""A lane that closes for the episode: what the world draws, what stands in the way, and what a roadside unit announces.

The lane is blocked by a row of obstacles in its middle. Its network does not say so: the closure is no part of the map
of the car, which knows of it by the message of a roadside unit alone (:mod:`lanebound.envs.batch.closure_kernel`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.v2v import V2vConfig

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable

__all__ = ["Closure", "announce", "barriers", "stand_in_lane"]

STREAM = "v2i"
BARRIER_STEP_M = 10.0  # between obstacles; shorter than two cars, so that no car stands between them unharmed


class Closure(NamedTuple):
    """A stretch of a lane that is closed, and the speed limit beside it.

    Attributes
    ----------
    lane_index : the closed lane
    start_m, end_m : stations on it between which it is closed
    limit_mps : limit on all lanes of the road between these stations
    """

    lane_index: LaneIndex
    start_m: float
    end_m: float
    limit_mps: float


def barriers(network: RoadNetwork, closure: Closure) -> list[tuple[NDArray[np.float64], float]]:
    """Middles and headings of the obstacles of a closure; the first and last are flush with its ends."""
    lane, half = network.get_lane(closure.lane_index), 0.5 * Obstacle.LENGTH
    count = 1 + math.ceil((closure.end_m - closure.start_m - 2.0 * half) / BARRIER_STEP_M)
    stations = np.linspace(closure.start_m + half, closure.end_m - half, count).tolist()
    return [(lane.position(s, 0.0), float(lane.heading_at(s))) for s in stations]


def stand_in_lane(objects: Records, table: LaneTable, network: RoadNetwork, closure: Closure) -> None:
    """Put the obstacles of a closure into the records (O,) CAR of an environment of the engine."""
    for thing, (position, heading) in zip(objects, barriers(network, closure), strict=True):
        (thing["x"], thing["y"]), thing["heading"] = position, heading
        thing["length"], thing["width"] = Obstacle.LENGTH, Obstacle.WIDTH
        thing["lane"] = table.row[closure.lane_index]


def announce(
    record: Any, table: LaneTable, network: RoadNetwork, closure: Closure, radio: V2vConfig, seed: int
) -> None:  # fmt: skip
    """Fill a record CLOSURE at the start of an episode, with what its radio draws; nothing has been received."""
    lane, row = network.get_lane(closure.lane_index), table.row[closure.lane_index]
    rng = named_generator(seed, STREAM)
    luck, waits = float(rng.random()), float(rng.random())
    spare_s = radio.latency_max_s - radio.latency_s
    in_time = float(spare_s >= 0.0)
    if radio.jitter_s > 0.0:
        in_time = max(-math.expm1(-spare_s / radio.jitter_s), 0.0)
    (start_x, start_y), (end_x, end_y) = lane.position(closure.start_m, 0.0), lane.position(closure.end_m, 0.0)
    record["there"], record["known"] = 1, 0
    record["road"], record["side"] = table.lanes.table["road"][row], table.lanes.table["side"][row]
    record["start_x_m"], record["start_y_m"], record["end_x_m"], record["end_y_m"] = start_x, start_y, end_x, end_y
    record["limit_mps"], record["share"] = closure.limit_mps, (1.0 - radio.loss) * in_time
    record["luck"], record["missed"], record["due_s"] = luck, 1.0, math.inf
    record["delay_s"] = radio.latency_s - radio.jitter_s * math.log1p(-waits * in_time)
