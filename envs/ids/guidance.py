"""Ids in which metres of position decide, beside those in which a lane does.

A camera keeps the car in its lane (``lane_sensor``); the position decides which road it is on. The sweeps over the ids
do not drive them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import META, Preset
from lanebound.envs.worlds.guidance import TARGET_SPEEDS_MPS

__all__ = ["Guidance"]


class Guidance(Preset):
    """
    ## Description
    Find the way to an exit, on a motorway (two lanes, 27.8 m/s) or on the collector road beside it (two lanes, 13.9
    m/s), whose nearest lanes are 18 m apart between their middles. The goal is an exit of the collector road, 1.4 km
    ahead. From the motorway a slip road leads to the collector road; at the same place the collector road has an exit
    that does not lead to the goal. A camera keeps the car in its lane ([lane sensor](#lane-sensor)), on whatever road
    that is. The alert limits are 15 m along (S5: route guidance) and 9.5 m across the track: an error of 9.75 m
    and more may let the car take the other road for its own.

    Difficulty: on the wrong road the map asks for the wrong lane and permits the wrong speed. A level of 5 to 20 m says
    whether the other road is possible.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 4.6, 9.3, 13.9, 18.5, 23.2 and 27.8 m/s. Lane changes
    start from the lane that the camera sees.

    ## Observation Space
    With the entries of a [lane sensor](#lane-sensor).

    ## Rewards
    As above.

    ## Costs
    Weights of 2 for `cost_speeding`, 20 for `cost_route`, 1 for `cost_gore` and 1 for `cost_blocking`. An alert permits
    the least limit of the roads that the levels leave possible. `cost_limit` is 5: the mean of `integrity_aware` over
    16 training seeds (2.5) and 1 % of a crash, rounded up.

    ## Starting State
    On a random lane of either road, 20 to 180 m along it, at 13.9 m/s. Up to 6 other vehicles on both roads.

    ## Episode End
    Terminated at the goal, which a success requires, and on a road that does not lead there (`info["lost"]`). Truncated
    after 150 s. A success requires 0.5 of the possible speed.

    ## Arguments
    `config["world"]`: `separation` (18 m), `lane_width` (3.5 m), `vehicles_count` (6), `duration` (150 s).
    `config["navigator"]`: another [service](navigation.md#positioning-services), such as `services/spp`
    (default `services/dgps`).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.05
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "GuidanceWorld",
        **META,
        "action_options": {"target_speeds": TARGET_SPEEDS_MPS},
        "sky": "suburban",
        "lane_sensor": {},
        "navigator": "services/dgps",  # its level is about the alert limit under this sky
        "perception": {"source": "sensor"},
        "observation": {"pl_max_m": 30.0},
        "al_at_m": 15.0,
        "al_ct_m": 9.5,
        "success_share": 0.5,
        "success_behind_s": 30.0,
        "cost": {"speeding": 2.0, "route": 20.0, "gore": 1.0, "blocking": 1.0, "alert_speed": "roads"},
        "cost_limit": 5.0,
    }
