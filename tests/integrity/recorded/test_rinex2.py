"""RINEX 2.11: the recorded pair written in it gives what it gives in RINEX 3."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from navigation_texts import GPS_RECORD, HEADER
from recordings import real
from rinex2_texts import TYPES, navigation_2_text, observation_2_text

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.rinex_observation import Observations, read_observations
from lanebound.integrity.replay.baseline import solve_baseline
from lanebound.integrity.replay.baseline_report import read_coordinates
from lanebound.integrity.sky.broadcast import read_navigation
from lanebound.integrity.sky.klobuchar import read_klobuchar
from lanebound.integrity.sky.rinex_navigation import parse_navigation

KINDS = {"G": ("C1C", "L1C", "S1C", "C2W", "L2W", "S2W"), "E": ("C1X", "L1X", "S1X", "C5X", "L5X", "S5X", "C7X")}


def header(*types: str, first: str = "     2.11           OBSERVATION DATA    G (GPS)") -> str:
    listed = f"{len(types):6d}" + "".join(f"{name:>6}" for name in types)
    ends = ("TIME OF FIRST OBS", "END OF HEADER")
    texts = ("  2024     6    24     8    20    0.0000000     GPS", "")
    lines = [f"{first:<60}RINEX VERSION / TYPE", f"{listed:<60}# / TYPES OF OBSERV"]
    return "\n".join(lines + [f"{text:<60}{label}" for text, label in zip(texts, ends, strict=True)]) + "\n"


def read(folder: Path, text: str) -> Observations:
    path = folder / "rover.24o"
    path.write_text(text)
    return read_observations(path)


def same_signals(data: Observations) -> Observations:
    """The signals of TYPES alone."""
    kept = {code for by_system in TYPES.values() for code in by_system.values()}
    rows = {}
    for system in "GE":
        part = data.rows[system]
        keep = [i for i, code in enumerate(part.codes) if code in kept and (system == "E" or "5Q" not in code)]
        rows[system] = replace(part, codes=tuple(part.codes[i] for i in keep), value=part.value[:, keep],
                               lost=part.lost[:, keep], half=part.half[:, keep])  # fmt: skip
    return replace(data, rows=rows)


def test_the_recorded_pair_in_version_2(tmp_path: Path) -> None:
    folder = real("rtk_matrtklib_1m_static_30s")
    pairs = []
    for name in ("rover", "base"):
        wanted = same_signals(read_observations(folder / f"{name}.obs"))
        found = read(tmp_path, observation_2_text(wanted))
        assert found.stopped is None
        assert not found.undeclared
        np.testing.assert_array_equal(found.tow_s, wanted.tow_s)
        for system in "GE":
            ours, theirs = found.rows[system], wanted.rows[system]
            np.testing.assert_array_equal(ours.satellite, theirs.satellite)
            np.testing.assert_array_equal(ours.epoch, theirs.epoch)
            for code in theirs.codes:
                new = code if system == "G" else f"{code[:2]}X"
                np.testing.assert_array_equal(ours.column(new), theirs.column(code))
                lost = theirs.lost_lock(code) & (theirs.column(code) != 0.0)
                np.testing.assert_array_equal(ours.lost_lock(new), lost)
        pairs.append((found, wanted))
    table = read_navigation(folder / "base.nav")
    place = read_coordinates(str(folder / "base_position.txt"))
    ours, theirs = (solve_baseline(pairs[0][k], pairs[1][k], table, place) for k in (0, 1))
    assert theirs.fixed.all()
    np.testing.assert_array_equal(ours.enu_m, theirs.enu_m)
    np.testing.assert_array_equal(ours.pl_m, theirs.pl_m)


def test_messages_of_gps_in_version_2(tmp_path: Path) -> None:
    path = real("rtk_matrtklib_1m_static_30s") / "base.nav"
    wanted = read_navigation(path)
    old = tmp_path / "base.24n"
    old.write_text(navigation_2_text(path.read_text(encoding="latin-1")))
    found, gps = read_navigation(old), wanted.take(np.flatnonzero(wanted.system == 0))
    assert len(found) == len(gps) > 5
    for name in ("prn", "toe_s", "toc_s", "clock", "root_a", "mean_anomaly_rad", "health", "group_delay_s"):
        np.testing.assert_array_equal(getattr(found, name), getattr(gps, name))


def test_ionosphere_and_joined_files_of_version_2(tmp_path: Path) -> None:
    alpha = "    0.1676D-07  0.2235D-07 -0.1192D-06 -0.1192D-06"
    beta = "    0.1208D+06  0.1310D+06 -0.1310D+06 -0.1966D+06"
    old = navigation_2_text(HEADER + GPS_RECORD)
    text = old.replace(" " * 60 + "END", f"{alpha:<60}ION ALPHA\n{beta:<60}ION BETA\n" + " " * 60 + "END", 1)
    path = tmp_path / "base.24n"
    path.write_text(text + old + HEADER + GPS_RECORD.replace("G04", "G05"))
    assert read_navigation(path).prn.tolist() == [4, 4, 5]
    figures = read_klobuchar([path])
    assert figures is not None
    assert figures.alpha == (1.676e-8, 2.235e-8, -1.192e-7, -1.192e-7)
    assert figures.beta == (1.208e5, 1.31e5, -1.31e5, -1.966e5)
    path.write_text(old.replace(" 4 24", " x 24"))
    with pytest.raises(InputError, match="line 3: satellite and date"):
        read_navigation(path)
    assert len(parse_navigation(HEADER + GPS_RECORD)) == 1


def test_the_second_phase_belongs_to_the_code_that_is_there(tmp_path: Path) -> None:
    """P2 and L2 are L2W; a satellite with C2 and without P2 has L2X."""
    rows = (
        f"{2e7:14.3f}  {1e8:14.3f}  {2.1e7:14.3f}  {'':16}{8e7:14.3f}\n"
        + f"{2e7:14.3f}  {1e8:14.3f}  "
        + (f"{2.1e7:14.3f}  {2.2e7:14.3f}  {8e7:14.3f}\n")
    )
    text = header("C1", "L1", "C2", "P2", "L2") + f" 24  6 24  8 20  0.0000000  0  2G 5 17\n{rows}"
    found = read(tmp_path, text).rows["G"]
    assert found.satellite.tolist() == [5, 17]
    assert found.column("C2X").tolist() == [2.1e7, 2.1e7]
    assert found.column("L2X").tolist() == [8e7, 0.0]
    assert found.column("C2W").tolist() == [0.0, 2.2e7]
    assert found.column("L2W").tolist() == [8e7, 8e7]


def test_events_other_systems_and_the_end(tmp_path: Path) -> None:
    row = f"{2e7:14.3f}  {1e8:14.3f}1"
    text = (
        header("C1", "L1", first="     2.10           OBSERVATION DATA    M (MIXED)")
        + f" 99 12 31 23 59 59.0000000  0  2G05R03\n{row}\n{row}\n"
        + " " * 28 + f"4  1\n{'moved':<60}COMMENT\n"
        + f" 00  1  1  0  0  0.0000000  0  1E11\n{row}\n"
        + f" 00  1  1  0  0  1.0000000  0  2G05G07\n{row}\n"
    )  # fmt: skip
    found = read(tmp_path, text)
    assert found.epochs == 2
    assert found.undeclared == {"R": 1}
    assert np.diff(found.since(int(found.week[0]))).tolist() == [1.0]
    assert found.rows["E"].column("L1X").tolist() == [1e8]
    assert found.rows["G"].lost_lock("L1C").all()
    assert "lacks 1 of its lines" in str(found.stopped)


def test_an_event_that_repeats_the_types_changes_nothing(tmp_path: Path) -> None:
    row, names = f"{2e7:14.3f}  {1e8:14.3f}1", ["C1", "L1", *(f"S{k}" for k in range(1, 9))]
    listed = [f"{10:6d}" + "".join(f"{n:>6}" for n in names[:9]), " " * 6 + f"{names[9]:>6}"]

    def text(*event: str) -> str:
        rows = f"{row}\n\n"
        return (
            header(*names[:9]).replace("     9", "    10").replace(
                f"{'  2024':6}", f"{listed[1]:<60}# / TYPES OF OBSERV\n  2024", 1)
            + f" 24  6 24  8 20  0.0000000  0  1G05\n{rows}"
            + (" " * 28 + f"4{len(event):3d}\n" + "".join(f"{t:<60}# / TYPES OF OBSERV\n" for t in event))
            + f" 24  6 24  8 20  1.0000000  0  1G05\n{rows}"
        )  # fmt: skip

    plain, again = read(tmp_path, text()), read(tmp_path, text(*listed))
    assert again.epochs == plain.epochs == 2
    np.testing.assert_array_equal(again.rows["G"].value, plain.rows["G"].value)
    for changed in (listed[:1], [listed[0].replace("L1", "L2"), listed[1]]):
        with pytest.raises(InputError, match="types of observables must not change inside the file, from"):
            read(tmp_path, text(*changed))


def test_files_of_glonass_and_blank_ionosphere_are_passed_over(tmp_path: Path) -> None:
    text = navigation_2_text(HEADER + GPS_RECORD)
    old = text.replace("N: GPS NAV DATA ", "G: GLONASS NAV  ").splitlines()
    (tmp_path / "brdc.24g").write_text("\n".join(old[:6]) + "\n")  # messages of four lines
    found = read_navigation(tmp_path / "brdc.24g")
    assert len(found) == 0
    assert found.left_out == ("1 messages of GLONASS: this reader does not use them",)
    blank = text.replace(" " * 60 + "END", f"{'':<60}ION ALPHA\n{'':<60}ION BETA\n" + " " * 60 + "END", 1)
    (tmp_path / "brdc.24n").write_text(blank)
    assert read_klobuchar([tmp_path / "brdc.24n"]) is None
    assert len(read_navigation(tmp_path / "brdc.24n")) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (header("C1", "L1").replace("     2    C1", "     3    C1"), "must list 3 types, got 2"),
        (header("C1", "L1") + " 24 13 24  8 20  0.0000000  0  1G05\n\n\n", "month"),
        (header("C1", "L1") + " 24  6 24  8 20  0.0000000  0  xG05\n\n", "line 5: must be a number"),
        (header("C1", "L1").replace(" " * 60 + "END", f"{'     1     2':<60}WAVELENGTH FACT L1/2\nEND"), "half a wave"),
        (header("T1"), "must have SYS / # / OBS TYPES"),
    ],
)
def test_malformed_files_are_refused_with_the_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)
