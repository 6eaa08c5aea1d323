"""Position and velocity of satellites on Keplerian orbits in the Earth-fixed frame, for any number of epochs."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.core.frames import WGS84_A_M, wrap_angle
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

__all__ = [
    "EARTH_RATE_RADPS", "MU_M3PS2", "OrbitElements", "nodal_regression_radps", "propagate", "ranges_and_sights",
    "rotated_with_earth", "solve_kepler",
]  # fmt: skip

Array = NDArray[np.float64]

MU_M3PS2 = 3.986005e14  # IS-GPS-200N table 20-IV; other systems differ by less than 2e-7 of it
EARTH_RATE_RADPS = 7.2921151467e-5  # IS-GPS-200N table 20-IV
J2 = 1.08262982e-3  # WGS 84 (EGM96), NIMA TR8350.2


@dataclass(frozen=True)
class OrbitElements:
    """Keplerian elements of S satellites, each array (S,).

    Attributes
    ----------
    semi_major_m, eccentricity, inclination_rad
    node_longitude_rad : Earth-fixed longitude of the ascending node at ``epoch_s``
    node_rate_radps : drift of the node in inertial space
    perigee_rad : argument of perigee
    mean_anomaly_rad : at ``epoch_s``
    epoch_s : GPS time of the elements [s since 1980-01-06]
    """

    semi_major_m: Array
    eccentricity: Array
    inclination_rad: Array
    node_longitude_rad: Array
    node_rate_radps: Array
    perigee_rad: Array
    mean_anomaly_rad: Array
    epoch_s: Array

    def __len__(self) -> int:
        return int(self.semi_major_m.shape[0])

    @property
    def mean_motion_radps(self) -> Array:
        """``n = sqrt(mu / a^3)``  (S,)."""
        return np.asarray(np.sqrt(MU_M3PS2 / self.semi_major_m**3))

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> OrbitElements:
        """Elements of the satellites that a mask or an index array selects."""
        return OrbitElements(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @staticmethod
    def build(count: int, **columns: ArrayLike) -> OrbitElements:
        """Elements of ``count`` satellites from columns that are scalars or (S,)."""
        wide = {k: np.broadcast_to(np.asarray(v, dtype=np.float64), (count,)).copy() for k, v in columns.items()}
        return OrbitElements(**wide)

    @staticmethod
    def join(parts: list[OrbitElements]) -> OrbitElements:
        """Concatenate the satellites of several sets."""
        return OrbitElements(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(OrbitElements)}
        )


def nodal_regression_radps(semi_major_m: ArrayLike, eccentricity: ArrayLike, inclination_rad: ArrayLike) -> Array:
    """Secular drift of the node: ``-3/2 n J2 (R / p)^2 cos i``  (Vallado, Astrodynamics, eq 9-37).  (...,) each."""
    a, e = np.asarray(semi_major_m, dtype=np.float64), np.asarray(eccentricity, dtype=np.float64)
    p = a * (1.0 - e**2)
    n = np.sqrt(MU_M3PS2 / a**3)
    return np.asarray(-1.5 * n * J2 * (WGS84_A_M / p) ** 2 * np.cos(inclination_rad))


def solve_kepler(mean_anomaly_rad: ArrayLike, eccentricity: ArrayLike) -> Array:
    """Solve ``E - e sin E = M`` for the eccentric anomaly E by Halley's iteration; E - M lies in [-e, e].

    mean_anomaly_rad (...,), eccentricity (...,) in [0, 1) -> (...,) [rad].

    Raises
    ------
    InputError
        An eccentricity is outside [0, 1) or is not finite.
    """
    e = require_in_range("eccentricity", eccentricity, 0.0, 1.0, high_open=True)
    whole = np.asarray(mean_anomaly_rad, dtype=np.float64)
    m = wrap_angle(whole)
    big = m + 0.85 * e * np.sign(np.sin(m))  # Danby's starter converges for every e < 1
    for _ in range(20):
        s, c = np.sin(big), np.cos(big)
        f, slope = big - e * s - m, 1.0 - e * c
        step = f / (slope - 0.5 * f * e * s / slope)
        big = np.clip(big - step, m - e, m + e)
        if np.abs(step).max(initial=0.0) < 1e-15:
            break
    return np.asarray(whole + (big - m))


def rotated_with_earth(vector_ecef: ArrayLike, angle_rad: ArrayLike) -> Array:
    """Express an Earth-fixed vector in the Earth-fixed frame of a later time: ``R3(angle) v``.

    vector_ecef (..., 3), angle_rad (...,) rotation of the Earth in between -> (..., 3). With the angle ``omega tau``,
    tau the travel time of a signal, this is the Sagnac correction (IS-GPS-200N 20.3.3.4.3.3).
    """
    v, angle = np.asarray(vector_ecef, dtype=np.float64), np.asarray(angle_rad, dtype=np.float64)
    s, c = np.sin(angle), np.cos(angle)
    return np.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], -1)


def propagate(elements: OrbitElements, gps_time_s: ArrayLike) -> tuple[Array, Array]:
    """Compute Earth-fixed position and velocity from Kepler's laws with a drifting node (IS-GPS-200N table 20-IV).

    gps_time_s (T,) [s since 1980-01-06] -> position (T, S, 3) [m], velocity (T, S, 3) [m/s], both ECEF.
    """
    el = elements
    dt = np.atleast_1d(np.asarray(gps_time_s, dtype=np.float64))[:, None] - el.epoch_s
    n, e, a = el.mean_motion_radps, el.eccentricity, el.semi_major_m
    big = solve_kepler(el.mean_anomaly_rad + n * dt, e)
    s, c, root = np.sin(big), np.cos(big), np.sqrt(1.0 - e**2)
    x, y = a * (c - e), a * root * s
    rate = n / (1.0 - e * c)
    vx, vy = -a * s * rate, a * root * c * rate
    sw, cw = np.sin(el.perigee_rad), np.cos(el.perigee_rad)
    p, q, vp, vq = x * cw - y * sw, x * sw + y * cw, vx * cw - vy * sw, vx * sw + vy * cw
    turn = el.node_rate_radps - EARTH_RATE_RADPS
    node = el.node_longitude_rad + turn * dt
    sn, cn, si, ci = np.sin(node), np.cos(node), np.sin(el.inclination_rad), np.cos(el.inclination_rad)
    position = np.stack([p * cn - q * ci * sn, p * sn + q * ci * cn, q * si], -1)
    velocity = np.stack([vp * cn - vq * ci * sn, vp * sn + vq * ci * cn, vq * si], -1)
    velocity[..., 0] -= turn * position[..., 1]
    velocity[..., 1] += turn * position[..., 0]
    return position, velocity


def ranges_and_sights(satellite_ecef_m: Array, receiver_ecef_m: Array) -> tuple[Array, Array]:
    """Compute range (...,) [m] and unit vector to the satellite (..., 3) in the Earth-fixed frame at reception.

    satellite_ecef_m (..., 3) in the Earth-fixed frame at transmission, receiver_ecef_m (..., 3). The satellite position
    is rotated by ``omega tau`` about the axis of the Earth, tau the travel time (IS-GPS-200 20.3.3.4.3.3).
    """
    distance = np.linalg.norm(satellite_ecef_m - receiver_ecef_m, axis=-1)
    for _ in range(2):  # the first correction of tau moves the satellite by 1e-4 m; the second is a reserve
        angle = EARTH_RATE_RADPS * distance / SPEED_OF_LIGHT_MPS
        offset = rotated_with_earth(satellite_ecef_m, angle) - receiver_ecef_m
        distance = np.linalg.norm(offset, axis=-1)
    return distance, offset / distance[..., None]
