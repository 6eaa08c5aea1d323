"""Position, velocity and clock of satellites at any time, computed from their broadcast ephemerides.

Constants and steps differ slightly between the systems: IS-GPS-200N table 20-IV, Galileo OS SIS ICD 2.1 5.1,
BDS-SIS-ICD-2.1 5.2.4.12, IS-QZSS-PNT-005 5.5. All times are GPS time, seconds since 1980-01-06.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.sky.ephemeris import Ephemerides
from lanebound.integrity.sky.orbit import rotated_with_earth, solve_kepler
from lanebound.integrity.sky.rinex_navigation import parse_navigation, read_navigation
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System

__all__ = ["BroadcastStates", "Ephemerides", "parse_navigation", "positions", "read_navigation"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

# GPS, Galileo, GLONASS, BeiDou, QZSS; GLONASS does not transmit Keplerian elements
MU_M3PS2 = np.array([3.986005e14, 3.986004418e14, 3.986004418e14, 3.986004418e14, 3.986005e14])
EARTH_RATE_RADPS = np.array([7.2921151467e-5, 7.2921151467e-5, 7.292115e-5, 7.292115e-5, 7.2921151467e-5])
VALID_FOR_S = np.array([7200.0, 14_400.0, 900.0, 21_600.0, 7200.0])
"""Largest time between the reference time of a message and its use: half the fit interval, or the customary value."""
GEO_TILT_RAD = np.deg2rad(-5.0)  # BDS-SIS-ICD-2.1 table 5-11

FNAV = 2  # bit 1 of Galileo's source word


@dataclass(frozen=True)
class BroadcastStates:
    """States of S satellites at T epochs; satellite s is row s of ``Ephemerides.satellites``.

    Attributes
    ----------
    position_ecef_m, velocity_ecef_mps : (T, S, 3), in the Earth-fixed frame at the same time (no Sagnac rotation)
    clock_s : (T, S) offset of the satellite's clock, polynomial and eccentricity (relativity), without group delays
    clock_rate_sps : (T, S) rate of ``clock_s`` [s/s]
    group_delay_s : (T, S, 2) as in :class:`Ephemerides`
    usable : (T, S) whether a valid message exists for the time; where it is False all other values are 0
    satellite : (S, 2) system and prn
    message : (T, S) row of the message used, -1 for none
    """

    position_ecef_m: Array
    velocity_ecef_mps: Array
    clock_s: Array
    clock_rate_sps: Array
    group_delay_s: Array
    usable: Bools
    satellite: Ints
    message: Ints


def positions(
    ephemerides: Ephemerides, gps_time_s: ArrayLike, earlier_s: ArrayLike = 0.0, *, healthy_only: bool = True
) -> BroadcastStates:
    """Compute position, velocity and clock of every satellite at ``gps_time_s - earlier_s`` from the nearest message.

    Parameters
    ----------
    gps_time_s : (T,), or (T, S) for different times of the satellites [s since 1980-01-06].
    earlier_s : broadcast to (T, S) [s], for example the travel time of the signal. A separate argument, because GPS
        time as one float64 resolves only 2e-7 s, which is 1 mm of orbit.
    healthy_only : satellites with a health word that is not healthy are not usable.

    Galileo's I/NAV message is preferred to F/NAV.

    Raises
    ------
    InputError
        A time is not finite, or the shapes do not fit the number of satellites.
    """
    satellite = ephemerides.satellites
    time = require_finite("gps_time_s", gps_time_s)
    time = np.atleast_1d(time)[:, None] if time.ndim < 2 else time
    earlier = require_finite("earlier_s", earlier_s)
    try:
        shape = np.broadcast_shapes(time.shape, earlier.shape, (1, len(satellite)))
    except ValueError:
        shape = ()
    if len(shape) != 2 or shape[1] != len(satellite):
        raise InputError(
            f"gps_time_s and earlier_s must fit (T, {len(satellite)}), got {time.shape} and {earlier.shape}: "
            "one column for each satellite"
        )
    time, earlier = np.broadcast_to(time, shape), np.broadcast_to(earlier, shape)
    message = _nearest_messages(ephemerides, satellite, time - earlier, healthy_only)
    usable = message >= 0
    if not len(ephemerides):
        return _unusable_states(shape, satellite)
    return _states(ephemerides, satellite, message, usable, time, earlier)


def _unusable_states(shape: tuple[int, ...], satellite: Ints) -> BroadcastStates:
    """States of ``shape`` (T, S) that are all zero and not usable."""
    empty = np.zeros(shape)
    vectors = np.zeros((*shape, 3))
    return BroadcastStates(
        vectors, vectors, empty, empty, np.zeros((*shape, 2)), empty > 0, satellite, empty.astype(np.int64)
    )


def _nearest_messages(ephemerides: Ephemerides, satellite: Ints, time: Array, healthy_only: bool) -> Ints:
    """Row of each satellite's message with the nearest reference time, -1 where no message is valid.  (T, S)."""
    out = np.full(time.shape, -1, np.int64)
    for s, (system, prn) in enumerate(satellite):
        of = (ephemerides.system == system) & (ephemerides.prn == prn)
        rows = np.flatnonzero(of & ephemerides.healthy if healthy_only else of)
        if not rows.size:
            continue
        away = np.abs(time[:, s, None] - ephemerides.toe_s[rows])
        late = system == System.GALILEO and (ephemerides.source[rows] & FNAV) > 0
        best = np.argmin(away + 0.5 * np.asarray(late), -1)  # 0.5 s matters only between equal reference times
        near = np.take_along_axis(away, best[:, None], -1)[:, 0] <= VALID_FOR_S[system]
        out[:, s] = np.where(near, rows[best], -1)
    return out


def _states(
    table: Ephemerides, satellite: Ints, message: Ints, usable: Bools, time: Array, earlier: Array
) -> BroadcastStates:
    """States from the chosen messages; entries without a message are computed from message 0 and set to zero."""
    el = table.take(np.where(usable, message, 0).ravel())
    dt = np.where(usable, (time - el.toe_s.reshape(time.shape)) - earlier, 0.0).ravel()
    position, velocity, anomaly, anomaly_rate = _orbit(el, dt)
    since = np.where(usable, (time - el.toc_s.reshape(time.shape)) - earlier, 0.0).ravel()
    clock, rate = _clock(el, since, anomaly, anomaly_rate)
    keep = usable.ravel()

    def shaped(column: Array) -> Array:
        masked = np.where(keep.reshape(-1, *[1] * (column.ndim - 1)), column, 0.0)
        return masked.reshape(*time.shape, *column.shape[1:])

    return BroadcastStates(
        position_ecef_m=shaped(position),
        velocity_ecef_mps=shaped(velocity),
        clock_s=shaped(clock),
        clock_rate_sps=shaped(rate),
        group_delay_s=shaped(el.group_delay_s),
        usable=usable,
        satellite=satellite,
        message=message,
    )


def _clock(el: Ephemerides, since: Array, anomaly: Array, anomaly_rate: Array) -> tuple[Array, Array]:
    """Clock offset ``a0 + a1 t + a2 t^2 + F e sqrt(a) sin E``, ``F = -2 sqrt(mu)/c^2``, and its rate.  (N,) each."""
    a0, a1, a2 = el.clock.T
    f = -2.0 * np.sqrt(MU_M3PS2[el.system]) / SPEED_OF_LIGHT_MPS**2 * el.eccentricity * el.root_a
    offset = a0 + since * (a1 + since * a2) + f * np.sin(anomaly)
    return offset, a1 + 2.0 * a2 * since + f * np.cos(anomaly) * anomaly_rate


def _orbit(el: Ephemerides, dt: Array) -> tuple[Array, Array, Array, Array]:
    """Position and velocity (N, 3), eccentric anomaly and its rate (N,), ``dt`` [s] after the reference time."""
    a, e = el.root_a**2, el.eccentricity
    motion = np.sqrt(MU_M3PS2[el.system] / a**3) + el.motion_correction_radps
    anomaly = solve_kepler(el.mean_anomaly_rad + motion * dt, e)
    s, c, root = np.sin(anomaly), np.cos(anomaly), np.sqrt(1.0 - e * e)
    rate = motion / (1.0 - e * c)
    phi = np.arctan2(root * s, c - e) + el.perigee_rad
    turn = root * rate / (1.0 - e * c)
    s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)

    def corrected(sine: Array, cosine: Array) -> tuple[Array, Array]:
        return sine * s2 + cosine * c2, 2.0 * turn * (sine * c2 - cosine * s2)

    du, u_rate = corrected(el.cus_rad, el.cuc_rad)
    dr, r_rate = corrected(el.crs_m, el.crc_m)
    di, i_rate = corrected(el.cis_rad, el.cic_rad)
    u, u_rate = phi + du, turn + u_rate
    r, r_rate = a * (1.0 - e * c) + dr, a * e * s * rate + r_rate
    i, i_rate = el.inclination_rad + di + el.inclination_rate_radps * dt, el.inclination_rate_radps + i_rate
    su, cu = np.sin(u), np.cos(u)
    plane = (r * cu, r * su, r_rate * cu - r * su * u_rate, r_rate * su + r * cu * u_rate)
    position, velocity = _ecef_from_plane(el, dt, plane, i, i_rate)
    return position, velocity, anomaly, rate


def _ecef_from_plane(
    el: Ephemerides, dt: Array, plane: tuple[Array, Array, Array, Array], i: Array, i_rate: Array
) -> tuple[Array, Array]:
    """Rotate from the orbital plane to ECEF; BeiDou's geostationary satellites need a second rotation."""
    x, y, vx, vy = plane
    earth, geo = EARTH_RATE_RADPS[el.system], el.geostationary
    node_rate = el.node_rate_radps - np.where(geo, 0.0, earth)
    node = el.node_rad + node_rate * dt - earth * el.toe_of_week_s
    sn, cn, si, ci = np.sin(node), np.cos(node), np.sin(i), np.cos(i)
    flat, flat_rate = y * ci, vy * ci - y * si * i_rate
    position = np.stack([x * cn - flat * sn, x * sn + flat * cn, y * si], -1)
    velocity = np.stack([vx * cn - flat_rate * sn, vx * sn + flat_rate * cn, vy * si + y * ci * i_rate], -1)
    velocity[..., 0] -= node_rate * position[..., 1]
    velocity[..., 1] += node_rate * position[..., 0]
    if geo.any():
        fixed, fixed_rate = _geostationary(position, velocity, earth, dt)
        position = np.where(geo[:, None], fixed, position)
        velocity = np.where(geo[:, None], fixed_rate, velocity)
    return position, velocity


def _geostationary(position: Array, velocity: Array, earth: Array, dt: Array) -> tuple[Array, Array]:
    """``R3(omega dt) R1(-5 deg)`` of vectors in the tilted frame (BDS-SIS-ICD-2.1 table 5-11), and the rate."""
    st, ct = np.sin(GEO_TILT_RAD), np.cos(GEO_TILT_RAD)

    def fixed(v: Array) -> Array:
        upright = np.stack([v[..., 0], ct * v[..., 1] + st * v[..., 2], ct * v[..., 2] - st * v[..., 1]], -1)
        return rotated_with_earth(upright, earth * dt)

    place, rate = fixed(position), fixed(velocity)
    rate[..., 0] += earth * place[..., 1]
    rate[..., 1] -= earth * place[..., 0]
    return place, rate
