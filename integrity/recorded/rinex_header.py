"""Parser of the header of a RINEX 3 observation file (IGS/RTCM RINEX Version 3.04, tables A1-A2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import enu_axes
from lanebound.integrity.core.packed import CRINEX_REMEDY
from lanebound.integrity.recorded.source import finite_number, whole_number

__all__ = ["FIRST_LABEL", "LABEL_AT", "SYSTEMS", "Header", "HeaderBuilder", "b1_in_band_2"]


LABEL_AT = 60
FIRST_LABEL = "RINEX VERSION / TYPE"
MAX_CODES = 999
SYSTEMS = "GRESCJI"
TIME_SYSTEMS = ("GPS", "GLO", "GAL", "QZS", "BDT", "IRN", "UTC")
KINDS = "CLDSXI"  # code, phase, Doppler, strength, channel number, ionospheric delay
B1_IN_BAND_1 = 3.02  # the only version in which BeiDou's B1I (1561.098 MHz) is band 1; it is band 2 in all others


@dataclass(frozen=True)
class Header:
    """Contents of the header.

    ``codes`` are the observation codes of each system letter in the order of their columns, BeiDou's B1I in band 2 for
    all versions (:func:`b1_in_band_2`); ``scale`` divides the stored values of (system, code); ``channel`` is the
    frequency number of a GLONASS satellite; ``position_ecef_m`` is the position of the marker or None;
    ``antenna_delta_enu_m`` is the vector from the marker to the antenna reference point; ``antenna_delta_body_m`` is
    that of a vehicle on its own axes.
    """

    version: float
    marker: str
    receiver: str
    antenna: str
    position_ecef_m: tuple[float, float, float] | None
    antenna_delta_enu_m: tuple[float, float, float]
    codes: dict[str, tuple[str, ...]]
    scale: dict[tuple[str, str], float]
    channel: dict[int, int]
    interval_s: float | None
    time_system: str
    leap_s: int | None
    antenna_delta_body_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def antenna_ecef_m(self) -> NDArray[np.float64] | None:
        """Antenna reference point (3,) [m]: marker plus ANTENNA: DELTA H/E/N (RINEX 3.04 table A2), or None."""
        if self.position_ecef_m is None:
            return None
        marker = np.array(self.position_ecef_m)
        return np.asarray(marker + enu_axes(marker) @ np.array(self.antenna_delta_enu_m))


@dataclass
class HeaderBuilder:
    """Parses header lines one by one; ``build`` is called after END OF HEADER. All errors are ValueErrors."""

    version: float | None = None
    marker: str = ""
    receiver: str = ""
    antenna: str = ""
    position: tuple[float, float, float] | None = None
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    body: tuple[float, float, float] = (0.0, 0.0, 0.0)
    codes: dict[str, list[str]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    scale: dict[tuple[str, str], float] = field(default_factory=dict)
    channel: dict[int, int] = field(default_factory=dict)
    interval: float | None = None
    time_system: str = ""
    leap: int | None = None
    kind: str = ""
    ended: bool = False
    system: str = ""
    scaled: tuple[str, float, int] = ("", 1.0, 0)

    def take(self, line: str) -> None:
        """Parse one line of the header."""
        label, text = line[LABEL_AT:].strip(), line[:LABEL_AT]
        if self.version is None and label != FIRST_LABEL:
            remedy = CRINEX_REMEDY if label.startswith("CRINEX") else "is it a RINEX file?"
            raise ValueError(f"the first line must be 'RINEX VERSION / TYPE', got {line[:80]!r}: {remedy}")
        reader = READERS.get(label)
        if reader is not None and (text.strip() or label in NEVER_BLANK):  # a blank optional record is a missing one
            reader(self, text)

    def build(self) -> Header:
        """The header from all lines."""
        assert self.version is not None
        for system, count in self.counts.items():
            if len(self.codes[system]) != count:
                raise ValueError(
                    f"SYS / # / OBS TYPES of {system} must list {count} codes, got {len(self.codes[system])}"
                )
        if not self.codes:
            raise ValueError("the header must have SYS / # / OBS TYPES, got none: is it a RINEX observation file?")
        return Header(
            self.version, self.marker, self.receiver, self.antenna, self.position, self.offset,
            {s: self._columns(s, c) for s, c in self.codes.items()},
            {(s, self._named(s, code)): factor for (s, code), factor in self.scale.items()},
            dict(self.channel), self.interval, self.time_system or ("BDT" if set(self.codes) == {"C"} else "GPS"),
            self.leap, self.body,
        )  # fmt: skip

    def _columns(self, system: str, codes: list[str]) -> tuple[str, ...]:
        """Codes in the names of most versions; refused if two columns get the same name."""
        named = tuple(self._named(system, code) for code in codes)
        for old, new in zip(codes, named, strict=True):
            if old != new and named.count(new) > 1:
                raise ValueError(
                    f"SYS / # / OBS TYPES of {system} must have BeiDou's B1I in one column, got {old} and {new}, which "
                    "are both B1I: remove one (for instance with gfzrnx)"
                )
        return named

    def _named(self, system: str, code: str) -> str:
        assert self.version is not None
        return b1_in_band_2(code, self.version) if system == "C" else code

    def _version(self, text: str) -> None:
        self.version = finite_number(text[:9], 0.0, 99.0)
        kind = text[20:21].upper()
        if not 3.0 <= self.version < 5.0:
            raise ValueError(
                f"RINEX version must be 2, 3 or 4, got {self.version:g}: convert the file (for instance with gfzrnx)"
            )
        if kind != "O":
            raise ValueError(f"the file must hold observations ('O'), got {text[20:40].strip()!r}")

    def _position(self, text: str) -> None:
        place = _triple(text, 1e8)
        self.position = place if any(place) and all(text[14 * i : 14 * i + 14].strip() for i in range(3)) else None

    def _offset(self, text: str) -> None:
        up, east, north = _triple(text, 1e4)
        self.offset = (east, north, up)

    def _body(self, text: str) -> None:
        self.body = _triple(text, 1e4)

    def _codes(self, text: str) -> None:
        if text[0] != " ":
            self.system = text[0]
            if self.system not in SYSTEMS:
                raise ValueError(f"SYS / # / OBS TYPES: the system must be one of {SYSTEMS}, got {text[0]!r}")
            self.counts[self.system] = whole_number(text[3:6], 1, MAX_CODES)
            self.codes[self.system] = []
        elif not self.system:
            raise ValueError("SYS / # / OBS TYPES: a continuation must follow a line with a system")
        for code in text[6:].split():
            if len(code) not in (2, 3) or code[0] not in KINDS:
                raise ValueError(f"SYS / # / OBS TYPES: a code is like C1C or L2W, got {code[:20]!r}")
            self.codes[self.system].append(code)
        if len(self.codes[self.system]) > self.counts[self.system]:
            raise ValueError(
                f"SYS / # / OBS TYPES of {self.system}: more codes than the declared {self.counts[self.system]}"
            )

    def _scale(self, text: str) -> None:
        if text[0] != " ":
            count = whole_number(text[8:10], 0, MAX_CODES) if text[8:10].strip() else 0
            factor = float(whole_number(text[2:6], 1, 10_000)) if text[2:6].strip() else 1.0
            self.scaled = (text[0], factor, count)
        system, factor, count = self.scaled
        for code in text[10:].split() if count else self.codes.get(system, ()):
            self.scale[system, code] = factor

    def _channels(self, text: str) -> None:
        for i in range(8):
            entry = text[4 + 7 * i : 11 + 7 * i]
            if entry.strip():
                if not entry[4:6].strip():
                    continue  # a satellite without its channel, which some receivers do not know
                if entry[0] != "R":
                    raise ValueError(f"GLONASS SLOT / FRQ #: an entry is like 'R01  1', got {entry!r}")
                self.channel[whole_number(entry[1:3], 0, 99)] = whole_number(entry[4:6], -12, 24)

    def _first(self, text: str) -> None:
        named = text[48:51].strip().upper()
        if named and named not in TIME_SYSTEMS:
            raise ValueError(
                f"TIME OF FIRST OBS: the time system must be one of {', '.join(TIME_SYSTEMS)}, got {named!r}"
            )
        self.time_system = named

    def _set_interval(self, text: str) -> None:
        self.interval = finite_number(text[:10], 0.0, 1e6) or None if text[:10].strip() else None

    def _leap(self, text: str) -> None:
        self.leap = whole_number(text[:6], -1000, 1000) if text[:6].strip() else None

    def _marker(self, text: str) -> None:
        self.marker = text.strip()

    def _receiver(self, text: str) -> None:
        self.receiver = text[20:].strip()

    def _antenna(self, text: str) -> None:
        self.antenna = text[20:40].strip()

    def _end(self, _text: str) -> None:
        self.ended = True


def _triple(text: str, bound: float) -> tuple[float, float, float]:
    """Three numbers of 14 columns, 0 for blanks."""
    cells = text[:14], text[14:28], text[28:42]
    x, y, z = (finite_number(cell, -bound, bound) if cell.strip() else 0.0 for cell in cells)
    return x, y, z


def b1_in_band_2(code: str, version: float) -> str:
    """Convert a BeiDou code to the name in all versions but 3.02: 1I, 1Q and 1X (1561.098 MHz) become 2I, 2Q and 2X.

    RINEX 3.05, note of table 19: readers of 3.02 treat both names alike. In the other versions 1I and 1Q are undefined,
    and B1C (1575.42 MHz, band 1 from 3.04 on) has no such channels; they are B1I as well. 1X is B1C there and does not
    change.
    """
    channels = "IQX" if round(version, 2) == B1_IN_BAND_1 else "IQ"
    return f"{code[0]}2{code[2]}" if code[1:2] == "1" and code[2:] in tuple(channels) else code


NEVER_BLANK = (FIRST_LABEL, "SYS / # / OBS TYPES", "END OF HEADER")
READERS = {
    FIRST_LABEL: HeaderBuilder._version,
    "MARKER NAME": HeaderBuilder._marker,
    "REC # / TYPE / VERS": HeaderBuilder._receiver,
    "ANT # / TYPE": HeaderBuilder._antenna,
    "APPROX POSITION XYZ": HeaderBuilder._position,
    "ANTENNA: DELTA H/E/N": HeaderBuilder._offset,
    "ANTENNA: DELTA X/Y/Z": HeaderBuilder._body,
    "SYS / # / OBS TYPES": HeaderBuilder._codes,
    "SYS / SCALE FACTOR": HeaderBuilder._scale,
    "GLONASS SLOT / FRQ #": HeaderBuilder._channels,
    "TIME OF FIRST OBS": HeaderBuilder._first,
    "INTERVAL": HeaderBuilder._set_interval,
    "LEAP SECONDS": HeaderBuilder._leap,
    "END OF HEADER": HeaderBuilder._end,
}
