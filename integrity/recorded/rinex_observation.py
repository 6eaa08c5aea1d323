"""Reader of RINEX 2 to 4 observation files: code, phase, Doppler and strength of every signal at every epoch.

IGS/RTCM RINEX Version 3.04, table A3: an epoch line ``> year month day hour minute second flag number [clock]``, then
one line for each satellite with 16 characters for each observation code: F14.3, loss-of-lock indicator, strength. Times
are in the time system of the file; files in GLONASS time or UTC are refused because of their leap seconds. Rows of
systems without a list of codes and a few values that are no numbers are left out and counted. Version 2 is read in the
form of version 3 (:mod:`.rinex_header`).
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_header import (
    FIRST_LABEL,
    LABEL_AT,
    SYSTEMS,
    Header,
    HeaderBuilder,
    as_version_3,
    b1_in_band_2,
)
from lanebound.integrity.recorded.source import (
    BDT_BEHIND_GPS_S,
    MAX_BYTES,
    Lines,
    Stop,
    finite_number,
    in_order,
    whole_number,
)
from lanebound.integrity.sky.systems import PRN_BEFORE

__all__ = ["Move", "Observations", "SystemRows", "read_observations"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FIELD = 16
LOST, HALF = 1, 2  # bits of the loss-of-lock indicator, RINEX 3.04 section 6.7
WEEK_S = 604_800
ORIGIN = date(1980, 1, 6)
GOOD, POWER_FAILURE, CYCLE_SLIPS, MAX_FLAG, LEFT_OUT = 0, 1, 6, 6, 7  # of epochs; the last one is ours
MAX_SATELLITES = 999
# Records of the place of the antenna: their field of the header, and of a HeaderBuilder
SITE = {
    "APPROX POSITION XYZ": ("position_ecef_m", "position"), "ANTENNA: DELTA H/E/N": ("antenna_delta_enu_m", "offset"),
    "ANTENNA: DELTA X/Y/Z": ("antenna_delta_body_m", "body"),
}  # fmt: skip
STARTS_TO_MOVE, NEW_SITE, SAME_PLACE_M = 2, 3, 0.01
MOST_BACK = 0.1  # share of epochs that go back, and repeat no time, beyond which a file is refused
MOST_GARBLED = 20  # values that are no numbers; a file with more of them is damaged
DATE_PARTS = ("year", "month", "day", "hour", "minute")
SAME_TIME = ("GPS", "GAL", "QZS", "IRN", "BDT")


@dataclass(frozen=True)
class SystemRows:
    """Satellite epochs (N,) of one system: index of the epoch, PRN as in navigation messages (J01 is 193), values
    (N, codes), 0.0 for none (phases in cycles), and flags (N, codes): lock lost, half-cycle ambiguity possible.
    """

    codes: tuple[str, ...]
    epoch: Ints
    satellite: Ints
    value: Array
    lost: NDArray[np.bool_]
    half: NDArray[np.bool_]

    def column(self, code: str) -> Array:
        """Values of a code, zeros if the file does not contain the code.  (N,)."""
        return self.value[:, self.codes.index(code)] if code in self.codes else np.zeros(len(self.epoch))

    def lost_lock(self, code: str) -> NDArray[np.bool_]:
        """Whether lock of a code was lost since the previous epoch.  (N,)."""
        return self.lost[:, self.codes.index(code)] if code in self.codes else np.zeros(len(self.epoch), np.bool_)

    def half_cycle(self, code: str) -> NDArray[np.bool_]:
        """Whether a phase may be wrong by half a cycle.  (N,)."""
        return self.half[:, self.codes.index(code)] if code in self.codes else np.zeros(len(self.epoch), np.bool_)


@dataclass(frozen=True)
class Move:
    """A record inside a file by which the antenna moved: line, GPS week and time of week [s] of the epoch before it,
    what it says, and whether that is only of the approximate position, which need not be that of the antenna."""

    line: int
    week: int
    tow_s: float
    what: str
    approximate: bool = False

    def __str__(self) -> str:
        return f"line {self.line} (after week {self.week}, {self.tow_s:.1f} s): {self.what}"


@dataclass(frozen=True)
class Observations:
    """Header, GPS week (T,), time of week (T,) [s], power failure before an epoch (T,), and rows by system letter.

    ``stopped`` tells where reading ended before the end of the file, ``left_out`` how many epochs were not later than
    the one before and were left out (files that were joined, epochs that are there twice), ``undeclared`` how many rows
    were of systems without codes in the header, by letter, ``garbled`` how many values were no numbers, ``twice`` how
    many rows were of a satellite that its epoch has already, and ``moves`` where the file says that the antenna moved.
    """

    header: Header
    week: Ints
    tow_s: Array
    power_failed: NDArray[np.bool_]
    rows: dict[str, SystemRows]
    stopped: Stop | None
    left_out: int = 0
    undeclared: dict[str, int] = field(default_factory=dict)
    garbled: int = 0
    twice: int = 0
    moves: tuple[Move, ...] = ()

    @property
    def note(self) -> str:
        """What of the file was not used, "" for nothing."""
        late = f"{self.left_out} epochs left out that are not later than the one before" if self.left_out else ""
        rows = ", ".join(f"{count} of {letter}" for letter, count in self.undeclared.items())
        rows = f"rows left out of systems without SYS / # / OBS TYPES: {rows}" if rows else ""
        garbled = f"{self.garbled} values left out that are no numbers" if self.garbled else ""
        twice = f"{self.twice} rows left out of satellites that their epochs have already" if self.twice else ""
        moves = f"{self.moves[0]}, not followed" if self.moves else ""
        gaps = in_order("", self.since(0))[1].note
        return "; ".join(text for text in (str(self.stopped or ""), late, gaps, rows, garbled, twice, moves) if text)

    @property
    def half_cycle_share(self) -> float:
        """Share of the phases that may be wrong by half a cycle, and are not used."""
        phases = [
            (rows.column(code) != 0.0, rows.half_cycle(code))
            for rows in self.rows.values()
            for code in rows.codes
            if code[0] == "L"
        ]
        present = sum(int(there.sum()) for there, _ in phases)
        return sum(int((there & half).sum()) for there, half in phases) / max(present, 1)

    @property
    def epochs(self) -> int:
        """Number of epochs."""
        return len(self.tow_s)

    def since(self, week: int) -> Array:
        """Time of the epochs since the start of a GPS week.  (T,) [s]."""
        return np.asarray((self.week - week) * float(WEEK_S) + self.tow_s)


def read_observations(path: str | Path, max_bytes: int = MAX_BYTES) -> Observations:
    """Read the observations of a RINEX 2, 3 or 4 file, plain or gzip.

    An incomplete epoch at the end of the file is left out and reported in ``stopped``.

    Raises
    ------
    InputError
        The file cannot be read, is not a RINEX 2, 3 or 4 observation file, is malformed before its last epoch, or has
        no epoch.
    """
    lines = Lines(path, max_bytes)
    parser = _Parser(lines)
    refusal: Stop | None = None
    try:
        for text in as_version_3(lines):
            if refusal is not None and text.strip():
                raise InputError(f"{path}, line {refusal.line}: {refusal.reason}")
            if refusal is None and text.strip():
                try:
                    parser.take(text)
                except ValueError as error:
                    refusal = Stop(lines.number, str(error))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}, line {lines.number}: {error}") from None
    if refusal is None and lines.stop is None and parser.unfinished():
        refusal = Stop(lines.number, parser.unfinished())
    stopped = lines.stop or refusal
    if not lines.read:
        raise InputError(f"{path} must hold observations, is empty: download it again")
    if parser.header is None:
        raise InputError(f"{path} must have a complete RINEX header, {stopped or 'it has none'}: is it a RINEX 3 file?")
    return parser.result(path, stopped)


class _ObservationRows:
    """Growing rows of one system."""

    def __init__(self, codes: tuple[str, ...], scales: list[float]) -> None:
        self.codes, self.scales = codes, scales
        self.epoch, self.satellite = array("i"), array("h")
        self.value, self.lost = array("d"), array("b")

    def finished(self, epochs: int) -> SystemRows:
        """Arrays of the rows of complete epochs."""
        epoch = np.array(self.epoch, dtype=np.int64)
        keep = epoch < epochs
        shape = (len(epoch), len(self.codes))
        value = np.frombuffer(self.value, np.float64).reshape(shape)[keep] if len(epoch) else np.zeros(shape)
        flags = np.frombuffer(self.lost, np.int8).reshape(shape)[keep] if len(epoch) else np.zeros(shape, np.int8)
        satellite = np.array(self.satellite, dtype=np.int64)[keep]
        return SystemRows(self.codes, epoch[keep], satellite, value, (flags & LOST) != 0, (flags & HALF) != 0)


class _Parser:
    """Parser state: header, then epochs; ``left`` is the number of remaining lines of the current epoch."""

    def __init__(self, lines: Lines) -> None:
        self.lines, self.builder, self.event = lines, HeaderBuilder(), HeaderBuilder()
        self.header: Header | None = None
        self.rows: dict[str, _ObservationRows] = {}
        self.week, self.tow, self.power = array("q"), array("d"), array("b")
        self.left, self.flag, self.done, self.left_out = 0, GOOD, 0, 0
        self.undeclared: dict[str, int] = {}
        self.garbled, self.twice = 0, 0
        self.seen: set[str] = set()
        self.times: set[tuple[int, float]] = set()
        self.back = 0
        self.moves: list[Move] = []

    def unfinished(self) -> str:
        """The missing part at the end of the file, "" for none."""
        if self.header is None:
            return "END OF HEADER is missing"
        return f"the last epoch lacks {self.left} of its lines" if self.left else ""

    def take(self, text: str) -> None:
        """Parse one non-blank line."""
        if self.header is not None and not self.left and text[LABEL_AT:].strip() == FIRST_LABEL:
            self.builder = HeaderBuilder()  # of a file that was joined to this one
        if self.header is None or not self.builder.ended:
            self.builder.take(text)
            if self.builder.ended:
                self._start(self.builder.build())
        elif self.left == 0:
            self._epoch(text)
        else:
            self._below(text)
            self.left -= 1
            if self.left == 0:
                if self.event.version is not None:
                    self._end_event()
                self.done = len(self.tow)

    def _start(self, header: Header) -> None:
        if header.time_system not in SAME_TIME:
            raise ValueError(
                f"TIME OF FIRST OBS: epochs must be in GPS, Galileo, QZSS or BeiDou time, got {header.time_system}: "
                "convert the file"
            )
        if self.header is not None:
            if header.codes != self.header.codes or header.scale != self.header.scale:
                raise ValueError("joined files must have the same observation codes: process them one by one")
            for label in SITE:
                self._moved(label, self.builder)
            return
        self.header = header
        for system, codes in header.codes.items():
            self.rows[system] = _ObservationRows(codes, [header.scale.get((system, code), 1.0) for code in codes])

    def _epoch(self, text: str) -> None:
        if not text.startswith(">"):
            raise ValueError(f"an epoch must start with '>', got {text[:40]!r}")
        self.flag = whole_number(text[29:32] or "0", 0, MAX_FLAG) if text[29:32].strip() else GOOD
        self.left = whole_number(text[32:35], 0, MAX_SATELLITES)
        self.seen.clear()
        if self.flag == STARTS_TO_MOVE:
            self._note_move("the antenna starts to move")
        if self.header is not None and self.left and self.flag not in (GOOD, POWER_FAILURE, CYCLE_SLIPS):
            site: dict[str, Any] = {of: getattr(self.header, field) for field, of in SITE.values()}
            self.event = HeaderBuilder(self.header.version, marker=self.header.marker, **site)
        if self.flag in (GOOD, POWER_FAILURE):
            assert self.header is not None
            week, tow = _gps_time(text[1:29], BDT_BEHIND_GPS_S if self.header.time_system == "BDT" else 0.0)
            if self.tow and (week, tow) <= (self.week[-1], self.tow[-1]):
                self.flag, self.left_out = LEFT_OUT, self.left_out + 1
                self.back += (week, tow) not in self.times
                return
            self.times.add((week, tow))
            self.week.append(week)
            self.tow.append(tow)
            self.power.append(self.flag == POWER_FAILURE)
            if self.left == 0:
                self.done = len(self.tow)

    def _below(self, text: str) -> None:
        if self.flag in (CYCLE_SLIPS, LEFT_OUT):
            return
        if self.flag not in (GOOD, POWER_FAILURE):
            self._event_header(text)
            return
        rows = self.rows.get(text[0])
        if rows is None:
            self._undeclared(text)
            return
        try:
            satellite = whole_number(text[1:3], 0, 99) + PRN_BEFORE.get(text[0], 0)
        except ValueError as error:
            raise ValueError(f"the number of satellite {text[:3]!r} {error}") from None
        name = f"{text[0]}{satellite}"
        if name in self.seen:  # the first one counts; which is right cannot be known
            self.twice += 1
            return
        self.seen.add(name)
        values, lost, garbled = _fields(text, rows.codes)
        if garbled:
            self.garbled += 1
            if self.garbled > MOST_GARBLED:
                raise ValueError(f"{garbled}, after {MOST_GARBLED} other values that are no numbers: is it damaged?")
        rows.value.extend(value / scale for value, scale in zip(values, rows.scales, strict=True))
        rows.lost.extend(lost)
        rows.satellite.append(satellite)
        rows.epoch.append(len(self.tow) - 1)

    def _undeclared(self, text: str) -> None:
        """Count a row whose system has no codes; refuse what is no row of a satellite."""
        if text[0] == ">":
            raise ValueError(f"the epoch before must have as many records as its head counts, {self.left} are missing")
        if text[0] not in SYSTEMS:
            raise ValueError(
                f"satellite {text[:3]!r} must be of a system in SYS / # / OBS TYPES ({''.join(self.rows)})"
            )
        self.undeclared[text[0]] = self.undeclared.get(text[0], 0) + 1

    def _event_header(self, text: str) -> None:
        """Parse a header line inside the file; what has no label of a header is passed over."""
        self.event.take(text)
        label = text[LABEL_AT:].strip()
        if label == "SYS / SCALE FACTOR" and text[:LABEL_AT].strip() and not self.event.scale:
            assert self.header is not None
            system, factor, _ = self.event.scaled  # of all its codes
            self.event.scale = {(system, code): factor for code in self.header.codes.get(system, ())}
        if label in SITE:
            self._moved(label, self.event)

    def _end_event(self) -> None:
        """Refuse columns that an event changed; the same ones again change nothing."""
        if self.flag == NEW_SITE and self.header is not None and self.event.marker != self.header.marker:
            self._note_move(f"a new site is occupied, {self.event.marker}")
        event, self.event = self.event, HeaderBuilder()
        assert event.version is not None
        assert self.header is not None
        codes = event.build().codes if event.codes else {}
        for system, columns in codes.items():
            if columns != self.header.codes.get(system):
                raise ValueError(
                    f"observation codes of {system} must not change inside the file, from "
                    f"{' '.join(self.header.codes.get(system, ('none',)))} to {' '.join(columns)}: split it there"
                )
        scale = {(s, b1_in_band_2(c, event.version) if s == "C" else c): f for (s, c), f in event.scale.items()}
        if any(self.header.scale.get(code, 1.0) != factor for code, factor in scale.items()):
            raise ValueError("scale factors must not change inside the file: split it there")

    def _moved(self, label: str, later: HeaderBuilder) -> None:
        """Keep that a record inside the file puts the antenna elsewhere; before the first epoch it is the place."""
        assert self.header is not None
        field, of = SITE[label]
        old, new = getattr(self.header, field), getattr(later, of)
        if not self.tow:
            self.header = replace(self.header, **{field: new})
        elif old is not None and new is not None and math.dist(old, new) > SAME_PLACE_M:
            approximate = field == "position_ecef_m"
            self._note_move(f"{label} is {math.dist(old, new):.3f} m from that of the header", approximate)

    def _note_move(self, what: str, approximate: bool = False) -> None:
        if self.tow:
            self.moves.append(Move(self.lines.number, self.week[-1], self.tow[-1], what, approximate))

    def result(self, path: str | Path, stopped: Stop | None) -> Observations:
        """Arrays of all complete epochs."""
        assert self.header is not None
        n = self.done
        found = self.back + len(self.tow)
        if self.back > MOST_BACK * found:  # most would be lost
            raise InputError(
                f"{path} must have epochs whose times increase, {self.back} of {found} go back: sort them by time"
            )
        if n == 0:
            raise InputError(f"{path} must hold at least one complete epoch, got none ({stopped or 'the file ends'})")
        week, tow = np.array(self.week[:n], dtype=np.int64), np.array(self.tow[:n])
        power = np.array(self.power[:n], dtype=np.bool_)
        rows = {system: r.finished(n) for system, r in self.rows.items()}
        return Observations(
            self.header, week, tow, power, rows, stopped, self.left_out, self.undeclared, self.garbled,
            self.twice, tuple(self.moves),
        )  # fmt: skip


def _gps_time(text: str, ahead_s: float) -> tuple[int, float]:
    """Week and time of week [s] of the date of an epoch line plus ``ahead_s``."""
    words = text.split()
    if len(words) != 6:
        raise ValueError(f"an epoch must have year, month, day, hour, minute and second, got {text.strip()[:40]!r}")
    parts = []
    for name, word, low, high in zip(DATE_PARTS, words, (1980, 1, 1, 0, 0), (2200, 12, 31, 23, 59), strict=False):
        try:
            parts.append(whole_number(word, low, high))
        except ValueError as error:
            raise ValueError(f"the {name} of an epoch {error}") from None
    year, month, day, hour, minute = parts
    try:
        second = finite_number(words[5], 0.0, 61.0)
    except ValueError as error:
        raise ValueError(f"the second of an epoch {error}") from None
    days = (date(year, month, day) - ORIGIN).days
    if days < 0:
        raise ValueError(f"an epoch must lie after 1980-01-06, got {text.strip()[:40]!r}")
    tow = (days % 7) * 86_400 + hour * 3600 + minute * 60 + second + ahead_s
    over = tow >= WEEK_S
    return days // 7 + over, tow - WEEK_S * over


def _fields(text: str, codes: tuple[str, ...]) -> tuple[list[float], list[int], str]:
    """Values and loss-of-lock bits of one satellite line, 0 for blanks; the last value that is no number, 0 too."""
    if text[3 + FIELD * len(codes) :].strip():
        raise ValueError(f"satellite {text[:3]} must have at most {len(codes)} observations, the line is longer")
    values, lost, garbled = [], [], ""
    for i, code in enumerate(codes):
        cell = text[3 + FIELD * i : 3 + FIELD * (i + 1)]
        number, indicator = cell[:14].strip(), cell[14:15].strip()
        value = 0.0
        try:
            value = finite_number(number, -1e12, 1e12) if number else 0.0
        except ValueError as error:
            garbled = f"{code} of {text[:3]} {error}"
        if indicator and not indicator.isdigit():
            garbled = f"loss of lock of {code} of {text[:3]} must be a digit, got {indicator!r}"
            value, indicator = 0.0, ""
        values.append(value)
        lost.append(int(indicator) & (LOST | HALF) if indicator else 0)
    return values, lost, garbled
