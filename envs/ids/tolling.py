"""The id in which a position of metres decides what is charged, whose page is its docstring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import META, Preset

__all__ = ["Tolling"]


class Tolling(Preset):
    """
    ## Description
    Decide for five geo-objects whether the car has driven the tolled road (road user charging, S3 V; pay as you speed
    by links, S5). The car drives by itself at 20 m/s along three roads of two lanes that look alike and are 8 to 40 m
    apart. One road of each geo-object, a section of 200 m, is tolled; slip roads between the sections lead from one
    road to the next. A camera keeps the car in its lane ([lane sensor](#lane-sensor)), and does not know on which road.

    Difficulty: the camera sees lanes, and the position has to say which road it is. A level across excludes the
    roads that are farther from the position; where it excludes neither the tolled road nor the others, the choice
    is between an overcharge and an undercharge.

    ## Action Space
    `Discrete(3)` at 2 Hz: 0 defer, 1 charge the open geo-object, 2 do not charge it. The first claim counts. A
    geo-object is open from where the estimated place comes onto its roads until 5 s after it has left them; without a
    claim it is not charged. `action_masks()` permits 1 and 2 while one is open and not decided.

    ## Observation Space
    As above without traffic, with the entries of a lane sensor and six of the open geo-object (`observation.tolls`), in
    `road`: `toll_open`, `toll_inside`, `toll_distance` and `toll_free_distance` (across from the position to the lane
    of the tolled road and of the nearest other one in which the car would be by the camera), `toll_share` (of the
    positions so far, nearest to the tolled road: the number of positions within the geo-object, S3 V) and
    `toll_passed`. All of them follow from position, camera, map and tariff. The level across is `integrity.pl_ct`.

    ## Rewards
    `toll` alone: 1 for each geo-object that is settled with the right claim. To defer to the end earns nothing.

    ## Costs
    `cost_overcharge` with a weight of 10 and `cost_undercharge` of 1. A geo-object that the true car has left is
    settled when it is closed, or when the episode ends. All other causes have no weight, as the agent does not drive.
    An overcharge is graver: it has to be justified to the user (charging integrity), an undercharge is lost revenue
    (charging availability: Grush et al., ITS World Congress 2009; metrics of ISO/TS 17444-1; the ratio is chosen, as S3
    states no rates).

    `cost_limit` and `cost_limits.undercharge` are 1, the 0.7 quantile of `integrity_aware` over 48 training seeds; who
    never charges pays 1.8 in the mean. `cost_limits.overcharge` is 0.1: 1 % of what one costs, as the rule for crashes
    ([limits](results/cost-limits.md)).

    ## Starting State
    On a random lane of the first or second road, 20 to 100 m along the first geo-object, at 20 m/s, alone. The tolled
    roads are drawn.

    ## Episode End
    Truncated after 105 s, when all geo-objects are closed. A success requires that none is overcharged or undercharged.

    ## Arguments
    `config["world"]`: `layout` (number by which the order of the distances between the roads is drawn, 0), `lane_width`
    (3.5 m), `duration` (105 s). `config["navigator"]`: another [service](navigation.md#positioning-services)
    (default `services/spp`, [measured](results/tolling.md)).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.05
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "TollingWorld",
        **META,
        "action_options": {"target_speeds": [0.0, 20.0]},
        "sky": "suburban",
        "lane_sensor": {},
        "navigator": "services/spp",  # its level is about the distance of the roads: 15 m at the median, 18 m
        "perception": {"source": "none"},
        "observation": {"tolls": True, "vehicles": 0, "pl_max_m": 50.0},
        "al_at_m": 15.0,
        "al_ct_m": 15.0,  # S5: of links
        "reward": {"progress": 0.0, "lane_centre": 0.0, "comfort": 0.0, "collision": 0.0},
        "cost": {
            "collision": 0.0,
            "off_road": 0.0,
            "lane": 0.0,
            "lane_integrity": 0.0,
            "headway": 0.0,
            "conflict": 0.0,
            "alert": 0.0,
            "hmi": 0.0,
            "overcharge": 10.0,
            "undercharge": 1.0,
        },
        "cost_limit": 1.0,
        "cost_limits": {"overcharge": 0.1, "undercharge": 1.0},
    }
