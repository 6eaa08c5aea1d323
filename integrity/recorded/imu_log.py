"""Reader of inertial logs with a GNSS solution: the format of rtklibexplorer's GNSS_IMU drives.

A drive is three files. ``imu.csv`` has 100 lines a second without a head: specific force [g] on three axes, rates
[deg/s] on three axes, time since power-up [ms]; logging may begin and end within a line. ``imu.csv.tag`` is RTKLIB's
time-tag file of it: 60 bytes of text, tick at the start (u4), GPS time at the start as seconds since 1970 (u4) and
their fraction (f8), then for each received block the time since the start [ms] (u4) and the length of the file at that
moment (u4, or u8 in later versions); little endian. A solution of RTKLIB lies next to it
(:mod:`~lanebound.integrity.recorded.rtklib`).

The sensor's clock is tied to GPS time by a line fitted to all tags. Axes of the log are forward, left, up; those here
forward, right, down. A sensor that is mounted askew is levelled by gravity at rest (:func:`levelled`), which leaves its
azimuth in the vehicle as it is.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import GPS_EPOCH_S, UNTIMED, Lines, Stop, Timing, finite_number, in_order

__all__ = ["G_MPS2", "ImuLog", "levelled", "read_imu_log"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

G_MPS2 = 9.80665  # standard gravity, BIPM 1901
HEAD_BYTES, START_BYTES = 60, 16
COLUMNS = (
    *((f"specific force {axis}", -50.0, 50.0) for axis in "xyz"),
    *((f"rate {axis}", -4000.0, 4000.0) for axis in "xyz"),
    ("time since power-up", 0.0, 5e9),
)
SIGNS = np.array([1.0, -1.0, -1.0])  # from forward, left, up to forward, right, down
REST_S, LEAST_ROWS = 2.0, 10
FORCE_UNITS = {"m/s^2": G_MPS2, "mg": 1e3, "cm/s^2": 100.0 * G_MPS2, "ft/s^2": G_MPS2 / 0.3048}
CLOCKS = (0.99, 1.01)  # rate of GPS time against a sensor's clock
CLOCK_UNITS = {"s": 1e3, "us": 1e-3, "ns": 1e-6}
UNTAGGED_S = 1.0  # without tags at the end of a log; blocks come every some hundredths
MOST_OFF_S = 0.1  # nine tenths of the tags from a line; blocks come within some hundredths


@dataclass(frozen=True)
class ImuLog:
    """Samples (N,): GPS time [s since 1980-01-06], specific force [m/s^2] and rate [rad/s] (N, 3) on forward, right,
    down; ``stopped`` is the place where a truncated file ends, ``tags`` what of the time tags is missing, "" for
    nothing."""

    gps_time_s: Array
    force_mps2: Array
    rate_radps: Array
    stopped: Stop | None
    timing: Timing = UNTIMED
    tags: str = ""

    @property
    def rate_hz(self) -> float:
        """Samples in a second."""
        return float(1.0 / np.median(np.diff(self.gps_time_s)))


def read_imu_log(path: str | Path, tag: str | Path | None = None) -> ImuLog:
    """Read an inertial log, plain or gzip, and its time tags (by default ``PATH.tag``).

    A first line that is cut is left out, and so is a last one. A gzip log keeps the tags of its plain text.

    Raises
    ------
    InputError
        A file cannot be read, a line between the first and the last is malformed, or fewer than ten samples remain.
    """
    rows, ends, line_of, stop = _samples(path)
    if len(rows) < LEAST_ROWS:
        raise InputError(f"{path} must have at least {LEAST_ROWS} samples, got {len(rows)}: is it the log of an IMU?")
    clock_s = 1e-3 * rows[:, 6] - 1e-3 * rows[0, 6]
    keep, timing = in_order(path, clock_s, rows=rows)
    rows, ends, line_of, clock_s = rows[keep], ends[keep], line_of[keep], clock_s[keep]
    tags = Path(f"{path}.tag" if tag is None else tag)
    start_s, tick_s, received, rest = _tags(tags)
    # a copy whose line ends were changed has one byte less in each line than the tags count
    fits = [_clock(path, clock_s, read, timing, tick_s, received) for read in (ends, ends + line_of)]
    rate, offset, off_s = min(fits, key=lambda fit: fit[2])
    # what an edited log shows; with its own tags the two agree to a block
    counts = (
        f". Tags count the bytes of the log, {received[-1]} where it has {ends[-1]}: write changed numbers "
        "as wide as those recorded, or make the tags anew"
    )
    unit = next((unit for unit, factor in CLOCK_UNITS.items() if 0.9 < rate / factor < 1.1), "")
    if off_s > MOST_OFF_S and not unit:
        raise InputError(
            f"the clock of {path} must keep to a line through its time tags within {MOST_OFF_S:g} s, is {off_s:.2f} s "
            f"off: one of them jumps, or the tags are of another log; cut the files there, or give its own tags{counts}"
        )
    if not CLOCKS[0] < rate < CLOCKS[1]:
        raise InputError(
            f"the clock of {path} must run within 1 % of its time tags, got a factor of {rate:.4f}: "
            f"{f'it is probably in {unit}, not in ms' if unit else f'give its own tags{counts}'}"
        )
    start = start_s + offset
    timing = replace(timing, gaps_s=start + rate * timing.gaps_s)
    after_s = rate * clock_s[-1] + offset - tick_s[-1]
    if after_s > UNTAGGED_S:
        rest = f"time tags end {after_s:.1f} s before the log, whose later times are those of its own clock"
    return ImuLog(
        start + rate * clock_s, G_MPS2 * SIGNS * rows[:, :3], np.radians(SIGNS * rows[:, 3:6]), stop, timing, rest
    )


def _clock(
    path: str | Path, clock_s: Array, ends: Ints, timing: Timing, tick_s: Array, received: Ints
) -> tuple[float, float, float]:
    """Rate and offset of the time tags against the clock of the rows, and what most tags are off at most [s]."""
    newest = np.searchsorted(ends, received, side="right") - 1  # last whole line that a block has brought
    # blocks beyond the end of a log that is cut, or in a gap, bring no line: they say nothing of the clock
    silent = np.isin(clock_s[np.maximum(newest, 0)], timing.gaps_s[:, 0]) | (newest == ends.size - 1)
    known = (newest >= 0) & ~(silent & (np.diff(newest, prepend=-1) == 0))
    if known.sum() < 2:
        raise InputError(f"{path} and its time tags must belong together, {int(known.sum())} tags fit: give its own")
    rate, offset = np.polyfit(clock_s[newest[known]], tick_s[known], 1)
    off = np.abs(tick_s[known] - offset - rate * clock_s[newest[known]])
    return float(rate), float(offset), float(np.quantile(off, 0.9))


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
    size = float(np.linalg.norm(mean)) / G_MPS2
    if not abs(size - 1.0) < 0.05:
        unit = next(
            (f"it is probably in {u}, not in g" for u, f in FORCE_UNITS.items() if abs(size / f - 1.0) < 0.05), ""
        )
        raise InputError(
            f"the first {rest_s:g} s must be at rest, got a mean force of {size * G_MPS2:.2f} m/s^2: "
            f"{unit or 'give another length'}"
        )
    roll = float(np.arctan2(-mean[1], -mean[2]))
    pitch = float(np.arctan2(mean[0], np.hypot(mean[1], mean[2])))
    (cr, sr), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (roll, pitch))
    turn = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])  # body to level
    return replace(log, force_mps2=log.force_mps2 @ turn.T, rate_radps=log.rate_radps @ turn.T), roll, pitch


def _samples(path: str | Path) -> tuple[Array, Ints, Ints, Stop | None]:
    """Numbers of the whole lines (N, 7), the byte after each (N,), for lines that end in LF alone also their numbers
    (N,), otherwise zeros, and the place where reading stopped."""
    lines, refusal, found, places = Lines(path), "", array("d"), array("q")
    stop: Stop | None = None
    text_bytes = 0
    for text in lines:
        if refusal:
            raise InputError(refusal)
        text_bytes += len(text) + 1
        try:
            numbers = _numbers(text)
        except ValueError as error:
            if lines.number > 1 and text.strip():
                refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
            continue
        found.extend(numbers)
        places.extend((lines.read, lines.number))
    at = np.array(places, dtype=np.int64).reshape(-1, 2)
    plain = lines.read - text_bytes < 0.5 * lines.number
    return np.array(found).reshape(-1, len(COLUMNS)), at[:, 0], at[:, 1] * plain, stop or lines.stop


def _numbers(text: str) -> list[float]:
    words = text.split(",")
    if ";" in text or "\t" in text:  # then commas are inside numbers
        words = text.replace("\t", ";").split(";")
    if len(words) < len(COLUMNS):
        raise ValueError(
            f"must have {len(COLUMNS)} columns between commas, semicolons or tabs, got {len(words)}: the line is "
            "truncated"
        )
    values = []
    for (name, low, high), word in zip(COLUMNS, words, strict=False):
        try:
            values.append(finite_number(word, low, high))
        except ValueError as error:
            raise ValueError(f"{name} {error}") from None
    return values


def _tags(path: Path) -> tuple[float, Array, Ints, str]:
    """GPS time at the start [s since 1980-01-06], of each block the time since then [s] and the bytes so far, and a
    note where the last block is cut."""
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
            cut = "time tags are cut inside their last block" if len(body) % kind.itemsize else ""
            return float(start) - GPS_EPOCH_S, 1e-3 * tick, length, cut
    raise InputError(f"time tags {path} must have blocks whose times and lengths ascend, has not: give RTKLIB's .tag")
