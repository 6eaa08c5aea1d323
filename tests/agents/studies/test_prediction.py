"""Prediction before a journey: calibrated where its assumptions hold, and what a run of the command leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import prediction as study

SHORT: dict[str, Any] = {
    "skies": ["dense"], "vehicles": 2, "duration_s": 6.0, "warm_up_s": 2.0, "length_m": 500.0, "streets": 1,
    "map_sigmas_m": [0.0, 5.0],
}  # fmt: skip


def made_up(seed: int, samples: int = 4000) -> study.SampledStreet:
    """A street whose positions are usable with a probability that the number of satellites determines."""
    rng = np.random.default_rng(seed)
    number = rng.integers(0, 21, size=200)
    station = rng.integers(200, size=samples)
    chance = number[station] / 20.0
    usable = rng.random(samples) < chance
    level = np.where(usable, 0.5, 5.0) * rng.random(samples)
    samples_of = {"station": station.astype(float), "received": number[station] + 2.0, "direct": number[station] * 1.0,
                  "codes": number[station] + 3.0, "pdop": np.full(samples, 2.0), "rtk": usable * 1.0,
                  "usable": usable * 1.0, "pl_ct_m": level}  # fmt: skip
    return study.SampledStreet(5.0, 10.0, number[None], np.full((1, 200), 1.5), samples_of)


def test_differences_are_received_less_predicted() -> None:
    found = study.differences([made_up(1)], 0)
    assert (found["mean"], found["mean_abs"], found["mean_abs_direct"], found["mean_codes"]) == (2.0, 2.0, 0.0, 3.0)
    assert (found["low"], found["high"], found["pdop"], found["without"]) == (2.0, 2.0, 0.5, 0.0)


def test_probabilities_are_calibrated_and_better_than_the_climate_on_other_streets() -> None:
    model = study.fitted([made_up(seed) for seed in range(4)])
    unseen = [made_up(seed) for seed in range(10, 16)]
    found = study.judged(model, [unseen])
    assert found["skill"]["low"] > 0.2  # variance of the chance over that of the outcome: 1/3
    assert abs(found["predicted"] - found["usable"]) < 0.03
    for row in study.reliability(model, [unseen]):
        assert abs(row["predicted"] - row["usable"]["value"]) < 0.05
    for share, quantile in zip(found["below"], study.QUANTILES, strict=True):
        assert abs(share - quantile) < 0.06


def test_shares_of_skies_are_no_skill() -> None:
    """A forecast that knows the share of each sky and nothing else has none, in one sky and over all."""
    good, bad = made_up(1), made_up(2)
    for street, chance in ((good, 0.9), (bad, 0.1)):
        street.samples["usable"][:] = np.random.default_rng(0).random(4000) < chance
        street.satellites[:] = round(20 * chance)
    model = study.fitted([good, bad])
    for skies in ([[good]], [[bad]], [[good], [bad]]):
        assert abs(study.judged(model, skies)["skill"]["value"]) < 0.01


def test_gaps_grow_at_the_planned_speed_since_rtk_was_likely() -> None:
    model = study.fitted([made_up(seed) for seed in range(4)])
    street = made_up(20)
    number = np.full(200, 2)
    number[50] = 20
    gap = study.gap_s(model.fix, street._replace(satellites=number[None]))
    assert gap[49] == study.LONGEST_GAP_S
    np.testing.assert_allclose(gap[50:53], [0.0, 0.5, 1.0])


def test_a_short_run_predicts_and_drives_all_streets(tmp_path: Path) -> None:
    arguments = [a for key, value in SHORT.items() for a in ("--set", f"{key}={json.dumps(value)}")]
    result = CliRunner().invoke(app, ["reproduce", "prediction", "--out", str(tmp_path / "out"), *arguments, "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    exact, poor = found["satellites"]
    assert exact["sigma_m"] == 0.0
    assert exact["samples"] == poor["samples"] == 2 * 2 * 6
    assert 0.0 <= found["availability"][0]["usable"] <= 1.0
    for name in ("results.json", "satellites.svg", "reliability.svg"):
        assert (tmp_path / "out" / name).is_file()
