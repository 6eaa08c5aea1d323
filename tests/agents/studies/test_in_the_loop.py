"""Bounding in the loop: what is counted, by street, and what a run of the command leaves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import in_the_loop as loop
from lanebound.agents.studies.street_drives import StreetDrivesConfig, _staircase, drive_street
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.modes import Mode

SHORT: dict[str, Any] = {
    "skies": ["dense"], "vehicles": 3, "duration_s": 6.0, "warm_up_s": 2.0, "length_m": 500.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("loop")
    config = loop.InTheLoopConfig.load({**SHORT, "epochs": 200, "risks": [0.5, 1e-3]})
    assert config.streets == 2
    return loop.assess_in_the_loop(config, out), out


def test_counts_are_those_of_the_drives(result: tuple[dict[str, Any], Path]) -> None:
    config = loop.InTheLoopConfig.load({**SHORT, "epochs": 200, "risks": [0.5, 1e-3]})
    beyond, epochs, usable = np.zeros((2, 2)), 0, 0
    for number in range(2):
        for moment in drive_street(config.with_levels(), "dense", number):
            s = moment.solution
            beyond += (np.abs(moment.error_m)[:, None] > s.pl_cases_m[:, 1:]).sum(0)
            epochs += s.batch
            usable += int((s.available & ~s.alert).sum())
    found = result[0]["skies"]["dense"]
    assert found["epochs"] == epochs == 2 * 3 * 60
    assert found["usable"] == pytest.approx(usable / epochs)
    for r, risk in enumerate(("0.5", "0.001")):
        for a, axis in enumerate(loop.AXES):
            assert found["rates"][risk][axis]["events"] == beyond[r, a]
    assert sum(mode["share"] for mode in found["modes"].values()) == pytest.approx(1.0)
    assert set(found["modes"]) <= {mode.name.lower() for mode in Mode}


def test_an_error_beyond_its_level_is_counted_where_it_belongs() -> None:
    config = loop.InTheLoopConfig.load({**SHORT, "risks": [1e-3, 1e-5]})
    moment = next(drive_street(config.with_levels(), "dense", 0))
    levels = np.array([[[9.0, 1.2], [1.0, 1.0], [2.0, 2.0]]] * 3)  # the operative one first
    usable = np.array([True, True, False])
    solution = replace(
        moment.solution, pl_cases_m=levels, mode=np.array([Mode.RTK, Mode.DOPPLER, Mode.DOPPLER]), available=usable,
        alert=np.zeros(3, dtype=np.bool_),
    )  # fmt: skip
    tally = loop._Tally(config)
    tally.count(replace(moment, error_m=np.array([[0.5, -1.5], [-2.5, 0.0], [0.0, 3.0]]), solution=solution))
    counts = tally.counts()
    assert counts["exceed"][Mode.RTK] == [[0, 1], [0, 0]]  # by risk and axis
    assert counts["exceed"][Mode.DOPPLER] == [[1, 1], [1, 1]]
    assert (counts["misleading"][Mode.RTK], counts["misleading"][Mode.DOPPLER]) == (1, 0)  # the third is not usable


def test_trust_levels_are_counted_where_there_are_any(result: tuple[dict[str, Any], Path]) -> None:
    assert "trust" not in result[0]["skies"]["dense"]  # the default navigator has none
    assert loop.trust_rows(result[0])[1] == []
    config = loop.InTheLoopConfig.load({**SHORT, "risks": [1e-3]})
    moment = next(drive_street(config.with_levels(), "dense", 0))
    level = np.array([1.0, 1.0, np.inf])  # the last one has no level yet
    solution = replace(moment.solution, trust_m=np.array([5.0, 8.0, 1.0]), pl_at_m=level,
                       hpl_sbas_m=np.array([4.0, np.inf, 2.0]))  # fmt: skip
    tally = loop._Tally(config)
    tally.count(replace(moment, error_m=np.array([[3.0, -4.1], [5.0, 0.0], [9.0, 0.0]]), solution=solution))
    counts = tally.counts()
    assert counts["trust"] == [2, 1, 1]  # with one, beyond it, below 7 m
    found = loop._summary(config, [counts | {"samples": [[0], [1.0], [1.0]]}])
    assert found["trust"]["rate"] == 0.5
    rows = loop.trust_rows({"skies": {"dense": found}})[1]
    assert rows == [("dense", "2", "1 (0.5)", "1", "50.0 %")]
    assert counts["sbas"] == [1.0, 1.0, 4.0]  # the third has no level, the second no position by SBAS
    assert loop.sbas_rows({"skies": {"dense": found}})[1] == [("dense", "1", "4.00 m", "1")]


def test_a_second_run_reads_what_the_first_left(result: tuple[dict[str, Any], Path]) -> None:
    found, out = result
    before = {file.name: file.stat().st_mtime_ns for file in (out / "parts").iterdir()}
    config = loop.InTheLoopConfig.load({**SHORT, "epochs": 200, "risks": [0.5, 1e-3]})
    assert loop.assess_in_the_loop(config, out) == found
    assert {file.name: file.stat().st_mtime_ns for file in (out / "parts").iterdir()} == before
    assert json.loads((out / "results.json").read_text()) == json.loads(json.dumps(found))


def test_tables_name_skies_modes_and_risks(result: tuple[dict[str, Any], Path]) -> None:
    heads, rows = loop.exceedance_rows(result[0])
    assert heads[-2:] == ("at 0.5", "at 0.001")
    assert [row[:2] for row in rows] == [("dense", "along"), ("dense", "across")]
    assert loop.mode_rows(result[0])[1][0][1] == "all"


def test_the_interval_of_a_rate_is_that_of_streets() -> None:
    """Ten streets with 100 epochs: all events in one of them tell less than one event in each."""
    epochs = np.full(10, 100)
    one, spread = np.zeros(10, dtype=np.int64), np.ones(10, dtype=np.int64)
    one[3] = 10
    clustered, even, none = (
        loop.rate_by_street(one, epochs),
        loop.rate_by_street(spread, epochs),
        loop.rate_by_street(0 * one, epochs),
    )
    assert clustered["rate"] == even["rate"] == 0.01
    assert clustered["low"] is None
    assert (even["low"], even["high"]) == (0.01, 0.01)
    assert none["streets_high"] == pytest.approx(1.0 - 0.025 ** (1.0 / 10.0))  # Clopper-Pearson without events
    two = loop.rate_by_street(one + np.roll(one, 1), epochs)
    assert two["low"] < two["rate"] < two["high"]


def test_streets_differ_and_do_not_cross_themselves() -> None:
    roads = [_staircase(2000.0, named_generator([1, number], "road")) for number in range(2)]
    assert roads[0].vertices_en_m.shape != roads[1].vertices_en_m.shape
    for road in roads:
        assert (np.diff(road.vertices_en_m, axis=0) >= -1e-9).all()  # always east or north
        assert road.length_m > 1700.0


def test_what_is_given_of_the_navigator_stands_before_the_instruments_of_a_sky() -> None:
    def scale(given: dict[str, Any]) -> float:
        config = loop.InTheLoopConfig.load({"navigator": {"positioning": {"dead_reckoning": given}}})
        return config.navigator_in("urban").positioning.dead_reckoning.odometer_scale

    assert scale({}) == scale({"odometer_bias_mps": 0.0}) == 0.027, "that of urban"
    assert scale({"odometer_scale": 0.0}) == 0.0


def test_a_wrong_sky_is_named() -> None:
    with pytest.raises(ConfigError, match="lunar"):
        next(drive_street(StreetDrivesConfig(skies=("lunar",)), "lunar", 0))


def test_epochs_are_rounded_up_to_whole_streets_and_it_is_said() -> None:
    assert loop.InTheLoopConfig(epochs=2000).rounding == (
        "2,000 epochs under each sky are rounded up to whole streets: 1 of 28,800 epochs each"
    )
    assert loop.InTheLoopConfig(epochs=57_600).rounding == ""


def test_cells_say_where_streets_are_too_few() -> None:
    few, many = (loop.rate_by_street(np.zeros(n, dtype=np.int64), np.full(n, 100)) for n in (1, 30))
    assert loop.rate_cell(few, 1e-3, 1) == "none in 1 street, too few to tell"
    assert loop.rate_cell(many, 1e-3, 30) == "none in 30 streets (share of streets below 0.12)"
    one = loop.rate_by_street(np.eye(1, 5, dtype=np.int64)[0], np.full(5, 100))
    assert loop.rate_cell(one, 1e-3, 5) == "2 in 1 of 5 streets, few"


def test_the_command_names_the_option_and_the_skies_before_it_claims_a_folder(
    result: tuple[dict[str, Any], Path], tmp_path: Path
) -> None:
    """Few streets are said too: the drives are those of the fixture."""
    known = "--sky must be one of open, suburban, urban, dense"
    for command, name in (("bounding", "foo"), ("monitors", "foo"), ("informativeness", "foo")):
        options = ["--in-the-loop"] if command == "bounding" else []
        done = CliRunner().invoke(app, ["assess", command, *options, "--sky", name, "--out", str(tmp_path / "out")])
        assert (done.exit_code, known in done.stderr) == (2, True), done.output
    done = CliRunner().invoke(
        app, ["assess", "bounding", "--in-the-loop", "--sky", "skies/foo", "--out", str(tmp_path / "out")]
    )
    assert "--sky 'skies/foo' is unknown: known are dense, open" in done.stderr
    assert not (tmp_path / "out").exists()
    given = [f"--set={key}={value}" for key, value in {**SHORT, "skies": "[dense]"}.items()]
    options = ["--risk", "0.5", "--risk", "1e-3", "--epochs", "200", "--out", str(result[1])]
    done = CliRunner().invoke(app, ["assess", "bounding", "--in-the-loop", *given, *options])
    assert done.exit_code == 0, done.output
    assert "note: 200 epochs under each sky are rounded up to whole streets: 2 of 180 epochs each" in done.stderr
    assert "Fewer than 30 streets of a sky say little of a rate" in done.stdout
