"""World ``HairpinWorld`` and its id ``lanebound/Hairpin-v0``: up a road, through a bend of half a turn, and back."""

from collections.abc import Mapping
from math import pi
from typing import Any, ClassVar

import numpy as np

from lanebound.envs.ids import CONTINUOUS, Preset, register_id
from lanebound.envs.worlds import WorldKind, register_world
from lanebound.envs.worlds.base import Seat, World
from lanebound.envs.worlds.networks import StreetNetwork
from lanebound.envs.worlds.paths import Path, Pose, bend, straight


class HairpinWorld(World):
    def _network(self) -> StreetNetwork:
        network = StreetNetwork()
        path = Path.of(Pose(0.0, 0.0, 0.0), [*straight(150.0), *bend(pi, 25.0, 10.0), *straight(150.0)])
        network.add_road(("start", "end"), path, lanes=1, width_m=self.config["lane_width"])
        return network

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], None]:
        return [Seat(("start", "end", 0), along_m=float(rng.uniform(10.0, 60.0)), speed_mps=8.0)], None


class Hairpin(Preset):
    PRESET: ClassVar[Mapping[str, Any]] = {"base": "HairpinWorld", **CONTINUOUS, "duration_s": 40.0}
    CORE_S = 0.03  # of a second of an episode


register_world(WorldKind("HairpinWorld", HairpinWorld, HairpinWorld.support))
register_id(Hairpin)
