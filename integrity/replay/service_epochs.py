"""Recorded signals of one receiver as a navigator with positioning services takes them; the truth is apart.

A smartLoc drive has codes alone, free of satellite clocks and atmosphere, and wheel speed and yaw rate. A
receiver in RINEX has codes and carriers: satellite clock with its group delay, troposphere
(:func:`~.differences.troposphere_m`) and ionosphere (:mod:`~lanebound.integrity.sky.klobuchar`) are taken off here, as
the receiver of a car does. A second receiver at a known place gives the corrections of DGPS: its own codes, smoothed by
its carriers, less the same models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, enu_axes, geodetic_from_ecef
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.positioning.smoothing_kernel import HATCH, smooth
from lanebound.integrity.recorded.rinex_observation import Observations
from lanebound.integrity.recorded.smartloc import Odometry, SmartLoc
from lanebound.integrity.replay.code_epochs import LEAST_DBHZ, recorded_epochs
from lanebound.integrity.replay.code_places import require_gps_time
from lanebound.integrity.replay.differences import Arc, arc_of, doppler_rates, matched, troposphere_m
from lanebound.integrity.replay.signal_choice import BAND_MHZ, LETTERS, Choice
from lanebound.integrity.sky.broadcast import Ephemerides, positions
from lanebound.integrity.sky.klobuchar import Klobuchar
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.systems import CARRIER_HZ, SPEED_OF_LIGHT_MPS, WAVELENGTH_M, System

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

SYSTEM_OF = {"G": System.GPS, "E": System.GALILEO, "R": System.GLONASS, "C": System.BEIDOU, "J": System.QZSS}
FIRST_BAND = {"G": "1", "E": "1", "C": "2", "J": "1"}  # L1, E1, B1I in RINEX 3.04
ROUNDS, LEAST_CODES = 8, 6
STATION_S, STATION_GATE_M = 100.0, 5.0  # smoothing of the station's codes (DO-229), and the change that ends it
STATION_TAU_S = 300.0  # correlation of its multipath, as CodeErrorBudget.rest_tau_s
OLDEST_S = 30.0  # of a correction, as of CodeServiceConfig of DGPS


@dataclass(frozen=True)
class StationCorrections:
    """Corrections of E epochs: of each satellite (E, S) to be subtracted from its ranges, where there is one (E, S),
    and their age (E,) [s]."""

    satellite_m: Array
    known: Bools
    age_s: Array


@dataclass(frozen=True)
class ServiceEpochs:
    """E epochs of S satellites in one local frame.

    ``code = -e.x + clock of the system + errors``, x the position in E, N, U of the frame [m], and the carrier the same
    with a constant of its own.

    Attributes
    ----------
    time_s : (E,) ascending, from 0 at the first epoch
    system, prn : (S,)
    los_enu : (E, S, 3); tracked, cn0_dbhz, code_m, phase_m, lost : (E, S), a missing carrier is 0
    odometry : wheel speed and yaw rate by the same clock, None without
    station : corrections of a base, None without
    rough_en_m : (E, 2) positions by plain least squares of the codes [m], to which a heading is fitted; None without
    truth_enu_m, known : (E, 3) true position and whether it is known (E,); only an assessment reads them
    reference : what the truth is
    origin_ecef_m : (3,) origin of the frame; None where it is not known
    rate_mps : (E, S) range rates by Doppler observables, ``-e.v + drift``, 0 for none; None without
    """

    time_s: Array
    system: Ints
    prn: Ints
    los_enu: Array
    tracked: Bools
    cn0_dbhz: Array
    code_m: Array
    phase_m: Array
    lost: Bools
    odometry: Odometry | None
    station: StationCorrections | None
    rough_en_m: Array | None
    truth_enu_m: Array
    known: Bools
    reference: str
    origin_ecef_m: Array | None = None
    rate_mps: Array | None = None

    @property
    def has_carrier(self) -> bool:
        """Whether any carrier phase is recorded."""
        return bool((self.phase_m != 0.0).any())


def epochs_of_drive(drive: SmartLoc) -> ServiceEpochs:
    """The epochs of a smartLoc drive, whose codes come without carriers.

    Raises
    ------
    InputError
        No epoch determines a position, or there is no odometry.
    """
    if drive.odometry.time_s.size < 2:
        raise InputError(f"drive must have odometry, got {drive.odometry.time_s.size} lines 'odom3': give a whole file")
    found, r, o = recorded_epochs(drive, LEAST_DBHZ), drive.ranges, drive.odometry
    letters, of = np.unique(r.system, return_inverse=True)
    names = np.unique(of * 100_000 + r.satellite)
    codes, start = found.epochs, found.epochs.time_s[0]
    system = np.array([int(SYSTEM_OF.get(str(letters[n // 100_000]), -1)) for n in names])
    keep = system >= 0
    y = np.where(codes.used & (codes.y_m == 0.0), 1e-9, codes.y_m)[:, keep]
    moved = Odometry(
        o.time_s - start, o.speed_mps, o.yaw_rate_left_radps, o.speed_variance_m2ps2, o.yaw_rate_variance_rad2ps2
    )
    return ServiceEpochs(
        time_s=codes.time_s - start, system=system[keep], prn=names[keep] % 100_000,
        los_enu=np.ascontiguousarray(codes.los_enu[:, keep]), tracked=np.ascontiguousarray(codes.used[:, keep]),
        cn0_dbhz=np.ascontiguousarray(codes.cn0_dbhz[:, keep]), code_m=y, phase_m=np.zeros_like(y),
        lost=np.zeros(y.shape, np.bool_), odometry=moved, station=None,
        rough_en_m=solve_codes(codes).x_m[:, :2], truth_enu_m=found.truth_enu_m, known=found.known,
        reference="ground truth of the recording", origin_ecef_m=found.origin_ecef_m,
    )  # fmt: skip


def epochs_of_receiver(
    rover: Observations, table: Ephemerides, ionosphere: Klobuchar, station: tuple[Observations, Array] | None = None,
    truth: tuple[Mapping[int, Array], str] | None = None,
) -> ServiceEpochs:  # fmt: skip
    """The epochs of a receiver on its first band.

    Parameters
    ----------
    station : observations of a base and its antenna (3,) ECEF [m]
    truth : true position (3,) ECEF [m] by the number of the epoch, and what it is

    Raises
    ------
    InputError
        No epoch has enough codes with a message.
    """
    own = _Receiver(rover, table, ionosphere)
    require_gps_time("receiver", rover, own.codes, own.choice, table, ionosphere)
    near = own.places()
    origin = near[np.isfinite(near).all(-1)][0]
    axes = enu_axes(origin)
    shape = own.arc.known.shape
    los, code, phase = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape)
    los[..., 2] = 1.0
    last = origin
    for k in range(shape[0]):
        last = near[k] if np.isfinite(near[k]).all() else last
        sight, model_code, model_phase = own.models(k, last)
        e = sight @ axes
        back = e @ ((last - origin) @ axes)
        there = own.tracked[k]
        los[k] = np.where(there[:, None], e, los[k])
        code[k] = np.where(there, own.arc.code_m[k, :, 0] - model_code - back, 0.0)
        phase[k] = np.where(there & own.locked[k], own.arc.phase_m[k, :, 0] - model_phase - back, 0.0)
    places, reference = truth if truth is not None else ({}, "none")
    true, known = np.zeros((shape[0], 3)), np.zeros(shape[0], np.bool_)
    for k, place in places.items():
        true[k], known[k] = (place - origin) @ axes, True
    time = rover.since(int(rover.week[0]))
    rates = doppler_rates(rover, own.codes, table, np.where(np.isfinite(near), near, origin))
    return ServiceEpochs(
        time_s=time - time[0], system=np.ascontiguousarray(own.satellites[:, 0]), prn=own.satellites[:, 1],
        los_enu=los, tracked=own.tracked, cn0_dbhz=np.ascontiguousarray(own.arc.cn0_dbhz[..., 0]), code_m=code,
        phase_m=phase, lost=np.ascontiguousarray(own.arc.lost[..., 0]), odometry=None,
        station=None if station is None else _corrections(rover, own, _Receiver(station[0], table, ionosphere),
                                                          station),
        rough_en_m=None, truth_enu_m=true, known=known, reference=reference, origin_ecef_m=origin,
        rate_mps=rates if rates.any() else None,
    )  # fmt: skip


def _corrections(
    rover: Observations, own: _Receiver, base: _Receiver, station: tuple[Observations, Array]
) -> StationCorrections:
    """Corrections for each epoch of the rover from the newest epoch of the base."""
    observations, place = station
    wrong = np.zeros(base.tracked.shape)
    hatch = np.zeros(base.tracked.shape[1], HATCH)
    spacing_s = float(np.median(np.diff(observations.tow_s))) if observations.epochs > 1 else 1.0
    for k in range(len(wrong)):
        _, of_code, of_phase = base.models(k, place)
        left = base.arc.code_m[k, :, 0] - of_code, base.arc.phase_m[k, :, 0] - of_phase
        wrong[k] = _smoothed(left, base.tracked[k], base.locked[k] & ~base.arc.lost[k, :, 0], spacing_s, hatch)
    epochs, partners, age = matched(rover, observations, OLDEST_S)
    shape = own.tracked.shape
    out = StationCorrections(np.zeros(shape), np.zeros(shape, np.bool_), np.full(shape[0], np.inf))
    out.satellite_m[epochs], out.known[epochs], out.age_s[epochs] = wrong[partners], base.tracked[partners], age
    return out


def _smoothed(left: tuple[Array, Array], tracked: Bools, locked: Bools, spacing_s: float, hatch: Records) -> Array:
    """Codes (S,) of an epoch smoothed by carriers (S,) [m]; ``hatch`` (S,) advances."""
    (code, phase), most, decay = left, STATION_S / spacing_s, float(np.exp(-spacing_s / STATION_TAU_S))
    out = np.zeros(code.size)
    for s in range(code.size):
        if tracked[s]:
            out[s] = smooth(float(code[s]), float(phase[s]), bool(locked[s]), most, STATION_GATE_M, decay, hatch[s])
        else:
            hatch[s]["count"] = 0.0
    return out


class _Receiver:
    """Observations of one receiver on the first band, with the models that are taken off them."""

    def __init__(self, observations: Observations, table: Ephemerides, ionosphere: Klobuchar) -> None:
        if not len(table):
            raise InputError("table must hold messages of GPS, Galileo, BeiDou or QZSS, has none: pass the navigation")
        self.codes = codes = _first_codes(observations)
        wavelength = np.ascontiguousarray(WAVELENGTH_M[:, [0, 1]])
        self.choice = Choice(codes, codes, wavelength, 1)
        self.arc: Arc = arc_of(observations, codes, self.choice, table)
        self.satellites, self.tow_s, self.ionosphere = table.satellites, observations.tow_s, ionosphere
        self.tracked = self.arc.known & (self.arc.code_m[..., 0] != 0.0)
        self.locked = (self.arc.phase_m[..., 0] != 0.0) & ~self.arc.half[..., 0]
        time = observations.week * 604_800.0 + observations.tow_s
        self.delay_m = SPEED_OF_LIGHT_MPS * positions(table, time).group_delay_s[..., 0]
        self.dispersion = (CARRIER_HZ[System.GPS, 0] / CARRIER_HZ[self.satellites[:, 0], 0]) ** 2

    def places(self) -> Array:
        """Positions (E, 3) by least squares of the codes, ECEF [m]; NaN without enough of them.

        Raises
        ------
        InputError
            No epoch has one.
        """
        out = np.full((len(self.tow_s), 3), np.nan)
        near = np.zeros(3)
        for k in range(len(out)):
            rows = np.flatnonzero(self.tracked[k])
            systems = np.unique(self.satellites[rows, 0])
            if rows.size < LEAST_CODES or rows.size < 3 + systems.size + 1:
                continue
            clocks = (self.satellites[rows, 0][:, None] == systems).astype(np.float64)
            for _ in range(ROUNDS):
                distance, sight = ranges_and_sights(self.arc.satellite_ecef_m[k, rows], near)
                left = self.arc.code_m[k, rows, 0] + self.arc.clock_m[k, rows] - distance
                step = np.linalg.lstsq(np.column_stack([-sight, clocks]), left, rcond=None)[0][:3]
                near = near + step
                if float(np.linalg.norm(step)) < 1.0:
                    break
            out[k] = near
        if not np.isfinite(out).any():
            raise InputError(
                f"the receiver must have {LEAST_CODES} codes of satellites with a message in one epoch, has at most "
                f"{int(self.tracked.sum(-1).max(initial=0))}: pass the navigation of its day"
            )
        return out

    def models(self, k: int, place: Array) -> tuple[Array, Array, Array]:
        """Unit vectors (S, 3) ECEF, and what is taken off codes and carriers (S,) [m] at a place of epoch k."""
        latitude, longitude, _ = geodetic_from_ecef(place)
        there = np.where(self.tracked[k][:, None], self.arc.satellite_ecef_m[k], place * 4.0)
        distance, sight = ranges_and_sights(there, place)
        e = sight @ ecef_from_enu_matrix(latitude, longitude)
        elevation, azimuth = np.arcsin(np.clip(e[:, 2], -1.0, 1.0)), np.arctan2(e[:, 0], e[:, 1])
        air = troposphere_m(place, elevation)
        iono = self.dispersion * self.ionosphere.delay_m(
            float(latitude), float(longitude), azimuth, np.maximum(elevation, 0.0), float(self.tow_s[k])
        )
        plain = distance - self.arc.clock_m[k] + self.delay_m[k] + air
        return sight, plain + iono, plain - iono


def _first_codes(observations: Observations) -> dict[str, tuple[str, ...]]:
    """The code of each system on its first band that most epochs have, without its first letter."""
    found: dict[str, tuple[str, ...]] = {}
    for letter in LETTERS:
        if letter not in observations.rows or FIRST_BAND[letter] not in BAND_MHZ[letter]:
            continue
        rows = observations.rows[letter]
        names = [code[1:] for code in rows.codes if code[0] == "C" and code[1] == FIRST_BAND[letter]]
        counts = {name: int((rows.column(f"C{name}") != 0.0).sum()) for name in names}
        if counts and max(counts.values()) > 0:
            found[letter] = (max(counts, key=lambda name: counts[name]),)
    if not found:
        raise InputError(
            f"the receiver must have codes on L1, E1 or B1I, has "
            f"{'; '.join(f'{s} {c}' for s, c in observations.header.codes.items()) or 'none'}: record them"
        )
    return found
