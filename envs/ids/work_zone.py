"""The id of a work zone, whose page is its docstring as those of :mod:`.streets` are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import META, Preset
from lanebound.envs.ids.priced import PRICES
from lanebound.integrity.core.presets import deep_merge

__all__ = ["WorkZone"]


class WorkZone(Preset):
    """
    ## Description
    Drive through a work zone on two lanes of 2.8 m, of which one closes 200 to 400 m ahead for 100 m. The road has
    bends of 200 to 600 m radius and a speed limit of 13.9 m/s (50 km/h), 8.3 m/s (30 km/h) beside the closure.
    Obstacles of 2 m stand in the middle of the closed lane every 10 m. Up to 6 other vehicles see them and change lane.

    The map does not have the closure. A roadside unit at its start sends lane, start, end and limit in coordinates of
    the map, 10 times a second, by the [channel](#perception) of `v2v`, which reaches 300 m. Sensors of the car do not
    see the obstacles, so the car knows start and lane of the closure only as well as its pose.

    Difficulty: the alert limits come from a [budget](#alert-limits). Across, 0.3 m are left in a lane of 2.8 m. Along,
    the limit falls before the closure, as behind a vehicle that stands there. A lane change under an alert costs, so
    the car has to change while levels are small.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 2.8, 5.6, 8.4, 11.2 and 14 m/s.

    ## Observation Space
    Seven more entries `road.closure_*` (`observation.closure`): whether the message has arrived, distances to
    start and end of the closure from the estimated pose, whether the left, own or right lane closes, and the limit.

    ## Rewards
    Beside the closure v_limit is the limit there.

    ## Costs
    Stopping has a [price](#priced-ids). The weight of `cost_speeding` is 2: beside the closure its limit counts.
    `cost_limit` is 10 by the [rule for means](results/cost-limits.md) over 40 training seeds: 7.0 and 1 % of a crash,
    rounded up. Other drivers: [results](results/where-levels-decide.md).

    ## Starting State
    In the middle of a lane at 10 m/s, in three of four episodes the lane that closes; the other vehicles from 150 m
    behind to 250 m ahead, at 8.3 to 12.5 m/s.

    ## Episode End
    Truncated after 60 s. A success requires 0.5 of the possible speed; at half the speed limit it is 0.46.

    ## Arguments
    `config["world"]`: `lanes_count` (2), `lane_width` (2.8 m), `ahead` ([200, 400] m), `closed_length` (100 m),
    `closed_limit` (8.3 m/s), `vehicles_count` (6), `spread` ([-150, 250] m), `initial_speed` (10 m/s), `layout` (number
    of the road, 0; the roads 0 to 3 have 2.67 to 3.21 km), `duration` (60 s). With `observation.closure` false no
    message is received.

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.05
    PRESET: ClassVar[Mapping[str, Any]] = deep_merge(
        {
            "base": "WorkZoneWorld",
            **META,
            "sky": "suburban",
            "observation": {"closure": True},
            "success_share": 0.5,
            "cost": {"speeding": 2.0},  # as in Guidance
            "cost_limit": 10.0,
        },
        PRICES,
    )
