"""Errors of a map: links beside their true place, links that are missing, links that end at a wrong node.

A survey digitised at 1:2,500 has errors of some metres, an old map lacks new roads, and a wrong topology forbids turns
that exist: a matcher that trusts the map then follows another road.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["MapErrorsConfig", "with_errors"]

Array = NDArray[np.float64]
SMALL_MAP = 2  # links that a map keeps in any case


class MapErrorsConfig(Config):
    """Errors of the map that a matcher has; all zero: the true map."""

    shift_m: float = Field(
        0.0, ge=0, le=30, description="shift of each street to its side, 1 sigma [m]; 1 to 10 m of digitised maps"
    )
    datum_m: float = Field(0.0, ge=0, le=30, description="shift of the whole map in a random direction [m]")
    missing: float = Field(0.0, ge=0, le=0.5, description="share of the streets that the map lacks [-]")
    wrong_topology: float = Field(
        0.0, ge=0, le=0.5, description="share of the links whose end the map does not join to their node [-]"
    )


def with_errors(road_map: RoadMap, config: MapErrorsConfig, rng: np.random.Generator) -> RoadMap:
    """The map with errors; identities of links stay. The number of draws depends on the map alone."""
    links = road_map.links
    side, angle = rng.standard_normal(links), float(rng.uniform(0.0, 2.0 * np.pi))
    lost, loose = rng.random(links), rng.random(links)
    street = np.where(road_map.twin == NO_LINK, np.arange(links), np.minimum(np.arange(links), road_map.twin))
    sign = np.where(np.arange(links) == street, 1.0, -1.0)  # twins share a line, and so its error
    lines = [
        _aside(road_map.line(i), config.shift_m * float(sign[i] * side[street[i]]))
        + config.datum_m * np.array([np.sin(angle), np.cos(angle)])
        for i in range(links)
    ]
    kept = lost[street] >= config.missing
    kept[:SMALL_MAP] |= not kept.any()
    nodes, ends = list(map(tuple, road_map.node_en_m)), []
    for i in np.flatnonzero(kept):
        start, end = int(road_map.link_from[i]), int(road_map.link_to[i])
        if loose[i] < config.wrong_topology:
            nodes.append(tuple(lines[i][-1]))
            end = len(nodes) - 1
        ends.append((start, end))
    chosen = np.flatnonzero(kept)
    renumbered = np.full(links + 1, NO_LINK)
    renumbered[chosen] = np.arange(chosen.size)
    out = RoadMap.of_lines(
        np.array(nodes), ends, [lines[i] for i in chosen],
        identity=road_map.identity[chosen], limit_mps=road_map.limit_mps[chosen], kind=road_map.kind[chosen],
    )  # fmt: skip
    out.twin[:] = renumbered[road_map.twin[chosen]]
    return out


def _aside(line: Array, shift_m: float) -> Array:
    """A line (P, 2) moved to the right of its direction; its ends stay joined to no node, as in a digitised map."""
    step = np.diff(line, axis=0)
    unit = step / np.linalg.norm(step, axis=-1, keepdims=True)
    along = np.concatenate([unit[:1], unit[:-1] + unit[1:], unit[-1:]])
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    return np.asarray(line + shift_m * np.column_stack([along[:, 1], -along[:, 0]]))
