"""The ids on roads of highway-env, one class each. The docstrings are pages in Gymnasium's order.

:class:`DrivingEnv` documents what all ids share; the page of an id documents the differences, with its default
configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import CONTINUOUS, INSTANT, META, SPEEDS, Preset

__all__ = ["Highway", "Intersection", "Merge", "Racetrack", "Roundabout"]


class Highway(Preset):
    """
    ## Description
    Drive fast in dense traffic on a straight motorway (highway-env's `highway-v0`): 4 lanes of 4 m, a speed limit of 30
    m/s, 50 other vehicles. Buildings line the first 2.5 km. The alert limits are 1.5 m along and 1 m across the track.

    Difficulty: because of position errors the car leaves its lane and misjudges gaps.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 5, 10, 15, 20, 25 and 30 m/s (highway-env has only 20 to 30 m/s).

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    An alert permits 15 m/s. `cost_limit` is 10, the default.

    ## Starting State
    On a random lane, about 180 m from its start, at 25 m/s; all other vehicles are ahead.

    ## Episode End
    Truncated after 40 s. A success requires 0.65 of the possible speed.

    ## Arguments
    `config["world"]`: keys of highway-env, such as `lanes_count` (4), `vehicles_count` (50), `vehicles_density` (1),
    `initial_lane_id`, `duration` (40 s). `config["traffic"]`: vehicles behind the car (`behind`, 0 to 4), at gaps of
    0.8 to 1.6 s (`gap_s`), which react with a time constant of 1 s (`reaction_s`) and brake with at most 4 m/s2
    (`brake_mps2`): a car that stops at once is hit.

    ## Version History
    * v0: first version, on `highway-v0`.
    """

    CORE_S = 0.5
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "highway-v0",
        **META,
        **INSTANT,
        "sky": "suburban",
        **SPEEDS,
        "success_share": 0.65,
    }


class Merge(Preset):
    """
    ## Description
    Pass a slip road from which a vehicle joins (highway-env's `merge-v1`): 460 m of two lanes of 4 m, from 230 to 310 m
    a third lane that ends at an obstacle, a speed limit of 20 m/s, three vehicles on the main road and one on the slip
    road. The alert limits are 1.5 m along and 1 m across the track.

    Difficulty: to make room the car must brake or change lane, and an alert restricts both.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 5, 10, 15, 20, 25 and 30 m/s.

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    An alert permits 10 m/s. `cost_limit` is 0.7. [Mean costs](results/cost-limits.md).

    ## Starting State
    At 30 m on the right lane, at 30 m/s; the other vehicles between 0 and 110 m at about the same speed, on the slip
    road at 20 m/s.

    ## Episode End
    Terminated on arrival, beyond 370 m, which a success requires. Truncated after 26 s (`duration_s`): a car at half
    the limit does not arrive.

    ## Arguments
    `config["world"]`: keys of highway-env, all of them weights of its own reward.

    ## Version History
    * v0: first version, on `merge-v1`.
    """

    CORE_S = 0.02
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "merge-v1",
        **META,
        **INSTANT,
        "sky": "suburban",
        **SPEEDS,
        "duration_s": 26.0,
        "cost_limit": 0.7,
    }


class Roundabout(Preset):
    """
    ## Description
    Cross a roundabout of two lanes from the south to the north exit (highway-env's `roundabout-v1`): circles of 20 and
    24 m radius, lanes of 4 m, a speed limit of 20 m/s, four other vehicles at about 16 m/s. The alert limits are 1.5 m
    along and 1 m across the track.

    Difficulty: in the curve a heading error becomes an error across the track, and gaps are short.

    ## Action Space
    `Discrete(5)` at 2 Hz, with the target speeds 0, 4 and 8 m/s. At highway-env's 16 m/s the circle of 20 m would need
    12.8 m/s2 across, and the car would leave the road.

    ## Observation Space
    The preview in `road` follows the planned route.

    ## Rewards
    As above.

    ## Costs
    An alert permits 10 m/s. `cost_limit` is 5, the 0.7 quantile of `integrity_aware` over 24 training seeds. With
    perfect navigation `cost_lane` is 0.6: highway-env's steering leaves the lane where the approach meets the circle.

    ## Starting State
    On the southern approach, 2.5 m before it bends towards the circle, at 8 m/s; one vehicle on the eastern approach,
    the others before and in the circle.

    ## Episode End
    Terminated on arrival, 10 m along the straight of the north exit, which a success requires. Truncated after 24 s.

    ## Arguments
    `config["world"]`: keys of highway-env, such as `incoming_vehicle_destination`, `duration` (24 s; highway-env has 11
    s).

    ## Version History
    * v0: first version, on `roundabout-v1`.
    """

    CORE_S = 0.07
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "roundabout-v1",
        **META,
        **INSTANT,
        "action_options": {"target_speeds": [0, 4, 8]},
        "world": {"duration": 24},
        "cost_limit": 5.0,
    }


class Intersection(Preset):
    """
    ## Description
    Turn left at a crossing without traffic lights, from the south to the west, and give way to all others
    (highway-env's `intersection-v2`): lanes of 4 m, a speed limit of 10 m/s, continuous traffic from all sides, about
    1,000 vehicles an hour, the most without traffic lights (MUTCD 2009, warrant 1A). The alert limits are 1.5 m along
    and 1 m across the track.

    Difficulty: the moment to enter depends on the positions that the other vehicles broadcast.

    ## Action Space
    `Discrete(3)` at 2 Hz: 0 slower, 1 idle, 2 faster, with the target speeds 0, 2, 4 and 6 m/s. At highway-env's 9 m/s
    the left turn of 13 m radius would need 6.2 m/s2 across, and the car would leave the road. With
    `action="continuous"` the world is `intersection-v1`, whose car has tyre slip.

    ## Observation Space
    12 vehicles in `traffic`. The preview in `road` follows the planned route.

    ## Rewards
    As above.

    ## Costs
    Weights of 40 for `cost_conflict` and 0.02 for `cost_lane_integrity`: a conflict with T2 < 1.42 s exceeds the limit,
    a large protection level alone does not. An alert permits 5 m/s. `cost_limit` is 2, the 0.7 quantile of
    `integrity_aware` over 20 training seeds, rounded up.

    ## Starting State
    About 65 m along the southern approach of 100 m (standard deviation 5 m), at 10 m/s.

    ## Episode End
    Terminated on arrival, 25 m beyond the crossing on the exit to the destination, which a success requires. Truncated
    after 45 s. A success requires 0.27 of the possible speed.

    ## Arguments
    `config["world"]`: keys of highway-env, such as `destination` ("o1", the west), `initial_vehicle_count` (7
    attempts), `spawn_probability` (0.14 at each decision, 1,000 an hour; at the 2,160 an hour of highway-env drivers
    block each other), `duration` (45 s; highway-env has 13 s). Other drivers wait before the crossing until their way
    is free, do not reverse, and speed up with at most 2 m/s2. Nobody gives way to the car. Buildings at the corners:
    [perception](#perception).

    ## Version History
    * v0: first version, on `intersection-v2`.
    """

    CORE_S = 0.12
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "intersection-v2",
        **META,
        **INSTANT,
        "action_options": {"target_speeds": [0, 2, 4, 6]},
        "observation": {"vehicles": 12},
        "world": {"duration": 45, "spawn_probability": 0.14, "initial_vehicle_count": 7},
        "success_share": 0.27,
        "cost": {"lane_integrity": 0.02, "conflict": 40.0},
        "cost_limit": 2.0,
    }


class Racetrack(Preset):
    """
    ## Description
    Steer around a closed track at constant speed (highway-env's `racetrack-v1`): about 350 m, two lanes of 5 m, 10 m/s
    and one slower vehicle. Both lanes may be used freely. The alert limits are 1.5 m along and 1.5 m across the track.

    Difficulty: the car cannot slow down, and the next bend comes before the next RTK position.

    ## Action Space
    `Box(-1.0, 1.0, (1,), float32)` at 5 Hz: steering (1 is 0.785 rad to the right). Meta-actions are refused.

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    `keep_lane=False`: `cost_lane` counts beyond the edges of the road and `cost_lane_integrity` is 0. Because the car
    cannot slow down, an alert permits 10 m/s (`cost.alert_speed_share` is 1). `cost_limit` is 10. Costs of a third of
    an episode (12 training seeds): 10 for `nominal`, all of it `cost_lane`, and 0.1 for `oracle`. `stop_on_alert`
    collides with the slower vehicle.

    ## Starting State
    In the middle of either lane of the first straight, 20 to 50 m along it, at 10 m/s; the other vehicle in the first
    bend, at 6 to 9 m/s.

    ## Episode End
    Truncated after 300 s.

    ## Arguments
    `config["world"]`: keys of highway-env, such as `other_vehicles` (1), `terminate_off_road` (true), `duration` (300
    s). `{"action_options": {"longitudinal": true}}` adds the acceleration: `Box(-1.0, 1.0, (2,), float32)`.

    ## Version History
    * v0: first version, on `racetrack-v1`.
    """

    CORE_S = 0.02
    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "racetrack-v1",
        **CONTINUOUS,
        "keep_lane": False,
        "cost": {"alert_speed_share": 1.0},  # it cannot slow down
        "actuators": None,  # 10 m/s on 15 m radius asks for 6.7 m/s2
    }
