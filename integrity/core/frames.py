"""Transformations between frames: geodetic, ECEF, local ENU and the track frame of a vehicle."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "GRAVITY_MPS2",
    "WGS84_A_M",
    "WGS84_E2",
    "ecef_from_enu_matrix",
    "ecef_from_geodetic",
    "enu_from_ecef",
    "geodetic_from_ecef",
    "rotate_covariance",
    "track_from_enu_matrix",
    "wrap_angle",
]

Array = NDArray[np.float64]
Angle = TypeVar("Angle", float, NDArray[np.float64])

GRAVITY_MPS2 = 9.80665  # ISO 80000-3, standard gravity
WGS84_A_M = 6378137.0  # NIMA TR8350.2, table 3.1
WGS84_F = 1.0 / 298.257223563  # NIMA TR8350.2, table 3.1
WGS84_E2 = WGS84_F * (2.0 - WGS84_F)


def wrap_angle(angle_rad: Angle) -> Angle:
    """An angle, or angles (...,), in [-pi, pi); rounding can give pi."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def track_from_enu_matrix(heading_rad: ArrayLike) -> Array:
    """Matrix R of S1 eq 16: ``[AT, CT] = R [E, N]``.  heading_rad (...,) clockwise from North -> (..., 2, 2).

    R is a reflection: symmetric, determinant -1 and its own inverse.
    """
    t = np.asarray(heading_rad, dtype=np.float64)
    s, c = np.sin(t), np.cos(t)
    return np.stack([np.stack([s, c], -1), np.stack([c, -s], -1)], -2)


def rotate_covariance(cov_en_m2: Array, heading_rad: ArrayLike) -> Array:
    """Rotate a covariance: ``Q_track = R Q_EN R'`` (S1 eq 16).  cov_en_m2 (..., 2, 2) -> (..., 2, 2) [m^2]."""
    r = track_from_enu_matrix(heading_rad)
    return np.asarray(r @ cov_en_m2 @ np.swapaxes(r, -1, -2))


def ecef_from_geodetic(lat_rad: ArrayLike, lon_rad: ArrayLike, height_m: ArrayLike) -> Array:
    """Convert WGS-84 latitude, longitude [rad] and ellipsoidal height [m] to ECEF.  (...,) each -> (..., 3) [m]."""
    lat, lon, h = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (lat_rad, lon_rad, height_m)))
    n = WGS84_A_M / np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2)
    x = (n + h) * np.cos(lat) * np.cos(lon)
    y = (n + h) * np.cos(lat) * np.sin(lon)
    return np.stack([x, y, (n * (1.0 - WGS84_E2) + h) * np.sin(lat)], -1)


def geodetic_from_ecef(position_ecef_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Convert ECEF (..., 3) [m] to WGS-84 latitude, longitude [rad] and height [m] by Bowring's iteration."""
    p = np.asarray(position_ecef_m, dtype=np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    r = np.hypot(x, y)
    b = WGS84_A_M * (1.0 - WGS84_F)
    beta = np.arctan2(z, r * (1.0 - WGS84_F))
    ep2 = WGS84_E2 / (1.0 - WGS84_E2)
    for _ in range(4):
        lat = np.arctan2(z + ep2 * b * np.sin(beta) ** 3, r - WGS84_E2 * WGS84_A_M * np.cos(beta) ** 3)
        beta = np.arctan2((1.0 - WGS84_F) * np.sin(lat), np.cos(lat))
    n = WGS84_A_M / np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2)
    height = r * np.cos(lat) + z * np.sin(lat) - WGS84_A_M**2 / n
    return lat, np.arctan2(y, x), height


def ecef_from_enu_matrix(lat_rad: ArrayLike, lon_rad: ArrayLike) -> Array:
    """Matrix whose columns are the East, North and Up unit vectors in ECEF.  (...,) [rad] -> (..., 3, 3)."""
    lat, lon = np.broadcast_arrays(np.asarray(lat_rad, dtype=np.float64), np.asarray(lon_rad, dtype=np.float64))
    sp, cp, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack([-sl, cl, np.zeros_like(sl)], -1)
    north = np.stack([-sp * cl, -sp * sl, cp], -1)
    up = np.stack([cp * cl, cp * sl, sp], -1)
    return np.stack([east, north, up], -1)


def enu_axes(origin_ecef_m: ArrayLike) -> Array:
    """Matrix :func:`ecef_from_enu_matrix` of the local frame at a point.  (..., 3) [m] -> (..., 3, 3)."""
    return ecef_from_enu_matrix(*geodetic_from_ecef(origin_ecef_m)[:2])


def enu_from_ecef(vector_ecef: ArrayLike, lat_rad: ArrayLike, lon_rad: ArrayLike) -> Array:
    """Rotate an ECEF vector into ENU at (lat, lon).  (..., 3) -> (..., 3)."""
    m = ecef_from_enu_matrix(lat_rad, lon_rad)
    return np.asarray(np.einsum("...ij,...i->...j", m, np.asarray(vector_ecef, dtype=np.float64)))
