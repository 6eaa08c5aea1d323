"""Conventional RTK beside a recorded drive: figures, the nearest sky, factors, and a run of the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lanebound.agents.studies import conventional as rtk
from lanebound.agents.studies import conventional as tables
from lanebound.agents.studies.in_the_loop import rate_by_street
from lanebound.agents.studies.street_drives import street_of
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.modes import Mode
from tests.helpers.recordings import RTK_REFERENCE, RTK_SOLUTION, real

SHORT: dict[str, Any] = {
    "skies": ["urban"], "vehicles": 2, "duration_s": 5.0, "warm_up_s": 2.0, "length_m": 500.0, "streets": 1,
}  # fmt: skip


def recording(folder: Path) -> Path:
    (folder / "rover_rtk.pos").write_text(RTK_SOLUTION)
    (folder / "reference.csv").write_text(RTK_REFERENCE)
    return folder


def test_figures_of_a_series() -> None:
    """Ten epochs of 0.2 s: four fixed (one 2 m off), three float, three without a position in the middle."""
    outcome = np.array([1, 1, 2, 0, 0, 0, 2, 2, 1, 1])[:, None]
    error = np.zeros((10, 1, 2))
    error[:, 0, 0] = [0.1, 0.1, 3.0, 0.0, 0.0, 0.0, 1.0, 5.0, 0.1, 2.1]
    satellites = np.array([10.0] * 3 + [2.0] * 3 + [10.0] * 3 + [20.0])[:, None]
    found = tables.figures(0.2 * np.arange(10), outcome, error, satellites, np.full((10, 1), 3.0), np.zeros((10, 1)))
    assert (found["fixed"], found["float"], found["wrong"]) == (0.4, 0.3, 0.25)
    assert found["fixed_error_m"][0] == pytest.approx(0.1)
    assert found["fixed_spread_m"][0] == pytest.approx(0.0)  # three of the four have the same offset
    assert found["float_error_m"][0] == pytest.approx(3.0)
    assert found["outage_s"]["count"] == 1
    assert found["outage_s"]["longest"] == pytest.approx(1.2)
    assert found["satellites"]["share"] == 0.5
    assert found["moving"] == 1.0


def test_epochs_without_a_solution_count_as_such(tmp_path: Path) -> None:
    folder = recording(tmp_path)
    (folder / "reference.csv").write_text(
        RTK_REFERENCE + "194670.4, 2270, 35.1, -3810228.5, 3567868.5, 3652903.3, 0.3\n"
    )
    found = rtk.recorded_figures(folder)
    assert found["epochs"] == 3
    assert found["fixed"] == found["float"] == pytest.approx(1.0 / 3.0)
    assert found["fixed_error_m"][0] < 0.2


def test_a_run_compares_with_the_nearest_sky(tmp_path: Path) -> None:
    folder = recording(tmp_path)
    config = rtk.RtkRealismConfig.load(SHORT)
    assert config.navigator_in("urban").corrections.outage_per_h == 0.0
    result = rtk.assess_rtk(folder, config, tmp_path / "out")
    assert result["nearest"] == "urban"
    assert result["skies"]["urban"]["epochs"] == 2 * 25
    assert result["skies"]["urban"]["navigator"]["epochs"] <= 2 * 50
    assert json.loads((tmp_path / "out" / "results.json").read_text())["skies"] == result["skies"]
    rows = {row[0]: row for row in tables.rtk_rows(result)[1]}
    fixed = rows["fixed, share of epochs"]
    assert float(fixed[3]) == pytest.approx(result["skies"]["urban"]["fixed"] / 0.5, rel=0.05)
    assert fixed[4] == ("yes" if 0.25 <= result["skies"]["urban"]["fixed"] <= 1.0 else "no")
    assert [row[0] for row in tables.sky_rows(result)[1]] == ["recorded", "urban"]
    assert rtk.navigator_rows(result)[1][0][0] == "urban"


def test_both_solutions_are_of_the_same_measurements() -> None:
    """In the open both are right: the conventional position and that of the navigator differ by centimetres."""
    config = rtk.RtkRealismConfig.load({**SHORT, "skies": ["open"], "duration_s": 20.0})
    navigator, drive = street_of(config, "open", 0)
    for _, truth in zip(range(150), drive, strict=False):
        m = navigator.measure(truth)
        s = navigator.locate(m)
    receivers = rtk.ConventionalReceivers(config, config.vehicles, len(navigator.track.system), (0, 1), 0.2)
    outcome, east, north, satellites = receivers.solve(m, truth.position_enu_m).T
    assert (outcome == 1).all()
    assert np.hypot(east, north).max() < 0.1
    fixed = s.mode == Mode.RTK  # a vehicle that has stood until now may know no heading
    assert fixed.any()
    assert np.hypot(*(s.position_en_m - truth.position_enu_m[:, :2])[fixed].T).max() < 0.1
    assert satellites.min() > 10


def test_the_filter_solves_the_same_epochs(tmp_path: Path) -> None:
    """In the open it is fixed from the first epochs on, and right; its restarts know the losses between solutions."""
    config = rtk.RtkRealismConfig.load({**SHORT, "skies": ["open"], "duration_s": 10.0, "receiver": "filtered"})
    found = rtk.work_street(config, "open", 0)
    outcome, east, north = (np.array(found[key]) for key in ("outcome", "error_east_m", "error_north_m"))
    assert outcome.shape == (50, 2)
    assert (outcome == 1).mean() > 0.9
    assert np.quantile(np.hypot(east, north), 0.9) < 0.1


def test_an_offset_of_the_vehicle_turns_with_it() -> None:
    """0.3 m to the right of a vehicle on a circle, and 0.1 m East: both go, noise of 1 cm stays, outliers too."""
    rng, heading = np.random.default_rng(1), np.linspace(0.0, 2.0 * np.pi, 400)
    right = np.stack([np.cos(heading), -np.sin(heading)], -1)
    error = 0.3 * right + [0.1, 0.0] + rng.normal(0.0, 0.01, (400, 2))
    error[::50] += 5.0
    left = tables.without_offsets(error, heading)
    assert np.median(left) == pytest.approx(0.01 * np.sqrt(2.0 * np.log(2.0)), rel=0.15)  # 3 sigma: 0.10
    assert (left[::50] > 6.0).all()
    assert tables.without_offsets(error, np.full(400, np.nan)).size == 0


def test_changes_of_the_error_between_fixes() -> None:
    """Epochs 0.2 s apart: six pairs are 1 s apart, of which the gap of a fix takes five; so does one of the clock."""
    fixed, time = np.ones((11, 1), bool), 0.2 * np.arange(11.0)
    error = np.zeros((11, 1, 2))
    error[:, 0, 0], error[10, 0, 1] = 7.0, 0.3
    found = tables.changes(time, fixed, error)
    assert found.size == 6
    np.testing.assert_allclose(np.sort(found), [0.0] * 5 + [0.3])
    fixed[5] = False
    assert tables.changes(time, fixed, error).size == 0
    fixed[5], time[5:] = True, time[5:] + 9.0
    assert tables.changes(time, fixed, error).size == 1


def test_streets_without_an_error_beyond_a_level_read_none() -> None:
    none, one = (rate_by_street(np.array(events), np.full(6, 100)) for events in ([0] * 6, [1, 0, 0, 0, 0, 0]))
    of = {"epochs": 600, "rtk_share": 0.5, "wrong_rtk": 0, "beyond": one, "beyond_rtk": none}
    config = {"streets": 6, "navigator": {"risk": {"integrity_risk": 1e-3}}}
    rows = rtk.navigator_rows({"config": config, "skies": {"open": {"navigator": of}}})[1]
    assert rows[0][-2:] == ("1.67 in 1 of 6 streets, few", "none in 6 streets, too few to tell")
    of["rtk_share"] = 0.0
    assert rtk.navigator_rows({"config": config, "skies": {"open": {"navigator": of}}})[1][0][-1] == "-"


def test_a_folder_without_a_drive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no rover_rtk\.pos"):
        rtk.recorded_figures(tmp_path)
    recording(tmp_path)
    (tmp_path / "reference.csv").write_text(RTK_REFERENCE.replace("19467", "39467"))
    with pytest.raises(InputError, match="must overlap in time"):
        rtk.recorded_figures(tmp_path)


def test_the_recorded_half_of_the_nagoya_drive() -> None:
    found = rtk.recorded_figures(real("nagoya_drive_rtk"))
    assert found["fixed"] == pytest.approx(1019 / 3075)
    assert found["wrong"] == pytest.approx(0.0186, abs=1e-4)
    assert found["fixed_spread_m"] == pytest.approx([0.0297, 0.104, 0.1423], abs=2e-3)
    assert found["fixed_mounted_m"][2] < 0.6 * found["fixed_spread_m"][2]  # a lever arm explains half
