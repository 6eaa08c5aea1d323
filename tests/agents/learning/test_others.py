"""Trainings take recorded neighbours where these can be; policies are judged with neighbours as configured."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar
from zipfile import ZipFile

import pytest
from experiments import experiment
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.drivers.origin import EXPERIMENT
from lanebound.agents.learning import training
from lanebound.agents.learning.evaluation import evaluation_suite
from lanebound.agents.learning.experiment import ExperimentConfig
from lanebound.agents.learning.opening import for_judging, for_learning
from lanebound.agents.learning.others import choose_others
from lanebound.envs.ids import META, Preset, register_id
from lanebound.integrity.core.errors import ConfigError

QUICK = {"navigation": {"source": "perfect"}, "duration_s": 2.0}


def planned(perception: Mapping[str, Any] | None = None, **changes: Any) -> ExperimentConfig:
    overrides = QUICK | changes.pop("overrides", {}) | {"perception": perception or {}}
    return experiment(env="CarFollowing", overrides=overrides, **changes)


@pytest.mark.parametrize(
    ("perception", "others", "learnt", "judged"),
    [
        ({}, None, "surrogate", "full"),
        ({}, "full", "full", "full"),
        ({}, "surrogate", "surrogate", "full"),
        ({"others": "full"}, None, "full", "full"),
        ({"others": "surrogate"}, None, "surrogate", "surrogate"),
        ({"others": "surrogate"}, "surrogate", "surrogate", "surrogate"),
    ],
)
def test_trainings_take_surrogates_and_evaluations_what_is_configured(
    perception: dict[str, Any], others: str | None, learnt: str, judged: str
) -> None:
    chosen, line = choose_others(planned(perception, others=others))
    assert chosen.others == learnt
    assert line.startswith(f"other vehicles in training: {learnt} (")
    assert choose_others(chosen).experiment == chosen
    with_learner, with_judge = for_learning(chosen, 1), for_judging(chosen, 1)
    assert (with_learner.config.perception.others, with_judge.config.perception.others) == (learnt, judged)
    with_learner.close()
    with_judge.close()


def test_where_surrogates_are_refused_training_says_why_it_takes_receivers() -> None:
    class UnknownRoad(Preset):
        PRESET: ClassVar[Mapping[str, Any]] = {"base": "merge-generic-v0", **META}

    register_id(UnknownRoad)
    for refused, reason in (
        (planned(overrides={"faults": "stress"}), "perception.others must be 'full' with faults 'stress'"),
        (planned(overrides={"action_options": {"dynamical": True}}), "action_options.dynamical must be False"),
        (experiment(env="UnknownRoad"), "perception.others must be 'full' with base 'merge-generic-v0'"),
    ):
        chosen, line = choose_others(refused)
        assert chosen.others == "full"
        assert line.startswith(f"other vehicles in training: full (since surrogates are refused: {reason}")
        assert "\n" not in line
        with pytest.raises(ConfigError, match=f"^others must be full here, got surrogate: {re.escape(reason)}"):
            choose_others(refused.replace(others="surrogate"))


def test_contradictions_and_choices_without_effect_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^others must be full, as overrides\.perception\.others is, got surrogate:"):
        choose_others(planned({"others": "full"}, others="surrogate"))
    for silent, why in (
        (planned({"source": "sensor"}), "perception.source is sensor"),
        (experiment(), "there are no other vehicles"),
    ):
        assert choose_others(silent) == (silent, "")
        with pytest.raises(ConfigError, match=rf"^others must be left out where nobody broadcasts \({why}\), got full"):
            choose_others(silent.replace(others="full"))


def test_what_was_used_is_printed_and_stored_and_benchmarks_take_receivers(tmp_path: Path) -> None:
    source, out = tmp_path / "mine.yaml", tmp_path / "out"
    source.write_text(json.dumps(planned(steps=64).to_dict() | {"kind": "experiment"}))
    result = CliRunner().invoke(app, ["train", str(source), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "other vehicles in training: surrogate (recorded errors" in result.stderr
    assert json.loads((out / "run.json").read_text())["config"]["others"] == "surrogate"
    assert "(`perception.others`): surrogate in training, full below." in (out / training.CARD).read_text()
    with ZipFile(out / "best.zip") as archive:
        assert json.loads(archive.read(EXPERIMENT))["others"] == "surrogate"
    suite = evaluation_suite(out, "nominal", 1)
    assert suite.env_overrides(suite.places[0], "learnt")["perception"] == {}
    again = CliRunner().invoke(app, ["train", str(source), "--out", str(out), "--others", "full"])
    assert again.exit_code != 0
    assert "others (surrogate there, now full)" in again.stderr.replace("\n", " ")
