"""RTK of two recorded receivers: simulated ones that stand and move, and the recorded pair."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from baselines import AXES, PLACE, navigation_text, observation_text, receiver, sky
from recordings import real
from rtklib_solution import read_solution
from typer.testing import CliRunner

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.recorded.rinex_observation import Observations, SystemRows, read_observations
from lanebound.integrity.replay.baseline import Baseline, BaselineConfig, solve_baseline
from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline, summarise
from lanebound.integrity.replay.datasets import kind_of, replay_folder
from lanebound.integrity.sky.rinex_navigation import parse_navigation

TABLE = sky()


def moving(time_s: np.ndarray) -> np.ndarray:
    """A rover that drives a curve at 10 m/s, (T, 3) E, N, U from the base."""
    heading = 0.3 + 0.05 * time_s
    return np.stack([300.0 - 200.0 * np.cos(heading), 100.0 + 200.0 * np.sin(heading), 5.0 + 0.02 * time_s], -1)


def base_at(time_s: np.ndarray, **options: Any) -> Observations:
    return receiver(TABLE, time_s, np.tile(PLACE, (time_s.size, 1)), clock_s=-3e-4, seed=2, **options)


def off(solved: Baseline, true_enu: np.ndarray) -> np.ndarray:
    error = solved.enu_m[:, :2] - true_enu[:, :2]
    return (track_from_enu_matrix(solved.heading_rad) @ error[..., None])[..., 0]


def test_a_moving_rover_at_five_times_the_rate_of_its_base() -> None:
    time = np.arange(0.0, 6.0, 0.2)
    rover = receiver(TABLE, time, PLACE + moving(time) @ AXES.T, clock_s=5e-4, seed=1)
    solved = solve_baseline(rover, base_at(np.arange(0.0, 6.0)), TABLE, PLACE)
    assert solved.fixed[1:].all()
    keep = solved.fixed
    error = np.abs(off(solved, moving(time))[keep])
    assert error.max() < 0.03
    assert (error < solved.pl_m[keep]).all()
    np.testing.assert_allclose(solved.age_s, np.tile(np.arange(5) * 0.2, 6), atol=1e-9)
    assert solved.wrong_fix_risk.max() <= 1e-6


def test_one_band_and_one_system_fix_too_or_fall_back_to_the_code() -> None:
    time = np.arange(0.0, 3.0)
    place = np.tile(PLACE + AXES @ np.array([50.0, 20.0, 0.0]), (3, 1))
    rover, base = receiver(TABLE, time, place, clock_s=1e-4, seed=1), base_at(time)
    thin = [replace(o, rows={"G": o.rows["G"]}) for o in (rover, base)]
    solved = solve_baseline(*thin, TABLE, PLACE, BaselineConfig(bands=1))
    assert solved.choice.bands == 1
    assert (solved.mode != Mode.NONE).all()
    error = np.abs(off(solved, np.tile([50.0, 20.0, 0.0], (3, 1))))
    assert (error < solved.pl_m).all()


def test_a_slip_that_the_receiver_tells_of_does_no_harm() -> None:
    time = np.arange(0.0, 6.0)
    offset = np.tile([10.0, 5.0, 1.0], (6, 1))
    rover = receiver(TABLE, time, PLACE + offset @ AXES.T, clock_s=1e-4, seed=1, slips={(2, 3): 5.0, (9, 3): -2.0})
    solved = solve_baseline(rover, base_at(time), TABLE, PLACE)
    assert solved.fixed.all()
    assert np.abs(off(solved, offset)).max() < 0.03


def test_a_gap_of_the_base_ages_and_then_ends_the_corrections() -> None:
    time = np.arange(0.0, 3.0)
    rover = receiver(TABLE, time + 20.0, np.tile(PLACE, (3, 1)), clock_s=1e-4, seed=1)
    with pytest.raises(InputError, match="must overlap in time"):
        solve_baseline(replace(rover, tow_s=rover.tow_s + 100.0), base_at(time), TABLE, PLACE)
    with pytest.raises(InputError, match="must overlap in time"):
        solve_baseline(rover, replace(base_at(time), week=base_at(time).week + 1), TABLE, PLACE)


def test_epochs_without_a_base_are_counted() -> None:
    """A base that ends after 3 s, for a rover of 40 s: corrections are used for 30 s, and then missing."""
    time = np.arange(-2.0, 38.0)
    rover = receiver(TABLE, time, np.tile(PLACE + AXES @ [5.0, 2.0, 0.0], (40, 1)), clock_s=1e-4, seed=1)
    solved = solve_baseline(rover, base_at(np.arange(0.0, 3.0)), TABLE, PLACE)
    none = solved.status == RtkStatus.NO_CORRECTIONS.code
    assert none.tolist() == [True] * 2 + [False] * 33 + [True] * 5
    assert (solved.mode[none] == Mode.NONE).all()
    assert np.isinf(solved.age_s[none]).all()
    found = summarise(solved)
    assert (found["epochs"], found["status"]["no_corrections"]) == (40, 7)
    assert found["fixed_share"] == found["fixed"] / 40
    assert found["first_fix_s"] == 2.0


DELTA_ENU_M = (0.3, 0.2, 1.5)


def pair_at_a_pillar() -> tuple[Observations, Observations, np.ndarray]:
    """A rover that stands, a base whose header has the marker DELTA_ENU_M below PLACE, and the delta in ECEF [m]."""
    time = np.arange(0.0, 3.0)
    rover = receiver(TABLE, time, np.tile(PLACE + AXES @ [50.0, 20.0, 1.0], (3, 1)), clock_s=1e-4, seed=1)
    base, delta = base_at(time), AXES @ np.array(DELTA_ENU_M)
    marker = replace(base.header, position_ecef_m=tuple(PLACE - delta), antenna_delta_enu_m=DELTA_ENU_M)
    return rover, replace(base, header=marker), delta


def test_the_antenna_of_the_base_stands_above_its_marker() -> None:
    rover, base, delta = pair_at_a_pillar()
    flat = replace(base, header=replace(base.header, antenna_delta_enu_m=(0.0, 0.0, 0.0)))
    solved, low = solve_baseline(rover, base, TABLE), solve_baseline(rover, flat, TABLE)
    assert solved.fixed.all()
    assert low.fixed.all()
    np.testing.assert_allclose(solved.base_ecef_m, PLACE, rtol=0.0, atol=1e-6)  # the normal turns over 2 m
    np.testing.assert_allclose(solved.ecef_m - low.ecef_m, np.tile(delta, (3, 1)), rtol=0.0, atol=1e-4)
    assert np.linalg.norm(solved.ecef_m - (PLACE + AXES @ [50.0, 20.0, 1.0]), axis=1).max() < 0.03


def test_without_a_delta_the_marker_is_the_antenna_to_the_bit() -> None:
    rover, base, _ = pair_at_a_pillar()
    flat = replace(base.header, antenna_delta_enu_m=(0.0, 0.0, 0.0))
    marker = np.array(flat.position_ecef_m)
    assert (flat.antenna_ecef_m == marker).all()
    ours = solve_baseline(rover, replace(base, header=flat), TABLE)
    assert ours.ecef_m.tobytes() == solve_baseline(rover, base, TABLE, marker).ecef_m.tobytes()


def test_a_given_position_is_the_antenna_and_a_delta_of_the_rover_moves_nothing() -> None:
    rover, base, _ = pair_at_a_pillar()
    raised = replace(rover, header=replace(rover.header, antenna_delta_enu_m=DELTA_ENU_M))
    plain = replace(base, header=replace(base.header, antenna_delta_enu_m=(0.0, 0.0, 0.0)))
    solved = solve_baseline(raised, base, TABLE, PLACE)
    assert solved.ecef_m.tobytes() == solve_baseline(rover, plain, TABLE, PLACE).ecef_m.tobytes()
    assert (solved.base_ecef_m == PLACE).all()


def test_what_does_not_belong_together_is_refused() -> None:
    time = np.arange(0.0, 2.0)
    rover, base = (base_at(time) for _ in range(2))
    with pytest.raises(InputError, match="near the Earth's surface"):
        solve_baseline(rover, base, TABLE, np.array([35.0, 137.0, 100.0]))
    with pytest.raises(InputError, match="must hold messages"):
        solve_baseline(rover, base, TABLE.take(np.zeros(0, np.int64)), PLACE)
    with pytest.raises(InputError, match="no APPROX POSITION"):
        solve_baseline(rover, replace(base, header=replace(base.header, position_ecef_m=None)), TABLE)


def test_epochs_without_satellites_have_no_position() -> None:
    time = np.arange(0.0, 3.0)
    rover, base = receiver(TABLE, time, np.tile(PLACE, (3, 1)), clock_s=1e-4, seed=1), base_at(time)
    blind = {}
    for letter, rows in rover.rows.items():
        keep = rows.epoch != 1
        blind[letter] = SystemRows(
            rows.codes, rows.epoch[keep], rows.satellite[keep], rows.value[keep], rows.lost[keep], rows.half[keep]
        )
    solved = solve_baseline(replace(rover, rows=blind), base, TABLE, PLACE)
    assert solved.mode.tolist() == [Mode.RTK, Mode.NONE, Mode.RTK]
    assert np.isinf(solved.pl_m[1]).all()
    found = summarise(solved, PLACE)
    assert found["fixed"] == 2
    assert found["wrong_fix_risk_max"] == solved.wrong_fix_risk[[0, 2]].max()
    assert "too narrow" in found["caution"]
    assert not {"errors", "caution"} & set(summarise(solved))  # no intervals, nothing to be cautious about


def test_coordinates_in_both_forms_and_from_a_file(tmp_path: Path) -> None:
    x, y, z = PLACE
    np.testing.assert_allclose(read_coordinates(f"{x},{y},{z}"), PLACE)
    (tmp_path / "here.txt").write_text("35.13 136.97 100.0")
    np.testing.assert_allclose(read_coordinates(str(tmp_path / "here.txt")), PLACE, atol=1e-6)
    for wrong in ("1,2", "a,b,c", "nowhere.txt"):
        with pytest.raises(InputError, match="coordinates"):
            read_coordinates(wrong)


def test_a_folder_of_nothing_known_is_told_what_there_could_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"smartloc.*comma2k19.*rinex"):
        kind_of(tmp_path)
    for name in ("rover.obs", "base.obs"):
        (tmp_path / name).write_text(observation_text(base_at(np.arange(2.0))))
    assert kind_of(tmp_path) == "rinex"
    with pytest.raises(InputError, match="must hold a RINEX navigation file"):
        replay_folder(tmp_path, tmp_path / "out")


def test_the_static_pair(tmp_path: Path) -> None:
    folder = real("rtk_matrtklib_1m_static_30s")
    found, written = replay_folder(folder, tmp_path)
    assert all(path.exists() for path in written)
    assert found["stopped"] == {}
    assert (found["epochs"], found["fixed"]) == (31, 31)
    assert found["errors"]["fixed"]["horizontal_max_m"] < 0.02
    assert found["errors"]["fixed"]["spatial_max_m"] < 0.02
    assert [found["errors"]["fixed"][axis]["exceeded"] for axis in ("at", "ct")] == [0, 0]
    _, oracle, quality = read_solution(folder / "rtklib_oracle.pos")
    assert (quality == 1).all()
    ours = np.genfromtxt(tmp_path / "solution.csv", delimiter=",", skip_header=1, usecols=(4, 5, 6))
    assert np.linalg.norm(ours - oracle, axis=1).max() < 0.02


def test_the_command(tmp_path: Path) -> None:
    from lanebound.agents.cli import app

    folder = real("rtk_matrtklib_1m_static_30s")
    files = {
        name: str(folder / file) for name, file in (("rover", "rover.obs"), ("base", "base.obs"), ("nav", "base.nav"))
    }
    options = [part for name, file in files.items() for part in (f"--{name}", file)]
    done = CliRunner().invoke(app, ["rtk", *options, "--out", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["fixed"] == 31
    refused = CliRunner().invoke(app, ["rtk", *options[:-1], str(folder / "base.obs"), "--out", str(tmp_path)])
    assert refused.exit_code == 2


def test_a_base_far_from_its_codes_is_noticed(tmp_path: Path) -> None:
    from lanebound.agents.cli import app

    folder = real("rtk_matrtklib_1m_static_30s")
    options = ["rtk", "--nav", str(folder / "base.nav"), "--out", str(tmp_path)]
    for name in ("rover", "base"):
        options += [f"--{name}", str(folder / f"{name}.obs")]
    place = read_coordinates(str(folder / "base_position.txt"))
    near, off, far = (
        CliRunner().invoke(
            app, [*options, "--base-position", ",".join(str(v) for v in place + np.array([0.0, 0.0, off]))]
        )
        for off in (0.0, 50.0, 5000.0)
    )
    assert "its own codes" not in near.output
    assert "from --base-position: an error of it is an error of every position, and in no level" in near.output
    assert "base_from_codes_m" in near.output
    assert "m from where its own codes put it, which are good to about 10 m" in off.stderr
    assert "correct --base-position of its antenna" in off.stderr
    assert far.exit_code == 2
    assert "from --base-position, must be that of its antenna, its own codes put it 5.0 km away" in far.stderr
    assert "correct --base-position" in far.stderr


def test_a_base_that_moves_is_refused(tmp_path: Path) -> None:
    time = np.arange(0.0, 8.0)
    table = parse_navigation(navigation_text(replace(TABLE, prn=np.arange(len(TABLE.prn)) % 90 + 1)))
    (tmp_path / "base.nav").write_text(navigation_text(table))
    for name, speed_mps, seed in (("car", 20.0, 1), ("pillar", 0.0, 2)):
        place = PLACE + (time[:, None] * [0.0, speed_mps, 0.0]) @ AXES.T
        text = observation_text(receiver(table, time, place, clock_s=1e-4, seed=seed))
        (tmp_path / f"{name}.obs").write_text(text)
    with pytest.raises(
        InputError,
        match=r"its codes say that it moves: .* the bound is 15 m; check that --rover and --base are not swapped",
    ):
        run_baseline(tmp_path / "pillar.obs", tmp_path / "car.obs", [tmp_path / "base.nav"], tmp_path / "out")


def test_reasons_of_epochs_without_a_fix_and_half_cycles_are_printed(tmp_path: Path) -> None:
    """All phases of the rover may be off by half a cycle: none is used, no fix, and the output says both."""
    from lanebound.agents.cli import app

    folder, halves = real("rtk_matrtklib_1m_static_30s"), tmp_path / "rover.obs"
    rover = read_observations(folder / "rover.obs")
    lines = (folder / "rover.obs").read_text().splitlines(keepends=True)
    for k, line in enumerate(lines):
        codes = rover.rows[line[0]].codes if line[0] in rover.rows and line[1:3].strip().isdigit() else ()
        for i in (i for i, code in enumerate(codes) if code[0] == "L"):
            at = 3 + 16 * i + 14
            if line[at - 14 : at].strip():
                line = f"{line[:at]}2{line[at + 1 :]}"
        lines[k] = line
    halves.write_text("".join(lines))
    options = ["--rover", str(halves), "--base", str(folder / "base.obs"), "--nav", str(folder / "base.nav")]
    done = CliRunner().invoke(app, ["rtk", *options, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert f"too_few: {RtkStatus.TOO_FEW.value}" in done.output
    assert "note: 100 % of the phases of the rover may be off by half a cycle" in done.stderr


@pytest.mark.parametrize("text", ["137.0,35.0,100.0", "35.0,400.0,100.0", "1.0,2.0,3e7", "95.0,10.0,50.0"])
def test_places_that_are_not_on_earth_are_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"near the Earth's surface.*latitude in \[-90, 90\]"):
        read_coordinates(text)


def test_the_static_pair_in_version_3_02(tmp_path: Path) -> None:
    folder = real("rtk_matrtklib_1m_static_30s")
    for name in ("rover", "base"):
        text = (folder / f"{name}.obs").read_text(encoding="utf-8").replace("     3.04 ", "     3.02 ", 1)
        (tmp_path / f"{name}.obs").write_text(text.replace("C2I L2I D2I S2I", "C1I L1I D1I S1I", 1), encoding="utf-8")
    for where, out in ((folder, "new"), (tmp_path, "old")):
        found, _ = run_baseline(where / "rover.obs", where / "base.obs", [folder / "base.nav"], tmp_path / out)
        assert "2I" in found["signals"]["rover"]["C"]
    assert (tmp_path / "new/solution.csv").read_bytes() == (tmp_path / "old/solution.csv").read_bytes()


def test_one_file_is_not_taken_for_two_receivers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"files of two receivers, got .* twice"):
        run_baseline(tmp_path / "a.obs", tmp_path / "below" / ".." / "a.obs", [tmp_path / "a.nav"], tmp_path)


def test_run_needs_no_truth(tmp_path: Path) -> None:
    folder = real("rtk_matrtklib_1m_static_30s")
    found, _ = run_baseline(folder / "rover.obs", folder / "base.obs", [folder / "base.nav"], tmp_path)
    assert "errors" not in found
    assert found["fixed"] == 31
    assert found["base_from_codes_m"] < 15.0
    assert found["base_antenna_from"] == "the header of its file"
    assert found["half_cycle_share"] == {"rover": 0.0, "base": 0.0}
    far = PLACE + 5000.0 * PLACE / np.linalg.norm(PLACE)
    with pytest.raises(InputError, match="its own codes put it"):
        run_baseline(folder / "rover.obs", folder / "base.obs", [folder / "base.nav"], tmp_path, base_ecef_m=far)
