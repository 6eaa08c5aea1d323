"""Learning curves: trainings in the ids as they are shipped, judged on held-out seeds, with receivers of all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.learning.evaluation import drive_all
from lanebound.agents.studies import curves
from lanebound.agents.studies.curves import PACE, SECTIONS, CurvesConfig, experiment_of, run_curves, save_curves, tables
from lanebound.envs import make_config
from lanebound.integrity.core.errors import ConfigError

SHORT = {
    "overrides": {"navigation": {"source": "perfect"}, "duration_s": 4.0},
    "imitation": {"rounds": 1, "decisions": 64, "epochs": 1},
    "count": 2,
    "steps": 128,
    "checkpoint_steps": 64,
    "settings": {"n_steps": 32, "batch_size": 32, "n_epochs": 1},
}


@pytest.mark.parametrize("env", PACE)
def test_each_id_is_as_it_is_shipped_under_the_cost_limit(env: str) -> None:
    planned, shipped = experiment_of(CurvesConfig(minutes=1.0), env), make_config(f"lanebound/{env}-v0")
    config = planned.open().config
    assert config.replace(observation=shipped.observation.to_dict()) == shipped
    assert planned.algorithm.constrained
    assert planned.steps == 7 * planned.checkpoint_steps
    assert planned.steps == pytest.approx(PACE[env][0], rel=0.2)
    assert planned.checkpoint_steps % (planned.count * planned.settings["n_steps"]) == 0


def test_an_interrupted_study_goes_on_and_judges_held_out_seeds_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = CurvesConfig(envs=("LaneKeeping",), seeds=2, final_seeds=4, experiment=SHORT)
    seeds: list[range] = []

    def noted(experiment, model, asked):
        seeds.append(asked)
        if len(seeds) == 2:
            raise KeyboardInterrupt
        return drive_all(experiment, model, asked)

    monkeypatch.setattr(curves, "drive_all", noted)
    with pytest.raises(KeyboardInterrupt):
        run_curves(config, tmp_path)
    found = run_curves(config, tmp_path)
    part = found["ids"]["LaneKeeping"]
    assert [point["steps"] for point in part["checkpoints"]] == [0, 64, 128]
    assert [len(point["episodes"]) for point in part["checkpoints"]] == [2, 2, 2]
    assert {name: len(of) for name, of in part["final"].items()} == {"learnt": 4, "nominal": 4, "ppo": 4}
    assert all(set(asked) <= set(SPLITS["test"]) for asked in seeds)
    assert {path.name for path in (tmp_path / "trainings/LaneKeeping").glob("*.zip")} == {"last.zip"}  # none is chosen
    before = len(seeds)
    assert run_curves(config, tmp_path) == found
    assert len(seeds) == before
    assert json.loads((tmp_path / "results.json").read_text()) == found
    shown = tables(found)
    assert tuple(shown) == SECTIONS
    for heads, rows in shown.values():
        assert {len(row) for row in rows} == {len(heads)}
    assert save_curves(found, tmp_path).stat().st_size > 10_000
    del part["final"]["ppo"]  # as in an id without a shipped policy
    assert save_curves(found, tmp_path).stat().st_size > 10_000


def test_unknown_ids_are_refused() -> None:
    with pytest.raises(ConfigError, match="environment 'Parking' is unknown"):
        CurvesConfig(envs=("Parking",))
