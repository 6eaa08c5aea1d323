"""The environments, one class an id, each with its page in Gymnasium's order.

What all of them share (frames, observation, rewards, costs, info, endings) is in :class:`DrivingEnv`; a page tells what
is particular, with the default configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.worlds import world_kind
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = [
    "CLASSES",
    "CONTINUOUS",
    "META",
    "CarFollowing",
    "Highway",
    "Intersection",
    "LaneKeeping",
    "Merge",
    "Preset",
    "Racetrack",
    "Roundabout",
    "UrbanCanyon",
    "enter",
    "has_engine",
    "id_of",
    "presets",
    "refuse_misplaced",
    "register_id",
    "withdraw_id",
]

CONTINUOUS: dict[str, Any] = {"action": "continuous", "policy_hz": 5}
META: dict[str, Any] = {"action": "meta", "policy_hz": 2}
INSTANT: dict[str, Any] = {"actuators": {"steering_rate_radps": None}}  # as highway-env's own control expects


SPEEDS: dict[str, Any] = {"action_options": {"target_speeds": [0, 5, 10, 15, 20, 25, 30]}}  # slow enough in an alert


ELSEWHERE = {
    "autoreset_mode": "where environments run one by one pass vector_kwargs={'autoreset_mode': ...} to make_vec",
    "max_episode_steps": "pass config={'duration_s': ...}",
}


def refuse_misplaced(misplaced: Mapping[str, Any], allowed: str) -> None:
    """Say where an argument belongs that an environment does not take.

    Raises
    ------
    InputError
        There is one.
    """
    for key, value in misplaced.items():
        fields = EnvConfig.model_fields
        advice = f"pass config={{{key!r}: {value!r}}}" if key in fields else nearest(key, ["config", *fields])
        raise InputError(f"arguments must be {allowed}, got {key}={value!r}: {ELSEWHERE.get(key, advice)}")


class Preset(DrivingEnv):
    """An environment with a configuration of its own, over which a user's is merged deeply."""

    PRESET: ClassVar[Mapping[str, Any]]
    ID: ClassVar[str | None] = None

    def __init__(
        self, config: Mapping[str, Any] | None = None, render_mode: str | None = None, **misplaced: Any
    ) -> None:
        refuse_misplaced(misplaced, "config and render_mode")
        if config is not None and not isinstance(config, Mapping):
            raise InputError(f"config must be a mapping of what to change, got {config!r}: pass a dict")
        super().__init__(EnvConfig.build(self.PRESET, config), render_mode)


class LaneKeeping(Preset):
    """
    ## Description
    Keep the middle of the only lane of a winding road, 3.25 m wide, alone on it. It is 1.83 km long: straights, bends
    of 42 to 160 m radius and S-bends between houses; the limit is 50 km/h (13.9 m/s), at which not every bend can be
    taken in comfort (the tightest asks for 9.1 m/s). The alert limits are 1.5 m along and 0.625 m across the track.

    What is hard: in an outage the estimate drifts sideways, and the car with it; 0.625 m is all there is on each side.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)` at 5 Hz: acceleration within 6 m/s2, steering within 0.4 rad (positive to the
    right). The speed stays between 0 and 20 m/s, to within a simulation step.

    ## Observation Space
    The common one. The road and the sky ahead say where to expect an outage; nobody is ever in `traffic`.

    ## Rewards
    The common ones, against the limit of 13.9 m/s.

    ## Costs
    `cost_lane` and `cost_lane_integrity` are about the one lane. `cost_headway` is 0. While an alert is on, 6.9 m/s are
    permitted.
    The limit of an episode, `cost_limit`, is 15: stopping on alerts costs 4, ignoring them 50, and `integrity_aware`
    14 (means of 24 training seeds, `urban`).

    ## Starting State
    In the middle of the lane, anywhere between 10 m and the place from which 60 s at the limit end before the road does
    (956 m), at 10 m/s or what the bends ahead allow.

    ## Episode End
    Truncated after 60 s, or 20 m before the end of the road.

    ## Arguments
    `config={"world": {...}}`: `layout` (which road, from 0 on; 0 to 3: of 1.83 to 1.94 km), `lanes_count` (1),
    `lane_width` (3.25 m), `initial_speed` (10 m/s), `duration` (60 s).

    ## Version History
    * v0: first version.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "LaneKeepingWorld", **CONTINUOUS, "cost_limit": 15.0}


class CarFollowing(Preset):
    """
    ## Description
    Follow one vehicle through stop-and-go traffic, without hitting it or falling behind. The road is 3.21 km long, one
    lane of 3.25 m, with bends of 200 to 600 m radius; the limit is 50 km/h (13.9 m/s). The vehicle ahead cruises at 5
    to 13.9 m/s for 3 to 15 s at a time, accelerates with 0.8 to 1.7 m/s2, brakes with 1 to 2.5 m/s2 or, 35 % of the
    times, with 2.5 to 6 m/s2, and stands for 2 to 18 s. The alert limits are 1.5 m along and 0.625 m across the track.

    What is hard: the gap is known only by what the vehicle ahead broadcasts of its own estimate, up to 10 times a
    second. Both errors along the track are in it, and so are both protection levels in its bound.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)` at 5 Hz: acceleration within 6 m/s2, steering within 0.4 rad (positive to the
    right). The speed stays between 0 and 20 m/s, to within a simulation step.

    ## Observation Space
    The common one; the vehicle ahead is the only one in `traffic`, and gone 1 s after its last message.

    ## Rewards
    The common ones, against the limit of 13.9 m/s: standing behind a standing vehicle earns nothing, and costs nothing.

    ## Costs
    The common ones; `cost_headway` is the one to watch. While an alert is on, 6.9 m/s are permitted.
    The limit of an episode, `cost_limit`, is 15: stopping on alerts costs 3, ignoring them 52, and `integrity_aware`
    23, of which 8 for one end off the road (means of 24 training seeds, `urban`).

    ## Starting State
    In the middle of the lane between 10 m and 1505 m, at the speed of the vehicle ahead (5 to 13.9 m/s), with a gap of
    2 m + T v between bumpers, T drawn from 0.8 to 1.0 s.

    ## Episode End
    Truncated after 120 s, or 20 m before the end of the road.

    ## Arguments
    `config={"world": {...}}`: `layout` (which road, from 0 on; 0 to 3: of 2.67 to 3.21 km), `lane_width` (3.25 m),
    `standstill_gap` (2 m), `time_gap` ([0.8, 1.0] s), `lead` (ranges of the profile
    above, see `SpeedProfileConfig`), `duration` (120 s).

    ## Version History
    * v0: first version.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "CarFollowingWorld", **CONTINUOUS, "cost_limit": 15.0}


class Highway(Preset):
    """
    ## Description
    Drive fast in dense traffic on a straight motorway (highway-env's `highway-v0`): 4 lanes of 4 m, a limit of 30 m/s,
    50 other vehicles. The first 2.5 km are lined as the suburban sky says. The alert limits are 1.5 m along and 1 m
    across the track.

    What is hard: at these distances nothing collides for an error of position; what shows is a car beside its lane, and
    lane changes into gaps that are not where they seem.

    ## Action Space
    `Discrete(5)` at 2 Hz: 0 lane left, 1 idle, 2 lane right, 3 faster, 4 slower, through the speeds 0, 5, 10,
    15, 20, 25 and 30 m/s (highway-env itself starts at 20, too fast in an alert).

    ## Observation Space
    The common one; `traffic` shows the nearest 6 vehicles of those that broadcast.

    ## Rewards
    The common ones, against the limit of 30 m/s; highway-env's own reward is the term `base` of weight 0.

    ## Costs
    The common ones. While an alert is on, 15 m/s are permitted. The limit of an episode, `cost_limit`, is 10, the
    default, not fitted to these drives.

    ## Starting State
    On a random lane about 180 m from its start, at 25 m/s; the others are ahead.

    ## Episode End
    Truncated after 40 s.

    ## Arguments
    `config={"world": {...}}` with highway-env's keys: `lanes_count` (4), `vehicles_count` (50), `vehicles_density` (1),
    `initial_lane_id`, `duration` (40 s) and so on.

    ## Version History
    * v0: first version, on `highway-v0`.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "highway-v0", **META, **INSTANT, "sky": "suburban", **SPEEDS}


class Merge(Preset):
    """
    ## Description
    Pass a slip road from which a vehicle joins (highway-env's `merge-v1`): 460 m of two lanes of 4 m, a third one from
    230 to 310 m that ends at an obstacle, a limit of 20 m/s, three vehicles on the main road and one on the slip road.
    The alert limits are 1.5 m along and 1 m across the track.

    What is hard: making room takes slowing down or a lane change, which an alert soon forbids.

    ## Action Space
    `Discrete(5)` at 2 Hz: 0 lane left, 1 idle, 2 lane right, 3 faster, 4 slower, through the speeds 0, 5, 10,
    15, 20, 25 and 30 m/s (highway-env itself starts at 20, too fast in an alert).

    ## Observation Space
    The common one.

    ## Rewards
    The common ones, against the limit of 20 m/s; highway-env's own reward, with its
    concern for who joins, is the term `base` of weight 0.

    ## Costs
    The common ones. While an alert is on, 10 m/s are permitted.
    The limit of an episode, `cost_limit`, is 0.7: stopping on alerts costs 0.4, ignoring them 1.2, and
    `integrity_aware` 0.2 (means of 24 training seeds).

    ## Starting State
    At 30 m on the right lane, at 30 m/s; the others from 0 to 110 m, about as fast or, on the slip road, at 20 m/s.

    ## Episode End
    Terminated beyond 370 m, where the task is done. Truncated after 60 s (`duration_s`).

    ## Arguments
    `config={"world": {...}}` with highway-env's keys, all of them weights of its own reward.

    ## Version History
    * v0: first version, on `merge-v1`.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "merge-v1",
        **META,
        **INSTANT,
        "sky": "suburban",
        **SPEEDS,
        "duration_s": 60.0,
        "cost_limit": 0.7,
    }


class Roundabout(Preset):
    """
    ## Description
    Go straight on through a roundabout of two lanes (highway-env's `roundabout-v1`): from the south to the north exit,
    circles of 20 and 24 m radius, lanes of 4 m, a limit of 20 m/s, four other vehicles at about 16 m/s. The alert
    limits are 1.5 m along and 1 m across the track.

    What is hard: the curve turns an error of heading into one across the track, and gaps are short.

    ## Action Space
    `Discrete(5)` at 2 Hz: 0 lane left, 1 idle, 2 lane right, 3 faster, 4 slower, through the speeds 0, 8 and 16 m/s.

    ## Observation Space
    The common one; the preview in `road` follows the planned route.

    ## Rewards
    The common ones, against the limit of 20 m/s; highway-env's own reward is the term `base` of weight 0.

    ## Costs
    The common ones. While an alert is on, 10 m/s are permitted.
    The limit of an episode, `cost_limit`, is 3: ignoring alerts costs 3.6 and a crash in 24 drives (8.3), stopping on
    them 1.1 and one in 8 (25), and `integrity_aware` 1.4 (means of 24 training seeds). With perfect navigation
    `cost_lane` still comes to about 1.5: highway-env's own control swings wide where the approach meets the circle.

    ## Starting State
    On the southern approach, 2.5 m before it bends towards the circle, at 8 m/s; one vehicle on the eastern approach,
    the others before and in the circle.

    ## Episode End
    Truncated after 11 s.

    ## Arguments
    `config={"world": {...}}` with highway-env's keys: `incoming_vehicle_destination`, `duration` (11 s) and so on.

    ## Version History
    * v0: first version, on `roundabout-v1`.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "roundabout-v1", **META, **INSTANT, "cost_limit": 3.0}


class Intersection(Preset):
    """
    ## Description
    Turn left at a crossing without lights, giving way to all (highway-env's `intersection-v2`): from the south to the
    west, lanes of 4 m, a limit of 10 m/s, and traffic that keeps coming from all sides. The alert limits are 1.5 m
    along and 1 m across the track.

    What is hard: when to go is a question of where the others are, and they are where their own receivers say.

    ## Action Space
    `Discrete(3)` at 2 Hz: 0 slower, 1 idle, 2 faster, through the speeds 0, 4.5 and 9 m/s. With `action="continuous"`
    the world is `intersection-v1`, whose car slips on its tyres.

    ## Observation Space
    The common one; the preview in `road` follows the planned route.

    ## Rewards
    The common ones, against the limit of 10 m/s; highway-env's own reward is the term `base` of weight 0.

    ## Costs
    The common ones. While an alert is on, 5 m/s are permitted.
    The limit of an episode, `cost_limit`, is 8: without the crashes ignoring alerts costs 6, stopping on them 0.8, and
    `integrity_aware` 3 (means of 24 training seeds); but all of them crash in a quarter of their drives or more, which
    adds 50 and more. To keep the limit takes fewer than one in forty.

    ## Starting State
    About 65 m along the southern approach of 100 m, with a standard deviation of 5 m, at 10 m/s.

    ## Episode End
    Terminated on arrival, 25 m beyond the crossing; truncated after 13 s.

    ## Arguments
    `config={"world": {...}}` with highway-env's keys: `destination` ("o1", the west), `initial_vehicle_count` (10
    tries), `spawn_probability` (0.6 at each decision), `duration` (13 s) and so on.

    ## Version History
    * v0: first version, on `intersection-v2`.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "intersection-v2", **META, **INSTANT, "cost_limit": 8.0}


class Racetrack(Preset):
    """
    ## Description
    Steer round a closed track at constant speed (highway-env's `racetrack-v1`): about 350 m, two lanes of 5 m, 10 m/s,
    and one slower vehicle on it. The lanes may be chosen freely. The alert limits are 1.5 m along and 1.5 m across the
    track.

    What is hard: there is no slowing down, and the next bend comes before the next fix.

    ## Action Space
    `Box(-1.0, 1.0, (1,), float32)` at 5 Hz: steering within 0.785 rad, positive to the right. Meta-actions are refused.

    ## Observation Space
    The common one.

    ## Rewards
    The common ones, against the limit of 10 m/s; highway-env's own reward is the term `base` of weight 0.

    ## Costs
    `cost_lane` is about the edges of the road, and `cost_lane_integrity` is 0. The car cannot slow down, so
    an alert permits its 10 m/s (`cost.alert_speed_share` is 1). The limit of an episode, `cost_limit`, is 10:
    a third of an episode (100 s) costs `nominal` 10, all for the lane, and `oracle` 0.1; both pass the slower vehicle,
    into which `stop_on_alert` crashes (12 training seeds).

    ## Starting State
    In the middle of either lane of the first straight, 20 to 50 m along it, at 10 m/s; the other vehicle in the first
    bend, at 6 to 9 m/s.

    ## Episode End
    Truncated after 300 s.

    ## Arguments
    `config={"world": {...}}` with highway-env's keys: `other_vehicles` (1), `terminate_off_road` (true), `duration`
    (300 s) and so on. `{"action_options": {"longitudinal": true}}` gives the throttle back, and the action `Box(-1.0,
    1.0, (2,), float32)`.

    ## Version History
    * v0: first version, on `racetrack-v1`.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {
        "base": "racetrack-v1",
        **CONTINUOUS,
        "keep_lane": False,
        "cost": {"alert_speed_share": 1.0},  # it cannot slow down
        "actuators": None,  # 10 m/s on 15 m radius asks for 6.7 m/s2
    }


class UrbanCanyon(Preset):
    """
    ## Description
    Drive round a city: a loop of 3.0 km with two lanes of 3.25 m, corners of 22 m radius upwards, a limit of 50 km/h
    (13.9 m/s), and up to 10 other vehicles. On the way lie open road, canyons, rows of trees, two overpasses and a
    tunnel of 120 m, whatever the level of the sky makes of them (`open` clears them away). The alert limits are 1.5 m
    along and 0.625 m across the track.

    What is hard: everything at once. Half of the outages can be foreseen from the map, and one lane may see more of the
    sky than the other.

    ## Action Space
    `Discrete(5)` at 2 Hz: 0 lane left, 1 idle, 2 lane right, 3 faster, 4 slower, through the speeds 0, 2.8, 5.6, 8.4,
    11.2 and 14 m/s. The wheels turn at a limited rate, and pursue the lane 6 m ahead or more.

    ## Observation Space
    The common one.

    ## Rewards
    The common ones, against the limit of 13.9 m/s.

    ## Costs
    The common ones. While an alert is on, 6.9 m/s are permitted: the speed 5.6 m/s, without changing lane.
    The limit of an episode, `cost_limit`, is 40: stopping on alerts costs 14, mostly by getting nowhere, ignoring them
    190, and `integrity_aware` 86, of which 20 for one end off the road (means of 10 training seeds).

    ## Starting State
    In the middle of either lane, anywhere on the loop, at 10 m/s or what the bends ahead allow; the others from 200 m
    behind to 400 m ahead.

    ## Episode End
    Truncated after 120 s.

    ## Arguments
    `config={"world": {...}}`: `vehicles_count` (10, places allowing), `spread` ([-200, 400] m), `lane_width` (3.25 m),
    `initial_speed` (10 m/s), `duration` (120 s).

    ## Version History
    * v0: first version.
    """

    PRESET: ClassVar[Mapping[str, Any]] = {"base": "UrbanCanyonWorld", **META, "cost_limit": 40.0}


CLASSES: tuple[type[Preset], ...] = (
    LaneKeeping,
    CarFollowing,
    Highway,
    Merge,
    Roundabout,
    Intersection,
    Racetrack,
    UrbanCanyon,
)


_registered: list[type[Preset]] = []


def presets() -> tuple[type[Preset], ...]:
    """The classes of all ids, those registered from outside last."""
    return (*CLASSES, *_registered)


def register_id(kind: type[Preset]) -> str:
    """Add an id with Gymnasium from outside, driven alone and, where its world has support, by the engine.

    Raises
    ------
    InputError
        The id is taken.
    """
    if any(id_of(kind) == id_of(other) for other in presets()):
        raise InputError(f"id must not be taken, got {id_of(kind)}: set ID in the class")
    _registered.append(kind)
    enter(kind)
    return id_of(kind)


def withdraw_id(kind: type[Preset]) -> None:
    """Take back an id that was registered."""
    _registered.remove(kind)
    del gymnasium.registry[id_of(kind)]


def enter(kind: type[Preset]) -> None:
    """Register an id with Gymnasium; doing so twice changes nothing."""
    if id_of(kind) not in gymnasium.registry:
        engine = f"lanebound.envs.vector.env:Vector{kind.__name__}" if has_engine(kind) else None
        entry = f"{kind.__module__}:{kind.__qualname__}" if kind in CLASSES else kind
        gymnasium.register(id_of(kind), entry, vector_entry_point=engine, kwargs={"config": {}})


def has_engine(kind: type[Preset]) -> bool:
    """Whether the vector engine drives an id."""
    world = world_kind(str(kind.PRESET["base"]))
    return world is not None and world.support is not None


def id_of(kind: type[Preset]) -> str:
    """The id of a class: ``lanebound/Name-v0``, or what it says itself."""
    return kind.ID or f"lanebound/{kind.__name__}-v0"
