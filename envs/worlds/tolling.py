"""Three roads beside each other, of which one is tolled in each section; slip roads lead from one to the next.

Each road has two lanes, which a camera cannot tell from those of the others. Along x sections alternate with slip
roads, by which every lane goes on: at the first two the left lane becomes the right lane of its road and the right one
the left lane of the road to the right; at the last two it is the other way. So a car that keeps its lane changes road
once or twice, and its lane numbers do not say on which road it is. The distances between the roads differ by section.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from numpy.typing import NDArray

from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.toll_kernel import CHARGE, DEFER, SPARE
from lanebound.envs.worlds.base import META, Array, Seat, World
from lanebound.envs.worlds.networks import StreetNetwork
from lanebound.envs.worlds.paths import Path, Piece, Pose, s_bend, straight
from lanebound.integrity.core.records import Records

__all__ = ["ClaimAction", "TollingWorld", "levy", "sensible_claims", "tolled_roads"]

ROADS, SIDES = "abc", (1, 1, -1, -1)  # to which side the outer lanes change road at each row of slip roads
SECTION_M, BETWEEN_M, BEYOND_M = 200.0, 240.0, 350.0  # along the geo-objects, the slip roads, and behind the last
GAP_M = (8.0, 40.0)  # between lanes of the same number: toll lanes 1 m beside free ones, to service roads; chosen
SPEED_MPS = 20.0  # of the car and the limit on all roads: speed does not tell the road
RADIUS_M, TRANSITION_M = 250.0, 20.0  # of slip roads: 1.6 m/s2 at 20 m/s
START_M = (20.0, 100.0)
STARTS = 2  # roads from the left on which a car may start, so that it does not come beyond the last one
NOSE_M = 1.0  # straight before and behind a bend, at least
LEAST_SHIFT_M = 0.01  # a smaller one is none


class ClaimAction(DiscreteMetaAction):  # type: ignore[misc]
    """Claims about the open geo-object; the car keeps its lane and its speed whatever is claimed."""

    def __init__(self, env: AbstractEnv, **options: Any) -> None:
        super().__init__(env, **options)
        self.actions = {DEFER: "IDLE", CHARGE: "CHARGE", SPARE: "SPARE"}
        self.actions_indexes = {label: code for code, label in self.actions.items()}

    def act(self, action: Any) -> None:
        """Drive on."""
        self.controlled_vehicle.act("IDLE")


def _aside(shift_m: float) -> list[Piece]:
    """From the end of a section to the next, ``shift_m`` to the right."""
    if abs(shift_m) < LEAST_SHIFT_M:
        return straight(BETWEEN_M)
    sign = 1.0 if shift_m > 0.0 else -1.0
    pieces = [Piece(p.length, sign * p.start, sign * p.end) for p in s_bend(abs(shift_m), RADIUS_M, TRANSITION_M)]
    path = Path.of(Pose(0.0, 0.0, 0.0), [*straight(NOSE_M), *pieces, *straight(NOSE_M)])
    rest = straight(NOSE_M + 0.5 * (BETWEEN_M - path.pose_at(path.station[-1]).x))
    return [*rest, *pieces, *rest]


def tolled_roads(layout: int, width_m: float) -> StreetNetwork:
    """The roads; road a of geo-object 2 is ``("a2", "a2x")``.

    ``layout`` draws the order of the distances between them, whose logarithms are evenly spaced.
    """
    gaps = np.random.default_rng(layout).permutation(np.geomspace(*GAP_M, 2 * len(SIDES) + 2)).reshape(-1, 2)
    network, y = StreetNetwork(), [(-left, 0.0, right) for left, right in gaps.tolist()]
    last = len(SIDES)
    for k in range(last + 1):
        x = k * (SECTION_M + BETWEEN_M)
        for r, road in enumerate(ROADS):
            edge = f"{road}{k}", f"{road}{k}x"
            network.add_beside(edge, Path.of(Pose(x, y[k][r], 0.0), straight(SECTION_M)), range(2), width_m, SPEED_MPS)
            network.geo_objects[edge] = k
            end = x + SECTION_M
            if k == last:
                beyond = Path.of(Pose(end, y[k][r], 0.0), straight(BEYOND_M))
                network.add_beside((edge[1], f"{road}e"), beyond, range(2), width_m, SPEED_MPS)
                continue
            outer = 1 if SIDES[k] > 0 else 0
            for lane in range(2):
                to = r + SIDES[k] if lane == outer else r
                if to in range(len(ROADS)):
                    begin = y[k][r] + lane * width_m
                    path = Path.of(Pose(end, begin, 0.0), _aside(y[k + 1][to] + (1 - lane) * width_m - begin))
                    network.add_beside((edge[1], f"{ROADS[to]}{k + 1}"), path, range(1), width_m, SPEED_MPS)
    return network


def levy(tolls: Records, row: int, table: LaneTable, tolled: tuple[tuple[str, str], ...]) -> None:
    """Begin an episode in a row of (N,) TOLL: these roads are tolled, one of each geo-object."""
    tolls[row] = np.zeros((), tolls.dtype)
    tolls["objects"][row], tolls["open"][row], tolls["driven"][row] = len(tolled), NONE, NONE
    tolls["tolled"][row, : len(tolled)] = [table.row[(*edge, 0)] for edge in tolled]


def sensible_claims(ego: Records) -> NDArray[np.bool_]:
    """Which claims make sense in environments (N,) EGO, (N, 3): without an open object to be decided none but DEFER."""
    toll = ego["toll"]
    may = (toll["open"] >= 0) & (toll["claims"][np.arange(len(toll)), toll["open"]] == DEFER)
    return np.stack([np.ones_like(may), may, may], axis=-1)


class TollingWorld(World):
    """A car drives by itself along roads of which one is tolled in each section; the agent decides what to charge.

    Action
        Discrete(3): defer, charge, do not charge the open geo-object (:class:`ClaimAction`), at 2 Hz by default.
    Observation, reward, episode end
        Those of :class:`World`.
    Start
        On a lane of the first or second road, at 20 m/s, alone; one road of each geo-object is drawn to be tolled.
    Configuration
        ``layout`` (number by which the order of the distances between the roads is drawn), ``lane_width`` [m].
    """

    ENDS_M: ClassVar[float | None] = None

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {
            "action": META | {"target_speeds": [0.0, SPEED_MPS]},
            "policy_frequency": 2,
            "lane_width": 3.5,
            "layout": 0,
            "duration": 105.0,
        }

    def define_spaces(self) -> None:
        """As highway-env, with claims as actions."""
        super().define_spaces()
        options = {key: value for key, value in self.config["action"].items() if key != "type"}
        self.action_type = ClaimAction(self, **options)
        self.action_space = self.action_type.space()

    def _network(self) -> StreetNetwork:
        return tolled_roads(self.config["layout"], self.config["lane_width"])

    def draw_tolls(self, rng: np.random.Generator) -> tuple[tuple[str, str], ...]:
        """Draw the tolled road of each geo-object."""
        return tuple(
            (f"{ROADS[r]}{k}", f"{ROADS[r]}{k}x") for k, r in enumerate(rng.integers(len(ROADS), size=len(SIDES) + 1))
        )

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw road, lane and place of the car."""
        road, lane = ROADS[int(rng.integers(STARTS))], int(rng.integers(2))
        return [Seat((f"{road}0", f"{road}0x", lane), float(rng.uniform(*START_M)), SPEED_MPS)], None
