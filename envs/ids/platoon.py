"""The id of a platoon, whose page is its docstring as those of :mod:`.streets` are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.preset import CONTINUOUS, Preset
from lanebound.envs.ids.priced import PRICES
from lanebound.integrity.core.presets import deep_merge

__all__ = ["Platoon"]


class Platoon(Preset):
    """
    ## Description
    Drive in the middle of a platoon of five vehicles through a canyon and a tunnel: one lane of 3.25 m on the loop of
    UrbanCanyon, with its corners of 24 m radius and more and a speed limit of 13.9 m/s (50 km/h). The first vehicle
    drives at 5 to 13.9 m/s for 3 to 15 s at a time, less in bends; three in ten of these phases end in a stop of 2 to
    18 s. All others follow the vehicle ahead of them by IDM; their reactions have a time constant of 1 s, and they
    brake with at most 4.5 m/s2: a car that stops at once may be hit from behind. Every vehicle has a receiver and a
    navigator and broadcasts what it believes ([perception](#perception)).

    Difficulty: all vehicles lose RTK at nearly the same time, between the same walls, so the gap becomes uncertain from
    both ends. The alert limits come from a [budget](#alert-limits).

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)` at 5 Hz, as in LaneKeeping.

    ## Observation Space
    As above.

    ## Rewards
    As above.

    ## Costs
    Stopping has a [price](#priced-ids). `cost_limit` is 40 by the [rule for means](results/cost-limits.md) over 40
    training seeds: 31.4 and 1 % of a crash, rounded up. [Degenerate
    policies](results/degenerate-policies.md#priced-ids).

    ## Starting State
    In the middle of the lane, 20 to 80 m before the end of the canyon and 0.7 km before the tunnel, at the speed of the
    first vehicle, with gaps of 2 m + T v between bumpers; T is drawn from 0.8 to 1.0 s, and v is the speed that the
    first would have without bends.

    ## Episode End
    Truncated after 150 s, when most cars have left the tunnel. A success requires 0.5 of the possible speed.

    ## Arguments
    `config["world"]`: `vehicles` (5; 4 to 8), `place` (of the car, 2 for the second; None: the middle), `lead`,
    `lane_width`, `standstill_gap`, `time_gap` (as in CarFollowing), `duration` (150 s). All vehicles may
    be [agents](multiagent.md).

    ## Version History
    * v0: first version.
    """

    CORE_S = 0.03
    PRESET: ClassVar[Mapping[str, Any]] = deep_merge(
        {"base": "PlatoonWorld", **CONTINUOUS, "sky": "suburban", "success_share": 0.5, "cost_limit": 40.0}, PRICES
    )
