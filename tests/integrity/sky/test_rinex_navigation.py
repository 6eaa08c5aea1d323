"""Navigation files whole, cut, broken and at random."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_texts import GPS_RECORD, HEADER

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.ephemeris import Ephemerides
from lanebound.integrity.sky.rinex_navigation import parse_navigation, read_navigation
from lanebound.integrity.sky.systems import System

GLONASS = """\
R01 2024 03 07 02 15 00 1.000000000000E-05 0.000000000000E+00 3.500000000000E+05
     1.000000000000E+04 0.000000000000E+00 0.000000000000E+00 0.000000000000E+00
     1.000000000000E+04 0.000000000000E+00 0.000000000000E+00 1.000000000000E+00
     1.000000000000E+04 0.000000000000E+00 0.000000000000E+00 0.000000000000E+00
"""


def test_every_column_is_read() -> None:
    table = parse_navigation(HEADER + GPS_RECORD)
    assert len(table) == 1
    assert table.satellites.tolist() == [[System.GPS, 4]]
    toe = 2304 * 604_800.0 + 352_800.0
    assert (table.toe_s[0], table.toc_s[0], table.toe_of_week_s[0]) == (toe, toe, 352_800.0)
    np.testing.assert_array_equal(table.clock[0], [3.08765098453e-4, 9.20863385545e-12, 0.0])
    np.testing.assert_array_equal(table.group_delay_s[0], [-4.65661287308e-9, 0.0])
    expected = {
        "issue": 193.0, "crs_m": -124.5, "motion_correction_radps": 4.05088302125e-9,
        "mean_anomaly_rad": -0.737165210118, "cuc_rad": -6.53602182865e-6, "eccentricity": 0.00286289479118,
        "cus_rad": 1.05816870928e-5, "root_a": 5153.58529663, "cic_rad": 7.07805156708e-8,
        "node_rad": -0.630216885486, "cis_rad": -1.11758708954e-8, "inclination_rad": 0.964607313389,
        "crc_m": 177.375, "perigee_rad": -2.95549664704, "node_rate_radps": -7.76710924556e-9,
        "inclination_rate_radps": -1.07147320259e-11, "health": 0.0, "source": 1.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert getattr(table, name)[0] == value, name


def test_fortran_exponents_and_lines_without_a_leading_zero_are_read() -> None:
    plain = parse_navigation(HEADER + GPS_RECORD)
    fortran = parse_navigation(
        HEADER + GPS_RECORD.replace("E", "D").replace(" 3.087650984530D-04", "  .308765098453D-03")
    )
    np.testing.assert_array_equal(plain.clock, fortran.clock)


def test_beidou_time_runs_behind_and_qzss_numbers_start_at_193() -> None:
    beidou = GPS_RECORD.replace("G04", "C04").replace("7.050000000000E+02", "0.000000000000E+00")
    table = parse_navigation(HEADER + beidou + GPS_RECORD.replace("G04", "J02"))
    assert table.toe_s[0] - table.toe_s[1] == 14.0
    assert table.toc_s[0] - table.toc_s[1] == 14.0
    assert table.satellites.tolist() == [[System.BEIDOU, 4], [System.QZSS, 194]]


def test_other_systems_are_passed_over_and_counted() -> None:
    table = parse_navigation(HEADER + GLONASS + GPS_RECORD + GLONASS)
    assert len(table) == 1
    assert table.left_out == ("2 messages of GLONASS: this reader does not use them",)


def test_a_cut_file_gives_what_came_before_and_says_where() -> None:
    whole = HEADER + GPS_RECORD + GPS_RECORD.replace("G04", "G05")
    second = len(HEADER + GPS_RECORD)
    for end in range(second + 1, len(whole) - 1, 7):
        table = parse_navigation(whole[:end])
        assert 1 <= len(table) <= 2
        if len(table) == 1:
            assert "line 11 (1 messages read): the text ends in the middle" in table.stopped
        else:  # only the last line's spare fields may be missing
            assert end > len(whole) - 40
    assert not parse_navigation(whole).stopped


def test_an_orbit_that_cannot_be_is_left_out_with_its_reason() -> None:
    table = parse_navigation(HEADER + GPS_RECORD.replace("5.153585296630E+03", "0.000000000000E+00"))
    assert len(table) == 0
    assert "root_a must lie in [2500, 8000], got 0" in table.left_out[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("hello\n", "RINEX VERSION / TYPE"),
        (HEADER.replace("3.04", "1.00"), "version 2"),
        (HEADER.replace("N: GNSS NAV", "OBSERVATION"), "type N"),
        (HEADER.splitlines()[0], "END OF HEADER"),
        (HEADER + "    1.0\n", "must start in column 1"),
        (HEADER + GPS_RECORD.replace("G04", "X04"), "one of G E C J R S I"),
        (HEADER + GPS_RECORD.replace("2024 03", "2024 13"), "date must read"),
        (HEADER + GPS_RECORD.replace("2024 03", "1970 03"), "after 1980-01-06"),
        (HEADER + GPS_RECORD.replace("5.153585296630E+03", "5.1535852966x0E+03"), "root_a must be a number"),
        (HEADER + GPS_RECORD.replace("5.153585296630E+03", "               nan"), "root_a must be finite"),
        (HEADER + GPS_RECORD.replace("     3.528", "G04 3.528") + GPS_RECORD, "must have 8 lines"),
    ],
)
def test_broken_text_is_refused_with_line_and_field(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_navigation(text)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="readable text"):
        read_navigation(tmp_path / "missing.nav")
    binary = tmp_path / "binary.nav"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="RINEX VERSION / TYPE"):
        read_navigation(binary)
    with pytest.raises(InputError, match="readable text"):
        read_navigation("nul\0byte")
    cut = tmp_path / "cut.nav.gz"
    cut.write_bytes(gzip.compress((HEADER + GPS_RECORD).encode())[:-20])
    with pytest.raises(InputError, match="readable text"):
        read_navigation(cut)


def test_compressed_files_and_comments_in_any_language(tmp_path: Path) -> None:
    first, rest = HEADER.split("\n", 1)
    text = f"{first}\n{'Münster':60}COMMENT\n{rest}{GPS_RECORD}"
    file = tmp_path / "brdc.nav"
    for raw in (text.encode("latin-1"), b"\xef\xbb\xbf" + text.encode(), gzip.compress(text.encode())):
        file.write_bytes(raw)
        assert read_navigation(file).prn.tolist() == [4]


def test_messages_of_version_4() -> None:
    """Same messages with a record line each; other records and forms are passed over, whatever follows them."""
    old = parse_navigation(HEADER + GPS_RECORD)
    other = (
        "> ION G04 LNAV\n    1.0 2.0\n> STO G\n    1.0\n"
        + GPS_RECORD.replace("G04", "> EPH G04 CNAV\nG04")
        + "    1.0\n"
    )
    new = parse_navigation(HEADER.replace("3.04", "4.00") + other + "> EPH G04 LNAV\n" + GPS_RECORD)
    assert new.toe_s.tolist() == old.toe_s.tolist()
    assert new.root_a.tolist() == old.root_a.tolist()
    assert sorted(new.left_out) == [
        f"1 messages of {name}: this reader does not use them" for name in ("CNAV", "ION", "STO")
    ]


def read_or_refused(text: str) -> Ephemerides:
    """The messages of a text, none where it is refused with a message that names the place."""
    refusals = []
    try:
        return parse_navigation(text)
    except InputError as refusal:
        refusals.append(str(refusal))
    assert refusals[0].startswith("navigation file text")
    return parse_navigation(HEADER)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_damage_crashes_without_a_message(data: st.DataObject) -> None:
    text = HEADER + GPS_RECORD + GLONASS + GPS_RECORD.replace("G04", "E04")
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 30))
        text = text[:at] + data.draw(st.text("0123456789.EDen+-GECJRS \n\t\u2003\x00", max_size=30)) + text[at + cut :]
    table = read_or_refused(text)
    assert all(np.isfinite(column).all() for column in (table.clock, table.root_a, table.toe_s))


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=400))
def test_any_text_is_read_or_refused(text: str) -> None:
    with pytest.raises(InputError, match="navigation file"):
        parse_navigation(text)
    read_or_refused(HEADER + text)
