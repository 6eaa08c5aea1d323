"""The page of the study says what its trainings came to, and the results quote it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from lanebound.agents.report.pages import csv_of
from lanebound.agents.studies.learning import load_study
from lanebound.agents.studies.learning_page import (
    differences,
    overview,
    packed,
    summed_up,
    unpacked,
    write_page,
)

DOCS = Path(__file__).parents[3] / "docs"
NAME = "value_of_integrity"
RESULTS = DOCS / "results" / "learning-study.md"


def test_the_results_are_up_to_date() -> None:
    """``python -m lanebound.agents.studies.learning_page docs/value_of_integrity.json out`` makes them."""
    trainings = unpacked(DOCS / f"{NAME}.json")
    study = load_study(NAME)
    places = summed_up(study, trainings).places
    assert overview(study, places) in RESULTS.read_text(encoding="utf-8")
    assert (DOCS / f"{NAME}-differences.csv").read_text(encoding="utf-8") == csv_of(differences(study, places))


def test_every_interval_in_the_results_is_one_of_the_differences() -> None:
    section = RESULTS.read_text(encoding="utf-8")
    page = (DOCS / f"{NAME}-differences.csv").read_text(encoding="utf-8")
    quoted = re.findall(r"-?[\d.]+ \[-?[\d.]+, -?[\d.]+\](?:, p [\d.e-]*\d)?", " ".join(section.split()))
    assert len(quoted) > 5
    assert [interval for interval in quoted if interval not in page] == []


def test_every_training_of_the_study_is_there_once_and_whole() -> None:
    study, trainings = load_study(NAME), unpacked(DOCS / f"{NAME}.json")
    there = [(one["env"], one["sky"], one["arm"], one["seed"]) for one in trainings]
    filtered = {"LaneKeeping-v0", "CarFollowing-v0"}  # the filter has no actions elsewhere
    to_come = {"clock", "clock_lagrangian"}  # later than the study; the page says so
    wanted = {
        (env, sky, arm, seed)
        for env, sky in study.places
        for arm in study.arms
        if arm not in to_come and (arm != "filtered" or env in filtered)
        for seed in range(study.seeds)
    }
    assert len(there) == len(set(there))
    assert set(there) == wanted
    assert {len(one["episodes"]) for one in trainings} == {study.test_seeds}


def test_what_is_packed_comes_out_as_it_was(tmp_path: Path) -> None:
    rows = [{"steps": 64, "return": 1.0 / 3.0}, {"steps": 128, "return": 2.0 / 3.0}]
    part = {"env": "LaneKeeping-v0", "sky": "urban", "arm": "blind", "seed": 0, "limit": 15.0, "checkpoints": rows}
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "one.json").write_text(json.dumps({**part, "episodes": rows[:1]}), encoding="utf-8")
    [row] = packed(tmp_path, "abc1234")
    (tmp_path / "all.json").write_text(json.dumps([row]), encoding="utf-8")
    [back] = unpacked(tmp_path / "all.json")
    assert (back["commit"], back["limit"], len(back["episodes"])) == ("abc1234", 15.0, 1)
    for was, now in zip(rows, back["checkpoints"], strict=True):
        assert now["steps"] == was["steps"]
        assert now["return"] == pytest.approx(was["return"], rel=1e-4)


def test_pages_are_written_of_what_is_there(tmp_path: Path) -> None:
    def training(arm: str, seed: int, cost: float) -> dict[str, object]:
        columns = {key: [cost, cost + 1.0] for key in (
            "return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput"
        )}  # fmt: skip
        return {
            "env": "LaneKeeping-v0", "sky": "urban", "arm": arm, "seed": seed, "limit": 15.0, "episodes": columns,
            "commit": "abc1234",
            "checkpoints": {"steps": [1, 2], "return": [0.0, 1.0], "cost": [1.0, 0.0]},
        }  # fmt: skip

    rows = [training(arm, seed, cost) for arm, cost in (("lagrangian", 14.0), ("taught", 40.0)) for seed in range(2)]
    rows.append(training("taught", 2, 1.5))
    source = tmp_path / f"{NAME}.json"
    source.write_text(json.dumps(rows), encoding="utf-8")
    table = write_page(source, tmp_path)
    page = (tmp_path / f"{NAME}.md").read_text(encoding="utf-8")
    assert "5 trainings (" in page
    assert "| LaneKeeping, urban | 14±0 at 14±0 (2) |" in table
    assert "## Harm" in page
    lines = (tmp_path / f"{NAME}-differences.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "arm,less,place,return,cost,harm"
    assert lines[1].startswith('taught,lagrangian,"LaneKeeping, urban","26 [26, 26]"')
    assert (tmp_path / "value_of_integrity-curves-1.png").stat().st_size > 1000
