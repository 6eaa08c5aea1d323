"""Materials of facades, and what they do to a signal that they reflect."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sky.propagation_kernel import permittivity

__all__ = ["MATERIAL", "Material", "clad", "material_table", "permittivities"]

MATERIAL = record(
    relative="relative permittivity [-]",
    conductivity="at 1 GHz [S/m]",
    exponent="of the frequency in GHz, by which the conductivity grows [-]",
    roughness_m="standard deviation of the face's height [m]",
)


class Material(IntEnum):
    """What a face is made of."""

    CONCRETE = 0
    GLASS = 1
    BRICK = 2
    METAL = 3


# Relative permittivity and conductivity ``c f^d``: ITU-R P.2040-3, table 3 (glass, brick, concrete, metal; 1-100 GHz).
# Roughness: chosen, plaster and balconies 20 mm, panes and panels 2 mm, masonry 10 mm.
_FIGURES = {
    Material.CONCRETE: (5.24, 0.0462, 0.7822, 0.020),
    Material.GLASS: (6.31, 0.0036, 1.3394, 0.002),
    Material.BRICK: (3.91, 0.0238, 0.16, 0.010),
    Material.METAL: (1.0, 1.0e7, 0.0, 0.002),
}


def material_table() -> Records:
    """Records MATERIAL in the order of :class:`Material`."""
    return np.array([_FIGURES[m] for m in Material], dtype=MATERIAL)


def permittivities(materials: Records, frequency_hz: float) -> NDArray[np.complex128]:
    """Complex relative permittivity of each material at a frequency (ITU-R P.2040-3, eq 9 and 29).  (M,)."""
    conductivity = materials["conductivity"] * (1e-9 * frequency_hz) ** materials["exponent"]
    return np.array(
        [permittivity(r, c, frequency_hz) for r, c in zip(materials["relative"], conductivity, strict=True)]
    )


def clad(building: NDArray[np.int64], shares: Sequence[float], rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw the material of each building, and give it to its triangles.

    building (T,), -1 for none, which is concrete; shares of the materials in the order of :class:`Material`, one draw
    for each building.  -> (T,) values of Material.
    """
    count = int(building.max(initial=-1)) + 1
    drawn = np.searchsorted(np.cumsum(shares)[:-1] / np.sum(shares), rng.random(count), side="right")
    return np.append(drawn, int(Material.CONCRETE))[building]
