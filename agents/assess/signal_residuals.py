"""Residuals of code and Doppler with the truth known: of recorded drives, of labelled signals, and of simulated ones.

All are treated alike. The receiver's clock at an epoch is the median residual of its GPS signals of 40 dB-Hz and more;
from the code residuals of every other system their median at 42 dB-Hz and more is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.street_drives import StreetDrivesConfig, street_of
from lanebound.agents.checkpointing.runner import Counter, OnProgress, RunProgress
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.recorded.smartloc_raw import SmartLocRaw
from lanebound.integrity.replay.sagnac import ranges_and_sights
from lanebound.integrity.replay.signal_choice import LETTERS
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, WAVELENGTH_M, System
from lanebound.integrity.sky.visibility import SignalPath

__all__ = ["SYSTEMS", "SignalResiduals", "labelled", "recorded", "simulated", "without_clock"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CLOCK_DBHZ, OFFSET_DBHZ = 40.0, 42.0
LEAST_GPS = 3  # signals for the clock of an epoch
EVERY = 5  # epochs of the simulation between those that count
SYSTEMS = {**LETTERS, "R": System.GLONASS}
UNKNOWN = -1
GLONASS_NUMBERS = 300  # smartLoc: number of a GLONASS satellite less its slot
GLONASS_STEP_HZ, GLONASS_MIDDLE = 0.5625e6, 7  # spacing of channels, and number of channel 0 in raw tables
SAME_PLACE_M, SAME_TIME_S = 0.05, 0.05  # of an epoch in both forms of a drive
RATE_SPAN_S = 2.0  # on both sides, of the satellite positions whose ranges give a rate


class SignalResiduals(NamedTuple):
    """N signals, (N,) each: time [s], system, satellite, residuals (observed less computed) of code [m] and range rate
    [m/s], NaN where not measured, elevation [deg], C/N0 [dB-Hz], and whether the direct ray is blocked: 1, 0, or -1
    where that is not known."""

    time_s: Array
    system: Ints
    satellite: Ints
    code_m: Array
    rate_mps: Array
    elevation_deg: Array
    cn0_dbhz: Array
    blocked: Ints

    def take(self, rows: Bools | Ints) -> SignalResiduals:
        """Some of the signals."""
        columns: Any = (column[rows] for column in self)
        return SignalResiduals(*columns)

    @staticmethod
    def join(parts: Sequence[SignalResiduals]) -> SignalResiduals:
        """All signals of several."""
        return SignalResiduals(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def without_clock(signals: SignalResiduals) -> SignalResiduals:
    """Residuals without the clock of each epoch and the offset of each system; epochs with few GPS signals go.

    Raises
    ------
    InputError
        No epoch has enough GPS signals.
    """
    s = signals
    _, epoch = np.unique(s.time_s, return_inverse=True)
    strong = (s.system == System.GPS) & (s.cn0_dbhz >= CLOCK_DBHZ)
    clock = np.full((int(epoch.max(initial=-1)) + 1, 2), np.nan)
    for k in np.unique(epoch[strong]):
        own = strong & (epoch == k)
        if own.sum() >= LEAST_GPS:
            clock[k] = np.median(s.code_m[own]), np.median(s.rate_mps[own])
    s = s._replace(code_m=s.code_m - clock[epoch, 0], rate_mps=s.rate_mps - clock[epoch, 1])
    s = s.take(np.isfinite(s.code_m))
    if not s.code_m.size:
        raise InputError(f"codes must have an epoch with {LEAST_GPS} GPS codes of {CLOCK_DBHZ:g} dB-Hz, got none")
    code = s.code_m.copy()
    for system in np.unique(s.system):
        own = s.system == system
        good = own & (s.cn0_dbhz >= OFFSET_DBHZ)
        if system != System.GPS and good.any():
            code[own] -= np.median(code[good])
    return s._replace(code_m=code)


def recorded(drive: SmartLoc) -> SignalResiduals:
    """Residuals of the codes of a drive with its truth, by time; Doppler and labels are not known.

    Raises
    ------
    InputError
        The drive has no truth.
    """
    codes, truth = drive.ranges, drive.truth
    if truth is None:
        raise InputError("drive must have a ground truth, has none: give its *_GT file")
    position, known = truth.at(codes.time_s)
    system = np.array([SYSTEMS.get(str(letter), UNKNOWN) for letter in codes.system], dtype=np.int64)
    nothing = np.full(system.size, np.nan)
    found = SignalResiduals(
        codes.time_s, system, codes.satellite,
        codes.range_m - ranges_and_sights(codes.satellite_ecef_m, position)[0], nothing,
        np.degrees(codes.elevation_rad), codes.cn0_dbhz, np.full(system.size, UNKNOWN),
    )  # fmt: skip
    found = found.take(known & (system >= 0))
    return found.take(np.argsort(found.time_s, kind="stable"))


def labelled(drive: SmartLoc, raw: SmartLocRaw) -> SignalResiduals:
    """The codes of a drive that stand in a raw table of it, with range rates and labels of that table.

    Range rates are ``-f lambda`` of the Doppler frequency f. The computed one is the rate of the range from the true
    position, by a parabola through the satellite's ranges of +- 2 s, less ``e.v`` of the true velocity.

    Raises
    ------
    InputError
        The drive has no truth, or the tables have no signal in common.
    """
    codes, truth = recorded(drive), drive.truth
    assert truth is not None  # checked by recorded
    place = ecef_from_geodetic(np.radians(raw.latitude_deg), np.radians(raw.longitude_deg), raw.height_m)
    near = np.array([np.linalg.norm(truth.position_ecef_m - p, axis=-1).argmin() for p in place])
    same = np.linalg.norm(truth.position_ecef_m[near] - place, axis=-1) < SAME_PLACE_M
    if not same.any():
        raise InputError("raw must be a table of the same drive, has no true position in common: give its raw table")
    time = raw.tow_s - np.median((raw.tow_s - truth.time_s[near])[same])
    number = raw.satellite + np.where(raw.system == "R", GLONASS_NUMBERS, 0)
    rates, rows, chosen = _range_rates(drive, raw, place, time, number), [], []
    for i in range(time.size):
        at = (codes.satellite == number[i]) & (np.abs(codes.time_s - time[i]) < SAME_TIME_S)
        own = np.flatnonzero(at & (codes.system == SYSTEMS.get(str(raw.system[i]), UNKNOWN)))
        if own.size:
            rows.append(own[0])
            chosen.append(i)
    if not rows:
        raise InputError("raw and drive must have signals in common, have none: give the raw table of the drive")
    return codes.take(np.array(rows))._replace(rate_mps=rates[chosen], blocked=raw.reflected[chosen])


def _range_rates(drive: SmartLoc, raw: SmartLocRaw, place: Array, time: Array, number: Ints) -> Array:
    """Observed less computed range rate of each signal of a raw table [m/s]; NaN for an unknown satellite."""
    codes, out = drive.ranges, np.full(time.size, np.nan)
    hertz = 1602.0e6 + GLONASS_STEP_HZ * (raw.slot - GLONASS_MIDDLE)
    wave = np.where(raw.system == "R", SPEED_OF_LIGHT_MPS / hertz, WAVELENGTH_M[System.GPS, 0])
    east, north = np.cos(raw.heading_east_left_rad), np.sin(raw.heading_east_left_rad)
    for i in range(time.size):
        own = (codes.satellite == number[i]) & (np.abs(codes.time_s - time[i]) < RATE_SPAN_S)
        if own.sum() < 3:
            continue
        distance, sight = ranges_and_sights(codes.satellite_ecef_m[own], place[i])
        late = codes.time_s[own] - time[i]
        slope = np.polyfit(late, distance - distance[0], 2)[1]
        axes = ecef_from_enu_matrix(np.radians(raw.latitude_deg[i]), np.radians(raw.longitude_deg[i]))
        velocity = raw.speed_mps[i] * (axes @ [east[i], north[i], 0.0])
        out[i] = -raw.doppler_hz[i] * wave[i] - (slope - sight[np.abs(late).argmin()] @ velocity)
    return out


def simulated(config: StreetDrivesConfig, streets: int, systems: Sequence[int], report: OnProgress) -> SignalResiduals:
    """Residuals of simulated drives under the first sky of ``config``, without their clocks; of these systems."""
    found, counter = [], Counter(report, RunProgress(float(streets)))
    for number in range(streets):
        navigator, drive = street_of(config, config.skies[0], number)
        first, epochs = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, config.span_s))
        each: list[list[SignalResiduals]] = [[] for _ in range(config.vehicles)]
        for k, truth in zip(range(epochs), drive, strict=False):
            m = navigator.measure(truth)
            if k < first or k % EVERY:
                continue
            wanted = np.isin(m.sky.system, systems)
            e = m.sky.los_enu[m.sky.index]
            code = m.gnss.code_m[:, :, 0] + np.einsum("bsi,bi->bs", e, truth.position_enu_m)
            rate = m.gnss.range_rate_mps + np.einsum("bsi,bi->bs", e, truth.velocity_enu_mps)
            elevation = np.degrees(m.sky.elevation_rad[m.sky.index])
            path = navigator.mask.look(truth.arc_m, truth.lane, m.sky).path
            blocked = (path == SignalPath.REFLECTED) | (path == SignalPath.BLOCKED)
            for v, rows in enumerate(each):
                s = np.flatnonzero(m.gnss.tracked[v] & wanted)
                rows.append(
                    SignalResiduals(
                        np.full(s.size, truth.time_s), m.sky.system[s], s, code[v, s], rate[v, s], elevation[v, s],
                        m.gnss.cn0_dbhz[v, s], blocked[v, s].astype(np.int64),
                    )
                )  # fmt: skip
        found += [without_clock(SignalResiduals.join(rows)) for rows in each]
        counter(number + 1.0)
    return SignalResiduals.join(found)
