"""The bounding study: the promise holds, the printed forms break it where they must, and a run goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import bounding
from lanebound.agents.studies.bounding import (
    BoundingConfig,
    assess_bounding,
    part_names,
    rate_of,
    rate_over,
    summarise,
    work_part,
)
from lanebound.integrity.assessment.exceedance import FaultSize
from lanebound.integrity.core.errors import InputError

SHORT = BoundingConfig(
    epochs=300_000, epochs_per_case=10_000, rare_cases=12, rare_draws=256, outages=4, vehicles=2000, seed=3
)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("bounding")
    return out, assess_bounding(SHORT, out)


def test_the_exact_forms_keep_their_promise(short: tuple[Path, dict[str, Any]]) -> None:
    """A 95 % interval above the risk would be a breach; by chance once in 40 where a rate equals it."""
    rates = short[1]["rates"]["all"]["all"]
    for form in ("exact root", "exact closed form"):
        for risk, found in rates[form].items():
            assert found["either"]["low"] <= float(risk), (form, risk)
            assert found["either"]["trials"] == SHORT.epochs
    assert rates["exact root"]["0.001"]["either"]["events"] > 20  # and is no empty one


def test_the_printed_bias_breaks_it_by_far_where_biases_are_large(short: tuple[Path, dict[str, Any]]) -> None:
    by_bias = short[1]["rates"]["bias"]
    for form in ("published", "published bias"):
        found = by_bias["biases up to 5 sigma"][form]["1e-05"]["either"]
        assert rate_of(found["events"], found["trials"])["low"] > 100.0 * 1e-5  # of these few geometries
        assert by_bias["biases up to 0 sigma"][form]["0.001"]["either"]["low"] < 1e-3
    assert by_bias["biases up to 5 sigma"]["exact root"]["0.001"]["either"]["low"] <= 1e-3


def test_drift_is_bounded_but_not_by_the_printed_growth(short: tuple[Path, dict[str, Any]]) -> None:
    for source in ("doppler", "odometer"):
        found = short[1]["drift"][source]
        assert found["exact"]["0.001"]["either"]["low"] <= 1e-3
        assert found["published"]["1e-05"]["either"]["low"] > 0.01


def test_false_alarms_keep_their_allocation_without_biases(short: tuple[Path, dict[str, Any]]) -> None:
    found = short[1]["alarms_by_bias"]["biases up to 0 sigma"]
    assert found["low"] <= SHORT.risk.false_alarm
    assert found["rate"] > 0.25 * SHORT.risk.false_alarm


def test_false_alarms_of_biased_geometries_are_known_no_better_than_their_spread(
    short: tuple[Path, dict[str, Any]],
) -> None:
    """Each geometry has a rate of its own: the count alone would claim ten times what is known."""
    for found in (short[1]["alarms_by_bias"]["biases up to 2 sigma"], short[1]["alarms"]["no fault"]):
        counted = rate_of(found["events"], found["trials"])
        assert counted["rate"] == found["rate"]
        assert found["high"] - found["low"] > 5.0 * (counted["high"] - counted["low"])


def test_importance_sampling_agrees_with_the_closed_form(short: tuple[Path, dict[str, Any]]) -> None:
    """Within five standard deviations of the draws: no more than both closed forms, which leave out part of the test.

    And no less than faultless errors that the test lets pass, 99 % of them where there are no biases: one side of each
    of eight figures, so that all of them hold but for one run in a hundred thousand.
    """
    for risk in ("1e-07", "1e-05"):
        found = short[1]["rare"][risk]["exact root"]
        unbiased = found["by_bias"]["biases up to 0 sigma"]
        for a, axis in enumerate(("along", "across")):
            most = found["exact"]["no fault"][a] + found["exact"]["one fault, worst"][a]
            assert found[axis]["rate"] < most + 5.0 * found[axis]["draws"]
            least = (1.0 - SHORT.risk.false_alarm) * unbiased["exact"]["no fault"][a]
            assert unbiased[axis]["rate"] > least - 5.0 * unbiased[axis]["draws"]
            assert most < 0.5 * float(risk)
            assert found[axis]["draws"] < 0.15 * found[axis]["rate"]


def test_rare_rates_are_told_by_stratum_and_by_biases(short: tuple[Path, dict[str, Any]]) -> None:
    rare = short[1]["rare"]
    found = rare["1e-07"]["exact root"]
    for axis in ("along", "across"):
        parts = found[axis]["by_stratum"]
        assert list(parts) == ["no fault", "one fault"]
        assert min(parts.values()) > 0.0
        assert sum(parts.values()) == pytest.approx(found[axis]["rate"])
        places = found["by_bias"].values()
        together = sum(one["geometries"] * one[axis]["rate"] for one in places) / SHORT.rare_cases
        assert together == pytest.approx(found[axis]["rate"])
    assert 1e-8 < rare["spent"]["mean"] < rare["spent"]["largest"] < 7e-8
    assert found["along"]["rate"] + found["across"]["rate"] + rare["spent"]["mean"] < 1e-7


def test_the_worst_sizes_of_faults_are_worse_than_uniform_ones() -> None:
    """Draws of the same geometries, and closed forms that do not depend on what is drawn."""
    worst, uniform = (
        work_part(SHORT.replace(rare_cases=8, rare_sizes=sizes), "rare-0")["cases"] for sizes in FaultSize
    )
    faulty = [np.mean([one["rates"]["ROOT"][1][0][1] for one in of], 0) for of in (worst, uniform)]
    assert (faulty[0] > 1.5 * faulty[1]).all()
    assert [one["exact"] for one in worst] == [one["exact"] for one in uniform]
    for name, drawn in zip(("worst", "uniform"), faulty, strict=True):
        exact = np.mean([one["exact"]["ROOT"][f"one fault, {name}"][1] for one in worst], 0)
        assert (drawn < 1.5 * exact).all()


def test_levels_are_above_the_least_that_would_have_held(short: tuple[Path, dict[str, Any]]) -> None:
    for risk, found in short[1]["level_over"]["exact root"].items():
        assert found["least"]["smallest"] >= 1.0
        assert 1.0 < found["least"]["median"] < 3.0
        closed = short[1]["level_over"]["exact closed form"][risk]
        assert closed["root"]["smallest"] > 1.0  # it gives each mode a share of the risk, the root what all leave
    assert short[1]["level_over"]["published bias"]["0.001"]["least"]["smallest"] < 1.0


def test_an_interrupted_run_ends_as_an_unbroken_one(
    short: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, result = short
    names = part_names(SHORT)
    for name in names[::2]:
        (out / "parts" / f"{name}.json").unlink()
    drawn: list[str] = []

    def watched(config: BoundingConfig, name: str, advance: Any) -> dict[str, Any]:
        drawn.append(name)
        return work_part(config, name, advance)

    monkeypatch.setattr(bounding, "work_part", watched)
    again = assess_bounding(SHORT, out)
    assert drawn == names[::2]
    assert again == result
    assert json.loads((out / "results.json").read_text(encoding="utf-8"))["rates"] == result["rates"]
    with pytest.raises(InputError, match="same bounding assessment"):
        assess_bounding(SHORT.replace(seed=4), out)


def test_the_command_prints_tables(tmp_path: Path) -> None:
    arguments = ["assess", "bounding", "--out", str(tmp_path / "a"), "--epochs", "20000", "--risk", "1e-3"]
    small = ["epochs_per_case=5000", "rare_cases=4", "rare_draws=64", "outages=2", "vehicles=200"]
    found = CliRunner().invoke(app, [*arguments, *(word for s in small for word in ("--set", s))])
    assert found.exit_code == 0, found.output
    told = ("40,000 axis epochs", "exact root", "biases up to 5 sigma", "doppler, published", "results.json")
    for words in (*told, "by what there was", "not drawn", "two faults and wrong fixes", "at 1e-07 by biases"):
        assert words in found.stdout
    levelless = ["--set", "rare_risk=1e-12"]  # two faults alone are likelier
    found = CliRunner().invoke(
        app,
        [
            "assess",
            "bounding",
            "--out",
            str(tmp_path / "c"),
            *(word for s in small for word in ("--set", s)),
            "--epochs",
            "20",
            *levelless,
        ],
    )
    assert found.exit_code == 0, found.output
    refused = CliRunner().invoke(app, ["assess", "bounding", "--out", str(tmp_path / "b"), "--risk", "2"])
    assert refused.exit_code != 0


def test_rates_without_trials_are_none() -> None:
    assert rate_of(0, 0)["rate"] is None
    assert summarise(SHORT.to_dict(), {})["confidence"] == 0.95


@pytest.mark.slow
def test_the_promise_at_length(tmp_path: Path) -> None:
    """Ten million axis epochs: every exact form at every risk and place.

    The interval of each rate is at 95 %, so that of many only those that exceed the risk by a fifth are breaches.
    """
    config = BoundingConfig(epochs=5_000_000, rare_cases=200, outages=20, seed=5)
    result = assess_bounding(config, tmp_path, jobs=2)
    assert result["axis_epochs"] == 10_000_000
    for places in result["rates"].values():
        for found in places.values():
            for form in ("exact root", "exact closed form"):
                for risk, rates in found[form].items():
                    assert rates["either"]["low"] <= 1.2 * float(risk)
    rare = result["rare"]["1e-07"]["exact root"]
    assert 2.0 * rare["upper"] + result["rare"]["spent"]["mean"] < 1e-7


def test_intervals_allow_for_the_spread_between_geometries() -> None:
    """Of 400 studies whose geometries differ, the interval holds the true rate in 95 %; here in 90 % at least."""
    generator = np.random.default_rng(3)
    bias = np.array([0.0, 2.0] * 100)
    means, trials = np.array([0.01, 0.05] * 100), np.full(200, 1000)
    held = drawn_alone = 0
    for _ in range(400):
        events = generator.binomial(trials, means * generator.gamma(1.0, size=200))
        found, alone = rate_over(events, trials, bias), rate_of(int(events.sum()), int(trials.sum()))
        held += found["low"] <= 0.03 <= found["high"]
        drawn_alone += alone["low"] <= 0.03 <= alone["high"]
    assert held > 360
    assert drawn_alone < 250  # as if all epochs were of one geometry
    alike = rate_over(np.full(200, 10), trials)
    assert alike == rate_of(2000, 200_000)
    assert rate_over(np.zeros(200, int), np.zeros(200, int), bias)["rate"] is None


def test_a_risk_that_is_none_is_refused_before_the_folder_is_marked(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["assess", "bounding", "--risk", "2", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert "risks.0 must be < 1, got 2.0: correct that value" in " ".join(done.output.split())
    assert not list(tmp_path.iterdir())
