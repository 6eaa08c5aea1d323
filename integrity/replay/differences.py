"""Single differences of two receivers, and range rates of one, reduced to terms of position, velocity and clock.

For each receiver and satellite ``u = P - |s - x| + c dt_s - T`` with the satellite position s at transmission from its
broadcast message, rotated with the Earth, and the troposphere T. The difference of rover and base, linearized at a
nominal position ``x_0`` of the rover and with the base as origin, is ``y = -e.x + clock (+ lambda N)``.

Range rates are ``y = -e.v + drift`` [m/s], less the motion of satellites and their clocks: from Doppler observables,
or, where a receiver records none, from the changes of its carriers between epochs, the mean rates over that time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import enu_axes, geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import WEEK_S, Observations
from lanebound.integrity.replay.signal_choice import (
    COLUMNS,
    LETTERS,
    USUAL_CN0_DBHZ,
    Choice,
    comparable_cn0,
    strength_dbhz,
)
from lanebound.integrity.sky.broadcast import Ephemerides, positions
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, WAVELENGTH_M

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

CLOCKS_S = 0.025  # receivers keep their time tags within some milliseconds of GPS time
LOWEST_RAD = np.deg2rad(3.0)  # the simple troposphere model is not valid below


@dataclass(frozen=True)
class Arc:
    """Observations of one receiver of the satellites of a navigation file: T epochs, S satellites, C signals each.

    ``code`` [m], ``phase`` [m] (T, S, C), 0 for none; ``lost``, ``half`` and C/N0 (T, S, C), of semi-codeless signals
    made comparable; satellite at transmission (T, S, 3) ECEF [m], its clock [m] and whether there is a message (T, S).
    """

    code_m: Array
    phase_m: Array
    lost: Bools
    half: Bools
    cn0_dbhz: Array
    satellite_ecef_m: Array
    clock_m: Array
    known: Bools


@dataclass(frozen=True)
class Reduced:
    """One epoch of S satellites, C signals: unit vectors (S, 3) from the rover in E, N, U of the base; code and phase
    (S, C) [m], ``-e.x + clock`` with x relative to the base; C/N0, tracked, and lock lost (S, C).

    The C/N0 is that of a signal whose variance is the mean over receivers: ``-10 lg mean 10^(-C/N0 / 10)``.
    """

    sight_enu: Array
    code_m: Array
    phase_m: Array
    cn0_dbhz: Array
    tracked: Bools
    lost: Bools


def arc_of(observations: Observations, codes: dict[str, tuple[str, ...]], choice: Choice, table: Ephemerides) -> Arc:
    """Arrange observations by epoch and satellite, with the satellite positions at transmission."""
    satellites = table.satellites
    shape = (observations.epochs, len(satellites), COLUMNS)
    code, phase, cn0 = np.zeros(shape), np.zeros(shape), np.full(shape, USUAL_CN0_DBHZ)
    lost, half = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for letter, names in codes.items():
        rows, system = observations.rows[letter], LETTERS[letter]
        where = {int(prn): i for i, (s, prn) in enumerate(satellites) if s == system}
        column = np.array([where.get(int(prn), -1) for prn in rows.satellite], dtype=np.int64)
        keep = column >= 0
        at = rows.epoch[keep], column[keep]
        for band, name in enumerate(names):
            code[(*at, band)] = rows.column(f"C{name}")[keep]
            phase[(*at, band)] = rows.column(f"L{name}")[keep] * choice.wavelength_m[system, band]
            lost[(*at, band)] = rows.lost_lock(f"L{name}")[keep]
            half[(*at, band)] = rows.half_cycle(f"L{name}")[keep]
            strength = strength_dbhz(rows, name)[keep]
            cn0[(*at, band)] = np.where(strength > 0.0, comparable_cn0(name, strength), USUAL_CN0_DBHZ)
    lost |= observations.power_failed[:, None, None]
    first = np.take_along_axis(code, (code != 0.0).argmax(-1)[..., None], -1)[..., 0]
    return Arc(code, phase, lost, half, cn0, *_at_transmission(observations, first, table))


def _at_transmission(observations: Observations, range_m: Array, table: Ephemerides) -> tuple[Array, Array, Bools]:
    """Satellite position (T, S, 3), clock [m] and whether they are known, at ``t = t_receiver - P/c - dt_s``."""
    time = (observations.week * WEEK_S + observations.tow_s)[:, None] * np.ones((1, range_m.shape[1]))
    travel = range_m / SPEED_OF_LIGHT_MPS
    first = positions(table, time, travel)
    states = positions(table, time, travel + first.clock_s)
    known = states.usable & (range_m > 0.0)
    return states.position_ecef_m, SPEED_OF_LIGHT_MPS * states.clock_s, known


def matched(rover: Observations, base: Observations, oldest_s: float) -> tuple[Ints, Ints, Array]:
    """Match epochs: indices of rover epochs and of the newest base epoch not after each, age [s].

    Clocks of receivers may differ by CLOCKS_S: an epoch of the base that is later by less is of the same time.
    """
    week = int(min(rover.week[0], base.week[0]))
    rover_s, base_s = rover.since(week), base.since(week)
    last = np.searchsorted(base_s, rover_s + CLOCKS_S, side="right") - 1
    age = np.where(last >= 0, rover_s - base_s[np.maximum(last, 0)], np.inf)
    keep = np.flatnonzero(age <= oldest_s)
    return keep, last[keep], np.maximum(age[keep], 0.0)


def reduce_epoch(
    rover: Arc, base: Arc, i: int, j: int, nominal_ecef_m: Array, base_ecef_m: Array, cn0_min_dbhz: float = 0.0
) -> Reduced:
    """Difference rover epoch i and base epoch j at a nominal position of the rover.

    A signal is tracked when both receivers have its code and phase with at least ``cn0_min_dbhz``.
    """
    axes = enu_axes(base_ecef_m)
    far, sight = ranges_and_sights(rover.satellite_ecef_m[i], nominal_ecef_m)
    near, seen = ranges_and_sights(base.satellite_ecef_m[j], base_ecef_m)
    e, elevation = sight @ axes, np.arcsin(np.clip((seen @ axes)[:, 2], -1.0, 1.0))
    air = troposphere_m(nominal_ecef_m, _elevation_at(sight, nominal_ecef_m)) - troposphere_m(base_ecef_m, elevation)
    model = (far - rover.clock_m[i]) - (near - base.clock_m[j]) + air
    model = model + e @ ((nominal_ecef_m - base_ecef_m) @ axes)
    both = rover.known[i] & base.known[j]
    whole = [(a.code_m[k] != 0.0) & (a.phase_m[k] != 0.0) for a, k in ((rover, i), (base, j))]
    strength = np.stack([rover.cn0_dbhz[i], base.cn0_dbhz[j]])
    tracked = both[:, None] & (strength >= cn0_min_dbhz).all(0) & whole[0] & whole[1]
    sure = ~(rover.half[i] | base.half[j])
    return Reduced(
        np.where(both[:, None], e, [0.0, 0.0, 1.0]),
        np.where(tracked, rover.code_m[i] - base.code_m[j] - model[:, None], 0.0),
        np.where(tracked & sure, rover.phase_m[i] - base.phase_m[j] - model[:, None], 0.0),
        -10.0 * np.log10((10.0 ** (-0.1 * strength)).mean(0)), tracked, rover.lost[i] | base.lost[j],
    )  # fmt: skip


def _elevation_at(sight_ecef: Array, place_ecef_m: Array) -> Array:
    """Elevation [rad] of unit vectors (S, 3) at a place (3,)."""
    return np.asarray(np.arcsin(np.clip((sight_ecef @ enu_axes(place_ecef_m))[:, 2], -1.0, 1.0)))


def troposphere_m(place_ecef_m: Array, elevation_rad: Array) -> Array:
    """Slant tropospheric delay of Saastamoinen's model in the standard atmosphere, humidity 50 %.  (S,) [m].

    Saastamoinen 1973 (Bulletin Geodesique 107): ``0.002277 / cos z (p + (1255 / T + 0.05) e - tan^2 z)``.
    """
    _, _, height = geodetic_from_ecef(place_ecef_m)
    h = float(np.clip(height, -500.0, 9000.0))
    kelvin = 288.15 - 6.5e-3 * h
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    vapour = 0.5 * 6.108 * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    zenith = np.pi / 2.0 - np.maximum(elevation_rad, LOWEST_RAD)
    tangent = np.tan(zenith) ** 2
    return np.asarray(
        0.002277 / np.cos(zenith) * (pressure + (1255.0 / kelvin + 0.05) * vapour - np.minimum(tangent, 1e3))
    )


FIRST_TRAVEL_S = 0.075
HALF_S = 0.5  # to each side of an epoch, over which the rate of a range is its mean
LONGEST_S = 2.0  # between epochs, over which a carrier's change is a rate


def doppler_rates(
    observations: Observations, codes: dict[str, tuple[str, ...]], table: Ephemerides, place_ecef_m: Array
) -> Array:
    """Range rates (T, S) at places (T, 3) from the Doppler observables of the codes' first band; 0 for none.

    A Doppler shift is positive for a satellite that approaches: ``-lambda D`` is the rate (RINEX 3.04 section 5.3).
    """
    rate = _recorded(observations, codes, table)
    if not rate.any():
        return rate
    time = observations.week * WEEK_S + observations.tow_s
    later, earlier = (_model(table, time, shift, place_ecef_m) for shift in (HALF_S, -HALF_S))
    there = (rate != 0.0) & np.isfinite(later) & np.isfinite(earlier)
    return np.where(there, rate - (later - earlier) / (2.0 * HALF_S), 0.0)


def _recorded(observations: Observations, codes: dict[str, tuple[str, ...]], table: Ephemerides) -> Array:
    """``-lambda D`` (T, S) [m/s], 0 for none."""
    out = np.zeros((observations.epochs, len(table.satellites)))
    for letter, names in codes.items():
        rows, system = observations.rows[letter], LETTERS[letter]
        where = {int(prn): i for i, (s, prn) in enumerate(table.satellites) if s == system}
        column = np.array([where.get(int(prn), -1) for prn in rows.satellite], dtype=np.int64)
        keep = column >= 0
        out[rows.epoch[keep], column[keep]] = -WAVELENGTH_M[system, 0] * rows.column(f"D{names[0]}")[keep]
    return out


def _model(table: Ephemerides, time_s: Array, shift_s: float, place_ecef_m: Array) -> Array:
    """Range less satellite clock (T, S) [m] a little later, from the same places; NaN without a message."""
    shape = (time_s.size, len(table.satellites))
    at, travel = np.broadcast_to(time_s[:, None], shape), np.full(shape, FIRST_TRAVEL_S)
    for _ in range(3):
        states = positions(table, at, travel - shift_s)
        known = states.usable[..., None]
        far = np.where(known, states.position_ecef_m, 4.0 * place_ecef_m[:, None, :])
        distance, _ = ranges_and_sights(far, place_ecef_m[:, None, :])
        travel = distance / SPEED_OF_LIGHT_MPS
    return np.where(states.usable, distance - SPEED_OF_LIGHT_MPS * states.clock_s, np.nan)


def carrier_rates(
    time_s: Array, los_enu: Array, phase_m: Array, lost: Bools, tracked: Bools, place_enu_m: Array
) -> Array:
    """Mean range rates (E, S) over the time since the epoch before; 0 for none.

    ``(phase_k - phase_j + (e_k - e_j).x_j) / dt``, with carriers ``phase = -e.x + clock + constant`` and the position
    x_j before, of which metres of error move a rate by a millimetre per second.

    Parameters
    ----------
    time_s : (E,)
    los_enu, phase_m, lost, tracked : (E, S, 3), (E, S) each; a phase is 0 for none
    place_enu_m : (E, 3)
    """
    out, dt = np.zeros(phase_m.shape), np.diff(time_s)
    whole = tracked & (phase_m != 0.0)
    both = whole[1:] & whole[:-1] & ~lost[1:] & (dt <= LONGEST_S)[:, None]
    turned = ((los_enu[1:] - los_enu[:-1]) * place_enu_m[:-1, None, :]).sum(-1)
    rate = (phase_m[1:] - phase_m[:-1] + turned) / dt[:, None]
    out[1:] = np.where(both, np.where(rate == 0.0, 1e-12, rate), 0.0)
    return out
