"""Reader of RINEX 2 to 4 navigation files: GPS, Galileo, BeiDou and QZSS messages as :class:`Ephemerides`.

Messages of other systems (GLONASS, SBAS, NavIC) and, in RINEX 4, of other forms (CNAV) are skipped and counted. A
truncated file gives the messages before the truncation and the place of it. Text that is not RINEX is refused.
"""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.packed import open_unpacked
from lanebound.integrity.sky.constellation import SECONDS_PER_WEEK
from lanebound.integrity.sky.ephemeris import Ephemerides
from lanebound.integrity.sky.rinex2_navigation import as_version_3
from lanebound.integrity.sky.systems import PRN_BEFORE, System

__all__ = ["navigation_text", "parse_navigation", "read_navigation"]

SYSTEMS = {"G": System.GPS, "E": System.GALILEO, "C": System.BEIDOU, "J": System.QZSS}
OTHERS = {"R": "GLONASS", "S": "SBAS", "I": "NavIC"}
FORMS = ("LNAV", "INAV", "FNAV", "D1", "D2", "D1D2", "FDMA", "SBAS")  # of RINEX 4 with the lines of RINEX 3
LARGEST_BYTES = 96 * 2**20  # reading needs 0.7 GiB; one day of all IGS receivers is below 20 MiB
GPS_START = datetime(1980, 1, 6)
BEIDOU_BEHIND_S = 14.0  # BDT was UTC at 2006-01-01, 14 leap seconds after GPS time's start; BDS-SIS-ICD-2.1 3.3
LINES = 8
FIRST_LABEL = "RINEX VERSION / TYPE"
WIDTH = 19

# Position of a column (line of the message, field on the line) and its allowed range.
FIELDS: dict[str, tuple[int, int, float, float]] = {
    "issue": (1, 0, 0.0, 4095.0),
    "crs_m": (1, 1, -1e5, 1e5),
    "motion_correction_radps": (1, 2, -1e-6, 1e-6),
    "mean_anomaly_rad": (1, 3, -100.0, 100.0),
    "cuc_rad": (2, 0, -1e-2, 1e-2),
    "eccentricity": (2, 1, 0.0, 0.9),
    "cus_rad": (2, 2, -1e-2, 1e-2),
    "root_a": (2, 3, 2500.0, 8000.0),
    "toe_of_week_s": (3, 0, 0.0, SECONDS_PER_WEEK),
    "cic_rad": (3, 1, -1e-2, 1e-2),
    "node_rad": (3, 2, -100.0, 100.0),
    "cis_rad": (3, 3, -1e-2, 1e-2),
    "inclination_rad": (4, 0, -math.pi, math.pi),
    "crc_m": (4, 1, -1e5, 1e5),
    "perigee_rad": (4, 2, -100.0, 100.0),
    "node_rate_radps": (4, 3, -1e-5, 1e-5),
    "inclination_rate_radps": (5, 0, -1e-5, 1e-5),
    "health": (6, 1, 0.0, 1e6),
}
OPTIONAL = {  # fields that may be blank
    "source": (5, 1, 0.0, 1e6),
    "delay": (6, 2, -1e-3, 1e-3),
    "delay_2": (6, 3, -1e-3, 1e-3),
}
INTEGERS = ("health", "source", "issue", "prn", "system")


@dataclass(frozen=True)
class _Message:
    """The lines of one message and the number of its first line."""

    number: int
    lines: list[str]


def read_navigation(path: str | Path) -> Ephemerides:
    """Read the messages of a RINEX 2, 3 or 4 navigation file, plain or gzip; see :func:`parse_navigation`.

    Raises
    ------
    InputError
        The file cannot be read, is too large, is not a RINEX 2, 3 or 4 navigation file, or has a malformed line.
    """
    return parse_navigation(navigation_text(path), source=str(path))


def navigation_text(path: str | Path) -> str:
    """The text of a navigation file, plain or gzip (detected by its first bytes), RINEX 2 in the form of RINEX 3.

    Raises
    ------
    InputError
        The file cannot be read, or is too large.
    """
    try:
        size = Path(path).stat().st_size
        raw = b""
        if size <= LARGEST_BYTES:
            with open_unpacked(Path(path)) as stream:
                raw = stream.read(LARGEST_BYTES + 1)
    except (OSError, EOFError, zlib.error, ValueError) as exc:
        raise InputError(f"navigation file {path} must be a readable text file, got: {exc}") from exc
    if max(size, len(raw)) > LARGEST_BYTES:
        raise InputError(f"navigation file {path} must have at most {LARGEST_BYTES} bytes: cut it into days")
    return as_version_3(raw.decode("latin-1").removeprefix("\u00ef\u00bb\u00bf"), str(path))


def parse_navigation(text: str, source: str = "text") -> Ephemerides:
    """Parse messages of GPS, Galileo, BeiDou and QZSS (RINEX 3.04, tables A6 to A14), in the order of the text.

    RINEX 4 has a line ``> EPH G05 LNAV`` before each message; forms with the lines of RINEX 3 are read.

    Times are converted to GPS time (BeiDou time is 14 s behind it). The week of the orbit's reference time is chosen
    such that this time is closest to the reference time of the clock. Week numbers with any rollover are therefore
    valid.

    Raises
    ------
    InputError
        A line is malformed; the message gives the line, the field and the number of messages read so far.
    """
    others: Counter[str] = Counter()
    lines = _in_old_form(text.splitlines(), others)
    body = _after_header(lines, 0, source)
    rows: list[dict[str, float]] = []
    left_out: list[str] = []
    stopped = ""
    messages = list(_messages(lines, body, source))
    for message in messages:
        where = f"navigation file {source}, line {message.number} ({len(rows)} messages read)"
        letter = message.lines[0][0]
        if letter in OTHERS:
            others[OTHERS[letter]] += 1
        elif letter not in SYSTEMS:
            raise InputError(f"{where}: a message must start with one of G E C J R S I, got {message.lines[0][:20]!r}")
        elif message is messages[-1] and _is_cut(message):
            stopped = f"{where}: the text ends in the middle of a message of {message.lines[0][:3]!r}"
        else:
            row, reason = _row(message, where)
            if reason:
                left_out.append(reason)
            else:
                rows.append(row)
    left_out += [f"{count} messages of {name}: this reader does not use them" for name, count in others.items()]
    return _table(rows, stopped, tuple(left_out))


def _in_old_form(lines: list[str], others: Counter[str]) -> list[str]:
    """The lines in the form of RINEX 3: record lines of RINEX 4, and what they lead that is read by nothing, are blank.

    Other records (CNAV, system times, ionosphere, ...) are counted in ``others``.
    """
    kept, keep = [], True
    for line in lines:
        if line.startswith(">"):
            words = line[1:].split()
            keep = len(words) == 3 and words[0] == "EPH" and words[2] in FORMS
            if not keep:
                others["".join(words[2:3] if words[:1] == ["EPH"] else words[:1]) or "an unknown form"] += 1
        kept.append(line if keep and not line.startswith(">") else "")
    return kept


def _after_header(lines: list[str], start: int, source: str) -> int:
    """Index of the first line after the header of a navigation file that begins at index ``start``."""
    where = f"navigation file {source}, line {start + 1}"
    if not any(lines):
        raise InputError(f"navigation file {source} must hold navigation messages, is empty: download it again")
    first = lines[start]
    if first[60:80].strip() != FIRST_LABEL:
        raise InputError(f"{where}: the label 'RINEX VERSION / TYPE' must start in column 61, got {first[:80]!r}")
    version, kind = first[:9].strip(), first[20:21].upper()
    if not version.startswith(("3.", "4.")) or kind != "N":
        raise InputError(
            f"{where}: version 2 to 4 and type N (navigation) are needed, got {version!r} and "
            f"{kind!r}: convert the file (for instance with gfzrnx), or pass that of navigation messages"
        )
    for i, line in enumerate(lines[start:], start):
        if line[60:80].strip() == "END OF HEADER":
            return i + 1
    raise InputError(f"navigation file {source}: 'END OF HEADER' is missing in {len(lines)} lines: is it truncated?")


def _messages(lines: list[str], body: int, source: str) -> Iterator[_Message]:
    """Iterate over the messages: a line that starts in column 1 and the indented lines after it.

    Headers of further files that were joined to the first one are passed over.
    """
    current: _Message | None = None
    for number, line in enumerate(lines[body:], start=body + 1):
        if line[60:80].strip() == FIRST_LABEL:
            body = _after_header(lines, number - 1, source)
        if number <= body or not line.strip():
            continue
        if not line[0].isspace():
            if current is not None:
                yield current
            current = _Message(number, [line])
        elif current is None:
            raise InputError(f"navigation file {source}, line {number}: a message must start in column 1, got {line!r}")
        else:
            current.lines.append(line)
    if current is not None:
        yield current


def _is_cut(message: _Message) -> bool:
    """Whether the last message is truncated: too few lines, or the last line ends within a field."""
    last = message.lines[-1].rstrip()
    return len(message.lines) < LINES or len(last) < 4 + WIDTH or (len(last) - 4) % WIDTH != 0


def _row(message: _Message, where: str) -> tuple[dict[str, float], str]:
    """The columns of a message, and the reason to omit it ("" for none)."""
    lines = message.lines
    if len(lines) != LINES:
        raise InputError(f"{where}: a message must have {LINES} lines, got {len(lines)}: is one missing?")
    system = SYSTEMS[lines[0][0]]
    prn, toc = _heading(lines[0], where)
    row = {"system": float(system), "prn": prn + PRN_BEFORE.get(lines[0][0], 0)}
    for k in range(3):
        row[f"clock_{k}"] = _number(lines[0], 23 + k * WIDTH, f"clock term {k}", where)
    bounds = {name: place for part in (FIELDS, OPTIONAL) for name, place in part.items()}
    for name, (line, field, _, _) in bounds.items():
        at = 4 + field * WIDTH
        blank = name in OPTIONAL and not lines[line][at : at + WIDTH].strip()
        row[name] = 0.0 if blank else _number(lines[line], at, name, f"{where}, {line} lines on")
    if system in (System.GPS, System.QZSS):
        row["delay_2"] = 0.0  # for these systems the field is the issue of data of the clock
    for name, (_, _, low, high) in bounds.items():
        if not low <= row[name] <= high:
            return row, f"{where}: {name} must lie in [{low:g}, {high:g}], got {row[name]:g}"
    row["toc_s"] = toc + (BEIDOU_BEHIND_S if system is System.BEIDOU else 0.0)
    row["toe_s"] = toc + math.remainder(row["toe_of_week_s"] - toc, SECONDS_PER_WEEK) + row["toc_s"] - toc
    return row, ""


def _heading(line: str, where: str) -> tuple[int, float]:
    """Satellite number, and the clock's reference time in the time scale of the system [s since 1980-01-06]."""
    try:
        prn = int(line[1:3])
        year, month, day, hour, minute, second = (int(word) for word in line[3:23].split())
        time = (datetime(year, month, day, hour, minute, second) - GPS_START).total_seconds()
    except ValueError as exc:
        raise InputError(f"{where}: satellite and date must read 'G05 2024 06 24 10 00 00', got {line[:23]!r}") from exc
    if prn < 1 or time < 0.0:
        raise InputError(f"{where}: the number must be at least 1 and the date after 1980-01-06, got {line[:23]!r}")
    return prn, time


def _number(line: str, at: int, name: str, where: str) -> float:
    """The Fortran number in the 19 columns from ``at``."""
    word = line[at : at + WIDTH].strip().replace("D", "E").replace("d", "e")
    try:
        value = float(word)
    except ValueError:
        raise InputError(
            f"{where}: {name} must be a number in columns {at + 1} to {at + WIDTH}, got {word!r}"
        ) from None
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} must be finite, got {word!r}")
    return value


def _table(rows: list[dict[str, float]], stopped: str, left_out: tuple[str, ...]) -> Ephemerides:
    """Convert rows to columns."""

    def column(name: str) -> np.ndarray:
        return np.array([row[name] for row in rows], dtype=np.int64 if name in INTEGERS else np.float64)

    def columns(names: Iterable[str]) -> np.ndarray:
        return np.stack([column(name) for name in names], -1)

    plain = {name: column(name) for name in (*FIELDS, "source", "system", "prn", "toe_s", "toc_s")}
    return Ephemerides(
        clock=columns(["clock_0", "clock_1", "clock_2"]),
        group_delay_s=columns(["delay", "delay_2"]),
        stopped=stopped,
        left_out=left_out,
        **plain,
    )
