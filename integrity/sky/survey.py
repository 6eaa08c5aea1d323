"""The city as a map has it: heights and facades that are a little off, and no trees.

S2 predicted satellites by a model whose heights, from aerial photographs, are good to 2-3 m; the numbers differed from
those observed by two on average, within five. That model had vegetation too. Most maps have buildings only, and where
crowns hang over a road changes from year to year.
"""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.sky.scene import City

__all__ = ["MapConfig", "as_mapped"]

LEAST_HEIGHT_M = 1.0


class MapConfig(Config):
    """How well a map knows what stands beside the road; bridges and tunnels are as they are."""

    height_sigma_m: float = Field(
        2.5, ge=0, le=20, description="error of a building's height, 1 sigma [m]; S2 section 5: good to 2-3 m"
    )
    position_sigma_m: float = Field(
        0.7,
        ge=0,
        le=1.5,
        description="error of its place on each axis, 1 sigma [m]; maps at 1:1000, Japan's rules for public surveys",
    )
    trees: bool = Field(False, description="the map has trees, each where it stands; argued: maps of buildings do not")


def as_mapped(city: City, config: MapConfig, rng: np.random.Generator) -> City:
    """The city as a map has it: each building higher or lower, and moved, by errors of its own.

    Draws three normals for each building, whatever the configuration. What a city does not tell apart as buildings
    stays as it is.
    """
    z = rng.standard_normal((city.buildings, 3))
    triangles, ours = city.triangles_enu_m.copy(), city.building >= 0
    which = city.building[ours]
    height = np.zeros(city.buildings)
    np.maximum.at(height, which, triangles[ours, :, 2].max(1))
    mapped = np.maximum(height + config.height_sigma_m * z[:, 0], LEAST_HEIGHT_M)
    triangles[ours, :, 2] *= (mapped / np.where(height > 0.0, height, 1.0))[which, None]
    triangles[ours, :, :2] += config.position_sigma_m * z[which, None, 1:]
    kept = slice(None) if config.trees else ~city.foliage
    return City(triangles[kept], city.surface[kept], city.building[kept])
