"""RINEX observation files, whole, cut and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from navigation_texts import GPS_RECORD, HEADER
from recordings import RINEX, real, rinex_epoch, rinex_header, rinex_line, rinex_satellite, survives

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_observation import Observations, read_observations
from lanebound.integrity.replay.baseline import base_antenna
from lanebound.integrity.sky.rinex_navigation import parse_navigation

FUZZ = settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "rover.obs"
    path.write_bytes(text.encode("latin-1") if isinstance(text, str) else text)
    return path


def test_a_small_file(tmp_path: Path) -> None:
    found = read_observations(written(tmp_path, RINEX))
    assert found.stopped is None
    assert found.epochs == 2
    # 24 June 2024 is a Monday, the second day of GPS week 2320
    assert found.week.tolist() == [2320, 2320]
    assert found.tow_s.tolist() == [86_400 + 8 * 3600 + 20 * 60, 86_400 + 8 * 3600 + 20 * 60 + 1]
    rows = found.rows["G"]
    assert rows.satellite.tolist() == [5, 7, 5]
    assert rows.epoch.tolist() == [0, 0, 1]
    assert rows.column("L2W").tolist() == [8e7, 0.0, 8e7]
    assert rows.column("L5Q").tolist() == [0.0, 0.0, 0.0]
    assert rows.lost_lock("L1C").tolist() == [False, False, True]
    assert found.header.position_ecef_m == (-3817680.9841, 3562840.0688, 3650158.4543)


def test_qzss_satellites_have_the_numbers_of_their_messages(tmp_path: Path) -> None:
    head = rinex_header(**{"SYS / # / OBS TYPES": "J    2 C1C L1C"})
    found = read_observations(written(tmp_path, head + rinex_epoch(0.0, rinex_satellite("J02", 3.7e7, 1.9e8))))
    message = parse_navigation(HEADER + GPS_RECORD.replace("G04", "J02"))
    assert found.rows["J"].satellite.tolist() == message.prn.tolist() == [194]


def test_the_antenna_is_height_east_and_north_of_the_marker(tmp_path: Path) -> None:
    head = rinex_header(**{
        "APPROX POSITION XYZ": f"{6378137.0:14.4f}{0.0:14.4f}{0.0:14.4f}",  # on the equator: up is x, east y, north z
        "ANTENNA: DELTA H/E/N": f"{1.5:14.4f}{0.3:14.4f}{0.2:14.4f}",
        "END OF HEADER": "",
    })  # fmt: skip
    head = head.replace(rinex_line("", "END OF HEADER"), "", 1) + rinex_line("", "END OF HEADER")
    header = read_observations(written(tmp_path, head + rinex_epoch(0.0, rinex_satellite("G05", 2e7, 1e8)))).header
    assert header.antenna_delta_enu_m == (0.3, 0.2, 1.5)
    np.testing.assert_allclose(header.antenna_ecef_m, [6378138.5, 0.3, 0.2], rtol=0.0, atol=1e-9)


def test_scale_factors_divide(tmp_path: Path) -> None:
    scaled = rinex_header(**{"SYS / SCALE FACTOR": "G  100  1 L1C", "END OF HEADER": ""})
    scaled = scaled.replace(rinex_line("", "END OF HEADER"), "") + rinex_line("", "END OF HEADER")
    found = read_observations(written(tmp_path, scaled + rinex_epoch(0.0, rinex_satellite("G05", 2e7, 1e8))))
    assert found.rows["G"].value[0].tolist() == [2e7, 1e6, 0.0, 0.0]


def beidou_file(version: str, codes: str) -> str:
    head = rinex_header(**{
        "RINEX VERSION / TYPE": f"     {version}           OBSERVATION DATA    M",
        "SYS / # / OBS TYPES": f"C{len(codes.split()):5d} {codes}",
    })  # fmt: skip
    return head + rinex_epoch(0.0, rinex_satellite("C05", 2e7, 1e8, 2.1e7, 8e7))


@pytest.mark.parametrize(
    ("version", "codes", "read"),
    [
        ("3.02", "C1I L1I D1I S1I", "C2I L2I D2I S2I"),
        ("3.02", "C1Q L1Q C1X L1X", "C2Q L2Q C2X L2X"),
        ("3.02", "C2I L2I C7I L7I", "C2I L2I C7I L7I"),  # the draft's, in files of that version too
        ("3.03", "C1I L1I C7I L7I", "C2I L2I C7I L7I"),  # 1I means nothing else
        ("3.04", "C2I L2I C1P L1P", "C2I L2I C1P L1P"),
        ("3.05", "C1X L1X C1D L1D", "C1X L1X C1D L1D"),
    ],
)
def test_b1i_of_beidou_is_in_band_2_whatever_the_version(tmp_path: Path, version: str, codes: str, read: str) -> None:
    found = read_observations(written(tmp_path, beidou_file(version, codes)))
    assert found.header.codes["C"] == found.rows["C"].codes == tuple(read.split())
    assert found.rows["C"].value[0].tolist() == [2e7, 1e8, 2.1e7, 8e7]


def test_b1i_of_beidou_in_two_columns_is_refused(tmp_path: Path) -> None:
    for version in ("3.02", "3.04"):
        with pytest.raises(InputError, match="B1I in one column, got C1I and C2I"):
            read_observations(written(tmp_path, beidou_file(version, "C1I L1I C2I L2I")))


def test_band_1_of_other_systems_stays_in_version_3_02(tmp_path: Path) -> None:
    text = RINEX.replace("     3.04", "     3.02", 1)
    assert read_observations(written(tmp_path, text)).header.codes["G"] == ("C1C", "L1C", "C2W", "L2W")


def test_a_scale_goes_with_its_code_to_band_2(tmp_path: Path) -> None:
    text = beidou_file("3.02", "C1I L1I C7I L7I")
    scale = rinex_line("C  100  1 L1I", "SYS / SCALE FACTOR")
    text = text.replace(rinex_line("", "END OF HEADER"), scale + rinex_line("", "END OF HEADER"))
    assert read_observations(written(tmp_path, text)).rows["C"].value[0].tolist() == [2e7, 1e6, 2.1e7, 8e7]


def test_beidou_time_is_14_s_behind(tmp_path: Path) -> None:
    head = rinex_header(**{"TIME OF FIRST OBS": "  2024     6    24     8    20    0.0000000     BDT"})
    found = read_observations(written(tmp_path, head + rinex_epoch(0.0, rinex_satellite("G05", 2e7))))
    assert found.tow_s[0] == 86_400 + 8 * 3600 + 20 * 60 + 14


def test_events_are_passed_over_and_power_failures_kept(tmp_path: Path) -> None:
    event = rinex_epoch(1.5, rinex_line("moved", "COMMENT"), flag=4)
    after = rinex_epoch(2.0, rinex_satellite("G05", 2e7), flag=1)
    slips = rinex_epoch(3.0, rinex_satellite("G05", 2e7), flag=6)
    found = read_observations(written(tmp_path, RINEX + event + after + slips))
    assert found.epochs == 3
    assert found.power_failed.tolist() == [False, False, True]


def same(first: Observations, second: Observations) -> bool:
    """Whether two files hold the same epochs and rows, to the bit."""
    return all(
        np.array_equal(getattr(first.rows["G"], name), getattr(second.rows["G"], name))
        for name in ("epoch", "satellite", "value", "lost", "half")
    ) and np.array_equal(first.tow_s, second.tow_s)


AFTER = rinex_epoch(2.0, rinex_satellite("G05", 2e7, 1e8))
TYPES = rinex_line("G    4 C1C L1C C2W L2W", "SYS / # / OBS TYPES")


@pytest.mark.parametrize("event", [
    (TYPES,), (rinex_line("", "COMMENT"), TYPES), (rinex_line("", "SYS / SCALE FACTOR"), TYPES),
    (rinex_line("G    1 C1C L1C C2W L2W", "COMMENT"),), (rinex_line("", "APPROX POSITION XYZ"),),
    (rinex_line(" -3817680.9841  3562840.0688  3650158.4543", "APPROX POSITION XYZ"),),
    (rinex_line("        0.0000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"),),
    (rinex_line("        0.0000        0.0000        0.0000", "ANTENNA: DELTA X/Y/Z"),),
    (rinex_line("G    1", "SYS / SCALE FACTOR"),), (rinex_line("G    1  2 C1C L1C", "SYS / SCALE FACTOR"),),
])  # fmt: skip
def test_an_event_that_repeats_the_header_changes_nothing(tmp_path: Path, event: tuple[str, ...]) -> None:
    plain = read_observations(written(tmp_path, RINEX + AFTER))
    found = read_observations(written(tmp_path, RINEX + rinex_epoch(1.5, *event, flag=4) + AFTER))
    assert same(found, plain)
    assert found.note == ""


@pytest.mark.parametrize(("event", "message"), [
    (rinex_line("G    4 C1C L1C L2W C2W", "SYS / # / OBS TYPES"), "of G must not change inside the file, from C1C"),
    (rinex_line("G    3 C1C L1C C2W", "SYS / # / OBS TYPES"), "of G must not change inside the file"),
    (rinex_line("E    1 C1C", "SYS / # / OBS TYPES"), "of E must not change inside the file, from none to C1C"),
    (rinex_line("G  100  1 L1C", "SYS / SCALE FACTOR"), "scale factors must not change"),
    (rinex_line("G  100", "SYS / SCALE FACTOR"), "scale factors must not change"),
])  # fmt: skip
def test_an_event_that_changes_the_columns_is_refused(tmp_path: Path, event: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_observations(written(tmp_path, RINEX + rinex_epoch(1.5, event, flag=4) + AFTER))


@pytest.mark.parametrize(("flag", "event", "what"), [
    (3, rinex_line(" -3817680.9841  3562840.0688  3650161.4003", "APPROX POSITION XYZ"), "POSITION XYZ is 2.946 m"),
    (4, rinex_line("        1.5000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"), "DELTA H/E/N is 1.500 m"),
    (4, rinex_line("        0.0000        2.0000        0.0000", "ANTENNA: DELTA X/Y/Z"), "DELTA X/Y/Z is 2.000 m"),
    (3, rinex_line("OTHER", "MARKER NAME"), "a new site is occupied, OTHER"),
    (2, "", "the antenna starts to move"),
])  # fmt: skip
def test_a_move_of_the_antenna_is_told_with_its_line_and_refused_of_a_base(
    tmp_path: Path, flag: int, event: str, what: str
) -> None:
    text = RINEX + rinex_epoch(1.5, *([event] if event else []), flag=flag)
    found = read_observations(written(tmp_path, text + AFTER))
    line = text.count("\n")
    assert found.epochs == 3
    assert found.moves[0].line == line
    assert f"line {line} (after week 2320, 116401.0 s): " in found.note
    assert what in found.note
    with pytest.raises(InputError, match=f"the base must stand at one place, line {line} .*{what}"):
        base_antenna(found, None)
    given = np.array([-3817680.9841, 3562840.0688, 3650158.4543])
    if "APPROX" in event:  # it need not be that of the antenna
        np.testing.assert_array_equal(base_antenna(found, given), given)
    else:
        with pytest.raises(InputError, match=r"cut the file there$"):
            base_antenna(found, given)


def test_a_site_before_the_first_epoch_is_that_of_the_file(tmp_path: Path) -> None:
    rows = RINEX[len(rinex_header()) :]
    site = (rinex_line(" -3817680.9841  3562840.0688  3650168.4543", "APPROX POSITION XYZ"),
            rinex_line("        1.5000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"))  # fmt: skip
    found = read_observations(written(tmp_path, rinex_header() + rinex_epoch(0.0, *site, flag=4) + rows))
    assert found.header.position_ecef_m == (-3817680.9841, 3562840.0688, 3650168.4543)
    assert found.header.antenna_delta_enu_m == (0.0, 0.0, 1.5)
    assert found.note == ""


def test_an_antenna_on_the_axes_of_a_vehicle_is_none_of_a_base(tmp_path: Path) -> None:
    end = rinex_line("", "END OF HEADER")
    body = rinex_line("        1.5000        0.0000        0.0000", "ANTENNA: DELTA X/Y/Z")
    found = read_observations(written(tmp_path, RINEX.replace(end, body + end)))
    with pytest.raises(InputError, match="the base must have ANTENNA: DELTA H/E/N"):
        base_antenna(found, None)
    given = np.array([-3817680.9841, 3562840.0688, 3650158.4543])
    np.testing.assert_array_equal(base_antenna(found, given), given)


def test_a_position_that_is_partly_blank_is_missing_and_a_blank_offset_is_0(tmp_path: Path) -> None:
    end = rinex_line("", "END OF HEADER")
    more = rinex_line(" -3817680.9841", "APPROX POSITION XYZ") + rinex_line("        0.1000", "ANTENNA: DELTA H/E/N")
    header = read_observations(written(tmp_path, RINEX.replace(end, more + end))).header
    assert (header.position_ecef_m, header.antenna_delta_enu_m) == (None, (0.0, 0.0, 0.1))


def test_a_file_of_beidou_alone_without_a_time_system_is_in_its_time(tmp_path: Path) -> None:
    labels = {"SYS / # / OBS TYPES": "C    2 C2I L2I", "TIME OF FIRST OBS": "  2024     6    24     8    20    0.0"}
    found = read_observations(written(tmp_path, rinex_header(**labels) + rinex_epoch(0.0, rinex_satellite("C05", 2e7))))
    assert found.header.time_system == "BDT"


def test_epochs_in_reverse_are_refused(tmp_path: Path) -> None:
    epochs = [rinex_epoch(float(t), rinex_satellite("G05", 2e7, 1e8)) for t in range(30, 10, -1)]
    with pytest.raises(InputError, match="must have epochs whose times increase, 19 of 22 go back: sort them by time"):
        read_observations(written(tmp_path, "".join([RINEX, *epochs])))
    assert read_observations(written(tmp_path, "".join([RINEX, *epochs[::-1], *epochs[::-1]]))).left_out == 20


def test_a_joined_file_of_another_site_is_told(tmp_path: Path) -> None:
    other = rinex_header(**{"APPROX POSITION XYZ": " -3817680.9841  3562845.0688  3650158.4543"})
    found = read_observations(written(tmp_path, RINEX + other + AFTER))
    assert "APPROX POSITION XYZ is 5.000 m from that of the header" in found.note


@pytest.mark.parametrize("label", [
    "MARKER NAME", "REC # / TYPE / VERS", "ANT # / TYPE", "APPROX POSITION XYZ", "ANTENNA: DELTA H/E/N", "INTERVAL",
    "SYS / SCALE FACTOR", "GLONASS SLOT / FRQ #", "TIME OF FIRST OBS", "LEAP SECONDS",
])  # fmt: skip
def test_a_blank_optional_record_is_as_missing(tmp_path: Path, label: str) -> None:
    rows = RINEX[len(rinex_header()) :]
    head = rinex_header(**{label: "", "END OF HEADER": ""}).replace(rinex_line("", "END OF HEADER"), "")
    found = read_observations(written(tmp_path, head + rinex_line("", "END OF HEADER") + rows))
    without = "".join(line for line in RINEX.splitlines(keepends=True) if line[60:].strip() != label)
    missing = read_observations(written(tmp_path, without))
    assert same(found, missing)
    assert found.header == missing.header


def test_a_channel_or_factor_that_is_blank_is_as_missing(tmp_path: Path) -> None:
    more = rinex_line("  2 R01    R02 -4", "GLONASS SLOT / FRQ #") + rinex_line("G", "SYS / SCALE FACTOR")
    found = read_observations(written(tmp_path, RINEX.replace(rinex_line("", "END OF HEADER"),
                                                              more + rinex_line("", "END OF HEADER"))))  # fmt: skip
    assert found.header.channel == {2: -4}
    assert found.rows["G"].value[0].tolist() == [2e7, 1e8, 2e7, 8e7]


def test_a_satellite_twice_in_an_epoch_counts_once(tmp_path: Path) -> None:
    twice = rinex_epoch(2.0, rinex_satellite("G05", 2e7), rinex_satellite("G07", 2e7), rinex_satellite("G05", 3e7))
    found = read_observations(written(tmp_path, RINEX + twice))
    assert found.rows["G"].satellite.tolist() == [5, 7, 5, 5, 7]
    assert found.rows["G"].column("C1C")[3] == 2e7
    assert found.note == "1 rows left out of satellites that their epochs have already"


def test_a_cut_file_gives_whole_epochs(tmp_path: Path) -> None:
    for cut in (3, 40, 70, 100):
        found = read_observations(written(tmp_path, RINEX[:-cut]))
        assert found.epochs == 1
        assert found.rows["G"].satellite.tolist() == [5, 7]
        assert found.stopped is not None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("     3.04", "     1.00", "version must be 2, 3 or 4"),
        ("OBSERVATION DATA", "NAVIGATION DATA ", "must hold observations"),
        ("     GPS ", "     GLO ", "must be in GPS"),
        ("G    4", "G    5", "must list 5 codes, got 4"),
        ("2024 06 24 08 20  0", "2024 13 24 08 20  0", r"the month of an epoch must lie in \[1, 12\], got '13'"),
        ("G05", "X05", "must be of a system"),
        ("G05", "G#5", "the number of satellite 'G#5' must be a number"),
        ("RINEX VERSION / TYPE", "CRINEX VERS   / TYPE", "crx2rnx"),
    ],
)
def test_damage_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = RINEX.replace(old, new, 1) + rinex_epoch(5.0, rinex_satellite("G05", 2e7))
    with pytest.raises(InputError, match=message):
        read_observations(written(tmp_path, text))


def test_rows_of_systems_without_codes_are_counted(tmp_path: Path) -> None:
    more = rinex_epoch(2.0, rinex_satellite("G05", 2e7), rinex_satellite("S27", 3.8e7), rinex_satellite("R01", 2e7))
    found = read_observations(written(tmp_path, RINEX + more))
    assert found.rows["G"].satellite.tolist() == [5, 7, 5, 5]
    assert found.undeclared == {"S": 1, "R": 1}
    assert found.note == "rows left out of systems without SYS / # / OBS TYPES: 1 of S, 1 of R"


def test_a_value_that_is_no_number_is_missing_and_many_are_damage(tmp_path: Path) -> None:
    whole = read_observations(written(tmp_path, RINEX)).rows["G"]
    found = read_observations(written(tmp_path, RINEX.replace("20000000.000", "2000000x.000", 1)))
    assert found.garbled == 1
    assert found.note == "1 values left out that are no numbers"
    value = whole.value.copy()
    value[0, 0] = 0.0
    np.testing.assert_array_equal(found.rows["G"].value, value)
    bad = "".join(
        rinex_epoch(2.0 + k, rinex_satellite("G05", 2e7)).replace("20000000.000", "2000000x.000") for k in range(25)
    )
    with pytest.raises(InputError, match=r"C1C of G05 must be a number.*after 20 other values"):
        read_observations(written(tmp_path, RINEX + bad))


def test_an_epoch_with_fewer_records_than_its_head_counts_is_named(tmp_path: Path) -> None:
    short = rinex_epoch(2.0, rinex_satellite("G05", 2e7), rinex_satellite("G07", 2e7)).splitlines(keepends=True)
    with pytest.raises(InputError, match="as many records as its head counts, 1 are missing"):
        read_observations(
            written(tmp_path, RINEX + "".join(short[:-1]) + rinex_epoch(3.0, rinex_satellite("G05", 2e7)))
        )


def test_epochs_that_are_not_later_are_left_out_and_counted(tmp_path: Path) -> None:
    again = rinex_epoch(1.0, rinex_satellite("G09", 3e7)) + rinex_epoch(0.0, rinex_satellite("G10", 3e7))
    found = read_observations(written(tmp_path, RINEX + again + rinex_epoch(2.0, rinex_satellite("G05", 2e7))))
    assert (found.tow_s - found.tow_s[0]).tolist() == [0.0, 1.0, 2.0]
    assert found.rows["G"].satellite.tolist() == [5, 7, 5, 5]
    assert found.left_out == 2
    assert found.note.startswith("2 epochs left out")


def test_gaps_are_told(tmp_path: Path) -> None:
    epochs = [rinex_epoch(t, rinex_satellite("G05", 2e7, 1e8)) for t in (2.0, 12.0, 13.0)]
    assert read_observations(written(tmp_path, "".join([RINEX, *epochs]))).note == "1 gap, the longest of 10.00 s"


def test_joined_files_and_padded_lines(tmp_path: Path) -> None:
    whole = read_observations(written(tmp_path, RINEX))
    later = rinex_epoch(2.0, rinex_satellite("G05", 2e7))
    joined = read_observations(written(tmp_path, RINEX + rinex_header() + later))
    assert joined.epochs == whole.epochs + 1
    assert not joined.note
    other = rinex_header(**{"SYS / # / OBS TYPES": "G    2 C1C L1C"})
    with pytest.raises(InputError, match="same observation codes"):
        read_observations(written(tmp_path, RINEX + other + later))
    padded = "\n".join(line.ljust(200) for line in RINEX.splitlines()) + "\n"
    marked = read_observations(written(tmp_path, b"\xef\xbb\xbf" + padded.encode()))
    np.testing.assert_array_equal(marked.rows["G"].value, whole.rows["G"].value)


def test_half_cycles_are_counted(tmp_path: Path) -> None:
    sure, doubtful = rinex_satellite("G05", 2e7, 1e8), rinex_satellite("G07", 2e7, 1e8, lost=2)
    for phases, share in (((sure, sure), 0.0), ((sure, doubtful), 0.5)):
        found = read_observations(written(tmp_path, rinex_header() + rinex_epoch(0.0, *phases)))
        assert found.half_cycle_share == share


def test_nothing_useful_is_refused(tmp_path: Path) -> None:
    for text in ("", "hello\n", rinex_header(), RINEX[:200]):
        with pytest.raises(InputError, match="must"):
            read_observations(written(tmp_path, text))


@FUZZ
@given(st.data())
def test_no_damage_hangs_or_crashes(tmp_path: Path, data: st.DataObject) -> None:
    text = bytearray(RINEX.encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text)))
        text[at : at + data.draw(st.integers(0, 40))] = data.draw(
            st.one_of(st.binary(max_size=40), st.sampled_from([b"999", b"-", b"\n", b">", b"G", b"1e308", b" " * 30]))
        )
    found = survives(lambda: read_observations(written(tmp_path, bytes(text))))
    if found is not None:
        assert all(np.isfinite(rows.value).all() for rows in found.rows.values())


@FUZZ
@given(st.binary(max_size=400))
def test_no_noise_hangs_or_crashes(tmp_path: Path, noise: bytes) -> None:
    survives(lambda: read_observations(written(tmp_path, noise)))


def test_the_static_pair() -> None:
    folder = real("rtk_matrtklib_1m_static_30s")
    for name, satellites in (("rover", 1767), ("base", 1767 + 2)):
        found = read_observations(folder / f"{name}.obs")
        assert found.stopped is None
        assert found.epochs == 31
        assert abs(sum(len(rows.epoch) for rows in found.rows.values()) - satellites) < 5
        assert np.diff(found.tow_s).tolist() == [1.0] * 30
