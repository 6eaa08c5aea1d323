"""Results: put together, saved, loaded; what counts and what does not."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from benchmarks import made_up_folder, made_up_outcome, made_up_results, made_up_suite

from lanebound.agents.benchmark.metrics import MAIN, METRICS, harm_of, metric_named
from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore, source_digest, stored_columns
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import MANIFEST, code_digest
from lanebound.integrity.core.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    made_up_folder(out, seeds={"count": 3})
    return out


def test_a_cell_for_each_agent_at_each_place():
    results = made_up_results()
    assert len(results.cells) == 2 * 2 * 3
    assert results.missing == []
    cell = results.cell(results.suite.places[1], "nominal")
    here = [o for o in results.outcomes if o.task.place == cell.place and o.agent == "nominal"]
    assert cell.metrics["return"].mean == pytest.approx(np.mean([o.total_return for o in here]))
    assert cell.metrics["return"].low < cell.metrics["return"].mean < cell.metrics["return"].high
    assert set(cell.metrics) == {metric.key for metric in METRICS} >= set(MAIN)


def test_pairs_are_by_seed_and_against_the_reference():
    results = made_up_results(seeds={"count": 8})
    pair = next(p for p in results.paired if p.metric == "return" and p.agent == "random")
    by_agent = {
        agent: [o.total_return for o in results.outcomes if o.task.place == pair.place and o.agent == agent]
        for agent in ("random", "nominal")
    }
    gaps = np.subtract(by_agent["random"], by_agent["nominal"])
    assert pair.against == "nominal"
    assert pair.difference == pytest.approx(gaps.mean())
    assert pair.better == np.mean(gaps > 0)
    assert pair.clear
    assert not any(p.clear for p in made_up_results(seeds={"count": 7}).paired)
    assert {p.agent for p in results.paired} == {"random", "integrity_aware"}


def test_several_references_are_each_paired_with_all_others():
    results = made_up_results(reference=["nominal", "integrity_aware"])
    here = [p for p in results.paired if p.place == results.suite.places[0] and p.metric == "return"]
    assert [(p.agent, p.against) for p in here] == [
        ("random", "nominal"), ("integrity_aware", "nominal"),
        ("random", "integrity_aware"), ("nominal", "integrity_aware"),
    ]  # fmt: skip
    assert here[1].difference == pytest.approx(-here[3].difference)
    one = made_up_results(reference="nominal").paired
    assert [p for p in results.paired if p.against == "nominal"] == one
    assert made_up_results(reference=["nobody", "nominal"]).paired == one


def test_nothing_is_clear_where_an_agent_failed():
    sound = made_up_results(seeds={"count": 12})
    failing = [replace(o, status="raised") if (o.agent, o.seed) == ("random", 10_000) else o for o in sound.outcomes]
    pairs = [p for p in Results.of(sound.suite, failing).paired if p.metric == "return"]
    assert {(p.agent, p.failed, p.n) for p in pairs} == {("random", 1, 11), ("integrity_aware", 0, 12)}
    assert {p.agent for p in pairs if p.clear} == {"integrity_aware"}
    assert {p.agent for p in sound.paired if p.metric == "return" and p.clear} == {"random", "integrity_aware"}


def test_harm_is_what_the_true_car_did_and_nothing_of_levels_alerts_or_weights():
    task = next(made_up_suite().tasks())
    believed = {"cost_lane_integrity": 9.0, "cost_headway": 9.0, "cost_alert": 9.0, "cost_hmi": 9.0}
    costs = {"cost_lane": 2.5, **believed}
    assert harm_of(made_up_outcome(task, collision=False, cost=999.0, costs=costs)) == 2.5
    assert harm_of(made_up_outcome(task, collision=True, costs=costs)) == 52.5
    assert harm_of(made_up_outcome(task, collision=False, costs=costs | {"cost_off_road": 1.0})) == 52.5
    assert harm_of(made_up_outcome(task, collision=True, costs=costs | {"cost_off_road": 1.0})) == 52.5


def test_a_folder_knows_the_versions_of_its_episodes(tmp_path):
    store, suite = EpisodeStore(tmp_path), made_up_suite()
    store.claim(suite, left_out=[("Merge-v0", "cbf", "it steers")])
    assert store.left_out() == [("Merge-v0", "cbf", "it steers")]
    assert store.same_version()
    manifest = store.manifest()
    write_json(tmp_path / MANIFEST, manifest | {"source": "0"})
    assert not store.same_version()
    with pytest.raises(InputError, match=r"of another version of the code \(.*\): .* or drive anew with --fresh"):
        store.claim(suite)
    store.claim(suite, fresh=True)
    assert store.same_version()


@pytest.mark.parametrize("name", ["episode.py", "outcome.py", "scoring.py", "suite.py", "work.py"])
def test_the_digest_is_of_all_that_an_outcome_follows_from(monkeypatch, name):
    read = Path.read_bytes

    def changed(path):
        return read(path) + (b"#" if path.parts[-2:] == ("benchmark", name) else b"")

    code_digest.cache_clear()
    before = source_digest()
    monkeypatch.setattr(Path, "read_bytes", changed)
    code_digest.cache_clear()
    assert source_digest() != before
    code_digest.cache_clear()


def test_what_an_agent_that_failed_did_counts_as_failure_and_as_nothing_else():
    suite = made_up_suite(envs=["LaneKeeping"], skies=["urban"], seeds={"count": 2})
    outcomes = [made_up_outcome(task, status="timeout") for task in suite.tasks() if task.agent == "random"]
    outcomes[0] = made_up_outcome(outcomes[0].task, total_return=7.0, success=True)
    cell = Results.of(suite, outcomes).cells[0]
    assert (cell.episodes, cell.failed, cell.metrics["failed"].mean) == (2, 1, 0.5)
    assert (cell.metrics["return"].mean, cell.metrics["return"].n) == (7.0, 1)
    assert cell.metrics["success"].n == 2


def test_what_was_not_driven_is_missing_and_what_cannot_be_is_not():
    suite = made_up_suite(seeds={"count": 1})
    outcomes = [made_up_outcome(task) for task in suite.tasks() if task.place.env == "LaneKeeping-v0"]
    results = Results.of(suite, outcomes, [("CarFollowing-v0", "random", "no reason")])
    assert results.missing == [
        f"CarFollowing-v0/{sky}-none/{agent}/10000"
        for sky in ("urban", "dense")
        for agent in ("nominal", "integrity_aware")
    ]  # fmt: skip


def test_a_folder_gives_back_what_was_put_in(folder):
    results = Results.load(folder)
    again = Results.load(folder)
    assert results == again
    assert results.suite == made_up_suite(seeds={"count": 3})
    assert [o.id for o in results.failures] == ["CarFollowing-v0/dense-none/integrity_aware/10002"]
    assert results.outcomes[:-1] == [made_up_outcome(task) for task in results.suite.tasks()][:-1]
    rows = results.rows(results.outcomes[0])
    assert rows.column_names == [column.name for column in stored_columns()]
    assert rows.num_rows == results.outcomes[0].steps + 1


def test_the_files_agree(folder):
    results = Results.load(folder)
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert data == json.loads(json.dumps(results.to_dict()))
    assert [Outcome.from_dict(o) for o in data["outcomes"]] == results.outcomes
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    alone, paired = ([line for line in lines if bool(line["against"]) == is_pair] for is_pair in (False, True))
    assert len(alone) == len(results.cells) * len(METRICS)
    assert float(alone[0]["mean"]) == results.cells[0].metrics["success"].mean
    assert len(paired) == len(results.paired) == len(data["paired"])
    last, pair = paired[-1], results.paired[-1]
    assert (last["agent"], last["against"], last["metric"]) == (pair.agent, pair.against, pair.metric)
    found = next(k for k, p in enumerate(results.paired) if p.metric == "return" and p.failed)
    assert (paired[found]["failed"], paired[found]["n"], data["paired"][found]["failed"]) == ("1", "2", 1)
    assert float(paired[found]["mean"]) == results.paired[found].difference
    assert float(paired[found]["p"]) == data["paired"][found]["p"] == results.paired[found].p
    table = pq.read_table(folder / "episodes.parquet").to_pylist()
    assert [row["id"] for row in table] == [o.id for o in results.outcomes]
    assert table[0]["share_rtk"] == results.outcomes[0].mode_shares["rtk"]
    assert sorted(path.name for path in folder.iterdir()) == [
        "episodes", "episodes.parquet", "results.csv", "results.json", "run.json",
    ]  # fmt: skip


def test_a_manifest_without_a_valid_suite_is_named_with_what_is_wrong(tmp_path):
    made_up_folder(tmp_path, seeds={"count": 1})
    manifest = EpisodeStore(tmp_path).manifest()
    for config, reason in (
        ({"envs": []}, "envs must .*; agents is required, .*"),
        (None, ".*"),
    ):
        write_json(tmp_path / MANIFEST, manifest | {"config": config})
        for read in (EpisodeStore(tmp_path).suite, lambda: Results.load(tmp_path)):
            with pytest.raises(
                InputError, match=f"run.json must hold a valid suite, got {reason}: restore .* --fresh'$"
            ):
                read()


@pytest.mark.parametrize(("folder", "found"), [("", r"without run\.json"), ("none", "none, which does not exist")])
def test_a_folder_without_a_benchmark_differs_from_one_that_does_not_exist(tmp_path, folder, found):
    with pytest.raises(InputError, match=f"^the folder must hold a benchmark, got .*{found}: give the folder of its"):
        EpisodeStore(tmp_path / folder).suite()


def test_what_is_fresh_holds_no_earlier_episodes_and_keeps_what_is_not_of_a_benchmark(tmp_path):
    made_up_folder(tmp_path, seeds={"count": 1})
    (tmp_path / "notes.txt").touch()
    store = EpisodeStore(tmp_path)
    store.claim(made_up_suite(skies=["open"]), fresh=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "run.json"]


def test_an_episode_counts_once():
    """Seeds that count twice make intervals too narrow."""
    results = made_up_results(seeds={"count": 2})
    twice = [*results.outcomes, replace(results.outcomes[3], cost=1.0)]
    with pytest.raises(InputError, match=f"seed of their own, got 2 of {twice[3].id}: keep one"):
        Results.of(results.suite, twice)


def test_outcomes_hold_no_infinity_and_ignore_what_they_do_not_know():
    outcome = made_up_outcome(next(made_up_suite().tasks()), pl_at_median_m=float("inf"))
    assert outcome.to_dict()["pl_at_median_m"] is None
    assert Outcome.from_dict(asdict(outcome) | {"from_the_future": 1}) == outcome
    assert set(outcome.to_dict()) - set(outcome.lasting()) == {"solve_ms_median", "solve_ms_p99"}


def test_metrics_are_named_once():
    keys = [metric.key for metric in METRICS]
    assert len(set(keys)) == len(keys)
    assert metric_named("gap").better is None
    assert all(metric.meaning and metric.title for metric in METRICS)
