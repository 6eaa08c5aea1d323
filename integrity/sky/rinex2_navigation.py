"""Navigation files of RINEX 2 in the form of RINEX 3 (Gurtner and Estey 2007, RINEX 2.11, tables A3, A4, A10, A15).

Messages have the lines of RINEX 3, one column further left, with the number of the satellite alone and two digits of
the year. Files of GLONASS (type G) and of geostationary satellites (H) have a system each, as those of GPS (N).
"""

from __future__ import annotations

from datetime import datetime, timedelta

from lanebound.integrity.core.errors import InputError

__all__ = ["as_version_3"]

LABEL_AT, FIRST_LABEL, END = 60, "RINEX VERSION / TYPE", "END OF HEADER"
IONOSPHERE = {"ION ALPHA": "GPSA", "ION BETA": "GPSB"}
LETTERS = {"N": "G", "G": "R", "H": "S"}  # of the system, by the type of the file
CENTURY_FROM = 80  # two digits of a year from here on are of the 20th century
HEADING = 22  # columns of satellite and date


def as_version_3(text: str, source: str) -> str:
    """The text of a navigation file with its parts of RINEX 2 in the form of RINEX 3; ``source`` names the file.

    Raises
    ------
    InputError
        Satellite and date of a message cannot be read.
    """
    old, header, letter, out = False, False, "G", []
    for number, line in enumerate(text.splitlines(), start=1):
        label = line[LABEL_AT : LABEL_AT + 20].strip()
        if label == FIRST_LABEL:
            old, header = line[:9].strip()[:2] in ("2", "2.") and line[20:21] in tuple(LETTERS), True
            letter = LETTERS.get(line[20:21], letter)
            if number == 1 and not old:
                return text
            line = f"     3.04           N: GNSS NAV DATA    G: GPS{'':14}{FIRST_LABEL}" if old else line
        elif old and header and label in IONOSPHERE:
            line = f"{IONOSPHERE[label]} {line[2:50]:<55}IONOSPHERIC CORR"
        elif old and not header and line.strip():
            line = (
                _heading(line, letter, f"navigation file {source}, line {number}") if line[:2].strip() else f" {line}"
            )
        header = header and label != END
        out.append(line)
    return "\n".join(out) + "\n"


def _heading(line: str, letter: str, where: str) -> str:
    """The first line of a message."""
    try:
        prn, year, month, day, hour, minute = (int(line[3 * k - 1 : 3 * k + 2] if k else line[:2]) for k in range(6))
        year += 1900 if year >= CENTURY_FROM else 2000
        time = datetime(year, month, day, hour, minute) + timedelta(seconds=round(float(line[17:HEADING])))
    except ValueError:
        raise InputError(f"{where}: satellite and date must read ' 5 24 06 24 10 00  0.0', got {line[:22]!r}") from None
    return f"{letter}{prn:02d} {time:%Y %m %d %H %M %S}{line[HEADING:]}"
