"""Recorded skies: reception of signals by direction and distance along a recorded drive, as a CSV file.

::

    satellite,arc_m,azimuth_deg,elevation_deg,path,excess_m,cn0_dbhz
    G12,2.5,141.2,85.1,los,0.0,50.0

Azimuths are clockwise from the direction of travel: an obstacle to the left of the car is also on the left on another
road. ``path`` is ``los``, ``foliage`` (weak but not delayed), ``reflected`` (delayed by ``excess_m``) or ``blocked``
(above the horizon and not received; the C/N0 is 0). The drive of any receiver can be written in this format.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import Lines, Stop, finite_number, require_degrees
from lanebound.integrity.sky.visibility import SignalPath

__all__ = ["SkyRecording", "read_sky_recording"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

HEAD = "satellite,arc_m,azimuth_deg,elevation_deg,path,excess_m,cn0_dbhz"
NUMBERS = (
    ("arc_m", 0.0, 1e6),
    ("azimuth_deg", -360.0, 360.0),
    ("elevation_deg", 0.0, 90.0),
    ("excess_m", 0.0, 1e4),
    ("cn0_dbhz", 0.0, 100.0),
)
PATHS = {path.name.lower(): int(path) for path in SignalPath if path <= SignalPath.BLOCKED}  # those of masks
LONGEST_NAME = 8
LONGEST_STEPS, LONGEST_GAP_M = 10.0, 100.0  # of the usual distance between rows, and without any
MOST_BYTES = 32 * 2**20  # about 600,000 rows, 3,000 km of street
# Scales of the distance between rows: half a house front along the street, and angles; elevation has more influence
# than azimuth. In Berlin (leave-one-satellite-out) these scales predict 79 % of the rows correctly; with half or twice
# any of them it is 72 to 80 %.
ALONG_M, ELEVATION_RAD, AZIMUTH_RAD = 10.0, np.deg2rad(8.0), np.deg2rad(16.0)


@dataclass(frozen=True)
class SkyRecording:
    """Rows (N,), one for each satellite and stretch of the drive; look-ups use the nearest row.

    Attributes
    ----------
    satellite : name, as ``G12``
    arc_m : distance driven [m]
    azimuth_rad : clockwise from the direction of travel
    elevation_rad : above the horizon
    path : uint8, values of :class:`~lanebound.integrity.sky.visibility.SignalPath`
    excess_m : excess path of a reflected signal; 0 for others
    cn0_dbhz : C/N0, 0 if not received
    length_m : length of the drive, which is used as a loop
    stopped : the place where a truncated file ended
    """

    satellite: NDArray[np.str_]
    arc_m: Array
    azimuth_rad: Array
    elevation_rad: Array
    path: NDArray[np.uint8]
    excess_m: Array
    cn0_dbhz: Array
    length_m: float
    stopped: Stop | None = None

    @cached_property
    def digest(self) -> str:
        """Digest of the contents; equal recordings have equal digests."""
        h = hashlib.blake2b(repr(self.length_m).encode(), digest_size=16)
        for name in ("arc_m", "azimuth_rad", "elevation_rad", "path", "excess_m"):
            h.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        return h.hexdigest()

    def rows(self, chosen: Bools) -> SkyRecording:
        """A recording of the chosen rows (N,) with the same length."""
        columns = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in ("length_m", "stopped")}
        return replace(self, **columns)

    def nearest(self, arc_m: Array, azimuth_rad: Array, elevation_rad: Array) -> NDArray[np.int64]:
        """Find the nearest row for distances (n,) along the drive, which is a loop, and directions (n,).  -> (n,)."""
        wanted = _coordinates(np.mod(arc_m, self.length_m), azimuth_rad, elevation_rad)
        _, row = self._tree.query(wanted)
        return np.asarray(row % self.arc_m.size, dtype=np.int64)

    @cached_property
    def _tree(self) -> cKDTree:
        """All rows three times: the drive, and the laps before and after it."""
        laps = [self.arc_m + k * self.length_m for k in (0, -1, 1)]
        return cKDTree(np.concatenate([_coordinates(arc, self.azimuth_rad, self.elevation_rad) for arc in laps]))

    def save(self, path: str | Path) -> None:
        """Write the file.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        names = [kind.name.lower() for kind in SignalPath]
        columns = (np.degrees(self.azimuth_rad), np.degrees(self.elevation_rad), self.excess_m, self.cn0_dbhz)
        lines = [
            f"{self.satellite[i]},{self.arc_m[i]:.2f},{columns[0][i]:.2f},{columns[1][i]:.2f},{names[self.path[i]]},"
            f"{columns[2][i]:.2f},{columns[3][i]:.1f}"
            for i in np.argsort(self.arc_m, kind="stable")
        ]
        try:
            Path(path).write_text("\n".join([f"# length_m={self.length_m:.2f}", HEAD, *lines, ""]), "utf-8")
        except OSError as error:
            raise InputError(f"{path} must be a file that can be written, got: {error}; choose another") from error


def _coordinates(arc_m: Array, azimuth_rad: Array, elevation_rad: Array) -> Array:
    """Places and directions as points with a meaningful Euclidean distance.  (n,) -> (n, 4)."""
    flat = np.cos(elevation_rad) / AZIMUTH_RAD
    parts = (arc_m / ALONG_M, elevation_rad / ELEVATION_RAD, flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad))
    return np.stack(np.broadcast_arrays(*parts), -1)


def read_sky_recording(path: str | Path) -> SkyRecording:
    """Read a recording from its file, plain or gzip; a malformed last line is treated as truncated.

    Raises
    ------
    InputError
        The file cannot be read, a line before the last is malformed, or there are no rows.
    """
    lines, refusal = Lines(path, MOST_BYTES), ""
    stop: Stop | None = None
    length, headed = 0.0, False
    names: list[str] = []
    kinds: list[int] = []
    values: list[list[float]] = []
    for text in lines:
        if refusal:
            raise InputError(refusal)
        try:
            if text.startswith("#") or not text.strip():
                length = _length(text) or length
            elif not headed:
                headed = _is_head(text)
            else:
                name, kind, numbers = _row(text.split(","))
                names.append(name)
                kinds.append(kind)
                values.append(numbers)
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
    if not names:
        raise InputError(
            f"{path} must hold rows under '{HEAD}', has none: {refusal or 'is it of lanebound record-sky?'}"
        )
    table = np.array(values)
    require_degrees(f"elevations of {path}", table[:, 2])
    require_degrees(f"azimuths of {path}", table[:, 1], 2.0 * np.pi)
    _require_cover(path, np.unique(table[:, 0]))
    if not length > table[:, 0].max() * (1.0 - 1e-6):
        raise InputError(
            f"{path} must give '# length_m=' of the drive, at least its largest arc_m {table[:, 0].max():g}, got "
            f"{length:g}: correct the first line"
        )
    return SkyRecording(
        np.array(names), table[:, 0], np.radians(table[:, 1]), np.radians(table[:, 2]), np.array(kinds, np.uint8),
        table[:, 3], table[:, 4], length, stop or lines.stop,
    )  # fmt: skip


def _require_cover(path: str | Path, arc_m: Array) -> None:
    """Refuse a drive with a long part without any row, for which the rows of another place would be taken."""
    step = np.diff(arc_m)
    if not step.size:
        return
    longest = int(np.argmax(step))
    if step[longest] > max(LONGEST_STEPS * float(np.median(step)), LONGEST_GAP_M):
        raise InputError(
            f"{path} must have rows along the whole drive, has none between {arc_m[longest]:g} and "
            f"{arc_m[longest + 1]:g} m: record it again, or cut it there"
        )


def _length(text: str) -> float:
    """The length given in a comment line, 0 for other comments."""
    key, _, value = text.lstrip("# ").partition("=")
    if key.strip() != "length_m":
        return 0.0
    return finite_number(value, 1.0, 1e6)


def _is_head(text: str) -> bool:
    if text.strip() != HEAD:
        raise ValueError(f"the head must be '{HEAD}', got {text[:40]!r}")
    return True


def _row(cells: list[str]) -> tuple[str, int, list[float]]:
    """Satellite, kind of path and numbers of a line; ValueError with the column."""
    if len(cells) != len(HEAD.split(",")):
        raise ValueError(f"the line must have {len(HEAD.split(','))} columns, got {len(cells)}: it is truncated")
    name, kind = cells[0].strip(), cells[4].strip()
    if not 0 < len(name) <= LONGEST_NAME:
        raise ValueError(f"satellite must have 1 to {LONGEST_NAME} letters, got {name[:40]!r}")
    if kind not in PATHS:
        raise ValueError(f"path must be one of {', '.join(PATHS)}, got {kind[:40]!r}")
    numbers = []
    for (column, low, high), text in zip(NUMBERS, [*cells[1:4], *cells[5:]], strict=True):
        try:
            numbers.append(finite_number(text, low, high))
        except ValueError as error:
            raise ValueError(f"{column} {error}") from None
    if (numbers[3] > 0.0) != (kind == "reflected"):
        raise ValueError(f"excess_m must be above 0 for reflected signals and 0 for others, got {numbers[3]:g}, {kind}")
    return name, PATHS[kind], numbers
