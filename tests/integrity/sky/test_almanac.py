"""YUMA almanacs, whole and broken."""

from __future__ import annotations

from datetime import date, datetime
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky import almanac
from lanebound.integrity.sky.almanac import parse_yuma, read_yuma
from lanebound.integrity.sky.constellation import SatelliteTable
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, MU_M3PS2, propagate
from lanebound.integrity.sky.systems import System

NEAR = date(2020, 1, 3)


def block(label: str = "PRN-01", **changes: object) -> str:
    field = {
        "ID": "01",
        "Health": "000",
        "Eccentricity": " 0.0000000000E+000",
        "Time of Applicability(s)": " 40000.0000",
        "Orbital Inclination(rad)": " 0.0",
        "Rate of Right Ascen(r/s)": "-0.0E-008",
        "SQRT(A)  (m 1/2)": " 5153.6",
        "Right Ascen at Week(rad)": " 0.5",
        "Argument of Perigee(rad)": " 0.25",
        "Mean Anom(rad)": "-0.125",
        "Af0(s)": "-0.1E-004",
        "Af1(s/s)": " 0",
        "week": "38",
    } | changes
    return f"******** Week 38 almanac for {label} ********\n" + "".join(f"{k}:   {v}\n" for k, v in field.items())


def test_equatorial_circular_satellite_stands_where_the_definition_says() -> None:
    table = parse_yuma(block(), NEAR)
    week = 2 * 1024 + 38
    assert table.elements.epoch_s[0] == week * 604_800.0 + 40_000.0
    t = table.elements.epoch_s[0] + np.array([0.0, 1000.0])
    position = propagate(table.elements, t)[0][:, 0]
    n = np.sqrt(MU_M3PS2 / 5153.6**6)
    # IS-GPS-200 table 20-IV with e = i = 0: node + perigee + M less the Earth's turn since the week began
    longitude = 0.5 + 0.25 - 0.125 + n * np.array([0.0, 1000.0]) - EARTH_RATE_RADPS * np.array([40_000.0, 41_000.0])
    np.testing.assert_allclose(position[:, 0], 5153.6**2 * np.cos(longitude), atol=1e-2)
    np.testing.assert_allclose(position[:, 1], 5153.6**2 * np.sin(longitude), atol=1e-2)


@pytest.mark.parametrize(
    ("week", "near", "expected"),
    [
        ("38", date(2000, 5, 1), 1024 + 38),
        ("38", date(1980, 10, 1), 38),
        ("1023", date(2019, 4, 10), 2047),  # the week before the second rollover
        ("1745", date(2013, 6, 20), 1745),  # given in full: kept
        ("1745", date(2033, 6, 20), 1745),
    ],
)
def test_weeks_given_modulo_1024_are_resolved_near_a_date(week: str, near: date, expected: int) -> None:
    table = parse_yuma(block(week=week), near)
    assert table.elements.epoch_s[0] // 604_800.0 == expected


def test_systems_by_label_and_variant_labels() -> None:
    labels = {"PRN-07": System.GPS, "GAL-01": System.GALILEO, "GLO-715": System.GLONASS, "BDU-M3": System.BEIDOU}
    text = "\n".join(block(name, ID=i + 1) for i, name in enumerate(labels))
    text = text.replace("Right Ascen at Week", "Right Ascen at TOA")
    table = parse_yuma(text, NEAR)
    assert table.system.tolist() == [int(s) for s in labels.values()]
    assert table.prn.tolist() == [1, 2, 3, 4]


def test_unhealthy_satellites_are_left_out_on_request() -> None:
    text = block(ID=1) + block("PRN-02", ID=2, Health="063")
    assert parse_yuma(text, NEAR).prn.tolist() == [1]
    assert parse_yuma(text, NEAR, healthy_only=False).prn.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "none: is it a YUMA file"),
        ("hello: 3\n", "line 1 .*header"),
        (block("PRN-02").rsplit("Mean Anom", 1)[0], r"end of text \(0 satellites read\).*'mean anom'.*truncated"),
        (block().rsplit("week", 1)[0] + block("PRN-02"), r"line 14 \(0 satellites read\).*'week' is missing"),
        (block(ID="x"), "line 2 .*'id' must be a number, got 'x'"),
        (block(Eccentricity="1.5"), r"line 4 .*'eccentricity' must lie in \[0, 0.9\], got 1.5"),
        (block(Eccentricity="nan"), "must lie in"),
        (block(**{"SQRT(A)  (m 1/2)": "51.5"}), "sqrt"),
        (block("XYZ-01"), "system must be one of .*'XYZ'"),
        (block().replace("Health:", "Health"), "line 3 .*'label: value'"),
        (block() + "ID: 01\n", "'id' must appear once"),
        (block(Health="001"), "healthy satellite"),
    ],
)
def test_broken_almanacs_name_the_line_and_the_field(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_yuma(text, NEAR)


@pytest.mark.parametrize("near", ["garbage", "2020-01-03", None, 2020.0])
def test_a_date_that_is_none_is_refused(near: object) -> None:
    with pytest.raises(InputError, match=r"near must be a datetime\.date, got .*: pass for instance date\("):
        parse_yuma(block(), near)  # type: ignore[arg-type]


def test_an_instant_stands_for_its_day() -> None:
    at_noon = parse_yuma(block(), datetime(2020, 1, 3, 12))
    assert at_noon.elements.epoch_s[0] == parse_yuma(block(), NEAR).elements.epoch_s[0]


def test_every_truncation_of_a_file_gives_the_satellites_before_it_and_says_where_it_stopped() -> None:
    one, two = block(), block("PRN-02", ID=2)
    for n in range(1, len(two) + 1):
        table = parse_yuma(one + two[:n], NEAR)
        whole = n >= len(two) - 1  # without the line end alone the week is whole still, as the header says
        assert table.prn.tolist() == ([1, 2] if whole else [1]), two[:n]
        # of a header that breaks off nobody can tell whose it is
        assert bool(table.stopped) != whole, two[:n]
        assert whole or "1 satellites read" in table.stopped
    for n in range(len(one) - 1):
        with pytest.raises(InputError):
            parse_yuma(one[:n], NEAR)


def test_where_a_file_stopped_stays_with_its_satellites() -> None:
    table = parse_yuma(block() + block("PRN-02", ID=2)[:200], NEAR)
    assert "end of text (1 satellites read): it ends in the middle of a satellite" in table.stopped
    assert table.take(np.array([0])).stopped == table.stopped
    assert SatelliteTable.join([table, parse_yuma(block(), NEAR)]).stopped == table.stopped


def test_files(tmp_path: Path) -> None:
    file = tmp_path / "yuma.txt"
    file.write_text(block())
    assert len(read_yuma(file, NEAR)) == 1
    file.write_text(" " * (almanac.LARGEST_BYTES + 1))
    with pytest.raises(InputError, match="at most 8388608 bytes, has 8388609"):
        read_yuma(file, NEAR)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="readable ASCII"):
        read_yuma(file, NEAR)
    with pytest.raises(InputError, match="readable ASCII"):
        read_yuma(tmp_path / "none.txt", NEAR)
