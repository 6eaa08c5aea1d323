"""Studies of learning: what is planned, what goes on where it was stopped, and what trainings come to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import sem, ttest_1samp
from scipy.stats import t as student_t
from typer.testing import CliRunner

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import run
from lanebound.agents.cli import app
from lanebound.agents.learning.evaluation import learnt_agent
from lanebound.agents.studies import learning as room
from lanebound.agents.studies.learning import (
    COMPARED,
    SHOWN,
    LearningStudyConfig,
    Pace,
    adjust,
    beside_suite,
    higher,
    kept_more_often,
    load_study,
    measured,
    plan,
    run_learning_study,
    study_hours,
    summarise,
)
from lanebound.agents.studies.learning_page import curves_figure
from lanebound.integrity.core.errors import ConfigError, InputError

STILL = {"navigation": {"source": "perfect"}, "duration_s": 3.0}
SMALL: dict[str, Any] = {
    "arms": {
        "blind": {"overrides": {"observation": {"integrity": "blind"}}},
        "filtered": {"algorithm": "ppo_lagrangian", "shield": "cbf", "against": "blind"},
    },
    "envs": ["CarFollowing"],
    "skies": ["open"],
    "seeds": 1,
    "test_seeds": 1,
    "experiment": {
        "overrides": STILL,
        "steps": 64,
        "count": 2,
        "checkpoint_steps": 32,
        "evaluation_episodes": 1,
        "settings": {"n_steps": 16, "batch_size": 16, "n_epochs": 1},
    },
}


def small(**changes: Any) -> LearningStudyConfig:
    return LearningStudyConfig.load({**SMALL, **changes})


def test_a_study_that_is_stopped_goes_on_and_drives_its_policies(tmp_path: Path, monkeypatch: Any) -> None:
    told: list[tuple[float, float]] = []
    nothing = run_learning_study(small(), tmp_path, budget_h=0.0)
    assert (nothing["trainings"], nothing["places"]) == ({"planned": 2, "done": 0}, [])

    train, begun = room.train, []

    def stops(*arguments: Any, **settings: Any) -> Any:
        begun.append(arguments[0].seed)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return train(*arguments, **settings)

    monkeypatch.setattr(room, "train", stops)
    with pytest.raises(KeyboardInterrupt):
        run_learning_study(small(), tmp_path)
    monkeypatch.setattr(room, "train", train)
    found = run_learning_study(small(), tmp_path, on_progress=lambda now: told.append((now.done, now.of)))
    assert (told[0], told[-1]) == ((1, 2), (2, 2))
    assert any(1 < done < 2 for done, _ in told)
    assert found["trainings"] == {"planned": 2, "done": 2}
    [place] = found["places"]
    assert {arm: of["seeds"] for arm, of in place["arms"].items()} == {"blind": [0], "filtered": [0]}
    assert set(place["beside"]) == {"nominal", "integrity_aware"}
    assert place["arms"]["filtered"]["less"]["blind"]["cost"]["n"] == 1
    assert json.loads((tmp_path / "results.json").read_text()) == json.loads(json.dumps(found))
    assert (tmp_path / "curves.svg").stat().st_size > 1000
    with pytest.raises(InputError, match="hold the same learning study"):
        run_learning_study(small(seeds=2), tmp_path)


def test_every_place_has_its_first_training_before_any_has_its_second() -> None:
    course = plan(small(envs=["CarFollowing", "LaneKeeping"], skies=["open", "urban"], seeds=2))
    assert [one.seed for one in course.trainings] == [0] * 8 + [1] * 8
    assert course.trainings[1].name == "CarFollowing-v0-open-filtered-0"
    assert course.trainings[1].experiment(small()).overrides == STILL
    assert course.trainings[0].experiment(small()).overrides == {**STILL, "observation": {"integrity": "blind"}}


def test_the_time_of_a_study_is_that_of_its_decisions(monkeypatch: pytest.MonkeyPatch) -> None:
    study = small(test_seeds=3, experiment=SMALL["experiment"] | {"count": 1})
    monkeypatch.setattr(room, "_each", lambda step: (step(), 0.25)[1])
    assert measured(plan(study).trainings[0].experiment(study)) == Pace(0.25 + room.LEARNING_S, 0.25, 15.0)
    monkeypatch.setattr(room, "measured", lambda planned: Pace(0.5, 2.0, 15.0))
    of_one, of_a_driver = 64 * 0.5 + (2 * 1 + 3) * 15 * 0.5, 3 * 15 * 2.0
    assert study_hours(study, plan(study)) == pytest.approx((2 * of_one + len(COMPARED) * of_a_driver) / 3600.0)


def test_the_folder_is_refused_before_any_speed_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []

    def refuses(planned: Any) -> Pace:
        begun.append(planned.env)
        raise InputError("measured")

    monkeypatch.setattr(room, "measured", refuses)
    (tmp_path / "letter.txt").write_text("of other origin")
    command = ["study", "value_of_integrity", "--out", str(tmp_path)]
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code != 0
    assert "with files of other origin (letter.txt)" in refused.stderr
    assert begun == []
    (tmp_path / "letter.txt").unlink()
    count = len(load_study("value_of_integrity").envs)
    assert CliRunner().invoke(app, command).stderr.splitlines()[0] == f"measuring the speed of {count} environments"
    assert len(begun) == 1


def test_an_environment_may_have_trainings_of_its_own_kind() -> None:
    seen = {"perception": {"source": "sensor"}}
    study = small(envs=["CarFollowing", "UrbanCanyon"], by_env={"UrbanCanyon": {"steps": 32, "overrides": seen}})
    here, there = (one.experiment(study) for one in plan(study).trainings[::2])
    assert (here.steps, there.steps) == (64, 32)
    assert there.overrides == {**STILL, **seen, "observation": {"integrity": "blind"}}
    assert here.overrides == {**STILL, "observation": {"integrity": "blind"}}
    suite = beside_suite(study, "UrbanCanyon-v0", "open")
    assert suite.overrides == {**STILL, **seen}
    with pytest.raises(ConfigError, match="did you mean 'UrbanCanyon-v0'"):
        small(by_env={"UrbanCanyn": {}})


def test_an_arm_may_learn_in_a_way_of_its_own() -> None:
    shown = {"driver": "nominal", "rounds": 1, "decisions": 10}
    slow = {"overrides": {"sky": "open"}, "experiment": {"imitation": shown, "settings": {"n_epochs": 2}}}
    study = small(arms={"slow": slow, "blind": {}}, by_env={"CarFollowing": {"settings": {"n_steps": 8}}})
    own, shared = (one.experiment(study) for one in plan(study).trainings)
    assert own.imitation is not None
    assert (own.imitation.driver, shared.imitation) == ("nominal", None)
    assert own.settings == {"n_steps": 8, "batch_size": 16, "n_epochs": 2}
    assert shared.settings == {"n_steps": 8, "batch_size": 16, "n_epochs": 1}
    assert own.overrides == {**STILL, "sky": "open"}


def test_policies_are_also_judged_in_environments_of_their_own(tmp_path: Path) -> None:
    """An episode of 2 s has two thirds of the decisions of one of 3 s; every arm has the difference from its own."""
    study = small(arms={"blind": {}, "other": {"against": "blind"}}, judged_in={"brief": {"duration_s": 2.0}})
    found = run_learning_study(study, tmp_path)
    assert [place["judged_in"] for place in found["places"]] == ["own", "brief"]
    assert [set(place["arms"]["other"]["less"]) for place in found["places"]] == [{"blind"}, {"blind", "own"}]
    part = json.loads((tmp_path / "parts" / "CarFollowing-v0-open-other-0.json").read_text())
    lengths = [of[0]["length"] for of in (part["episodes"], part["elsewhere"]["brief"])]
    assert lengths == [15.0, 10.0]
    own, brief = (place["arms"]["other"] for place in found["places"])
    gap = brief["means"]["return"]["mean"] - own["means"]["return"]["mean"]
    assert brief["less"]["own"]["return"]["difference"] == pytest.approx(gap)
    assert (tmp_path / "beside" / "CarFollowing-v0-open-brief").is_dir()
    with pytest.raises(ConfigError, match=r"judged_in.own stands for the environment of the training"):
        small(judged_in={"own": {}})


def test_the_filter_is_left_out_where_actions_do_not_accelerate() -> None:
    course = plan(small(envs=["UrbanCanyon", "CarFollowing"]))
    assert course.left_out == (("UrbanCanyon-v0", "filtered"),)
    assert {(one.env, one.arm) for one in course.trainings} == {
        ("UrbanCanyon-v0", "blind"), ("CarFollowing-v0", "blind"), ("CarFollowing-v0", "filtered"),
    }  # fmt: skip


def test_the_packaged_study_has_every_arm_in_every_place() -> None:
    study = load_study("value_of_integrity")
    course = plan(study)
    places = len(study.envs) * len(study.skies)
    left_out = len(course.left_out) * len(study.skies)
    assert len(course.trainings) == study.seeds * (len(study.arms) * places - left_out)
    assert {arm for _, arm in course.left_out} <= {"filtered"}
    assert study.hypotheses


def test_a_training_is_one_draw_however_many_episodes_its_policy_drives() -> None:
    def part(arm: str, seed: int, cost: float) -> dict[str, Any]:
        episodes = [dict.fromkeys(SHOWN, 0.0) | {"cost": cost + seed + shift} for shift in (-0.5, 0.0, 0.5)]
        limit = {"blind": 13.0, "seeing": 6.0}[arm]
        return {"arm": arm, "seed": seed, "limit": limit, "episodes": episodes}

    parts = [part(arm, seed, cost) for arm, cost in (("blind", 10.0), ("seeing", 4.0)) for seed in range(5)]
    found = summarise(parts, {"blind": (), "seeing": ("blind",), "unlearnt": ("blind",)})
    assert list(found["arms"]) == ["blind", "seeing"]
    mean = found["arms"]["seeing"]["means"]["cost"]
    assert mean["n"] == 5
    assert mean["mean"] == pytest.approx(np.mean([4.0, 5.0, 6.0, 7.0, 8.0]))
    less = found["arms"]["seeing"]["less"]["blind"]["cost"]
    assert (less["n"], less["difference"]) == (5, pytest.approx(-6.0))
    assert [of["kept"] for of in found["arms"].values()] == [4, 3]


def test_few_trainings_have_intervals_and_tests_and_many_tests_are_adjusted() -> None:
    def part(arm: str, seed: int, **figures: float) -> dict[str, Any]:
        return {"arm": arm, "seed": seed, "limit": 5.0, "episodes": [dict.fromkeys(SHOWN, 0.0) | figures] * 20}

    cost = {"blind": (10.0, 12.0, 11.0), "seeing": (4.0, 5.5, 4.6)}
    parts = [part(arm, seed, cost=value) for arm in cost for seed, value in enumerate(cost[arm])]
    place = summarise(parts, {"blind": (), "seeing": ("blind",)})
    mean, crashes = (place["arms"]["seeing"]["means"][key] for key in ("cost", "collision"))
    gap = np.subtract(cost["seeing"], cost["blind"])
    assert [mean["low"], mean["high"]] == pytest.approx(t_interval(cost["seeing"]))
    assert [crashes["low"], crashes["high"]] == [0.0, pytest.approx(1.0 - 0.025 ** (1.0 / 60.0))]
    less = place["arms"]["seeing"]["less"]["blind"]
    assert [less["cost"]["low"], less["cost"]["high"]] == pytest.approx(t_interval(gap))
    assert less["cost"]["p"] == pytest.approx(ttest_1samp(gap, 0.0).pvalue)
    assert (less["return"]["difference"], less["return"]["p"]) == (0.0, 1.0)
    alike = [part(arm, seed, cost=float(arm == "blind")) for arm in cost for seed in range(3)]
    always = summarise(alike, {"blind": (), "seeing": ("blind",)})["arms"]["seeing"]["less"]["blind"]["cost"]
    assert (always["difference"], always["p"]) == (-1.0, 0.25), "three that agree prove little"
    assert adjust([place, {"arms": {"seeing": {"less": {}}}}], [], {"blind": "", "seeing": "late"}) == {
        "": 0,
        "late": 3,
    }
    assert less["cost"]["p_holm"] == pytest.approx(3.0 * less["cost"]["p"])
    assert "p_holm" not in less["collision"]


def test_who_keeps_the_limit_oftener_is_tested_in_pairs() -> None:
    def training(arm: str, seed: int, cost: float, sky: str = "urban") -> dict[str, Any]:
        episode = {**dict.fromkeys(SHOWN, 0.0), "cost": cost}
        return {"env": "LaneKeeping-v0", "sky": sky, "arm": arm, "seed": seed, "limit": 15.0, "episodes": [episode]}

    parts = [training("blind", seed, 16.0) for seed in range(6)] + [training("seeing", seed, 15.0) for seed in range(5)]
    parts += [training(arm, 0, 1.0, "dense") for arm in ("blind", "seeing")] + [training("seeing", 1, 1.0, "dense")]
    arms = {"blind": (), "seeing": ("blind",), "unlearnt": ("blind", "seeing")}
    first, *others = kept_more_often(parts, arms)
    assert {**first, "p": None} == {
        "arm": "seeing", "other": "blind", "n": 6, "first": 6, "second": 1, "first_alone": 5, "second_alone": 0,
        "p": None,
    }  # fmt: skip
    assert first["p"] == pytest.approx(2.0 * 0.5**5)
    assert [(row["n"], row["p"]) for row in others] == [(0, 1.0), (0, 1.0)]
    assert adjust([], [first, *others], {"seeing": "late", "unlearnt": ""}) == {"late": 1}
    assert first["p_holm"] == first["p"]


def test_whose_return_is_higher_is_counted_in_pairs_and_places() -> None:
    def training(arm: str, seed: int, found: float, sky: str) -> dict[str, Any]:
        episodes = [{**dict.fromkeys(SHOWN, 0.0), "return": found + off} for off in (-1.0, 1.0)]
        return {"env": "LaneKeeping-v0", "sky": sky, "arm": arm, "seed": seed, "limit": 15.0, "episodes": episodes}

    parts = [training("blind", seed, 10.0, sky) for seed in range(3) for sky in ("urban", "dense")]
    parts += [training("seeing", seed, found, "urban") for seed, found in enumerate((11.0, 11.0, 1.0))]
    parts += [training("seeing", seed, found, "dense") for seed, found in enumerate((12.0, 10.0))]
    assert higher(parts, "seeing", "blind") == (3, 5, 1, 2)
    assert higher(parts, "blind", "seeing") == (1, 5, 1, 2)
    assert higher(parts, "blind", "unlearnt") == (0, 0, 0, 0)
    assert higher(parts, "seeing", "blind", "cost") == (0, 5, 0, 2)


def t_interval(values: Any) -> list[float]:
    return list(student_t.interval(0.95, len(values) - 1, np.mean(values), sem(values)))


def test_held_out_episodes_are_those_of_the_benchmark(tmp_path: Path) -> None:
    """Noted in the engine, all at once, they are what the benchmark finds of the same policy, seed by seed."""
    overrides = {"experiment": {**SMALL["experiment"], "overrides": {"duration_s": 4.0}}, "skies": ["dense"]}
    study = small(test_seeds=3, **overrides)
    run_learning_study(study, tmp_path)
    for one in plan(study).trainings:
        noted = json.loads((tmp_path / "parts" / f"{one.name}.json").read_text())["episodes"]
        agent = learnt_agent(one.experiment(study), tmp_path / "trainings" / one.name / "best.zip")
        suite = SuiteConfig.load({**beside_suite(study, one.env, one.sky).to_dict(), "agents": {"nominal": agent}})
        for row, outcome in zip(noted, run(suite, tmp_path / one.arm).outcomes, strict=True):
            for key in SHOWN:
                value = metric_named(key).take(outcome)
                assert row[key] == pytest.approx(value, rel=0.04 if key == "throughput" else 1e-5, abs=1e-9), key


def test_curves_take_trainings_of_different_lengths() -> None:
    def training(seed: int, length: int) -> dict[str, Any]:
        rows = [{"steps": 10 * i, "return": i + seed, "cost": 1.0} for i in range(1, length)]
        return {"env": "LaneKeeping-v0", "sky": "urban", "arm": "blind", "checkpoints": rows}

    figure = curves_figure([training(0, 5), training(1, 3)], ["blind", "seeing"])
    line = figure.axes[0].lines[0]
    assert line.get_xdata().tolist() == [0.01, 0.02]
    assert line.get_ydata().tolist() == [1.5, 2.5]


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"arms.filtered.against must be one of blind, got seeing"):
        small(arms={**SMALL["arms"], "filtered": {"against": "seeing"}})
    with pytest.raises(ConfigError, match="did you mean 'value_of_integrity'"):
        load_study("value_of_integrit")
    told = CliRunner().invoke(app, ["study", "value_of_integrity", "--out", str(tmp_path), "--set", "seeds=0"])
    assert told.exit_code == 2
    assert "seeds must lie in [1, 100], got 0" in told.stderr


def test_the_command_prints_a_table_for_each_place(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(json.dumps({"kind": "learning_study", **SMALL}))
    told = CliRunner().invoke(app, ["study", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out")])
    assert told.exit_code == 0, told.output
    assert "2 trainings, 1 at a time" in told.stderr
    assert "CarFollowing-v0, open: means over trainings" in told.stdout


def test_studies_of_another_kind_are_not_offered() -> None:
    with pytest.raises(ConfigError, match="study 'urban_drive' is unknown: known are cities, value_of_integrity"):
        load_study("urban_drive")
