"""What is said of a pair whose files or given positions cannot be right: simulated receivers, 70 m apart."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from baselines import AXES, PLACE, TOW, navigation_text, observation_text, receiver, sky
from typer.testing import CliRunner, Result

from lanebound.agents.cli import app
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.replay.baseline_report import (
    navigation_notes,
    read_coordinates,
    require_two_receivers,
    run_baseline,
)
from lanebound.integrity.replay.datasets import replay_folder
from lanebound.integrity.sky.broadcast import parse_navigation

ROVER, FAR = PLACE + AXES @ [50.0, 40.0, 2.0], PLACE + AXES @ [300.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a rover, a base and a far rover that stand, of a car, and the navigation of this and of another day."""
    made, table, time = tmp_path_factory.mktemp("pair"), sky(), np.arange(0.0, 8.0)
    table = replace(table, prn=np.arange(len(table.prn)) % 90 + 1)
    (made / "base.nav").write_text(navigation_text(table))
    day = 86_400.0
    other = replace(
        table, toe_s=table.toe_s + day, toc_s=table.toc_s + day, toe_of_week_s=(table.toe_of_week_s + day) % 604_800.0
    )
    (made / "other.nav").write_text(navigation_text(other))
    table = parse_navigation((made / "base.nav").read_text())
    ways = {"base": (PLACE, 0.0), "rover": (ROVER, 0.0), "car": (ROVER, 20.0), "far": (FAR, 0.0)}
    for seed, (name, (start, speed_mps)) in enumerate(ways.items(), start=1):
        places = start + speed_mps * time[:, None] * AXES[:, 0]
        (made / f"{name}.obs").write_text(
            observation_text(receiver(table, time, places, clock_s=1e-4 * seed, seed=seed))
        )
    return made


def solve(folder: Path, out: Path, rover: str = "rover", **places: Any) -> dict[str, Any]:
    files = folder / f"{rover}.obs", folder / "base.obs", [folder / "base.nav"], out
    return run_baseline(*files, **{"base_ecef_m": PLACE, **places})[0]


def command(folder: Path, out: Path, base: np.ndarray, rover: np.ndarray, *more: str) -> Result:
    words = ["rtk", "--rover", folder / "rover.obs", "--base", folder / "base.obs", "--nav", folder / "base.nav"]
    words += ["--out", out, *more]
    for name, place in (("base", base), ("rover", rover)):
        words += [f"--{name}-position", ",".join(f"{v:.4f}" for v in place)]
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.parametrize(("behind_s", "scale"), [
    (14.0, "BDT without its label; write BDT into columns 49 to 51"), (18.0, "UTC; convert"),
    (18.0 - 10_800.0, "GLONASS time; convert"), (-14.0, "GPS time with the label BDT"), (-18.0, "seconds added twice"),
    (1.0, "a clock that is off"), (-3.0, "a clock that is off"),
])  # fmt: skip
@pytest.mark.parametrize("which", ["rover", "base"])
def test_times_in_another_scale_are_refused_and_the_scale_named(
    folder: Path, tmp_path: Path, which: str, behind_s: float, scale: str
) -> None:
    files = {name: folder / f"{name}.obs" for name in ("rover", "base")}
    data = read_observations(files[which])
    files[which] = tmp_path / "late.obs"
    files[which].write_text(observation_text(replace(data, tow_s=data.tow_s - behind_s)))
    with pytest.raises(
        InputError, match=rf"times of the {which} must be GPS time, .* times \{behind_s:+g} s later: .*{scale}"
    ):
        run_baseline(files["rover"], files["base"], [folder / "base.nav"], tmp_path / "out", base_ecef_m=PLACE)


@pytest.mark.parametrize("which", ["rover", "base"])
def test_codes_and_phases_exchanged_are_named(folder: Path, tmp_path: Path, which: str) -> None:
    text = (folder / f"{which}.obs").read_text()
    assert "C1C L1C" in text
    files = {name: folder / f"{name}.obs" for name in ("rover", "base")} | {which: tmp_path / "exchanged.obs"}
    files[which].write_text(text.replace("C1C L1C", "L1C C1C"))
    with pytest.raises(InputError, match=rf"codes of the {which} must be distances .* columns of codes and phases"):
        run_baseline(files["rover"], files["base"], [folder / "base.nav"], tmp_path, base_ecef_m=PLACE)


def test_a_base_in_radians_and_empty_files_are_named(folder: Path, tmp_path: Path) -> None:
    latitude, longitude, height = geodetic_from_ecef(PLACE)
    radians = read_coordinates(f"{latitude:.9f},{longitude:.9f},{height:.3f}")
    with pytest.raises(
        InputError, match=r"every position would be wrong .* probably given in radians: convert --base-p"
    ):
        solve(folder, tmp_path, base_ecef_m=radians)
    empty = tmp_path / "empty.obs"
    empty.touch()
    with pytest.raises(InputError, match=r"empty\.obs must hold observations, is empty: download it again"):
        run_baseline(empty, folder / "base.obs", [folder / "base.nav"], tmp_path)
    with pytest.raises(InputError, match=r"empty\.obs must hold navigation messages, is empty: download it again"):
        run_baseline(folder / "rover.obs", folder / "base.obs", [empty], tmp_path)
    with pytest.raises(InputError, match=r"empty\.obs must be a RINEX file, is empty: download it again"):
        replay_folder(tmp_path, tmp_path / "out")


def test_a_true_position_of_a_rover_that_moves_is_refused(folder: Path, tmp_path: Path) -> None:
    """A car goes 140 m: nine tenths of its places lie within 70 m of the middle."""
    assert solve(folder, tmp_path, "car")["epochs"] == 8
    with pytest.raises(InputError, match=r"--rover-position .* moves: a tenth of their positions lie \d\d m and more"):
        solve(folder, tmp_path, "car", rover_ecef_m=ROVER)


def test_a_true_position_far_from_the_codes_is_refused_and_a_doubtful_one_noted(folder: Path, tmp_path: Path) -> None:
    up = PLACE / np.linalg.norm(PLACE)
    with pytest.raises(InputError, match=r"from --rover-position, .* put it 5\.0 km away, .* correct --rover-position"):
        solve(folder, tmp_path, rover_ecef_m=ROVER + 5000.0 * up)
    doubtful, right = (command(folder, tmp_path, PLACE, ROVER + off * up) for off in (50.0, 0.0))
    assert doubtful.exit_code == right.exit_code == 0
    assert "note: the rover is 5" in doubtful.stderr
    assert "correct --rover-position of its antenna" in doubtful.stderr
    assert "50.00 m from that of the two positions: one of them is probably wrong by as much" in doubtful.stderr
    assert "note:" not in right.stderr


def test_swapped_positions_are_named(folder: Path, tmp_path: Path) -> None:
    """The fixed baseline is the negative of that of the positions; near ones pass the test by codes."""
    found = solve(folder, tmp_path, base_ecef_m=ROVER, rover_ecef_m=PLACE)["fixed_baseline"]
    assert found["likely"] == "swapped"
    assert found["off_m"] == pytest.approx(2.0 * np.linalg.norm(ROVER - PLACE), abs=0.1)
    assert found["off_swapped_m"] < 0.1
    done = command(folder, tmp_path / "command", ROVER, PLACE)
    assert "they are probably swapped, exchanged they are 0.0" in done.stderr
    assert "exchange --base-position and --rover-position" in done.stderr
    assert solve(folder, tmp_path, rover_ecef_m=ROVER)["fixed_baseline"]["likely"] is None


def test_positions_far_apart_and_swapped_are_named_too(folder: Path, tmp_path: Path) -> None:
    """A true position of the rover near the base is no sign of it: both receivers must fit the other position."""
    with pytest.raises(InputError, match=r"--rover-position fits them, .*: exchange the two, or rover and base"):
        solve(folder, tmp_path, "far", base_ecef_m=FAR, rover_ecef_m=PLACE)
    up = PLACE / np.linalg.norm(PLACE)
    with pytest.raises(InputError, match=r"put it 3\.0 km away, .*; correct --base-position$"):
        solve(folder, tmp_path, base_ecef_m=PLACE + 3000.0 * up, rover_ecef_m=ROVER)


def test_the_same_observations_under_two_names_are_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "rover.obs", tmp_path / "copy.obs")
    with pytest.raises(InputError, match=r"got the same observations: 100 % .* pass the file of the other receiver"):
        run_baseline(folder / "rover.obs", tmp_path / "copy.obs", [folder / "base.nav"], tmp_path, base_ecef_m=PLACE)
    rover, base = (read_observations(folder / f"{name}.obs") for name in ("rover", "base"))
    require_two_receivers(rover, base)
    late = replace(rover, tow_s=rover.tow_s + 60.0)
    require_two_receivers(rover, late)  # no common epoch: refused elsewhere


def test_navigation_of_another_day_is_named(folder: Path, tmp_path: Path) -> None:
    done = command(folder, tmp_path, PLACE, ROVER, "--nav", str(folder / "other.nav"))
    assert done.exit_code == 0, done.output
    notes = [line for line in done.stderr.splitlines() if line.startswith("note:")]
    assert len(notes) == 1
    assert notes[0].startswith(f"note: {folder / 'other.nav'}: no message of that time, ")
    rover = read_observations(folder / "rover.obs")
    table = parse_navigation((folder / "other.nav").read_text())
    assert navigation_notes({"other.nav": table}, rover) == {}  # none that fits: refused elsewhere


def test_a_replayed_folder_names_its_files(folder: Path, tmp_path: Path) -> None:
    pair = tmp_path / "pair"
    pair.mkdir()
    for name in ("rover.obs", "base.obs", "base.nav"):
        shutil.copy(folder / name, pair / name)
    up = PLACE / np.linalg.norm(PLACE)
    for name, place in (("base", PLACE), ("rover", ROVER + 5000.0 * up)):
        (pair / f"{name}_position.txt").write_text(" ".join(f"{v:.4f}" for v in place))
    with pytest.raises(InputError, match=r"from rover_position\.txt, .* correct rover_position\.txt"):
        replay_folder(pair, tmp_path / "out")


def utc(folder: Path) -> Path:
    """A track of the car in UTC that also spans the epochs of the rover."""
    times = np.arange(-20.0, 8.0)
    places = ROVER + 20.0 * (times[:, None] + 18.0) * AXES[:, 0]
    rows = [f"{TOW + t:.3f},{','.join(f'{v:.4f}' for v in place)}" for t, place in zip(times, places, strict=True)]
    (folder / "utc.csv").write_text("\n".join(["GPS time,X,Y,Z", *rows]) + "\n")
    return folder / "utc.csv"


def test_errors_of_a_rover_that_moves_are_counted_against_its_true_positions(folder: Path, tmp_path: Path) -> None:
    """Epochs without a true position are left out; a track 3 m off contradicts every level of the fixed epochs."""
    times = np.arange(0.0, 8.0)
    places = ROVER + 20.0 * times[:, None] * AXES[:, 0]

    def table(shift_m: float, shift_s: float, columns: str = "GPS time,X,Y,Z") -> Path:
        rows = [f"{TOW + t + shift_s:.3f},{','.join(f'{v:.4f}' for v in place + shift_m)}"
                for t, place in zip(times[:5], places, strict=False)]  # fmt: skip
        (tmp_path / "truth.csv").write_text("\n".join([columns, *rows]) + "\n")
        return tmp_path / "truth.csv"

    found = solve(folder, tmp_path / "a", "car", truth=table(0.0, 0.01))
    errors = found["errors"]["fixed"]
    assert errors["at"]["epochs"] == min(found["fixed"], 5)
    assert errors["horizontal_median_m"] <= errors["horizontal_95_m"] <= errors["horizontal_max_m"] < 0.03
    assert errors["at"]["exceeded"] == errors["ct"]["exceeded"] == 0
    off = solve(folder, tmp_path / "b", "car", truth=table(3.0, 0.0, "GPS TOW (s),ECEF X (m),ECEF Y (m),ECEF Z (m)"))
    assert off["errors"]["fixed"]["horizontal_median_m"] > 2.0
    assert "errors exceed their levels in 5 of 5 fixed epochs" in off["doubt"]
    with pytest.raises(InputError, match=r"--truth must have positions within 0.02 s of epochs .* in GPS time"):
        solve(folder, tmp_path / "c", "car", truth=table(0.0, 0.4))
    with pytest.raises(InputError, match=r"must be in GPS time, got positions \d+ m off, which fit 18 s earlier"):
        solve(folder, tmp_path / "e", "car", truth=utc(tmp_path))
    with pytest.raises(InputError, match=r"near the Earth's surface, got one \d+ km off it"):
        solve(folder, tmp_path / "f", "car", truth=table(3e6, 0.0))
    with pytest.raises(InputError, match="got both: leave one out"):
        solve(folder, tmp_path / "d", "car", truth=table(0.0, 0.0), rover_ecef_m=ROVER)
