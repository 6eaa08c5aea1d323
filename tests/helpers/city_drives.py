"""Drives through a city made up as the smartLoc data set has them, with walls where a test wants some."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.recorded.smartloc import GroundTruth, Odometry, Pseudoranges, SmartLoc
from lanebound.integrity.sky.orbit import ranges_and_sights

__all__ = ["ELEVATION_DEG", "SIGMA_M", "SPEED_MPS", "as_files", "heading_at", "simulated", "walled"]

LAT, LON = np.radians(52.5), np.radians(13.4)
SIGMA_M = 3.0
SPEED_MPS = 8.0
ELEVATION_DEG = 20.0 + 6.0 * np.arange(10)  # of satellites 1 to 10, whose azimuths are 36 degrees apart


def heading_at(time_s: np.ndarray) -> np.ndarray:
    """Direction of travel from North [rad]."""
    return np.asarray(0.6 + 0.05 * time_s)


def simulated(
    seconds: float = 24.0, late: tuple[int, ...] = (), late_m: float = 0.0, seed: int = 1, axle_m: float = 0.0
) -> SmartLoc:
    """A drive at 5 Hz with ten satellites in two systems, a drifting clock and, for some satellites, late signals.

    The antenna is ``axle_m`` ahead of the rear axle.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.2)
    origin, axes = ecef_from_geodetic(LAT, LON, 80.0), ecef_from_enu_matrix(LAT, LON)
    heading = heading_at(t)
    path = np.zeros((t.size, 3))
    path[1:, 0] = np.cumsum(SPEED_MPS * 0.2 * np.sin(0.5 * (heading[1:] + heading[:-1])))
    path[1:, 1] = np.cumsum(SPEED_MPS * 0.2 * np.cos(0.5 * (heading[1:] + heading[:-1])))
    path += axle_m * np.stack([np.sin(heading), np.cos(heading), 0.0 * heading], -1)
    place = origin + path @ axes.T
    azimuth, elevation = np.arange(10) * 2.0 * np.pi / 10.0, np.radians(ELEVATION_DEG)
    up = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    satellite = origin + 2.2e7 * up @ axes.T
    k, s = (v.ravel() for v in np.meshgrid(np.arange(t.size), np.arange(10), indexing="ij"))
    distance, _ = ranges_and_sights(satellite[s], place[k])
    system = np.where(s < 6, "G", "R")
    clock = 1000.0 - 40.0 * t[k] + np.where(s < 6, 0.0, 25.0)
    noise = rng.normal(0.0, SIGMA_M, k.size) + np.where(np.isin(s, late), late_m, 0.0)
    ranges = Pseudoranges(
        t[k], distance + clock + noise, np.full(k.size, SIGMA_M**2), satellite[s], s + 1, system, elevation[s],
        np.full(k.size, 45.0),
    )  # fmt: skip
    odometry = Odometry(
        t, np.full(t.size, SPEED_MPS), np.full(t.size, -0.05), np.full(t.size, 0.01), np.full(t.size, 1e-6)
    )
    return SmartLoc(ranges, odometry, GroundTruth(t, place), None)


def walled(
    drive: SmartLoc, from_s: float, until_s: float, blocked_deg: float = 60.0, late_deg: float = 40.0
) -> SmartLoc:
    """The drive with a wall on its left, behind which lower satellites are lost, and late signals from its right."""
    r = drive.ranges
    side = np.sin(np.radians(36.0 * (r.satellite - 1)) - heading_at(r.time_s))  # positive to the right
    beside, elevation = (r.time_s >= from_s) & (r.time_s < until_s), np.degrees(r.elevation_rad)
    late = beside & (side > 0.0) & (elevation < late_deg)
    lost = beside & (side < 0.0) & (elevation < blocked_deg)
    r = replace(r, range_m=r.range_m + 40.0 * late, cn0_dbhz=np.where(late, 30.0, r.cn0_dbhz))
    return replace(drive, ranges=Pseudoranges(*(getattr(r, f.name)[~lost] for f in fields(r))))


def as_files(drive: SmartLoc, folder: Path) -> None:
    """The drive in the form of the data set."""
    r, o, truth = drive.ranges, drive.odometry, drive.truth
    assert truth is not None
    lines = [
        f"pseudorange3 {t} {p:.4f} {v} {x:.4f} {y:.4f} {z:.4f} {s} {1 if letter == 'G' else 4} {np.degrees(e)} {c}"
        for t, p, v, (x, y, z), s, letter, e, c in zip(
            r.time_s,
            r.range_m,
            r.variance_m2,
            r.satellite_ecef_m,
            r.satellite,
            r.system,
            r.elevation_rad,
            r.cn0_dbhz,
            strict=True,
        )
    ]
    lines += [
        f"odom3 {t} {v} 0 0 0 0 {w} 0.0025 0.0009 0.0009 4e-06 4e-06 4e-06"
        for t, v, w in zip(o.time_s, o.speed_mps, o.yaw_rate_left_radps, strict=True)
    ]
    (folder / "Town_Input.txt").write_text("\n".join(lines) + "\n")
    points = [
        f"point3 {t} {x:.4f} {y:.4f} {z:.4f}" for t, (x, y, z) in zip(truth.time_s, truth.position_ecef_m, strict=True)
    ]
    (folder / "Town_GT.txt").write_text("\n".join(points) + "\n")
