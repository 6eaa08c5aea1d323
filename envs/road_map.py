"""The road network of highway-env as the map of the context monitor."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.records import enu_of
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

__all__ = ["road_map_of"]

SAMPLE_M = 5.0


def road_map_of(network: Any) -> tuple[RoadMap, tuple[str, ...]]:
    """The road network of highway-env as a map, and the name of each link: its lanes side by side are one link."""
    nodes: dict[str, int] = {}
    places: list[Any] = []
    ends, lines, limits, names = [], [], [], []
    for start, onward in network.graph.items():
        for end, lanes in onward.items():
            middle, length = lanes[len(lanes) // 2], float(lanes[0].length)
            at = np.linspace(0.0, length, max(2, int(np.ceil(length / SAMPLE_M)) + 1))
            line = enu_of(np.array([middle.position(float(s), 0.0) for s in at]))
            for node, place in ((start, line[0]), (end, line[-1])):
                if node not in nodes:
                    nodes[node] = len(places)
                    places.append(place)
            ends.append((nodes[start], nodes[end]))
            lines.append(line)
            limits.append(float(middle.speed_limit or 0.0))
            names.append(f"{start}-{end}")
    return RoadMap.of_lines(np.array(places), ends, lines, limit_mps=limits), tuple(names)
