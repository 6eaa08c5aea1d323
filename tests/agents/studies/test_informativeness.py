"""Informativeness of levels: what the models find in data made up for them, and what a run of the command leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lanebound.agents.studies import in_the_loop as info
from lanebound.agents.studies.street_drives import drive_street
from lanebound.integrity.positioning.modes import Mode

SHORT: dict[str, Any] = {
    "skies": ["dense"], "vehicles": 3, "duration_s": 6.0, "warm_up_s": 2.0, "length_m": 500.0, "streets": 2,
}  # fmt: skip


def made_up(own_share: float, streets: int = 6, each: int = 600, seed: int = 3) -> list[dict[str, Any]]:
    """Doppler epochs whose scale grows with age, and by its own part, a share ``own_share`` of the log variance."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(streets):
        age = rng.uniform(0.0, 60.0, each)
        clock = np.log1p(age)
        own = rng.standard_normal(each) * np.std(clock) * np.sqrt(own_share / (1.0 - own_share)) if own_share else 0.0
        level = np.exp(clock + own - 2.0)
        error = np.abs(rng.standard_normal(each)) * level / 4.0
        out.append({"mode": np.full(each, float(Mode.DOPPLER)), "age_s": age, "pl_m": level, "error_m": error})
    return out


def test_a_level_that_is_a_clock_adds_nothing() -> None:
    found = info.compare(made_up(0.0), 0.3)
    assert found["r2"]["value"] > 0.99
    assert abs(found["gain"]["value"]) < 0.01
    assert found["auc_clock"]["value"] > 0.6


def test_a_level_with_knowledge_of_its_own_foretells_errors_better() -> None:
    found = info.compare(made_up(0.5), 0.3)
    assert found["r2"]["value"] == pytest.approx(0.5, abs=0.05)
    assert found["gain"]["low"] > 0.05
    assert found["auc_level"]["low"] <= found["auc_level"]["value"] <= found["auc_level"]["high"]


def test_a_level_without_relation_to_the_error_is_not_taken_for_one() -> None:
    """Streets that are held out show no gain, where those that are fitted would."""
    streets = made_up(0.0)
    rng = np.random.default_rng(1)
    for street in streets:
        street["pl_m"] = np.exp(rng.standard_normal(len(street["mode"])))
    found = info.compare(streets, 0.3)
    assert found["gain"]["low"] < 0.0 < found["gain"]["high"] or abs(found["gain"]["value"]) < 0.01
    assert found["r2"]["value"] < 0.02


def test_figures_that_are_not_defined_are_none() -> None:
    found = info.compare(made_up(0.3), 1e6)
    assert found["gain"] == {"value": None, "low": None, "high": None}
    assert found["large"] == 0.0


def test_a_street_may_lack_a_mode_that_others_have() -> None:
    streets = made_up(0.3)
    streets[0]["mode"] = [2] * 20 + [1] * (len(streets[0]["mode"]) - 20)
    for street in streets[2:]:
        street["mode"] = [1] * len(street["mode"])
    streets[1]["mode"] = [2] * 10 + [1] * (len(streets[1]["mode"]) - 10)
    found = info.compare(streets, 0.3)
    assert found["gain"] is not None
    assert found["r2"] is not None


def test_auc_is_the_share_of_ordered_pairs() -> None:
    scores, large = np.array([0.1, 0.4, 0.4, 0.9]), np.array([False, True, False, True])
    street = np.array([0, 0, 1, 1])
    ones, first_twice = np.ones((1, 2)), np.array([[2.0, 1.0]])
    assert info._weighted_auc(scores, large, street, ones)[0] == 3.5 / 4.0
    twice = np.concatenate([np.arange(2), np.arange(4)])
    again = info._weighted_auc(scores[twice], large[twice], street[twice], ones)
    assert info._weighted_auc(scores, large, street, first_twice) == pytest.approx(again)


def test_a_run_holds_the_samples_of_its_drives(tmp_path: Path) -> None:
    config = info.InformativenessConfig.load(SHORT)
    result = info.assess_informativeness(config, tmp_path)
    samples = 0
    for number in range(2):
        for k, moment in enumerate(drive_street(config, "dense", number)):
            known = (moment.solution.mode != Mode.NONE) & np.isfinite(moment.solution.pl_ct_m)
            samples += int(known.sum()) if k % 10 == 0 else 0
    assert result["cells"][0]["samples"] == samples > 0
    assert json.loads((tmp_path / "results.json").read_text())["cells"] == result["cells"]
    assert (tmp_path / "informativeness.svg").stat().st_size > 1000
    assert info.informativeness_rows(result)[1][0][0] == "dense"
