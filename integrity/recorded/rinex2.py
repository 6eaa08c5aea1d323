"""RINEX 2 observation files as lines of RINEX 3 (Gurtner and Estey 2007, RINEX version 2.11, tables A1 and A2).

Version 2 names a signal by observable and frequency alone. GPS: C1 is C/A, P1 and P2 are P(Y), which civil receivers
track semi-codelessly (W), C2 and the third frequency are civil. The phase of a frequency is that of its C/A or, on L2,
its P(Y) code, and of the civil code for a satellite without P2. Galileo's components are not named: X. Rows of other
systems are passed on without codes, so that they are counted as left out.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from itertools import chain

from lanebound.integrity.recorded.rinex_header import FIRST_LABEL, LABEL_AT
from lanebound.integrity.recorded.source import finite_number, whole_number

__all__ = ["as_version_3"]

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
