"""The comparison of monitors: counts, resumption, the page, the fit of errors, and the commands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from city_drives import as_files, simulated
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.cli.listing import resolve
from lanebound.agents.studies import monitored_drives
from lanebound.agents.studies import monitors as module
from lanebound.agents.studies.monitored_drives import (
    CampaignConfig,
    FitErrorsConfig,
    alert_times,
    code_errors_of,
    fit_errors,
    simulated_epochs,
)
from lanebound.agents.studies.monitors import MonitorsConfig, assess_monitors, monitor_rows, write_page
from lanebound.agents.studies.street_drives import StreetDrivesConfig
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.error_classes import FittedErrors
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import FAMILY, monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.replay.code_epochs import recorded_epochs

SHORT: dict[str, Any] = {"skies": ["urban"], "vehicles": 2, "duration_s": 6.0, "warm_up_s": 2.0, "length_m": 500.0}
FEW = ["residual", "ibpl", "classes_normal", "rraim_position"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive")
    as_files(simulated(40.0, late=(2, 7), late_m=30.0), path)
    return path


@pytest.fixture(scope="module")
def result(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], MonitorsConfig, Path]:
    out = tmp_path_factory.mktemp("monitors")
    config = MonitorsConfig.load({"monitors": FEW, "fit": {"fewest": 10}})
    return assess_monitors(config, folder, out), config, out


def test_counts_are_those_of_the_verdicts(folder: Path, result: tuple[dict[str, Any], MonitorsConfig, Path]) -> None:
    found, config, _ = result
    assert set(found["places"]) == {"whole drive", "after training"}
    whole = found["places"]["whole drive"]["monitors"]
    assert set(whole) == {"residual", "ibpl"}  # nothing fitted, no carriers
    assert set(found["places"]["after training"]["monitors"]) == {"residual", "ibpl", "classes_normal"}
    tracked = recorded_epochs(module.read_city(folder))
    for name in whole:
        v = watch(tracked.epochs, monitor_named(name).config(), config.risks)
        error = np.hypot(*(v.position_enu_m - tracked.truth_enu_m)[:, :2].T)
        assert whole[name]["usable"] == pytest.approx(v.usable.mean())
        assert whole[name]["alarms"] == pytest.approx(v.alarm.mean())
        for r, risk in enumerate(config.risks):
            events = int((v.usable & (error > v.hpl_m[:, r])).sum())
            shown = v.usable & np.isfinite(v.hpl_m[:, r])
            assert whole[name]["exceed"][f"{risk:g}"]["events"] == events
            assert whole[name]["exceed"][f"{risk:g}"]["rate"] == pytest.approx(events / max(shown.sum(), 1))
            assert whole[name]["shown"][f"{risk:g}"] == pytest.approx(shown.mean())
        available = (v.usable & (v.hpl_m[:, 1] <= 25.0)).mean()
        assert whole[name]["available"]["25"] == pytest.approx(available)


def test_epochs_without_a_level_at_a_risk_do_not_dilute_its_exceedances(folder: Path) -> None:
    """A prior of systems of 1e-4 leaves ARAIM a level at 1e-3 and none at 1e-5 with one system; each risk is counted as
    if it were asked for alone."""
    tracked = recorded_epochs(module.read_city(folder))
    one = tracked.epochs.with_codes(used=tracked.epochs.used & (tracked.epochs.system == 0))
    tracked = module.TrackedEpochs(one, tracked.truth_enu_m + 500.0, tracked.known)
    unit = np.zeros(one.count, np.int64)
    for name in ("araim", "odds"):
        kind, both = monitor_named(name), MonitorsConfig(risks=(1e-3, 1e-5), operative=0)
        counted = module.place_counts(both, tracked, kind, {}, unit)
        for r, risk in enumerate(both.risks):
            alone = module.place_counts(MonitorsConfig(risks=(risk,), operative=0), tracked, kind, {}, unit)
            assert counted["shown"][0][r] == alone["shown"][0][0]
            assert counted["exceed"][0][r] == alone["exceed"][0][0] == counted["shown"][0][r]  # all are 500 m off
        if name == "araim":
            assert counted["shown"][0][0] > 0 == counted["shown"][0][1]


@pytest.mark.parametrize(("quiet", "faulty", "noticed"), [(2, 1, False), (1, 2, True), (0, 0, False)])
def test_fewer_exclusions_are_no_notice(
    quiet: int, faulty: int, noticed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    e = CodeEpochs.of(np.zeros((6, 9)), np.tile([0.0, 0.0, 1.0], (6, 9, 1)))
    tracked = module.TrackedEpochs(e, np.zeros((6, 3)), np.ones(6, bool))
    said = iter((quiet, faulty))
    fine = np.ones(6, bool)
    monkeypatch.setattr(
        monitored_drives, "_states", lambda *_: (np.zeros(6), fine, np.full(6, next(said)), np.zeros(6, bool))
    )
    config, drives = CampaignConfig(onset_s=0.0), StreetDrivesConfig(warm_up_s=0.0)
    found = alert_times(config, drives, monitor_named("residual"), {}, (tracked, tracked), 1e-3)
    assert (found["noticed_s"] != [None]) == noticed


def test_changes_of_every_monitor_are_given_by_key(folder: Path) -> None:
    tracked = recorded_epochs(module.read_city(folder))
    unit = np.zeros(tracked.epochs.count, np.int64)
    out = [
        module.place_counts(MonitorsConfig.load({"changes": changes}), tracked, monitor_named("ransac"), {}, unit)
        for changes in ({}, {"inlier_sigmas": 0.5})
    ]
    assert out[0]["sample_level_m"] != out[1]["sample_level_m"]


def test_a_finished_run_is_read_and_the_page_is_one_file(result: tuple[dict[str, Any], MonitorsConfig, Path]) -> None:
    found, config, out = result
    stored = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert stored["places"].keys() == found["places"].keys()
    written = write_page(config, found, out)
    page = written[0].read_text(encoding="utf-8")
    assert "data:image/png;base64" in page
    assert all(name in page for name in FAMILY)
    heads, rows = monitor_rows(config, found["places"]["after training"])
    assert len(heads) == len(rows[0])
    assert len(rows) == 3


def test_a_resumed_run_computes_nothing_again(
    folder: Path, result: tuple[dict[str, Any], MonitorsConfig, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object) -> None:
        raise AssertionError(arguments)

    monkeypatch.setattr(module, "place_counts", fail)
    again = assess_monitors(result[1], folder, result[2])
    assert again["places"]["whole drive"]["epochs"] == result[0]["places"]["whole drive"]["epochs"]


def test_fitted_errors_follow_the_errors_that_were_put_in(folder: Path, tmp_path: Path) -> None:
    tracked = recorded_epochs(module.read_city(folder))
    error, known = code_errors_of(tracked)
    late = np.abs(error.mean(0) - 30.0) < 4.0
    assert late.sum() == 2  # satellites 3 and 8 are late by 30 m
    assert known.all()
    fitted, found = fit_errors(folder, None, FitErrorsConfig.load({"fewest": 30, "centred": False}))
    assert max(law.sigma_m for law in fitted.classes.laws) > 10.0
    assert {"normal", "mixture", "mean and variance jump", "errors"} <= set(found["laws"])
    assert found["laws"]["mixture"]["criterion"] < found["laws"]["normal"]["criterion"]
    path = tmp_path / "errors.yaml"
    result = CliRunner().invoke(app, ["fit-errors", str(folder), "--out", str(path), "--set", "fewest=30"])
    assert result.exit_code == 0, result.output
    kind, loaded = resolve(str(path))
    assert kind == "fitted_errors"
    assert isinstance(loaded, FittedErrors)
    assert "pareto_shape" in loaded.changes()


def test_simulated_streets_hold_what_monitors_need_and_no_truth() -> None:
    config = StreetDrivesConfig.load(SHORT)
    tracked = simulated_epochs(config, "urban", 0, every=5)
    e = tracked.epochs
    assert e.count == 2 * 12
    fit = solve_codes(e)
    assert np.hypot(*(fit.x_m - tracked.truth_enu_m)[fit.solved, :2].T).max() < 60.0
    assert e.carrier_kept is not None
    assert e.carrier_step_m is not None
    assert e.carrier_sigma_m is not None
    assert e.step_enu_m is not None
    assert e.shadowed is not None
    assert not e.carrier_kept[e.starts()].any()
    moved = np.diff(tracked.truth_enu_m, axis=0, prepend=tracked.truth_enu_m[:1])
    step = np.hypot(*(e.step_enu_m - moved)[~e.starts(), :2].T)
    assert np.median(step) < 0.3
    steps = e.carrier_step_m + (e.los_enu @ moved[..., None])[..., 0]
    kept = e.carrier_kept & (e.elevation_rad > 0.5)
    spread = [np.std(steps[k, kept[k]]) for k in range(e.count) if kept[k].sum() > 5]
    assert np.median(spread) < 0.15  # clocks apart, carriers tell the displacement to decimetres
    error, known = code_errors_of(tracked)  # each receiver has clocks of its own, hundreds of metres apart
    assert np.median(np.abs(error[known])) < 6.0


def test_the_fault_campaign_tells_when_monitors_notice(tmp_path: Path) -> None:
    """Under an open sky: a step of 50 m of one satellite, and a system that drifts away."""
    cases = ["step of one satellite", "ramp of a system"]
    config = MonitorsConfig.load({
        "skies": ["open"], "streets": 1, "monitors": ["separation", "separation_fde", "sbas", "craim"],
        "drives": {**SHORT, "skies": ["open"], "faults": None}, "errors": "errors/berlin_potsdamer",
        "campaign": {"cases": cases, "onset_s": 2.0, "length_s": 4.0, "after_s": 1.0, "every": 5},
    })  # fmt: skip
    found = assess_monitors(config, None, tmp_path / "campaign")
    tried = found["campaign"]["open"]
    assert list(tried) == cases
    step, ramp = (tried[case] for case in cases)
    assert max(step["separation_fde"]["noticed_s"]) <= 0.5
    assert max(step["separation"]["noticed_s"]) <= 0.5
    assert step["sbas"]["noticed_s"] == [None, None]  # it tests nothing
    assert not any(step["separation_fde"]["failed"])  # excluded
    assert max(ramp["separation"]["alert_s"]) <= max(ramp["sbas"]["alert_s"])
    assert any(ramp["sbas"]["failed"])
    craim = found["places"]["open"]["monitors"]["craim"]
    assert craim["exceed"]["0.01"]["events"] == 0
    assert "faults" in write_page(config, found, tmp_path)[0].read_text(encoding="utf-8")


def test_mistakes_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--data or --sky, got both or none"):
        assess_monitors(MonitorsConfig(), None, tmp_path)
    with pytest.raises(InputError, match="operative must be < 4"):
        assess_monitors(MonitorsConfig(operative=7), folder, tmp_path / "a")
    with pytest.raises(ConfigError, match="did you mean"):
        assess_monitors(MonitorsConfig.load({"monitors": ["ibpll"]}), folder, tmp_path / "b")
    with pytest.raises(InputError, match="DATASET or --sky"):
        fit_errors(None, None, FitErrorsConfig())


def test_the_commands(folder: Path, tmp_path: Path) -> None:
    listed = CliRunner().invoke(app, ["monitors", "--json"])
    assert {row["monitor"] for row in json.loads(listed.output)} == set(FAMILY)
    assert "promise" in CliRunner().invoke(app, ["monitors"], env={"COLUMNS": "200"}).output
    out = tmp_path / "out"
    done = CliRunner().invoke(
        app,
        ["assess", "monitors", "--data", str(folder), "--out", str(out), "--monitor", "ibpl", "--set", "fit.fewest=10"],
        env={"COLUMNS": "200"},
    )
    assert done.exit_code == 0, done.output
    assert "whole drive" in done.output
    assert (out / "report.html").is_file()
