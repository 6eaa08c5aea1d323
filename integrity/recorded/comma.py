"""Reader of comma2k19 segments: one minute of highway with wheel speeds, IMU, receiver fixes and a reference pose.

Source of the layout: Schafer et al. 2018, "A Commute in Data: The comma2k19 Dataset" (arXiv 1812.05752). A segment is a
folder of NumPy arrays, in the original without the suffix ``.npy``. Reference poses are a smoothed solution of raw GNSS
and vision, in ECEF; orientations are quaternions that rotate the frame of the phone (x forward, y right, z down) to
ECEF.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import MAX_BYTES, UNTIMED, Timing, in_order, interpolated, notes

__all__ = ["Comma", "ReceiverFixes", "Reference", "Series", "read_comma", "read_rows"]

Array = NDArray[np.float64]
SLOWEST_S = 5.0  # between rows; the slowest series has some ten rows a second
MAX_HEADER = 4096  # bytes; the header of a plain array has 118


@dataclass(frozen=True)
class Series:
    """Times (N,) [s], strictly increasing, values (N,) or (N, k), and what the times show."""

    time_s: Array
    value: Array
    timing: Timing = UNTIMED

    def at(self, time_s: Array) -> Array:
        """Interpolate values (T,) or (T, k) at times (T,): linear between samples, constant beyond them."""
        return interpolated(time_s, self.time_s, self.value)

    def earlier(self, by_s: float) -> Series:
        """The series with all its times earlier."""
        return Series(self.time_s - by_s, self.value, replace(self.timing, gaps_s=self.timing.gaps_s - by_s))


@dataclass(frozen=True)
class Reference:
    """Reference pose: time (N,) [s], position and velocity (N, 3) ECEF [m, m/s], quaternion (N, 4) w x y z."""

    time_s: Array
    position_ecef_m: Array
    velocity_ecef_mps: Array
    quaternion: Array
    timing: Timing = UNTIMED


@dataclass(frozen=True)
class ReceiverFixes:
    """Fixes of the u-blox receiver: time (N,) [s], latitude and longitude [deg], speed [m/s], course [deg]."""

    time_s: Array
    latitude_deg: Array
    longitude_deg: Array
    speed_mps: Array
    course_deg: Array
    timing: Timing = UNTIMED


@dataclass(frozen=True)
class Comma:
    """A segment: reference, speed of the car [m/s] and of its four wheels [m/s], acceleration [m/s^2] and rotation rate
    [rad/s] (forward, right, down), and fixes or None."""

    reference: Reference
    speed: Series
    wheel_speed: Series
    acceleration: Series
    rotation_rate: Series
    fixes: ReceiverFixes | None

    @property
    def notes(self) -> dict[str, str]:
        """By array, rows that are left out, and gaps."""
        parts = (self.reference, self.speed, self.wheel_speed, self.acceleration, self.rotation_rate, self.fixes)
        return notes(*((part.timing.name, None, part.timing) for part in parts if part is not None))

    def bridged(self, time_s: Array, before_s: float = 0.0, after_s: float = 0.0) -> NDArray[np.bool_]:
        """Whether times (T,) lie in a gap of the reference, of the speed or of the gyro, widened as given."""
        parts = (self.reference, self.speed, self.rotation_rate)
        return np.asarray(np.any([part.timing.bridged(time_s, before_s, after_s) for part in parts], axis=0))


def read_comma(folder: str | Path) -> Comma:
    """Read a segment from its folder (``global_pose``, ``CAN``, ``IMU`` and, optionally, ``GNSS/live_gnss_ublox``).

    Raises
    ------
    InputError
        A required array is missing, malformed or of another length than its times, or a tenth of its times go back;
        the message gives the file.
    """
    reader = _Reader(Path(folder))
    pose = Path("global_pose")
    time = reader.rows(pose / "frame_times")
    position = reader.rows(pose / "frame_positions", 3)
    velocity = reader.rows(pose / "frame_velocities", 3)
    turn = reader.rows(pose / "frame_orientations", 4)
    keep, timing = _ordered("global_pose/frame_times", time, positions=position, velocities=velocity, orientations=turn)
    reference = Reference(time[keep], position[keep], velocity[keep], turn[keep], timing)
    speed, wheels = reader.series("CAN/speed"), reader.series("CAN/wheel_speed", 4)
    acceleration, rate = reader.series("IMU/accelerometer", 3), reader.series("IMU/gyro", 3)
    fixes = _fixes(reader)
    return Comma(reference, speed, wheels, acceleration, rate, fixes)


def read_rows(path: str | Path, columns: int | None, max_bytes: int = MAX_BYTES) -> Array:
    """Read rows (N,) or, with ``columns``, (N, columns) of a NumPy array file as float64.

    Raises
    ------
    InputError
        The file cannot be read, is truncated or too large, is not an array of real numbers of this shape, or contains a
        number that is not finite.
    """
    source = Path(path)
    try:
        size = source.stat().st_size
        if size > max_bytes:
            raise InputError(f"{path} must have at most {max_bytes} bytes, has {size}: split it")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers written by Python 2
            # memory-mapped: a header that declares more than the file contains allocates no memory
            found = np.load(source, mmap_mode="r", allow_pickle=False, max_header_size=MAX_HEADER)
    except OSError as error:
        raise InputError(f"{path} must be a readable file, got {error.strerror or error}: correct the path") from error
    except InputError:
        raise
    except Exception as error:  # NumPy's header parser raises errors of many types
        raise InputError(f"{path} must be a complete NumPy array file (.npy), got: {str(error)[:200]}") from error
    if not isinstance(found, np.ndarray):
        found.close()
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiu" or found.dtype.itemsize > 8:
        kind = getattr(found, "dtype", type(found).__name__)
        raise InputError(f"{path} must hold real numbers, got {kind}: save them as float64")
    rows = found[:, 0] if columns is None and found.ndim == 2 and found.shape[1] == 1 else found
    wanted = () if columns is None else (columns,)
    if not rows.ndim or rows.shape[1:] != wanted:
        expected = ", ".join(["N", *map(str, wanted)])
        raise InputError(f"{path} must have shape ({expected}), got {rows.shape}: transpose or slice it")
    numbers = np.array(rows, dtype=np.float64)
    if not np.isfinite(numbers).all():
        bad = int(np.argwhere(~np.isfinite(numbers))[0][0])
        raise InputError(f"{path} must be finite, got {numbers[bad]} in row {bad}: remove this row from all arrays")
    return numbers


def _ordered(name: str, time_s: Array, **values: Array) -> tuple[NDArray[np.bool_], Timing]:
    """As in_order, of times in seconds and as many rows of each array of values."""
    for what, rows in values.items():
        if len(rows) != time_s.size:  # a row too few may be the first, a middle or the last one
            raise InputError(
                f"{name} and its {what} must have as many rows as each other, got {time_s.size} and {len(rows)}: one "
                "of the files is cut; download it again"
            )
    usual_s = float(np.median(np.abs(np.diff(time_s)))) if time_s.size > 1 else 0.0
    if usual_s > SLOWEST_S:
        raise InputError(f"{name} must be in s, most rows are {usual_s:g} s apart: are they in ms? Convert them")
    return in_order(name, time_s, rows=np.column_stack([time_s, *values.values()]))


def _fixes(reader: _Reader) -> ReceiverFixes | None:
    """Columns of live_gnss: latitude, longitude, speed, time stamp, altitude, course."""
    if reader.path(Path("GNSS/live_gnss_ublox/t")) is None:
        return None
    found = reader.series("GNSS/live_gnss_ublox", 6)
    latitude, longitude, speed, _, _, course = found.value.T
    return ReceiverFixes(found.time_s, latitude, longitude, speed, course, found.timing)


class _Reader:
    """Arrays of one folder."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder} must be a folder of a comma2k19 segment: give the folder with global_pose")
        self.folder = folder

    def path(self, name: Path) -> Path | None:
        """The file of an array, with or without the suffix; None if the file does not exist."""
        plain = self.folder / name
        return next((p for p in (plain.with_name(f"{plain.name}.npy"), plain) if p.is_file()), None)

    def rows(self, name: Path, columns: int | None = None) -> Array:
        """Rows of a required array."""
        path = self.path(name)
        if path is None:
            raise InputError(f"{self.folder / name}(.npy) must exist, got none: is {self.folder} a comma2k19 segment?")
        found = read_rows(path, columns)
        if not len(found):
            raise InputError(f"{path} must hold at least one row, got none: download it again")
        return found

    def series(self, name: str, columns: int | None = None) -> Series:
        """The series of ``NAME/t`` and ``NAME/value``."""
        time, value = self.rows(Path(name) / "t"), self.rows(Path(name) / "value", columns)
        keep, timing = _ordered(f"{name}/t", time, value=value)
        return Series(time[keep], value[keep], timing)
