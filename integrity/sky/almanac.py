"""Reader of YUMA almanacs, the text format in which orbits of GPS (and often of other systems) are published.

A truncated file gives the satellites before the truncation and the place of it. Text that is not an almanac is refused.
"""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from dataclasses import replace
from datetime import date, datetime
from pathlib import Path

import numpy as np

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.constellation import SECONDS_PER_WEEK, SatelliteTable, gps_seconds_of
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, OrbitElements
from lanebound.integrity.sky.systems import System

__all__ = ["parse_yuma", "read_yuma"]

# The start of each line's label, lower case, and the range its value must lie in (IS-GPS-200N 20.3.3.5, widened to
# hold geosynchronous orbits).
FIELDS: dict[str, tuple[str, float, float]] = {
    "id": ("id", 1, 999),
    "health": ("health", 0, 511),
    "eccentricity": ("eccentricity", 0.0, 0.9),
    "toa": ("time of applicability", 0.0, SECONDS_PER_WEEK),
    "inclination": ("orbital inclination", 0.0, np.pi),
    "node_rate": ("rate of right ascen", -1e-5, 1e-5),
    "root_a": ("sqrt(a)", 2500.0, 8000.0),
    "node": ("right ascen at", -100.0, 100.0),
    "perigee": ("argument of perigee", -100.0, 100.0),
    "anomaly": ("mean anom", -100.0, 100.0),
    "af0": ("af0", -1.0, 1.0),
    "af1": ("af1", -1e-3, 1e-3),
    "week": ("week", 0, 1_000_000),
}
LABELS = {
    System.GPS: ("PRN", "GPS", "G"),
    System.GALILEO: ("GAL", "E"),
    System.GLONASS: ("GLO", "R"),
    System.BEIDOU: ("BDU", "BDS", "BEI", "C"),
    System.QZSS: ("QZS", "QZ", "J"),
}
HEADER = re.compile(r"almanac for\s+([A-Za-z]+)", re.IGNORECASE)
WEEK_OF_HEADER = re.compile(r"week\s+(\d+)\s+almanac", re.IGNORECASE)
LARGEST_BYTES = 8 * 2**20  # an almanac of all systems is below 100 kB
WEEKS_OF_ROLLOVER = 1024


def read_yuma(path: str | Path, near: date, *, healthy_only: bool = True) -> SatelliteTable:
    """Read the satellites of a YUMA file; see :func:`parse_yuma` for the parameters.

    Raises
    ------
    InputError
        The file cannot be read, is too large, is not ASCII text, or is malformed.
    """
    try:
        if (size := Path(path).stat().st_size) > LARGEST_BYTES:
            raise InputError(f"almanac {path} must have at most {LARGEST_BYTES} bytes, has {size}: is it a YUMA file?")
        text = Path(path).read_bytes().removeprefix(BOM_UTF8).decode("ascii")
    except (OSError, UnicodeDecodeError) as exc:
        raise InputError(f"almanac {path} must be a readable ASCII text file, got: {exc}") from exc
    return parse_yuma(text, near, healthy_only=healthy_only, source=str(path))


def parse_yuma(text: str, near: date, *, healthy_only: bool = True, source: str = "text") -> SatelliteTable:
    """Parse the satellites of an almanac in YUMA format, in the order of the text.

    Parameters
    ----------
    text : blocks of 13 lines ``label: value``, each after a line ``**** Week N almanac for SYS-NN ****``
    near : a date within ten years of the almanac's date; it resolves weeks that are given modulo 1024
    healthy_only : leave out satellites whose health word is not 0
    source : name of the text in error messages

    The right ascension is the Earth-fixed longitude of the node at the start of the week (IS-GPS-200N 20.3.3.5.2.1).
    An incomplete last satellite of a truncated text is left out, and ``stopped`` of the table describes the place.

    Raises
    ------
    InputError
        The text is malformed (the message gives the line, the field and the number of satellites read so far), the only
        satellite is incomplete, or ``near`` is not a date.
    """
    day = _day(near)
    system: list[int] = []
    blocks: list[dict[str, float]] = []
    current: dict[str, float] | None = None
    lines, cut = _whole_lines(text)
    for number, line in enumerate(lines, start=1):
        where = f"almanac {source}, line {number} ({len(blocks)} satellites read)"
        if header := HEADER.search(line):
            _require_complete(current, where)
            system.append(int(_system_of(header[1], where)))
            current = {}
        elif line.strip():
            if current is None:
                raise InputError(
                    f"{where}: a header '**** Week N almanac for PRN-NN ****' must come first, got {line!r}"
                )
            _read_field(line, current, where)
            if len(current) == len(FIELDS):
                blocks.append(current)
    end, stopped = f"almanac {source}, end of text ({len(blocks)} satellites read)", ""
    if not blocks:
        _require_complete(current, end)
    elif current is not None and len(current) < len(FIELDS):
        stopped = f"{end}: it ends in the middle of a satellite, whose {_missing(current)!r} is missing"
    elif cut:
        stopped = f"{end}: the last line has no line end and may be truncated"
    if not blocks:
        raise InputError(f"almanac {source} must hold at least one satellite, got none: is it a YUMA file?")
    keep = [i for i, b in enumerate(blocks) if b["health"] == 0 or not healthy_only]
    if not keep:
        raise InputError(
            f"almanac {source} must hold a healthy satellite, got none of {len(blocks)}: use healthy_only=False"
        )
    return replace(_table([system[i] for i in keep], [blocks[i] for i in keep], day), stopped=stopped)


def _day(near: date) -> date:
    """The calendar day of ``near``, or InputError."""
    if not isinstance(near, date):
        raise InputError(f"near must be a datetime.date, got {near!r}: pass for instance date(2016, 6, 7)")
    return near.date() if isinstance(near, datetime) else near


def _system_of(label: str, where: str) -> System:
    for system, prefixes in LABELS.items():
        if label.upper() in prefixes:
            return system
    known = ", ".join(p for prefixes in LABELS.values() for p in prefixes)
    raise InputError(f"{where}: the system must be one of {known}, got {label!r}: correct the header")


def _whole_lines(text: str) -> tuple[list[str], bool]:
    """Split the text into lines; the flag says whether the last line was left out.

    A last line without a line end may be truncated and is left out. It stays if it is the week line and its week
    equals the week of the last header.
    """
    lines = text.splitlines()
    if not lines or text.endswith(("\n", "\r")):
        return lines, False
    name, _, value = lines[-1].partition(":")
    weeks = WEEK_OF_HEADER.findall(text)
    if name.strip().lower() == FIELDS["week"][0] and weeks and value.strip().lstrip("0") == weeks[-1].lstrip("0"):
        return lines, False
    return lines[:-1], True


def _missing(block: dict[str, float]) -> str:
    """The label of the first missing field of a satellite."""
    return next(label for key, (label, _, _) in FIELDS.items() if key not in block)


def _require_complete(block: dict[str, float] | None, where: str) -> None:
    if block is not None and len(block) < len(FIELDS):
        raise InputError(
            f"{where}: field {_missing(block)!r} is missing, got {len(block)} of {len(FIELDS)}: is the file truncated?"
        )


def _read_field(line: str, block: dict[str, float], where: str) -> None:
    label, colon, value = line.partition(":")
    name = " ".join(label.lower().split())
    key = next((k for k, (start, _, _) in FIELDS.items() if name.startswith(start)), None)
    if not colon or key is None:
        raise InputError(f"{where}: a line must read 'label: value' with a YUMA label, got {line!r}")
    if key in block:
        raise InputError(f"{where}: field {name!r} must appear once for each satellite, got it again")
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{where}: field {name!r} must be a number, got {value.strip()!r}") from None
    _, low, high = FIELDS[key]
    if not low <= number <= high:
        raise InputError(f"{where}: field {name!r} must lie in [{low:g}, {high:g}], got {number:g}")
    block[key] = number


def _table(system: list[int], blocks: list[dict[str, float]], near: date) -> SatelliteTable:
    column = {key: np.array([b[key] for b in blocks]) for key in FIELDS}
    target = gps_seconds_of(near) / SECONDS_PER_WEEK
    week = column["week"]
    rolled = week < WEEKS_OF_ROLLOVER
    week = week + rolled * WEEKS_OF_ROLLOVER * np.maximum(0.0, np.round((target - week) / WEEKS_OF_ROLLOVER))
    elements = OrbitElements(
        semi_major_m=column["root_a"] ** 2,
        eccentricity=column["eccentricity"],
        inclination_rad=column["inclination"],
        # ``node`` refers to the start of the week; until the time of applicability the Earth rotates below the node
        node_longitude_rad=column["node"] - EARTH_RATE_RADPS * column["toa"],
        node_rate_radps=column["node_rate"],
        perigee_rad=column["perigee"],
        mean_anomaly_rad=column["anomaly"],
        epoch_s=week * SECONDS_PER_WEEK + column["toa"],
    )
    return SatelliteTable(np.array(system, dtype=np.int64), column["id"].astype(np.int64), elements)
