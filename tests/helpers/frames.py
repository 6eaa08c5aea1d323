"""Observations of any belief and traffic on any road network, by the kernels that fill those of environments."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork

from lanebound.envs.batch.episodes import Episodes, empty_cars, reach_of
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.records_kernel import BELIEF, PERCEIVED
from lanebound.envs.batch.route_map import routes_of
from lanebound.envs.batch.rules import rules_of
from lanebound.envs.batch.view_kernel import derive, fill_frame, words_of
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation import Observation, Observer
from lanebound.envs.records import EgoBelief, Traffic

__all__ = ["Viewer"]

POLICY_HZ = 10


class Viewer:
    """What an agent sees of an ego at 10 Hz; ``changes``: of the configuration of observations."""

    def __init__(self, **changes: Any) -> None:
        self.config = EnvConfig.load({"base": "highway-v0", "policy_hz": POLICY_HZ, "observation": changes})
        self.observer = Observer(self.config.observation)
        self._network: RoadNetwork | None = None
        self._seen = 0

    def reset(self) -> None:
        """Begin an episode."""
        self.observer.reset()
        self._seen = 0

    def observe(
        self, ego: EgoBelief, traffic: Traffic, sky: Any, network: RoadNetwork, route: Any = None
    ) -> Observation:
        """One observation; sky (D, 3): satellites predicted, None for no prediction."""
        return self.observer.observe(self.frame(ego, traffic, sky, network, route))

    def frame(self, ego: EgoBelief, traffic: Traffic, sky: Any, network: RoadNetwork, route: Any = None) -> Any:
        """One frame of an observation (E,)."""
        if network is not self._network:
            self._network, self._episodes = network, self._made(network)
        e = self._episodes
        row = e.table.row
        lane, target = row[ego.lane_index], row[ego.target_lane_index]
        known = {"x_m": ego.position_m[0], "y_m": ego.position_m[1], "lane": lane, "target_lane": target}
        known["fix_x_m"], known["fix_y_m"] = ego.fix_position_m
        known["path"] = e.routes.row(lane, route)
        for name in BELIEF.names or ():
            e.ego["shown"][name] = known[name] if name in known else getattr(ego, name)
        e.views.sky[:] = -1.0 if sky is None else np.ravel(sky)
        seen = _perceived(traffic)
        e.ego["score"]["observed"] = self._seen
        derive(e.ego[0], seen, seen.size, e.table.lanes, e.routes.map, e.rules[0], 0, e.views)
        fill_frame(e._sources, words_of(e.ego, e.views), 0, e.ego["own"][0], e.frame[0])
        self._seen += 1
        return e.frame[0]

    def _made(self, network: RoadNetwork) -> Episodes:
        config, routes = self.config, routes_of(network, reach_of(self.config))
        rules = rules_of(config, (1.0, 0.625), 0.0)
        return Episodes(config, rules, routes, empty_cars(1, 1), None, PerceptionBatch(config.perception, 1, 0, 1, 0.1))


def _perceived(traffic: Traffic) -> Any:
    """The rows of a traffic as records."""
    out = np.zeros(traffic.count, PERCEIVED)
    out["x_m"], out["y_m"] = traffic.position_m.T
    for name in PERCEIVED.names or ():
        if name not in ("x_m", "y_m"):
            out[name] = getattr(traffic, name)
    return out
