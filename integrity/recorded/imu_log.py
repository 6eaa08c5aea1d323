"""Reader of inertial logs beside a GNSS solution: the format of rtklibexplorer's GNSS_IMU drives.

A drive is three files. ``imu.csv`` has 100 lines a second without a head: specific force [g] on three axes, rates
[deg/s] on three axes, time since power-up [ms]; logging may begin and end within a line. ``imu.csv.tag`` is RTKLIB's
time-tag file of it: 60 bytes of text, tick at the start (u4), GPS time at the start as seconds since 1970 (u4) and
their fraction (f8), then for each received block the time since the start [ms] (u4) and the length of the file at that
moment (u4, or u8 in later versions); little endian. ``gnss.pos`` is a solution of RTKLIB with times of day and
velocities.

The sensor's clock is tied to GPS time by a line fitted to all tags. Axes of the log are forward, left, up; those here
forward, right, down. A sensor that is mounted askew is levelled by gravity at rest (:func:`levelled`), which leaves its
azimuth in the vehicle as it is.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic
from lanebound.integrity.recorded.source import Lines, Stop, finite_number

__all__ = ["ImuLog", "SolutionTrack", "levelled", "read_imu_log", "read_solution_track"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

G_MPS2 = 9.80665  # standard gravity, BIPM 1901
GPS_EPOCH_S = 315_964_800.0  # 1980-01-06 in seconds since 1970
HEAD_BYTES, START_BYTES = 60, 16
COLUMNS = (
    *((f"specific force {axis}", -50.0, 50.0) for axis in "xyz"),
    *((f"rate {axis}", -4000.0, 4000.0) for axis in "xyz"),
    ("time since power-up", 0.0, 5e9),
)
SIGNS = np.array([1.0, -1.0, -1.0])  # from forward, left, up to forward, right, down
REST_S, LEAST_ROWS = 2.0, 10
COMMENT = "%"
# (column, name, low, high) of a solution with date and time in the first two columns
TRACK_COLUMNS = (
    (2, "latitude", -90.0, 90.0), (3, "longitude", -180.0, 360.0), (4, "height", -1e4, 1e5), (5, "Q", 0, 10),
    (7, "sdn", 0.0, 1e6), (8, "sde", 0.0, 1e6), (9, "sdu", 0.0, 1e6), (15, "vn", -1e3, 1e3), (16, "ve", -1e3, 1e3),
    (17, "vu", -1e3, 1e3),
)  # fmt: skip


@dataclass(frozen=True)
class ImuLog:
    """Samples (N,): GPS time [s since 1980-01-06], specific force [m/s^2] and rate [rad/s] (N, 3) on forward, right,
    down; ``stopped`` is the place where a truncated file ends."""

    gps_time_s: Array
    force_mps2: Array
    rate_radps: Array
    stopped: Stop | None

    @property
    def rate_hz(self) -> float:
        """Samples in a second."""
        return float(1.0 / np.median(np.diff(self.gps_time_s)))


@dataclass(frozen=True)
class SolutionTrack:
    """Epochs (T,) of a solution: GPS time [s since 1980-01-06], position (T, 3) ECEF [m], deviations (T, 3) and
    velocity (T, 3) in North, East, Up [m], [m/s], quality (1 fixed, 2 float)."""

    gps_time_s: Array
    position_ecef_m: Array
    sigma_neu_m: Array
    velocity_neu_mps: Array
    quality: Ints
    stopped: Stop | None


def read_imu_log(path: str | Path, tag: str | Path | None = None) -> ImuLog:
    """Read an inertial log, plain or gzip, and its time tags (by default ``PATH.tag``).

    A first line that is cut is left out, and so is a last one. A gzip log keeps the tags of its plain text.

    Raises
    ------
    InputError
        A file cannot be read, a line between the first and the last is malformed, or fewer than ten samples remain.
    """
    rows, ends, stop = _samples(path)
    if len(rows) < LEAST_ROWS:
        raise InputError(f"{path} must have at least {LEAST_ROWS} samples, got {len(rows)}: is it the log of an IMU?")
    clock_s = 1e-3 * rows[:, 6]
    if (np.diff(clock_s) < 0.0).any():
        late = int(np.argmax(np.diff(clock_s) < 0.0)) + 2
        raise InputError(f"{path}, sample {late}: time since power-up must not decrease: cut the file there")
    start_s, tick_s, length = _tags(Path(f"{path}.tag" if tag is None else tag))
    newest = np.searchsorted(ends, length, side="right") - 1  # last whole line that a block has brought
    known = newest >= 0
    if known.sum() < 2:
        raise InputError(f"{path} and its time tags must belong together, {int(known.sum())} tags fit: give its own")
    rate, offset = np.polyfit(clock_s[newest[known]] - clock_s[0], tick_s[known], 1)
    if not 0.99 < rate < 1.01:
        raise InputError(
            f"the clock of {path} must run within 1 % of its time tags, got a factor of {rate:.4f}: give its own tags"
        )
    time = start_s + offset + rate * (clock_s - clock_s[0])
    return ImuLog(time, G_MPS2 * SIGNS * rows[:, :3], np.radians(SIGNS * rows[:, 3:6]), stop)


def levelled(log: ImuLog, rest_s: float = REST_S) -> tuple[ImuLog, float, float]:
    """The log turned so that the mean specific force of its first ``rest_s`` points up; roll and pitch [rad].

    ``roll = atan2(-f_y, -f_z)`` and ``pitch = atan2(f_x, hypot(f_y, f_z))`` of forward, right, down. The vehicle must
    stand still and level.

    Raises
    ------
    InputError
        The mean force is not that of gravity within 5 %.
    """
    rest = log.gps_time_s < log.gps_time_s[0] + rest_s
    mean = log.force_mps2[rest].mean(0)
    if not abs(float(np.linalg.norm(mean)) / G_MPS2 - 1.0) < 0.05:
        raise InputError(
            f"the first {rest_s:g} s must be at rest, got a mean force of {float(np.linalg.norm(mean)):.2f} m/s^2: "
            "give another length"
        )
    roll = float(np.arctan2(-mean[1], -mean[2]))
    pitch = float(np.arctan2(mean[0], np.hypot(mean[1], mean[2])))
    (cr, sr), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (roll, pitch))
    turn = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])  # body to level
    return replace(log, force_mps2=log.force_mps2 @ turn.T, rate_radps=log.rate_radps @ turn.T), roll, pitch


def read_solution_track(path: str | Path) -> SolutionTrack:
    """Read a solution of RTKLIB with dates, geodetic positions and velocities, plain or gzip.

    Raises
    ------
    InputError
        The file cannot be read, a line before the last is malformed or without velocities, or there is none.
    """
    lines, refusal, found = Lines(path), "", array("d")
    stop: Stop | None = None
    for text in lines:
        if refusal:
            raise InputError(refusal)
        if not text.strip() or text.startswith(COMMENT):
            continue
        try:
            found.extend(_epoch(text.split()))
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
    rows = np.array(found).reshape(-1, 1 + len(TRACK_COLUMNS))
    if not len(rows):
        raise InputError(f"{path} must hold at least one position, got none: {refusal or 'is it the right file?'}")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    place = ecef_from_geodetic(np.radians(rows[:, 1]), np.radians(rows[:, 2]), rows[:, 3])
    return SolutionTrack(
        rows[:, 0], place, rows[:, 5:8], rows[:, 8:11], rows[:, 4].astype(np.int64), stop or lines.stop
    )


def _epoch(words: list[str]) -> list[float]:
    """Numbers of a line; ValueError with the column."""
    if len(words) <= TRACK_COLUMNS[-1][0]:
        raise ValueError(f"must have velocities in columns 16 to 18, got {len(words)} columns: write them (out-outvel)")
    try:
        moment = datetime.strptime(f"{words[0]} {words[1]}", "%Y/%m/%d %H:%M:%S.%f").replace(tzinfo=UTC)
    except ValueError:
        raise ValueError(f"date and time must be as 2025/07/08 19:34:18.499, got {' '.join(words[:2])!r}") from None
    values = [moment.timestamp() - GPS_EPOCH_S]
    for column, name, low, high in TRACK_COLUMNS:
        try:
            values.append(finite_number(words[column], low, high))
        except ValueError as error:
            raise ValueError(f"{name} {error}") from None
    return values


def _samples(path: str | Path) -> tuple[Array, Ints, Stop | None]:
    """Numbers of the whole lines (N, 7), the byte after each (N,), and the place where reading stopped."""
    lines, refusal, found, ends = Lines(path), "", array("d"), array("q")
    stop: Stop | None = None
    for text in lines:
        if refusal:
            raise InputError(refusal)
        try:
            numbers = _numbers(text)
        except ValueError as error:
            if lines.number > 1:
                refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
            continue
        found.extend(numbers)
        ends.append(lines.read)
    return np.array(found).reshape(-1, len(COLUMNS)), np.array(ends, dtype=np.int64), stop or lines.stop


def _numbers(text: str) -> list[float]:
    words = text.split(",")
    if len(words) < len(COLUMNS):
        raise ValueError(f"must have {len(COLUMNS)} columns, got {len(words)}: the line is truncated")
    values = []
    for (name, low, high), word in zip(COLUMNS, words, strict=False):
        try:
            values.append(finite_number(word, low, high))
        except ValueError as error:
            raise ValueError(f"{name} {error}") from None
    return values


def _tags(path: Path) -> tuple[float, Array, Ints]:
    """GPS time at the start [s since 1980-01-06], and of each block the time since then [s] and the bytes so far."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"time tags {path} must be a readable file, got {error.strerror}: give the .tag") from error
    body = data[HEAD_BYTES + START_BYTES :]
    if not data.startswith(b"TIMETAG") or len(body) < 16:
        raise InputError(f"time tags {path} must begin with 'TIMETAG' and hold blocks, has neither: give RTKLIB's .tag")
    start = np.frombuffer(data, "<u4", 1, HEAD_BYTES + 4)[0] + np.frombuffer(data, "<f8", 1, HEAD_BYTES + 8)[0]
    for kind in (np.dtype([("tick", "<u4"), ("bytes", "<u4")]), np.dtype([("tick", "<u4"), ("bytes", "<u8")])):
        blocks = np.frombuffer(body, kind, len(body) // kind.itemsize)
        tick, length = blocks["tick"].astype(np.float64), blocks["bytes"].astype(np.int64)
        if (np.diff(tick) >= 0.0).all() and (np.diff(length) >= 0).all() and length[-1] > 0:
            return float(start) - GPS_EPOCH_S, 1e-3 * tick, length
    raise InputError(f"time tags {path} must have blocks whose times and lengths ascend, has not: give RTKLIB's .tag")
