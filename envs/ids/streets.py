"""The ids on roads of our own, one class each. The docstrings are pages in Gymnasium's order.

:class:`DrivingEnv` documents what all ids share; the page of an id documents the differences, with its default
configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import CONTINUOUS, META, Preset

__all__ = ["CarFollowing", "LaneKeeping", "UrbanCanyon"]


class LaneKeeping(Preset):
    """
    ## Description
    Keep the middle of a lane of 3.25 m on a winding road without traffic. The road is 1.83 km long: straights, bends of
    42 to 160 m radius and S-bends between buildings. The speed limit is 13.9 m/s (50 km/h); the tightest bend is
    comfortable at 9.1 m/s. The alert limits are 1.5 m along and 0.625 m across the track.

    Difficulty: during an outage of RTK the estimate drifts across the track and the car follows it.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)` at 5 Hz: acceleration (1 is 6 m/s2), steering (1 is 0.4 rad to the right). The speed
    stays between 0 and 20 m/s.

    ## Observation Space
    `traffic` is always empty.

    ## Rewards
    As above.

    ## Costs
    `cost_headway` is always 0. An alert permits 6.9 m/s. `cost_limit` is 15. [Mean costs](results/cost-limits.md).

    ## Starting State
    In the middle of the lane, 10 to 956 m along the road, at 10 m/s or at the speed that the bends ahead allow.

    ## Episode End
    Truncated after 60 s, or 20 m before the end of the road. A success requires 0.55 of the possible speed.

    ## Arguments
    `config["world"]`: `layout` (number of the road, 0; the roads 0 to 3 have 1.83 to 1.94 km), `roads` (1; with
    more, each episode is on one of the roads from `layout` on), `lanes_count` (1),
    `lane_width` (3.25 m), `initial_speed` (10 m/s), `duration` (60 s).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.03
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "LaneKeepingWorld",
        **CONTINUOUS,
        "success_share": 0.55,
        "cost_limit": 15.0,
    }


class CarFollowing(Preset):
    """
    ## Description
    Follow one vehicle through stop-and-go traffic without a collision and without falling behind. The road is 3.21 km
    long, has one lane of 3.25 m and bends of 200 to 600 m radius. The speed limit is 13.9 m/s (50 km/h). The vehicle
    ahead drives at 5 to 13.9 m/s for 3 to 15 s at a time, accelerates with 0.8 to 1.7 m/s2, brakes with 1 to 2.5 m/s2
    (in 35 % of the cases 2.5 to 6 m/s2) and stands for 2 to 18 s. The alert limits are 1.5 m along and 0.625 m across
    the track.

    Difficulty: the vehicle ahead is known by its broadcasts, so the gap contains the errors of both vehicles, and its
    bound both protection levels.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)` at 5 Hz, as in LaneKeeping.

    ## Observation Space
    `traffic` contains the vehicle ahead only.

    ## Rewards
    As above.

    ## Costs
    `cost_headway` dominates. An alert permits 6.9 m/s. `cost_limit` is 15. [Mean costs](results/cost-limits.md).

    ## Starting State
    In the middle of the lane, 10 to 1505 m along the road, at the speed of the vehicle ahead (5 to 13.9 m/s), with a
    gap of 2 m + T v between bumpers; T is drawn from 0.8 to 1.0 s.

    ## Episode End
    Truncated after 120 s, or 20 m before the end of the road. A success requires 0.5 of the possible speed.

    ## Arguments
    `config["world"]`: `layout` (number of the road, 0; the roads 0 to 3 have 2.67 to 3.21 km), `roads` (1; with
    more, each episode is on one of the roads from `layout` on), `lane_width` (3.25 m),
    `standstill_gap` (2 m), `time_gap` ([0.8, 1.0] s), `lead` (speed profile: keys of `SpeedProfileConfig`), `duration`
    (120 s), `platoon` (1; vehicles ahead, up to 4). In a platoon the first drives the profile; each of the others
    follows by IDM with a lag of 1 s, and hides those ahead of it from the sensor: only messages show at once that the
    first brakes ([remote braking](results/where-levels-decide.md)).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.03
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "CarFollowingWorld",
        **CONTINUOUS,
        "success_share": 0.5,
        "cost_limit": 15.0,
    }


class UrbanCanyon(Preset):
    """
    ## Description
    Drive around a city: a loop of 3.0 km with two lanes of 3.25 m, corners of 22 m radius and more, a speed limit of
    13.9 m/s (50 km/h) and up to 10 other vehicles. The loop has open road, canyons, rows of trees, two overpasses and a
    tunnel of 120 m; the sky preset sets their heights (`open` removes them). The alert limits are 1.5 m along and 0.625
    m across the track.

    Difficulty: half of the outages can be predicted from the map, and one lane may see more of the sky than the other.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 2.8, 5.6, 8.4, 11.2 and 14 m/s. The car steers to a point of the
    lane at least 6 m ahead.

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    An alert permits 6.9 m/s (target speed 5.6 m/s) without a lane change. `cost_limit` is 40. [Mean
    costs](results/cost-limits.md).

    ## Starting State
    In the middle of either lane, anywhere on the loop, at 10 m/s or at the speed that the bends ahead allow; the other
    vehicles from 200 m behind to 400 m ahead.

    ## Episode End
    Truncated after 120 s. A success requires 0.48 of the possible speed.

    ## Arguments
    `config["world"]`: `vehicles_count` (10; fewer where drawn positions are too close), `spread` ([-200, 400] m),
    `lane_width` (3.25 m), `initial_speed` (10 m/s), `duration` (120 s); `map`, `route`, `via`, `roads`: street
    maps in place of the loop ([street maps](#street-maps)).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.05
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "UrbanCanyonWorld",
        **META,
        "success_share": 0.48,
        "cost_limit": 40.0,
    }


class CityStreets(Preset):
    """
    ## Description
    Drive through generated cities, one of 16 drawn for each episode: each has its own streets (a grid with shifted
    junctions, or rings with spokes), buildings, park and rows of trees on avenues. The way is closed and 2.8 to 4.3 km
    long, mostly with one lane of 3.25 m; speed limits are 8.3 to 16.7 m/s (30 to 60 km/h). There are up to 10 other
    vehicles. The alert limits are 1.5 m along and 0.625 m across the track.

    Difficulty: with `cities: {split: test, count: 16}` neither streets nor sky have been seen in training.

    ## Action Space
    `Discrete(5)` at 2 Hz, as in UrbanCanyon.

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    As in UrbanCanyon. `cost_limit` is 40, that of UrbanCanyon.

    ## Starting State
    As in UrbanCanyon, anywhere on the way through a city.

    ## Episode End
    As in UrbanCanyon.

    ## Arguments
    As UrbanCanyon, and `config["cities"]`: `split` and `count` (16; at most 128) of the cities, also of the test split.
    `make` finds the ways of all cities, in about half a second each; a reset makes the sky of a new one in about 3 s.
    `route`, `via` and `roads` need one map, as `config["world"]["map"]`: `generated:SEED` ([street
    maps](#street-maps)).

    ## Version History
    * v0: first version.
    """

    ID = "lanebound/City-v0"
    CORE_S = 0.05
    PRESET: ClassVar[Mapping[str, Any]] = {
        **UrbanCanyon.PRESET,
        "world": {"map": "generated"},
        "cities": {"count": 16},
    }
