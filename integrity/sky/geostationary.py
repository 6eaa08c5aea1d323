"""Directions of geostationary satellites, which bring the messages of SBAS."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lanebound.integrity.core.frames import ecef_from_geodetic, enu_from_ecef
from lanebound.integrity.sky.constellation import GEOSYNCHRONOUS_M
from lanebound.integrity.sky.view import SkyView

__all__ = ["geostationary_view"]


@lru_cache(maxsize=64)
def geostationary_view(longitude_deg: tuple[float, ...], place_rad: tuple[float, float, float], batch: int) -> SkyView:
    """Directions of G geostationary satellites over the equator from a place (latitude, longitude, height).

    One row, which B vehicles share; system and prn are -1, as no range is measured.
    """
    longitude = np.deg2rad(np.asarray(longitude_deg, dtype=np.float64))
    ecef = GEOSYNCHRONOUS_M * np.stack([np.cos(longitude), np.sin(longitude), np.zeros_like(longitude)], -1)
    latitude, east, height = (np.full(1, value) for value in place_rad)
    offset = enu_from_ecef(ecef - ecef_from_geodetic(latitude, east, height), latitude, east)
    distance = np.linalg.norm(offset, axis=-1)
    los = (offset / distance[:, None])[None]
    elevation = np.arcsin(los[..., 2])
    none = np.full(len(longitude_deg), -1, np.int64)
    return SkyView(
        los_enu=los,
        elevation_rad=elevation,
        azimuth_rad=np.remainder(np.arctan2(los[..., 0], los[..., 1]), 2.0 * np.pi),
        range_m=distance[None],
        range_rate_mps=np.zeros_like(elevation),
        above=elevation > 0.0,
        system=none,
        prn=none,
        index=np.zeros(batch, np.int64),
    )
