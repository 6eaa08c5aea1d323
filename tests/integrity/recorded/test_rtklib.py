"""Solution files of RTKLIB and reference trajectories: what is read, and which damage is named."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from recordings import RTK_REFERENCE, RTK_SOLUTION, real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.recorded.rtklib import FIXED, FLOAT, read_reference, read_rtk_solution


def written(folder: Path, text: str) -> Path:
    path = folder / "drive"
    path.write_text(text)
    return path


def test_a_small_solution(tmp_path: Path) -> None:
    found = read_rtk_solution(written(tmp_path, RTK_SOLUTION))
    assert found.stopped is None
    assert found.gps_time_s == pytest.approx(2270 * 604_800.0 + np.array([194670.0, 194670.2]), abs=1e-6)
    assert found.velocity_neu_mps is None
    assert found.quality.tolist() == [FIXED, FLOAT]
    assert found.satellites.tolist() == [16, 9]
    assert found.ratio.tolist() == [6.4, 1.2]
    latitude, longitude, height = geodetic_from_ecef(found.position_ecef_m[0])
    assert np.degrees([latitude, longitude]) == pytest.approx([35.165360868, 136.88140954], abs=1e-9)
    assert float(height) == pytest.approx(41.4082, abs=1e-4)


def test_a_small_reference(tmp_path: Path) -> None:
    head, *rows = RTK_REFERENCE.splitlines()
    found = read_reference(written(tmp_path, RTK_REFERENCE))
    assert (found.tow_s.tolist(), found.week) == ([194670.0, 194670.2], 2270)
    np.testing.assert_allclose(found.position_ecef_m[0], [-3810228.582, 3567868.547, 3652903.300])
    assert np.isnan(found.heading_rad).all()
    headed = read_reference(written(tmp_path, RTK_REFERENCE.replace("Roll", "Heading")))
    np.testing.assert_allclose(np.degrees(headed.heading_rad), [0.329, 0.331])
    with pytest.raises(InputError, match="must have times that increase, 1 of 2 rows go back"):
        read_reference(written(tmp_path, "\n".join([head, *reversed(rows)]) + "\n"))
    ends = RTK_REFERENCE.replace("194670.0", "604799.9").replace("194670.2", "0.1")
    over = read_reference(written(tmp_path, ends))
    assert over.tow_s.tolist() == [604_799.9, 604_800.1]
    np.testing.assert_allclose(over.since_start(2271 * 604_800.0 + np.array([0.1])), [604_800.1], atol=1e-6)


PLACES = np.array([[35.165360868, 136.881409540, 41.4082], [35.165461, 136.8815, 41.5]])
BASE = np.array([35.134709483, 136.977574275, 104.7280])
SPEEDS = np.array([1.0, -2.0, 0.25])
TAIL = "1 16 0.0049 0.0046 0.0102 0.0028 0.0018 -0.0033 0.03 6.4"
HEADS = {
    "llh": "latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)",
    "dms": "latitude(d'\")   longitude(d'\")  height(m)   Q  ns   sdn(m)   sde(m)",
    "xyz": "x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   sdy(m)",
    "enu": "e-baseline(m)  n-baseline(m)  u-baseline(m)   Q  ns   sde(m)   sdn(m)",
}


def solution(form: str = "llh", scale: str = "GPST", date: bool = False, separator: str = " ", speeds: bool = False,
             base: bool = True) -> str:  # fmt: skip
    """Two epochs, 10 s apart, of the GPS time week 2270, 194670 s, as RTKLIB writes them in each of its forms."""

    def dms(angle: float) -> str:
        minutes, seconds = divmod(abs(angle) * 3600.0, 60.0)
        return f"{int(angle)} {int(minutes % 60):02d} {seconds:09.6f}"

    ecef, home = (
        ecef_from_geodetic(*np.radians(PLACES[:, :2].T), PLACES[:, 2]),
        ecef_from_geodetic(*np.radians(BASE[:2]), BASE[2]),
    )
    axes = ecef_from_enu_matrix(*np.radians(BASE[:2]))
    north, east, up = SPEEDS
    fast = ecef_from_enu_matrix(*np.radians(PLACES[0, :2])) @ [east, north, up] if form == "xyz" else SPEEDS
    base_text = " ".join(f"{v:.9f}" for v in BASE) if form in ("llh", "dms") else " ".join(f"{v:.4f}" for v in home)
    lines = ["% program : x", f"% ref pos   : {base_text}" if base else "%", f"%  {scale:14}{HEADS[form]}"]
    for k, place in enumerate(PLACES):
        seconds = 194_670.0 + 10.0 * k + {"GPST": 0.0, "UTC": -18.0, "JST": 9 * 3600.0 - 18.0}[scale]
        when = datetime(1980, 1, 6) + timedelta(weeks=2270, seconds=seconds)
        time = f"{when:%Y/%m/%d %H:%M:%S}.000" if date else f"2270 {seconds:.3f}"
        coordinates = {
            "llh": " ".join(f"{v:.9f}" for v in place), "xyz": " ".join(f"{v:.4f}" for v in ecef[k]),
            "dms": f"{dms(place[0])} {dms(place[1])} {place[2]:.4f}",
            "enu": " ".join(f"{v:.4f}" for v in (ecef[k] - home) @ axes),
        }[form]  # fmt: skip
        row = f"{time} {coordinates} {TAIL}" + (" " + " ".join(f"{v:.5f}" for v in fast) if speeds else "")
        lines.append(row.replace(" ", separator))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
@pytest.mark.parametrize("speeds", [False, True])
@pytest.mark.parametrize("date", [False, True])
@pytest.mark.parametrize("scale", ["GPST", "UTC", "JST"])
@pytest.mark.parametrize("form", ["llh", "dms", "xyz", "enu"])
def test_all_forms_of_a_solution_are_the_same(
    tmp_path: Path, form: str, scale: str, date: bool, speeds: bool, separator: str
) -> None:
    found = read_rtk_solution(written(tmp_path, solution(form, scale, date, separator, speeds)))
    wanted = ecef_from_geodetic(*np.radians(PLACES[:, :2].T), PLACES[:, 2])
    np.testing.assert_allclose(found.position_ecef_m, wanted, atol=3e-4)
    np.testing.assert_allclose(found.gps_time_s, 2270 * 604_800.0 + np.array([194_670.0, 194_680.0]), atol=1e-5)
    assert (found.quality.tolist(), found.satellites.tolist(), found.ratio.tolist()) == ([1, 1], [16, 16], [6.4, 6.4])
    if speeds:
        np.testing.assert_allclose(found.velocity_neu_mps, [SPEEDS, SPEEDS], atol=1e-3)
    else:
        assert found.velocity_neu_mps is None


def test_southern_and_western_degrees_of_less_than_one_keep_their_sign(tmp_path: Path) -> None:
    row = f"2270 194670.000 -0 30 00.000000 -0 15 00.000000 10.0 {TAIL}\n"
    found = read_rtk_solution(written(tmp_path, f"%  GPST {HEADS['dms']}\n{row}"))
    latitude, longitude, _ = geodetic_from_ecef(found.position_ecef_m[0])
    assert np.degrees([latitude, longitude]) == pytest.approx([-0.5, -0.25], abs=1e-9)


@pytest.mark.parametrize(("text", "message"), [
    (solution("enu", base=False), "holds baselines .* no 'ref pos' in its head: set out-solformat"),
    (solution("enu").replace(HEADS["enu"], HEADS["llh"]), "out-solformat"),  # baselines under a head of degrees
    (solution("xyz").replace(HEADS["xyz"], ""), r"latitude must lie in .* read as latitude .* \(out-solformat\)"),
    (solution("dms").replace(HEADS["dms"], HEADS["llh"]), "Q must .*out-solformat"),
    ("$GPGGA,123519.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,,,,*47\n" * 3, r"NMEA \(\$GPGGA\): set out-solf"),
    (solution(date=True).replace(".", ","), "must have decimal points, got commas in '2023"),
    (solution(date=True).replace("06:04:30.000", "06:0\n"), "got 2: the line is truncated"),
    (solution().replace("35.16536", "0.61375").replace("35.16546", "0.61375").replace("136.881", "2.389"),
     "they are probably in radians: convert them to degrees. Set"),
    (solution(date=True).replace("06:04", "6h04"), "date and time must be as .* set out-timeform"),
])  # fmt: skip
def test_forms_that_the_head_does_not_say_are_refused_with_the_option(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_rtk_solution(written(tmp_path, text))


@pytest.mark.parametrize("head", ["", "%  GPST latitude(deg) longitude(deg) height(m) Q ns\n"])
@pytest.mark.parametrize("baseline", ["0.0010 0.0020 0.5000", "12.3450 -45.6780 1.2000"])
def test_baselines_without_ref_pos_are_no_degrees(tmp_path: Path, head: str, baseline: str) -> None:
    rows = "".join(f"2270 {k}.000 {baseline} 1 16 0.01 0.01 0.01 0 0 0 0.0 6.4\n" for k in range(30))
    with pytest.raises(InputError, match=r"with 4 decimals, .*are these baselines \(e/n/u\)\? Set out-solformat"):
        read_rtk_solution(written(tmp_path, head + rows))
    moving = "".join(
        f"2270 {k}.000 {0.01 * k:.9f} 20.000000000 1.2 1 16 0.01 0.01 0.01 0 0 0 0.0 6.4\n" for k in range(30)
    )
    with pytest.raises(InputError, match="most move at 1106 m/s"):
        read_rtk_solution(written(tmp_path, head + moving))


def test_heads_inside_a_file_must_be_alike(tmp_path: Path) -> None:
    whole = solution("llh")
    heads = "".join(line for line in whole.splitlines(keepends=True) if line.startswith("%"))
    assert read_rtk_solution(written(tmp_path, whole + heads)).timing.note == ""
    for form, scale in (("enu", "GPST"), ("llh", "UTC")):
        with pytest.raises(InputError, match=r"all heads of a solution must be alike, got GPST, .* split the file"):
            read_rtk_solution(written(tmp_path, whole + solution(form, scale)))


def test_constant_baselines_under_a_head_of_degrees_are_far_from_the_base(tmp_path: Path) -> None:
    text = solution().splitlines()
    rows = [f"2270 {194670 + k}.000 12.345 -45.678 1.2 {TAIL}" for k in range(5)]
    with pytest.raises(InputError, match=r"1\d\d\d\d km from ref pos: are these baselines \(e/n/u\)"):
        read_rtk_solution(written(tmp_path, "\n".join([*text[:3], *rows]) + "\n"))


def test_a_solution_over_the_end_of_a_week_and_rows_that_go_back(tmp_path: Path) -> None:
    rows = [f"{w} {t:.1f} 35.1653608 136.8814095 41.4 {TAIL}" for w, t in ((2270, 604_799.5), (2271, 0.0), (2271, 0.5))]
    found = read_rtk_solution(written(tmp_path, "\n".join(rows) + "\n"))
    assert np.diff(found.gps_time_s).tolist() == [0.5, 0.5]
    more = [f"2271 {0.5 * k:.1f} 35.1653608 136.8814095 41.4 {TAIL}" for k in range(2, 30)]
    again = read_rtk_solution(written(tmp_path, "\n".join([*rows, rows[1], *more]) + "\n"))
    assert (again.timing.repeated, again.gps_time_s.size) == (1, 31)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("35.165360868", "95.0", "line 3, latitude must lie in"),
        ("   0.03    6.4", "", "line 3, must have more than 14 columns, got 13"),
        (" 1  16 ", " x  16 ", "line 3, Q must be a number"),
    ],
)
def test_damage_of_a_solution_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_rtk_solution(written(tmp_path, RTK_SOLUTION.replace(old, new, 1)))


def test_damage_of_a_reference_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 1 must name a column 'ECEF Y"):
        read_reference(written(tmp_path, RTK_REFERENCE.replace("ECEF Y (m)", "North")))
    with pytest.raises(InputError, match=r"line 2, ECEF X .* must be a number"):
        read_reference(written(tmp_path, RTK_REFERENCE.replace("-3810228.582", "far", 1)))
    with pytest.raises(InputError, match="must hold at least one position"):
        read_reference(written(tmp_path, RTK_REFERENCE.splitlines()[0] + "\n"))


def test_the_nagoya_drive() -> None:
    folder = real("nagoya_drive_rtk")
    solution, truth = read_rtk_solution(folder / "rover_rtk.pos"), read_reference(folder / "reference.csv")
    assert (solution.gps_time_s.size, truth.tow_s.size) == (2519, 3075)
    assert [(solution.quality == q).sum() for q in (FIXED, FLOAT)] == [1019, 1500]
