"""Nominal constellations of the five systems, and the view of their satellites from a place on the Earth.

Nominal orbits reproduce number, geometry and motion of the satellites in view. They do not give the position of a named
satellite at a date: the almanac reader (:mod:`lanebound.integrity.sky.almanac`) does.

Geostationary satellites bring the messages of SBAS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range
from lanebound.integrity.core.frames import ecef_from_geodetic, enu_from_ecef
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, MU_M3PS2, OrbitElements, nodal_regression_radps, propagate
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.view import SkyView

__all__ = [
    "SECONDS_PER_WEEK",
    "SatelliteTable",
    "SkyConfig",
    "geostationary_view",
    "gps_seconds_of",
    "nominal_satellites",
]


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


Array = NDArray[np.float64]

SECONDS_PER_WEEK = 604_800.0

# GPS SPS Performance Standard, 5th ed. (2020), table 3.2-1 (24 slots), in degrees at 1993-07-01 00:00, Greenwich hour
# angle 18 h 36 min 14.4 s: right ascension of the plane, then arguments of latitude.
GPS_PLANES_DEG = {
    "A": (272.847, (268.126, 161.786, 11.676, 41.806)),
    "B": (332.847, (80.956, 173.336, 309.976, 204.376)),
    "C": (32.847, (111.876, 11.796, 339.666, 241.556)),
    "D": (92.847, (135.226, 265.446, 35.156, 167.356)),
    "E": (152.847, (197.046, 302.596, 66.066, 333.686)),
    "F": (212.847, (238.886, 345.226, 105.206, 135.346)),
}
GPS_HOUR_ANGLE_DEG = 15.0 * (18.0 + 36.0 / 60.0 + 14.4 / 3600.0)
# Table 3.2-2, expandable slots: (plane, replaced slot) -> fore and aft arguments of latitude.
GPS_EXPANDED_DEG = {("B", 0): (94.916, 66.356), ("D", 1): (282.676, 257.976), ("F", 1): (0.456, 334.016)}
GPS_SPARES_DEG = (("A", 330.0), ("C", 290.0), ("D", 80.0), ("E", 130.0))  # in wide gaps of the planes; our choice
GPS_SEMI_MAJOR_M = 26_559_700.0  # the same table

GALILEO_ANCHOR_DEG = (
    317.632 - 60.426,
    225.153,
)  # slot A01 at 2016-11-21 00:00 (GSC reference constellation), less GMST
QZSS_CENTRE_DEG, QZSS_GEO_DEG = 135.0, 127.0  # IS-QZSS-PNT-005 3.1.1: centre of the ground track, GEO longitude
GEOSYNCHRONOUS_M = (MU_M3PS2 / EARTH_RATE_RADPS**2) ** (1.0 / 3.0)


def gps_seconds_of(day: date) -> float:
    """GPS time at the start of a calendar day [s since 1980-01-06], leap seconds ignored."""
    return (day - date(1980, 1, 6)).days * 86_400.0


def _circular(
    semi_major_m: float, inclination_deg: float, node_deg: ArrayLike, latitude_deg: ArrayLike, day: date
) -> OrbitElements:
    """Circular orbits at given node longitudes and arguments of latitude (S,), with the drift of the node by J2."""
    inclination = np.deg2rad(inclination_deg)
    return OrbitElements.build(
        np.size(latitude_deg),
        semi_major_m=semi_major_m,
        eccentricity=0.0,
        inclination_rad=inclination,
        node_longitude_rad=np.deg2rad(node_deg),
        node_rate_radps=nodal_regression_radps(semi_major_m, 0.0, inclination),
        perigee_rad=0.0,
        mean_anomaly_rad=np.deg2rad(latitude_deg),
        epoch_s=gps_seconds_of(day),
    )


def _walker_24_3_1(semi_major_m: float, inclination_deg: float, anchor_deg: tuple[float, float]) -> OrbitElements:
    """Walker delta pattern 24/3/1: planes 120 deg apart, 45 deg within a plane, 15 deg from plane to plane."""
    plane, slot = np.divmod(np.arange(24), 8)
    node, latitude = anchor_deg[0] + 120.0 * plane, anchor_deg[1] + 45.0 * slot + 15.0 * plane
    return _circular(semi_major_m, inclination_deg, node, latitude, date(2016, 11, 21))


def _gps(count: int) -> OrbitElements:
    slots = [
        (plane, u)
        for plane, (_, latitudes) in GPS_PLANES_DEG.items()
        for k, nominal in enumerate(latitudes)
        for u in (GPS_EXPANDED_DEG.get((plane, k), (nominal,)) if count > 24 else (nominal,))
    ]
    slots += GPS_SPARES_DEG if count == 31 else ()
    node = np.array([GPS_PLANES_DEG[plane][0] for plane, _ in slots]) - GPS_HOUR_ANGLE_DEG
    return _circular(GPS_SEMI_MAJOR_M, 55.0, node, [u for _, u in slots], date(1993, 7, 1))


def _qzss(count: int) -> OrbitElements:
    """Three inclined orbits (e 0.075, i 41 deg, perigee 270 deg, nodes 120 deg apart) and one geostationary satellite.

    The mean anomaly follows from the ground track's centre: ``M = centre - perigee - node``.
    """
    node = np.array([0.0, 120.0, 240.0, 0.0])
    perigee = np.array([270.0, 270.0, 270.0, 0.0])
    centre = np.array([QZSS_CENTRE_DEG] * 3 + [QZSS_GEO_DEG])
    return OrbitElements.build(
        count,
        semi_major_m=GEOSYNCHRONOUS_M,
        eccentricity=[0.075, 0.075, 0.075, 0.0],
        inclination_rad=np.deg2rad([41.0, 41.0, 41.0, 0.0]),
        node_longitude_rad=np.deg2rad(node),
        node_rate_radps=0.0,  # station keeping maintains the ground track
        perigee_rad=np.deg2rad(perigee),
        mean_anomaly_rad=np.deg2rad(centre - perigee - node),
        epoch_s=gps_seconds_of(date(2018, 11, 1)),
    )


_NOMINAL: dict[System, tuple[tuple[int, ...], Callable[[int], OrbitElements]]] = {
    System.GPS: ((24, 27, 31), _gps),
    # Galileo OS SDD 1.3, 3.1: Walker 24/3/1, 29 599.8 km, 56 deg
    System.GALILEO: ((24,), lambda _: _walker_24_3_1(29_599_800.0, 56.0, GALILEO_ANCHOR_DEG)),
    # GLONASS ICD L1, L2 ed. 5.1, 3.3: Walker 24/3/1, 25 510 km, 64.8 deg; the phase is our choice
    System.GLONASS: ((24,), lambda _: _walker_24_3_1(25_510_000.0, 64.8, (0.0, 0.0))),
    # BDS-SIS-ICD-B1C-1.0, 3.1: 24 MEO, Walker 24/3/1, 27 906 km, 55 deg; the phase is our choice
    System.BEIDOU: ((24,), lambda _: _walker_24_3_1(27_906_000.0, 55.0, (20.0, 5.0))),
    System.QZSS: ((4,), _qzss),
}
_QZSS_PRN = (193, 194, 195, 199)  # IS-QZSS-PNT-005 table 3.2.2-1


@dataclass(frozen=True)
class SatelliteTable:
    """Identities and orbits of S satellites.

    Attributes
    ----------
    system, prn : (S,)
    elements : orbital elements of the S satellites
    stopped : the place where a truncated file ended, empty for a complete file
    """

    system: NDArray[np.int64]
    prn: NDArray[np.int64]
    elements: OrbitElements
    stopped: str = ""

    def __len__(self) -> int:
        return len(self.elements)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> SatelliteTable:
        """The satellites that a mask or an index array selects."""
        return SatelliteTable(self.system[rows], self.prn[rows], self.elements.take(rows), self.stopped)

    @staticmethod
    def join(tables: list[SatelliteTable]) -> SatelliteTable:
        """Concatenate the satellites of several tables."""
        return SatelliteTable(
            np.concatenate([t.system for t in tables]),
            np.concatenate([t.prn for t in tables]),
            OrbitElements.join([t.elements for t in tables]),
            "; ".join(t.stopped for t in tables if t.stopped),
        )

    def relative_enu(
        self, gps_time_s: ArrayLike, lat_rad: ArrayLike, lon_rad: ArrayLike, height_m: ArrayLike
    ) -> tuple[Array, Array]:
        """Compute the vectors from a place (scalars, or one place for each epoch) to the satellites, and their rates.

        gps_time_s (K,) -> (K, S, 3) [m], (K, S, 3) [m/s], both ENU. Geometric: no light time and no refraction.
        """
        t = np.atleast_1d(require_finite("gps_time_s", gps_time_s))
        lat, lon, height = (
            np.broadcast_to(require_finite(name, v), t.shape)
            for name, v in (("lat_rad", lat_rad), ("lon_rad", lon_rad), ("height_m", height_m))
        )
        position, velocity = propagate(self.elements, t)
        offset = position - ecef_from_geodetic(lat, lon, height)[:, None]
        return enu_from_ecef(offset, lat[:, None], lon[:, None]), enu_from_ecef(velocity, lat[:, None], lon[:, None])

    def view(
        self,
        gps_time_s: ArrayLike,
        lat_rad: ArrayLike,
        lon_rad: ArrayLike,
        height_m: ArrayLike = 0.0,
        mask_rad: float = 0.0,
        index: ArrayLike | None = None,
    ) -> SkyView:
        """Compute the view at epochs ``gps_time_s`` (K,) from one place, or from one place for each epoch.

        ``index`` (B,) is the row that each vehicle uses; by default there is one vehicle for each row.

        Raises
        ------
        InputError
            An entry is not finite, a latitude or mask angle is outside [-pi/2, pi/2], or a row does not exist.
        """
        require_in_range("lat_rad", lat_rad, -0.5 * np.pi, 0.5 * np.pi)
        require_in_range("mask_rad", mask_rad, -0.5 * np.pi, 0.5 * np.pi)
        offset, rate = self.relative_enu(gps_time_s, lat_rad, lon_rad, height_m)
        rows = offset.shape[0]
        which = np.arange(rows) if index is None else np.atleast_1d(np.asarray(index, dtype=np.int64))
        if which.size and not (which.min() >= 0 and which.max() < rows):
            raise InputError(f"index must lie in [0, {rows - 1}], got {which.min()}..{which.max()}: use existing rows")
        distance = np.linalg.norm(offset, axis=-1)
        los = offset / distance[..., None]
        elevation = np.arcsin(np.clip(los[..., 2], -1.0, 1.0))
        return SkyView(
            los_enu=los,
            elevation_rad=elevation,
            azimuth_rad=np.remainder(np.arctan2(los[..., 0], los[..., 1]), 2.0 * np.pi),
            range_m=distance,
            range_rate_mps=np.sum(los * rate, -1),
            above=elevation > mask_rad,
            system=self.system,
            prn=self.prn,
            index=which.astype(np.int64),
        )

    def rising(
        self, gps_time_s: ArrayLike, lat_rad: float, lon_rad: float, height_m: float = 0.0, mask_rad: float = 0.0
    ) -> SatelliteTable:
        """Select the satellites that are above the mask angle at one or more of the epochs."""
        above = self.view(gps_time_s, lat_rad, lon_rad, height_m, mask_rad).above
        return self.take(np.flatnonzero(above.any(0)))


def nominal_satellites(counts: dict[System, int]) -> SatelliteTable:
    """Build nominal constellations: GPS 24, 27 or 31, Galileo 24, GLONASS 24, BeiDou MEO 24, QZSS 4; 0 for none.

    Raises
    ------
    InputError
        No nominal constellation has the given count, or there is no satellite at all.
    """
    tables = []
    for system in System:
        count = counts.get(system, 0)
        allowed, make = _NOMINAL[system]
        if count not in (0, *allowed):
            raise InputError(f"satellites of {system.name} must be 0 or one of {allowed}, got {count}: choose one")
        if count:
            prn = np.array(_QZSS_PRN) if system is System.QZSS else np.arange(1, count + 1)
            tables.append(SatelliteTable(np.full(count, int(system)), prn.astype(np.int64), make(count)))
    if not tables:
        raise InputError("counts must name at least one satellite, got none: add a system")
    return SatelliteTable.join(tables)


class SkyConfig(Config):
    """Numbers of satellites, place of the street and start time of the scene."""

    gps: Literal[0, 24, 27, 31] = Field(31, description="GPS satellites [-]; SPS Performance Standard 2020 slots")
    galileo: Literal[0, 24] = Field(24, description="Galileo satellites [-]; Walker 24/3/1, OS SDD 1.3")
    glonass: Literal[0, 24] = Field(24, description="GLONASS satellites [-]; Walker 24/3/1, ICD 5.1")
    beidou: Literal[0, 24] = Field(24, description="BeiDou MEO satellites [-]; Walker 24/3/1, BDS-SIS-ICD-B1C-1.0")
    qzss: Literal[0, 4] = Field(4, description="QZSS satellites [-]; three inclined and one geostationary")
    lat_deg: float = Field(35.666, ge=-90, le=90, description="latitude of the street's origin; Tokyo (S1 section 4)")
    lon_deg: float = Field(139.792, ge=-180, le=360, description="longitude of the street's origin; Tokyo")
    height_m: float = Field(40.0, ge=-500, le=9000, description="ellipsoidal height of the street's origin")
    gps_week: int = Field(1900, ge=0, description="GPS week of the start, counted without rollover [-]; June 2016")
    week_second_s: float = Field(180_000.0, ge=0, lt=SECONDS_PER_WEEK, description="second of that week at the start")
    mask_deg: float = Field(10.0, ge=0, lt=90, description="elevation mask; customary for kinematic RTK")

    @property
    def start_gps_s(self) -> float:
        """GPS time of the start [s since 1980-01-06]."""
        return self.gps_week * SECONDS_PER_WEEK + self.week_second_s

    @property
    def place_rad(self) -> tuple[float, float, float]:
        """Latitude [rad], longitude [rad] and height [m] of the street's origin."""
        return float(np.deg2rad(self.lat_deg)), float(np.deg2rad(self.lon_deg)), self.height_m

    @property
    def mask_rad(self) -> float:
        """Elevation mask [rad]."""
        return float(np.deg2rad(self.mask_deg))

    def satellites(self) -> SatelliteTable:
        """Build the nominal satellites.

        Raises
        ------
        InputError
            All counts are 0.
        """
        return nominal_satellites({system: int(getattr(self, system.name.lower())) for system in System})
