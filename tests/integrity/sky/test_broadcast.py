"""Satellites from broadcast messages, against the numbers of others and against their own derivatives."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from broadcast_cases import CASES, MESSAGES, NAMES
from navigation_texts import GPS_RECORD, HEADER, record

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.broadcast import parse_navigation, positions, read_navigation
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, rotated_with_earth
from lanebound.integrity.sky.systems import System

WEEK_START = {"G": 2111 * 604_800.0, "E": 2111 * 604_800.0, "C": 2111 * 604_800.0 + 14.0}
"""GPS time of the week that 2020-06-25 lies in, as each system counts."""


def date(second_of_week: float) -> str:
    """The date in June 2020 of a second of GPS week 2111, which began on the 21st."""
    day, rest = divmod(int(second_of_week), 86_400)
    return f"2020 06 {21 + day:02d} {rest // 3600:02d} {rest // 60 % 60:02d} {rest % 60:02d}"


def message(satellite: str, toc_later_s: float = 0.0) -> str:
    values, clock, delay = MESSAGES[satellite]
    elements = dict(zip(NAMES, values, strict=True))
    return record(satellite, date(elements["toe_sow"] + toc_later_s), clock, elements, delay)


@pytest.mark.parametrize(("satellite", "second", "position", "polynomial", "relativity"), CASES)
def test_positions_and_clocks_agree_with_others(
    satellite: str, second: float, position: tuple[float, ...], polynomial: float, relativity: float
) -> None:
    table = parse_navigation(HEADER + message(satellite))
    start = WEEK_START[satellite[0]] + (604_800.0 if second < 0 else 0.0)
    found = positions(table, [start], -second)
    assert found.usable.all()
    np.testing.assert_allclose(found.position_ecef_m[0, 0], position, rtol=0.0, atol=1e-5)
    # theirs counts the polynomial's time by the satellite's own clock, ours is given GPS time
    drift = table.clock[0, 1] + 2.0 * table.clock[0, 2] * (start + second - table.toc_s[0])
    expected = polynomial * (1.0 + drift) + relativity
    np.testing.assert_allclose(found.clock_s[0, 0], expected, rtol=0.0, atol=2e-15)
    assert found.group_delay_s[0, 0, 0] == MESSAGES[satellite][2]


def test_a_clock_may_have_another_reference_time_than_the_orbit() -> None:
    table = parse_navigation(HEADER + message("G01", 30.0))
    found = positions(table, [WEEK_START["G"]], -360_000.0)
    # the same source, case gps_toc_offset: x, clock polynomial by the satellite's own time, relativity
    assert found.position_ecef_m[0, 0, 0] == pytest.approx(-14038625.008796463, abs=1e-5)
    expected = 1.6043216873978756e-05 * (1.0 + 7.04858393874e-12) - 1.3682735761311472e-08
    assert found.clock_s[0, 0] == pytest.approx(expected, abs=2e-15)


def test_a_position_at_the_time_of_transmission() -> None:
    # gps-labs gps_lab03: received 2024-03-07 00:53:01, transmitted 72.187285912 ms earlier
    table = parse_navigation(HEADER + GPS_RECORD)
    found = positions(table, [2304 * 604_800.0 + 4 * 86_400.0 + 53 * 60.0 + 1.0], 1.0 - 0.927812714088)
    expected = (4460302.794944842, 17049812.69228974, 19845264.366251267)
    np.testing.assert_allclose(found.position_ecef_m[0, 0], expected, rtol=0.0, atol=0.01)


@pytest.mark.parametrize("satellite", MESSAGES)
def test_velocities_are_derivatives(satellite: str) -> None:
    table = parse_navigation(HEADER + message(satellite))
    at = np.array([table.toe_s[0] + 1234.0])
    h = 0.5
    now, after, before = (positions(table, at, e) for e in (0.0, -h, h))
    change = (after.position_ecef_m - before.position_ecef_m) / (2.0 * h)
    np.testing.assert_allclose(now.velocity_ecef_mps, change, rtol=0.0, atol=5e-6)
    slope = (after.clock_s - before.clock_s) / (2.0 * h)
    np.testing.assert_allclose(now.clock_rate_sps, slope, rtol=0.0, atol=1e-18 / h + 1e-17)


def test_the_nearest_message_serves_and_none_far_away() -> None:
    early, late = message("G01"), message("G01").replace("3.600000000000E+05", "3.672000000000E+05")
    late = late.replace(date(360_000.0), date(367_200.0))
    table = parse_navigation(HEADER + early + late)
    start = WEEK_START["G"]
    seconds = np.array([350_000.0, 353_000.0, 363_000.0, 364_000.0, 374_000.0, 375_000.0])
    found = positions(table, start + seconds)
    np.testing.assert_array_equal(found.message[:, 0], [-1, 0, 0, 1, 1, -1])
    np.testing.assert_array_equal(found.usable[:, 0], found.message[:, 0] >= 0)
    assert np.isfinite(found.position_ecef_m).all()
    assert not found.position_ecef_m[[0, 5]].any()


def test_unhealthy_satellites_are_left_out_unless_asked_for() -> None:
    sick = message("G01").splitlines()
    sick[6] = sick[6][:23] + " 6.300000000000E+01" + sick[6][42:]
    table = parse_navigation(HEADER + "\n".join(sick) + "\n")
    at = table.toe_s
    assert not positions(table, at).usable.any()
    assert positions(table, at, healthy_only=False).usable.all()


@pytest.mark.parametrize(("word", "well"), [(0, True), (1, True), (2, False), (33, False), (63, False)])
def test_the_last_bit_of_a_qzss_word_is_of_a_signal_that_nobody_uses(word: int, well: bool) -> None:
    """All QZSS satellites send 1 while L1 C/A goes in the place of L1 C/B."""
    for name, expected in (("J02", well), ("G01", word == 0)):
        lines = message("G01").replace("G01", name).splitlines()
        lines[6] = f"{lines[6][:23]}{word:19.12E}{lines[6][42:]}"
        table = parse_navigation(HEADER + "\n".join(lines) + "\n")
        assert table.healthy.tolist() == [expected]
        assert positions(table, table.toe_s).usable.all() == expected


def test_each_satellite_may_have_its_own_time() -> None:
    table = parse_navigation(HEADER + message("G01") + message("E01"))
    at = np.array([[WEEK_START["G"] + 350_500.0]])
    travel = np.array([[0.07, 0.09]])
    both = positions(table, at, travel)
    for s in range(2):
        alone = positions(table, at[0], travel[0, s])
        np.testing.assert_array_equal(both.position_ecef_m[:, s], alone.position_ecef_m[:, s])
    np.testing.assert_array_equal(both.satellite, [[System.GPS, 1], [System.GALILEO, 1]])


@pytest.mark.parametrize("times", [(np.zeros((2, 3)), 0.0), (np.zeros(2), np.zeros((5, 7))), (np.array([np.nan]), 0.0)])
def test_times_of_a_wrong_shape_are_refused(times: tuple[np.ndarray, object]) -> None:
    table = parse_navigation(HEADER + message("G01") + message("E01"))
    with pytest.raises(InputError, match="gps_time_s"):
        positions(table, *times)


def test_the_earth_turns_while_a_signal_travels() -> None:
    turned = rotated_with_earth(np.array([2.6e7, 0.0, 1.0]), EARTH_RATE_RADPS * 0.086)
    # 7.292e-5 rad/s for 86 ms at 26,000 km: 163 m towards the west
    np.testing.assert_allclose(turned, [2.6e7, -163.05, 1.0], atol=0.1)


@pytest.mark.skipif("LANEBOUND_DATA" not in os.environ, reason="needs recorded data in the folder LANEBOUND_DATA")
def test_a_recorded_file_puts_the_satellites_into_their_shells() -> None:
    file = Path(os.environ["LANEBOUND_DATA"]) / "rtk_matrtklib_1m_static_30s" / "base.nav"
    if not file.exists():
        pytest.skip(f"{file} is absent")
    table = read_navigation(file)
    found = positions(table, [2320 * 604_800.0 + 116_400.0])
    radius = np.linalg.norm(found.position_ecef_m[0], axis=-1)
    for system, low, high in ((System.GPS, 2.6e7, 2.7e7), (System.GALILEO, 2.95e7, 2.97e7)):
        of = (found.satellite[:, 0] == system) & found.usable[0]
        assert of.sum() >= 8
        assert ((radius[of] > low) & (radius[of] < high)).all()
    assert not table.stopped
    assert table.left_out == ("19 messages of GLONASS: this reader does not use them",)
