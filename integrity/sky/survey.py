"""The city as represented in a map: heights and facades with errors, without trees.

S2 predicted satellites with a model whose heights, from aerial photographs, have errors of 2-3 m. The predicted numbers
differed from the observed ones by two on average and by at most five. That model included vegetation. Most maps contain
only buildings, and the crowns above a road change from year to year.
"""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.sky.scene import City

__all__ = ["MapConfig", "as_mapped"]

LEAST_HEIGHT_M = 1.0


class MapConfig(Config):
    """Errors of a map of the buildings beside the road; bridges and tunnels have no errors."""

    height_sigma_m: float = Field(
        2.5, ge=0, le=20, description="error of a building's height, 1 sigma [m]; S2 section 5: 2-3 m"
    )
    position_sigma_m: float = Field(
        0.7,
        ge=0,
        le=1.5,
        description="error of its position on each axis, 1 sigma [m]; maps at 1:1000, Japan's rules for public surveys",
    )
    trees: bool = Field(False, description="the map has trees, without errors; chosen: maps of buildings have none")


def as_mapped(city: City, config: MapConfig, rng: np.random.Generator) -> City:
    """Build the mapped city: independent random errors of height and position for each building.

    Three normals are drawn for each building, with every configuration. Triangles without a building number do not
    change.
    """
    z = rng.standard_normal((city.buildings, 3))
    triangles, numbered = city.triangles_enu_m.copy(), city.building >= 0
    which = city.building[numbered]
    height = np.zeros(city.buildings)
    np.maximum.at(height, which, triangles[numbered, :, 2].max(1))
    mapped = np.maximum(height + config.height_sigma_m * z[:, 0], LEAST_HEIGHT_M)
    triangles[numbered, :, 2] *= (mapped / np.where(height > 0.0, height, 1.0))[which, None]
    triangles[numbered, :, :2] += config.position_sigma_m * z[which, None, 1:]
    kept = slice(None) if config.trees else ~city.foliage
    return City(triangles[kept], city.surface[kept], city.building[kept], city.material[kept])
