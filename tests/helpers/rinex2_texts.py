"""Observations and navigation messages as RINEX 2.11 text."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np

from lanebound.integrity.recorded.rinex_observation import Observations

__all__ = ["TYPES", "navigation_2_text", "observation_2_text"]

TYPES = {
    "C1": {"G": "C1C", "E": "C1C"}, "L1": {"G": "L1C", "E": "L1C"}, "S1": {"G": "S1C", "E": "S1C"},
    "P2": {"G": "C2W"}, "L2": {"G": "L2W"}, "S2": {"G": "S2W"},
    "C5": {"E": "C5Q"}, "L5": {"E": "L5Q"}, "S5": {"E": "S5Q"},
    "C7": {"E": "C7Q"}, "L7": {"E": "L7Q"}, "S7": {"E": "S7Q"},
}  # fmt: skip
"""The types of version 2 and the codes of version 3 that are written under them, by system."""


def observation_2_text(data: Observations) -> str:
    """The signals of TYPES: 12 types of three lines a satellite, more than 12 satellites on two lines of an epoch."""
    names = list(TYPES)
    lines = [f"{'     2.11           OBSERVATION DATA    M (MIXED)':<60}RINEX VERSION / TYPE"]
    place = "".join(f"{v:14.4f}" for v in data.header.position_ecef_m or (0.0, 0.0, 0.0))
    lines += [f"{place:<60}APPROX POSITION XYZ", f"{'     1     1':<60}WAVELENGTH FACT L1/2"]
    for start in range(0, len(names), 9):
        head = f"{len(names):6d}" if not start else " " * 6
        lines.append(f"{head + ''.join(f'{n:>6}' for n in names[start : start + 9]):<60}# / TYPES OF OBSERV")
    lines += [
        f"{'  2024     1     1     0     0    0.0000000     GPS':<60}TIME OF FIRST OBS",
        " " * 60 + "END OF HEADER",
    ]
    for k in range(data.epochs):
        rows = [(s, r, i) for s, r in data.rows.items() if s in "GE" for i in np.flatnonzero(r.epoch == k)]
        time = datetime(1980, 1, 6) + timedelta(weeks=int(data.week[k]), seconds=float(data.tow_s[k]))
        seen = [f"{' ' if s == 'G' else s}{r.satellite[i]:2d}" for s, r, i in rows]
        date = f" {time:%y} {time.month:2d} {time.day:2d} {time.hour:2d} {time.minute:2d}"
        second = time.second + time.microsecond * 1e-6
        lines.append(f"{date}{second:11.7f}  {int(data.power_failed[k])}{len(rows):3d}" + "".join(seen[:12]))
        lines += [" " * 32 + "".join(seen[i : i + 12]) for i in range(12, len(seen), 12)]
        for system, r, i in rows:
            cells = []
            for name in names:
                code = TYPES[name].get(system, "")
                at = r.codes.index(code) if code in r.codes else -1
                flags = int(r.lost[i, at]) + 2 * int(r.half[i, at]) if at >= 0 else 0
                there = at >= 0 and r.value[i, at] != 0.0
                cells.append(f"{r.value[i, at]:14.3f}{flags or ' '} " if there else " " * 16)
            lines += ["".join(cells[j : j + 5]).rstrip() for j in range(0, len(cells), 5)]
    return "\n".join(lines) + "\n"


def navigation_2_text(text: str) -> str:
    """The GPS messages of a RINEX 3 navigation file."""
    lines = [f"{'     2.11           N: GPS NAV DATA':<60}RINEX VERSION / TYPE", " " * 60 + "END OF HEADER"]
    taken = False
    for line in text.split("END OF HEADER", 1)[1].splitlines()[1:]:
        if line[:1].strip():
            taken = line[0] == "G"
            year, *rest = line[4:23].split()
            date = f"{int(line[1:3]):2d} {year[2:]}" + "".join(f"{int(word):3d}" for word in rest[:4])
            line = f" {date}{float(rest[4]):5.1f}{line[23:]}"
        if taken:
            lines.append(line[1:])
    return "\n".join(lines) + "\n"
