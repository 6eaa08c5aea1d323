"""What a street map holds, in metres about its middle: East, North [m], heights above the street [m]."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef

__all__ = ["BridgeAxis", "MapFrame", "Restriction", "Solid", "StreetMap", "StreetWay", "Tree"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MapFrame:
    """The local plane East, North at a place; the ground is taken for flat.

    Attributes
    ----------
    lat_deg, lon_deg : the place
    """

    lat_deg: float
    lon_deg: float

    def en_of(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Array:
        """East, North of places on the ellipsoid.  (...,) [deg] each -> (..., 2) [m]."""
        lat, lon = np.deg2rad(self.lat_deg), np.deg2rad(self.lon_deg)
        away = ecef_from_geodetic(np.deg2rad(lat_deg), np.deg2rad(lon_deg), 0.0) - ecef_from_geodetic(lat, lon, 0.0)
        return np.ascontiguousarray(enu_from_ecef(away, lat, lon)[..., :2])

    def lat_lon_of(self, en_m: ArrayLike) -> Array:
        """Latitudes and longitudes of places in the plane.  (..., 2) [m] -> (..., 2) [deg]."""
        lat, lon = np.deg2rad(self.lat_deg), np.deg2rad(self.lon_deg)
        en = np.asarray(en_m, dtype=np.float64)
        enu = np.concatenate([en, np.zeros((*en.shape[:-1], 1))], -1)
        place = geodetic_from_ecef(ecef_from_geodetic(lat, lon, 0.0) + enu @ ecef_from_enu_matrix(lat, lon).T)
        return np.rad2deg(np.stack(place[:2], -1))


@dataclass(frozen=True)
class StreetWay:
    """A street, or a part of one, between any two of its points.

    Attributes
    ----------
    number : its number in the map
    nodes : (n,) numbers of its points: streets with a common point meet there
    points_en_m : (n, 2)
    kind : class of ``highway``
    lanes, lanes_back : lanes along its points and against them, 0 for none
    lane_width_m : of each lane, None where the map says nothing
    speed_limit_mps : tagged, or that of its class
    level : 0 on the ground, above on bridges, below in tunnels
    bridge, covered : whether it is a bridge; whether it has a roof: a tunnel, a passage through a building
    """

    number: int
    nodes: tuple[int, ...]
    points_en_m: Array
    kind: str
    lanes: int
    lanes_back: int
    lane_width_m: float | None
    speed_limit_mps: float
    level: int = 0
    bridge: bool = False
    covered: bool = False


@dataclass(frozen=True)
class Restriction:
    """A turn that is forbidden, or the only one that is allowed, from one street to another at a point."""

    before: int
    node: int
    after: int
    only: bool


@dataclass(frozen=True)
class Solid:
    """A building or a part of one: a prism.

    Attributes
    ----------
    rings_en_m : its outline, counter-clockwise, and its holes, clockwise, (n, 2) each
    bottom_m, top_m : its lower and upper face
    building : number of the building; parts of one building have one number
    """

    rings_en_m: tuple[Array, ...]
    bottom_m: float
    top_m: float
    building: int


@dataclass(frozen=True)
class Tree:
    """A tree.

    Attributes
    ----------
    east_m, north_m : its trunk
    height_m, crown_m : its height, the width of its crown; None where the map says nothing
    """

    east_m: float
    north_m: float
    height_m: float | None = None
    crown_m: float | None = None


@dataclass(frozen=True)
class BridgeAxis:
    """A bridge of a street, a path or a railway: its axis (n, 2), its width, its level, the numbers of its points."""

    points_en_m: Array
    width_m: float
    level: int
    nodes: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class StreetMap:
    """A street map.

    Attributes
    ----------
    frame : where East, North are 0
    streets, restrictions, solids, trees, bridges : what it holds
    found : how many objects were read, by kind
    assumed : how many objects have a value that the map does not state, by what is assumed
    skipped : how many objects are left out, by reason
    """

    frame: MapFrame
    streets: tuple[StreetWay, ...] = ()
    restrictions: tuple[Restriction, ...] = ()
    solids: tuple[Solid, ...] = ()
    trees: tuple[Tree, ...] = ()
    bridges: tuple[BridgeAxis, ...] = ()
    found: Counter[str] = field(default_factory=Counter)
    assumed: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)

    @cached_property
    def boxes_en_m(self) -> Array:
        """Least East and North, largest East and North of each solid.  (S, 4)."""
        rings = (solid.rings_en_m[0] for solid in self.solids)
        return np.array([(*ring.min(0), *ring.max(0)) for ring in rings]).reshape(-1, 4)
