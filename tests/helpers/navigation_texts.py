"""RINEX 3 navigation text made from numbers."""

from __future__ import annotations

HEADER = (
    "     3.04           N: GNSS NAV DATA    M: MIXED            RINEX VERSION / TYPE\n"
    "                                                            END OF HEADER       \n"
)
GPS_RECORD = """\
G04 2024 03 07 02 00 00 3.087650984530E-04 9.208633855450E-12 0.000000000000E+00
     1.930000000000E+02-1.245000000000E+02 4.050883021250E-09-7.371652101180E-01
    -6.536021828650E-06 2.862894791180E-03 1.058168709280E-05 5.153585296630E+03
     3.528000000000E+05 7.078051567080E-08-6.302168854860E-01-1.117587089540E-08
     9.646073133890E-01 1.773750000000E+02-2.955496647040E+00-7.767109245560E-09
    -1.071473202590E-11 1.000000000000E+00 2.304000000000E+03 0.000000000000E+00
     2.000000000000E+00 0.000000000000E+00-4.656612873080E-09 7.050000000000E+02
     3.487860000000E+05 4.000000000000E+00
"""
"""gps-labs gps_lab03 (szymon2024, MIT), nav_record.txt; mantissas brought to one figure before the point."""


def number(value: float) -> str:
    """A Fortran number of 19 columns."""
    return f"{value:19.12E}"


def record(satellite: str, date: str, clock: tuple[float, ...], elements: dict[str, float], delay_s: float) -> str:
    """One message of 8 lines; ``date`` as it stands in columns 5 to 23."""
    el = elements
    rows = [
        (0.0, el["crs"], el["delta_n"], el["m0"]),
        (el["cuc"], el["e"], el["cus"], el["sqrt_a"]),
        (el["toe_sow"], el["cic"], el["omega0"], el["cis"]),
        (el["i0"], el["crc"], el["omega"], el["omega_dot"]),
        (el["idot"], 0.0, 0.0, 0.0),
        (2.0, 0.0, delay_s, 0.0),
        (0.0, 0.0),
    ]
    first = f"{satellite} {date}" + "".join(map(number, clock))
    return "\n".join([first, *("    " + "".join(map(number, row)) for row in rows)]) + "\n"
