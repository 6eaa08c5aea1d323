"""Conversion of a recorded city drive to a recorded sky: received satellites and their delays along the street.

A satellite that is received at some times is assumed above the horizon between them; while it is missing, it is
blocked. Its direction is then computed from a parabola through the recorded positions. A satellite that is never
received is not in the recording: if low satellites are blocked along the whole drive, the recording is too optimistic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import enu_axes
from lanebound.integrity.recorded.sky_recording import SkyRecording
from lanebound.integrity.recorded.smartloc import GroundTruth, Pseudoranges, SmartLoc
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay.training import code_errors
from lanebound.integrity.sky.visibility import SignalPath

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

TANGENT_M = 2.0  # the direction of travel is that of the chord from this distance behind to this distance ahead
PARABOLA_S = 20.0  # the track of a satellite recorded for a shorter time is assumed straight


class SkyRecordConfig(Config):
    """Thresholds of the classification of signals."""

    spacing_m: float = Field(5.0, gt=0.0, le=100.0, description="length of a stretch of the drive [m]; as in streets")
    late_m: float = Field(
        10.0, gt=0.0, description="smallest code error of a reflection [m]; 3 sigma of the receiver's code, 3.2 m"
    )
    weak_db: float = Field(
        4.0, gt=0.0, description="smallest loss of C/N0 in foliage [dB]; half of the loss of a tree, 8 dB"
    )
    cn0_zenith_dbhz: float = Field(48.0, description="C/N0 at the zenith in the open [dB-Hz]; the receiver's")
    cn0_horizon_dbhz: float = Field(38.0, description="C/N0 at the horizon in the open [dB-Hz]; the receiver's")
    lowest_deg: float = Field(5.0, ge=0.0, lt=90.0, description="lower satellites are left out [deg]")
    expected_s: float = Field(
        300.0, ge=0.0, description="assumed visibility before and after the reception [s]; 2 deg of the orbit"
    )


def record_sky(drive: SmartLoc, config: SkyRecordConfig | None = None) -> SkyRecording:
    """Compute the recorded sky along a drive with known truth.

    A signal is blocked in a stretch if fewer than half of its epochs have the signal. Otherwise it is classified by the
    median of its code errors (:func:`.training.code_errors`) and of its C/N0.

    Raises
    ------
    InputError
        There is no truth, there are too few strong signals for the receiver clock, or the car does not move.
    """
    config = config or SkyRecordConfig()
    known, error = code_errors(drive, np.inf)
    assert drive.truth is not None  # checked by code_errors
    r = _taken(drive.ranges, known)
    time = np.unique(r.time_s)
    place, arc, heading = _way(drive.truth, time)
    stretch = np.floor(arc / config.spacing_m).astype(np.int64)
    columns: list[tuple[Any, ...]] = []
    for number in np.unique(r.satellite):
        own = np.flatnonzero(r.satellite == number)
        name = f"{r.system[own[0]]}{number}"
        azimuth, elevation = _directions(r.time_s[own], r.satellite_ecef_m[own], time, place, heading)
        received = np.full(time.size, -1)
        received[np.searchsorted(time, r.time_s[own])] = own
        gap = np.clip(np.maximum(r.time_s[own[0]] - time, time - r.time_s[own[-1]]), 0.0, None)
        up = (elevation >= np.deg2rad(config.lowest_deg)) & (gap <= config.expected_s)
        columns += _rows(name, config, arc, stretch, azimuth, elevation, received, up, error, r.cn0_dbhz)
    if not columns:
        raise InputError(f"drive must have satellites above {config.lowest_deg:g} deg, has none: lower lowest_deg")
    names, *numbers = zip(*columns, strict=True)
    table = np.array(numbers, dtype=np.float64)
    return SkyRecording(
        np.array(names), table[0], table[1], table[2], table[3].astype(np.uint8), table[4], table[5], float(arc[-1])
    )


def _taken(r: Pseudoranges, keep: Bools) -> Pseudoranges:
    return Pseudoranges(**{name: column[keep] for name, column in vars(r).items()})


def _way(truth: GroundTruth, time_s: Array) -> tuple[Array, Array, Array]:
    """Position ECEF (T, 3), distance driven (T,) [m] and direction of travel from North (T,) [rad] at times (T,)."""
    path = truth.position_ecef_m
    axes = enu_axes(path[0])
    step = np.linalg.norm(np.diff(path, axis=0) @ axes[:, :2], axis=-1)
    driven = np.concatenate([[0.0], np.cumsum(step)])
    if driven[-1] < 10.0 * TANGENT_M:
        raise InputError(
            f"drive must be at least {10.0 * TANGENT_M:g} m long, got {driven[-1]:.1f}: give a longer drive"
        )
    moved = np.concatenate([[True], step > 0.0])
    local = (path - path[0]) @ axes
    arc = np.interp(time_s, truth.time_s, driven)
    late, early = (interpolated(arc + by, driven[moved], local[moved]) for by in (TANGENT_M, -TANGENT_M))
    ahead = late - early
    return truth.at(time_s)[0], arc - arc[0], np.arctan2(ahead[:, 0], ahead[:, 1])


def _directions(seen_s: Array, ecef_m: Array, time_s: Array, place: Array, heading: Array) -> tuple[Array, Array]:
    """Azimuth from the direction of travel and elevation (T,) [rad] of a satellite observed at some times (n,)."""
    middle, degree = seen_s.mean(), 2 if np.ptp(seen_s) >= PARABOLA_S else min(1, np.unique(seen_s).size - 1)
    terms = np.polynomial.polynomial.polyvander(seen_s - middle, degree)
    law = np.linalg.lstsq(terms, ecef_m, rcond=None)[0]
    there = np.polynomial.polynomial.polyvander(time_s - middle, degree) @ law
    axes = enu_axes(place[0])  # one local frame is sufficient for a short drive
    sight = (there - place) @ axes
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    azimuth = np.arctan2(sight[:, 0], sight[:, 1]) - heading
    return np.mod(azimuth, 2.0 * np.pi), np.arcsin(sight[:, 2])


def _rows(
    name: str, config: SkyRecordConfig, arc: Array, stretch: Ints, azimuth: Array, elevation: Array, received: Ints,
    up: Bools, error: Array, cn0: Array,
) -> list[tuple[Any, ...]]:  # fmt: skip
    """One row for each stretch in which a satellite is above the horizon."""
    found: list[tuple[Any, ...]] = []
    for k in np.unique(stretch[up]):
        epochs = np.flatnonzero(up & (stretch == k))
        got = received[epochs]
        got = got[got >= 0]
        middle = epochs[len(epochs) // 2]
        where = (name, arc[epochs].mean(), azimuth[middle], elevation[middle])
        if 2 * got.size < epochs.size:
            found.append((*where, SignalPath.BLOCKED, 0.0, 0.0))
            continue
        level, late = float(np.median(cn0[got])), float(np.median(error[got]))
        path = _kind_of(config, late, level, float(elevation[middle]))
        found.append((*where, path, late if path == SignalPath.REFLECTED else 0.0, level))
    return found


def _kind_of(config: SkyRecordConfig, error_m: float, cn0_dbhz: float, elevation_rad: float) -> SignalPath:
    """Propagation path of a received signal with this error and C/N0."""
    if error_m > config.late_m:
        return SignalPath.REFLECTED
    rise = config.cn0_zenith_dbhz - config.cn0_horizon_dbhz
    open_dbhz = config.cn0_horizon_dbhz + rise * np.sin(elevation_rad)
    return SignalPath.FOLIAGE if cn0_dbhz < open_dbhz - config.weak_db else SignalPath.LOS


def agreement(recording: SkyRecording) -> tuple[float, float]:
    """Leave-one-satellite-out test: prediction of a satellite's line of sight from the rows of the other satellites.

    Returns the share of rows with a correct prediction (clear or not clear), and that of the best constant prediction.
    """
    right = 0
    for name in np.unique(recording.satellite):
        own = recording.satellite == name
        if own.all():
            continue
        rest, tested = recording.rows(~own), recording.rows(own)
        row = rest.nearest(tested.arc_m, tested.azimuth_rad, tested.elevation_rad)
        right += int((_clear(rest.path[row]) == _clear(tested.path)).sum())
    clear = float(_clear(recording.path).mean())
    return right / recording.path.size, max(clear, 1.0 - clear)


def _clear(path: NDArray[np.uint8]) -> Bools:
    return np.asarray((path == SignalPath.LOS) | (path == SignalPath.FOLIAGE))


def summary(recording: SkyRecording) -> dict[str, Any]:
    """Statistics of a recording as JSON data."""
    late = recording.excess_m[recording.path == SignalPath.REFLECTED]
    right, constant = agreement(recording)
    return {
        "length_m": recording.length_m,
        "satellites": int(np.unique(recording.satellite).size),
        "rows": int(recording.path.size),
        "shares": {kind.name.lower(): float((recording.path == kind).mean()) for kind in SignalPath},
        "late_median_m": float(np.median(late)) if late.size else None,
        "late_95_m": float(np.quantile(late, 0.95)) if late.size else None,
        "foretold": right,
        "guessed": constant,
    }
