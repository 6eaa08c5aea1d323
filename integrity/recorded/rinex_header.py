"""Header of a RINEX 3 observation file (IGS/RTCM RINEX Version 3.04, tables A1-A2), and RINEX 2 in lines of RINEX 3.

Version 2 (Gurtner and Estey 2007, RINEX version 2.11, tables A1 and A2) names a signal by observable and frequency
alone. GPS: C1 is C/A, P1 and P2 are P(Y), which civil receivers track semi-codelessly (W), C2 and the third frequency
are civil. The phase of a frequency is that of its C/A or, on L2, its P(Y) code, and of the civil code for a satellite
without P2. Galileo's components are not named: X. Rows of other systems are passed on without codes, so that they are
counted as left out.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import enu_axes
from lanebound.integrity.core.packed import CRINEX_REMEDY
from lanebound.integrity.recorded.source import finite_number, whole_number

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


FIELD, PER_LINE = 16, 5
PER_EPOCH_LINE, PER_HEADER_LINE, PER_NEW_HEADER_LINE = 12, 9, 13
TYPES_LABEL, NEW_TYPES_LABEL, END = "# / TYPES OF OBSERV", "SYS / # / OBS TYPES", "END OF HEADER"
WAVE_LABEL = "WAVELENGTH FACT L1/2"
MOST_TYPES, MOST_SATELLITES, LAST_FLAG, CYCLE_SLIPS = 99, 999, 6, 6
WITH_ROWS = (0, 1, CYCLE_SLIPS)  # flags of epochs with rows of satellites
CENTURY_FROM = 80  # two digits of a year from here on are of the 20th century

Column = tuple[str, int, int | None]
"""A code of RINEX 3, the column of version 2 that holds it, and one that must be blank for it, or None."""


def as_version_3(lines: Iterable[str]) -> Iterator[str]:
    """The lines of an observation file, those of RINEX 2 in the form of RINEX 3; any others as they are.

    Raises
    ------
    ValueError
        A line of RINEX 2 is malformed.
    """
    source = iter(lines)
    first = next(source, None)
    if first is None:
        return
    if first[LABEL_AT:].strip() != FIRST_LABEL or first[:9].strip()[:2] not in ("2", "2.") or first[20:21] != "O":
        yield first
        yield from source
        return
    yield f"     3.04{first[9:]}"
    types = yield from _header(source)
    columns = {system: _columns(system, types) for system in "GEJ"}
    rows, kind = -(-len(types) // PER_LINE), first[40:41]
    usual = kind if kind in tuple("RSEJ") else "G"  # of mixed files GPS
    for text in source:
        if text[LABEL_AT:].strip() == FIRST_LABEL:  # of a file that was joined to this one
            yield from as_version_3(chain([text], source))
        elif text.strip():
            yield from _epoch(text, source, types, columns, rows, usual)


def _header(source: Iterator[str]) -> Generator[str, None, list[str]]:
    """The header after its first line; returns the types of observables."""
    types: list[str] = []
    declared = 0
    for text in source:
        label = text[LABEL_AT:].strip()
        if label == TYPES_LABEL:
            declared = whole_number(text[:6], 1, MOST_TYPES) if text[:6].strip() else declared
            types += [text[6 + 6 * i : 12 + 6 * i].strip() for i in range(PER_HEADER_LINE)]
            types = [name for name in types if name]
        elif label == WAVE_LABEL and "2" in text[:12].split():
            raise ValueError(f"{WAVE_LABEL} must be 1: phases of half a wavelength (squaring receivers) are not read")
        elif label == END:
            if len(types) != declared:
                raise ValueError(f"{TYPES_LABEL} must list {declared} types, got {len(types)}")
            for system in "GEJ":
                yield from _new_types(system, [code for code, _, _ in _columns(system, types)])
            yield text
            break
        else:
            yield text
    return types


def _new_types(system: str, codes: list[str]) -> Iterator[str]:
    for start in range(0, len(codes), PER_NEW_HEADER_LINE):
        head = f"{system}  {len(codes):3d}" if start == 0 else " " * 6
        part = "".join(f" {code}" for code in codes[start : start + PER_NEW_HEADER_LINE])
        yield f"{head + part:<{LABEL_AT}}{NEW_TYPES_LABEL}"


def _columns(system: str, types: list[str]) -> list[Column]:
    """What becomes of the types of version 2 in a system."""
    at, out = {name: i for i, name in enumerate(types)}, list[Column]()
    for name, i in at.items():
        kind, band = name[:1], name[1:]
        if system == "E" and band in tuple("15678") and kind in tuple("CLDS"):
            out.append((f"{name}X", i, None))
        elif system == "J" and band in tuple("125") and kind in tuple("CLDS"):
            out.append((f"{name}{'C' if band == '1' else 'X'}", i, None))
        elif system != "G" or len(band) != 1:
            continue
        elif kind == "P" and band in "12":
            out.append((f"C{band}W", i, None))
        elif band == "1" and kind in "CLDS":
            out.append((f"{name}{'C' if 'C1' in at else 'W'}", i, None))
        elif band == "2" and kind in "LDS":
            if "P2" in at:
                out.append((f"{name}W", i, None))
            if "C2" in at:
                out.append((f"{name}X", i, at.get("P2")))
        elif band in "25" and kind in "CLDS":
            out.append((f"{name}X", i, None))
    return out


def _epoch(
    text: str, source: Iterator[str], types: list[str], columns: dict[str, list[Column]], rows: int, usual: str
) -> Iterator[str]:
    """One epoch and its rows; ``usual`` is the system of satellites without a letter."""
    flag = whole_number(text[26:29], 0, LAST_FLAG) if text[26:29].strip() else 0
    count = whole_number(text[29:32], 0, MOST_SATELLITES) if text[29:32].strip() else 0
    yield f">{_date(text[:26])}  {flag}{count:3d}"
    if flag not in WITH_ROWS:
        again: list[str] = []
        for _, event in zip(range(count), source, strict=False):
            same = event[LABEL_AT:].strip() == TYPES_LABEL
            again += event[6:LABEL_AT].split() if same else []
            if again != types[: len(again)]:
                raise ValueError(_changed(types, again))
            yield event if event.strip() and not same else f"{'':{LABEL_AT}}COMMENT"
        if again and again != types:
            raise ValueError(_changed(types, again))
        return
    names, more = text[32:68], count - PER_EPOCH_LINE
    while more > 0:
        names = f"{names:<{3 * (count - more)}}" + next(source, "")[32:68]
        more -= PER_EPOCH_LINE
    for k in range(count):
        name = names[3 * k : 3 * k + 3]
        cells = [next(source, None) for _ in range(rows)]
        if None in cells:
            return
        whole = "".join(f"{cell:<80}"[:80] for cell in cells if cell is not None)
        system = name[:1].strip() or usual
        yield f"{system}{whole_number(name[1:], 0, 99):02d}" + _row(whole, columns.get(system, []))


def _changed(types: list[str], again: list[str]) -> str:
    return f"types of observables must not change inside the file, from {types} to {again}: split it there"


def _row(cells: str, columns: list[Column]) -> str:
    """The values of a satellite in their new order."""
    found = []
    for _, i, blank in columns:
        taken = blank is None or not cells[FIELD * blank : FIELD * blank + 14].strip().strip("0.")
        found.append(cells[FIELD * i : FIELD * (i + 1)] if taken else " " * FIELD)
    return "".join(found).rstrip()


def _date(text: str) -> str:
    """The date of an epoch with four digits of the year; blank where it is blank, as before some events."""
    if not text.strip():
        return " " * 28
    year = whole_number(text[:3], 0, 99)
    second = finite_number(text[15:26], 0.0, 61.0)
    month, day, hour, minute = (whole_number(text[3 * i : 3 * i + 3], 0, 99) for i in range(1, 5))
    century = 1900 if year >= CENTURY_FROM else 2000
    return f" {century + year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d}{second:11.7f}"
