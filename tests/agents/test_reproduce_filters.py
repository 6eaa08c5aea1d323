"""The trials of S4: a short run through the command, its table and figures; and the fit of a static log."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import bootstrap
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import filter_scenarios, filters
from lanebound.agents.studies.filters import paired
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive
from lanebound.integrity.sensors.inertial_law import PUBLISHED


@pytest.fixture
def short(monkeypatch):
    """Scenario 6 cut to some seconds, with an outage and a spurious position in them, and a fault cut to some."""
    trial = replace(
        filter_scenarios.SCENARIOS["6"], length_s=9.0, outages_s=((5.0, 8.0),), spurious_s=((3.0, 5.0),), shift_m=60.0
    )
    monkeypatch.setitem(filter_scenarios.SCENARIOS, "6", trial)
    kind = "spoofing, step of 25 m"
    monkeypatch.setattr(filters, "FAULTS", {kind: filter_scenarios.FAULTS[kind]})
    for name, value in (("WARM_UP_S", 4.0), ("FAULT_S", 6.0), ("FAULT_AFTER_S", 1.0)):
        monkeypatch.setattr(filter_scenarios, name, value)


def test_a_trial_writes_its_table_and_figures(short, tmp_path):
    out = tmp_path / "filters"
    changed = ("--set", 'scenarios=["6"]', "--set", "vehicles=2")
    done = CliRunner().invoke(app, ["reproduce", "filters", "--out", str(out), "--seeds", "2", *changed, "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads((out / "tables.json").read_text())["scenarios"]["6"]["figures"]
    low, middle, high = found["max IMM-EKF"]
    assert 0.0 < low <= middle <= high < 15.0
    assert found["max DR"][1] > 30.0  # it takes the spurious position
    assert found["HTL exceeded IMM-EKF"] == 0.0
    fault = json.loads((out / "tables.json").read_text())["faults"]["spoofing, step of 25 m"]["filters"]
    assert fault["gate"]["rejected"] > 0.8
    assert fault["no gate, no memory"]["rejected"] == 0.0
    assert fault["no gate, no memory"]["worst_m"][1] > 4.0 * fault["gate"]["worst_m"][1]
    assert fault["gate"]["beyond_level"] == 0.0
    assert {path.name for path in out.glob("*.png")} == {f"scenario-6-{n}.png" for n in ("errors", "path", "integrity")}
    law = json.loads((out / "tables.json").read_text())["law"]
    assert law["C1 [m/s^2]"][1] == pytest.approx(-0.0043, rel=0.1)
    assert law["tau [s]"][1] == pytest.approx(500.0, rel=0.2)
    assert law["drift in 60 s, uncorrected [m]"][1] == pytest.approx(12.9, abs=1.0)
    assert 0.0 < law["drift in 60 s, corrected [m]"][1] < 0.7
    rows = filters.table_rows(json.loads((out / "tables.json").read_text()))[1]
    assert rows[[r[1] for r in rows].index("max IMM-EKF")][:3] == ("6", "max IMM-EKF", "15")


def test_the_error_at_the_end_of_an_outage_is_that_of_its_last_epoch(short):
    """The outage is 5 <= t < 8 s; at 8.0 s, epoch 79, satellites are back and dead reckoning is at their position."""
    trial = filters._Trial(filters.FiltersConfig(seeds=3, vehicles=0), filter_scenarios.SCENARIOS["6"])
    for k in range(90):
        trial.step(k)
    figures = trial.summary()["figures"]
    for name, rows in trial.error.items():
        last = np.quantile(rows[78], [0.05, 0.5, 0.95])
        np.testing.assert_array_equal(figures[f"error at the end of the first outage {name}"], last)
    assert trial.error["DR"][79].max() < 0.5 * trial.error["DR"][78].min()


@pytest.mark.parametrize(
    ("out", "last"), [([0, 1, 1, 0, 1, 0], 2), ([1, 0], 0), ([0, 1, 1], None), ([0, 0], None), ([1, 1], None)]
)
def test_the_last_epoch_of_the_first_outage(out, last):
    assert filters._last_of_first(np.array(out, dtype=np.bool_)) == last


def test_sharp_turns_of_390_m_with_slip_by_all_models_and_with_a_calibrated_gyro(tmp_path, monkeypatch):
    """S4's course of 390 m without GNSS, below 3 m with a calibrated gyro; 8 drives."""
    kept = {name: trial for name, trial in filter_scenarios.SHARP.items() if "at rest" in name}
    monkeypatch.setattr(filters, "SHARP", kept)
    scenario = filter_scenarios.SCENARIOS["10"]
    car, traffic = CityDrive(scenario.road, scenario.drive, 0.1, filter_scenarios.AXLE_M), Streams([1])
    state, driven, slip = car.start(traffic), 0.0, 0.0
    for _ in range(round(10 * scenario.length_s)):
        before = state.position_m.copy()
        car.step(state, traffic)
        driven += float(np.linalg.norm(state.position_m - before))
        slip = max(slip, abs(float(np.sin(state.course_rad - state.heading_rad)[0])))
    assert driven == pytest.approx(390.0, abs=0.5)
    assert slip == pytest.approx(1.35 / 10.0, rel=0.05)  # bends of 10 m
    config = filters.FiltersConfig(seeds=8, scenarios=("10",), vehicles=0)
    result = filters.run_filters(config, tmp_path / "sharp")
    plain, calibrated = (figures["max IMM-EKF"][1] for figures in result["sharp"].values())
    assert plain == result["scenarios"]["10"]["figures"]["max IMM-EKF"][1]
    assert calibrated < 3.0
    assert calibrated < 0.7 * plain
    assert len(filters.sharp_rows(result)[1]) == 2
    figures = result["scenarios"]["10"]["figures"]
    for other in ("SM-EKF", filter_scenarios.WIDE, filter_scenarios.CURVED):  # each single model is compared
        assert f"rms of {other} less IMM-EKF, p of a difference" in figures
    slips = {name: figures[f"slip rms [deg], {name}"] for name in ("SM-EKF", filter_scenarios.CURVED, "IMM-EKF")}
    assert max(slips["IMM-EKF"], slips[filter_scenarios.CURVED]) < 0.5 * slips["SM-EKF"]
    assert figures["NEES of slip, IMM-EKF"] < 1.0 < figures["NEES of slip, SM-EKF"]
    assert 0.0 < figures["NIS of compass, IMM-EKF"] < 1.0


def test_paired_differences_have_an_interval_and_a_test_of_equivalence():
    """Against closed forms: 90 % by Student's law, TOST at the margin of 0.05 m."""
    rng = np.random.default_rng(4)
    less = rng.random(50)
    more = less + 0.01 + 0.02 * rng.standard_normal(50)
    found = paired("d", more, less)
    apart = more - less
    low, mean, high = found["d, mean and 90 %"]
    inside = bootstrap((apart,), np.mean, confidence_level=0.9, rng=np.random.default_rng(1)).confidence_interval
    np.testing.assert_allclose([low, mean, high], [inside.low, apart.mean(), inside.high], atol=1.5e-3)
    assert found["d, p of one beyond 0.05 m"] < 1e-6  # equivalent at the margin, though
    assert found["d, p of a difference"] < 0.05  # different
    wide = paired("d", less + 0.06 + 0.02 * rng.standard_normal(50), less)
    assert wide["d, p of one beyond 0.05 m"] > 0.5
    assert paired("d", less, less) == {"d": [0.0, 0.0, 0.0]}


def test_an_unknown_scenario_is_refused():
    with pytest.raises(ConfigError, match="scenarios must be among 5, 6, 7, 8-9, 10, 11, got '4'"):
        filters.FiltersConfig(scenarios=("4",))


def test_a_static_log_is_fitted_by_the_command(tmp_path):
    time_s = np.arange(0.0, 2000.0, 2.0)
    log = tmp_path / "static.csv"
    rows = [f"{t},{a}" for t, a in zip(time_s, PUBLISHED.error_mps2(time_s), strict=True)]
    log.write_text("time_s,forward\n" + "\n".join(rows) + "\n")
    done = CliRunner().invoke(app, ["fit-imu", str(log), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["forward"]
    np.testing.assert_allclose(
        [found["c1_mps2"], found["c2_mps2"], found["tau_s"]], [-0.0043, -0.007, 500.0], rtol=1e-3
    )
    assert abs(abs(found["drift_before_m"]) - 12.9) < 0.1
    assert abs(found["drift_after_m"]) < 1e-3
    assert found["constant"] is None
    log.write_text("time_s,forward\n" + "\n".join(f"{t},-0.007" for t in time_s) + "\n")
    done = CliRunner().invoke(app, ["fit-imu", str(log)])
    assert "forward: a constant is fitted; the log is constant." in done.stdout
    missing = CliRunner().invoke(app, ["fit-imu", str(tmp_path / "none.csv")])
    assert missing.exit_code != 0
