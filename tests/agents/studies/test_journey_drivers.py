"""Drivers of journeys: what is learnt and compared in a city whose answer is known, and sums over cities."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from two_routes import two_routes
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.episodes import full_id
from lanebound.agents.learning import journeys as learning
from lanebound.agents.learning.journeys import JourneyVecEnv, LearntJourney, train_journeys
from lanebound.agents.studies import journey_drivers as study
from lanebound.envs.journeys import engine
from lanebound.envs.journeys.env import VectorJourney
from lanebound.envs.registration import JOURNEY_ID, make_config
from lanebound.integrity.core.errors import InputError

CONFIG: dict[str, Any] = {"cities": {"count": 1}, "hours": [3.0, 15.0], "reward": {"unusable": 3.0}}


@pytest.fixture(autouse=True)
def small_city(monkeypatch: pytest.MonkeyPatch) -> None:
    """The city of two routes in place of generated ones, and a short learning."""
    monkeypatch.setattr(engine, "city_hours", lambda sky, errors, seed, hours: (2 * two_routes())[: len(hours)])
    monkeypatch.setattr(learning, "ENVS", 8)
    monkeypatch.setattr(learning, "PPO_OPTIONS", learning.PPO_OPTIONS | {"n_steps": 16, "batch_size": 64})


def made_up(seed: int, journeys: int = 30, draws: int = 200) -> dict[str, Any]:
    """A city in which full and fast drives have one normal distribution, about the mean of the journey."""
    rng = np.random.default_rng(seed)
    out = {}
    for k, driver in enumerate(study.DRIVERS):
        mean = 30.0 + 5.0 * k + 10.0 * rng.standard_normal(journeys)
        lost = mean[:, None] + 3.0 * rng.standard_normal((journeys, draws + 1))
        met = np.stack([np.full_like(lost, 80.0 - k), lost], -1)
        out[driver] = {"full": met[:, 0].tolist(), "fast": met[:, 1:].tolist()}
    return out


def test_sums_over_cities_find_what_cities_were_made_of() -> None:
    found = study.summary([made_up(seed) for seed in range(20)])
    assert (found["cities"], found["journeys"], found["draws"]) == (20, 600, 200)
    rows = {row["driver"]: row for row in found["drivers"]}
    assert rows["fastest"]["less_shortest"]["time_s"] == pytest.approx([-1.0, -1.0, -1.0])
    assert rows["shortest"]["less_shortest"]["cost_s"] == [0.0, 0.0, 0.0]
    for row in rows.values():
        _, low, high = row["fast_less_full"]["unusable_s"]
        assert low < 0.5  # 600 differences of 3 s: sigma 0.12 s
        assert high > -0.5
        assert row["cost_s"] == pytest.approx(row["time_s"] + 3.0 * row["unusable_s"])
    for one in found["spread"]:
        assert one["draws_s"] == pytest.approx(3.0, rel=0.02)
        assert one["residual_s"] == pytest.approx(3.0, rel=0.15)  # 600 squares: sigma of the root 2.9 %, five of them
        low, high = binom.ppf([5e-4, 1.0 - 5e-4], 600, 0.9) / 600.0  # fails by chance once in 1000 runs
        assert low - 0.01 < one["within"][0] < high + 0.01  # quantiles of 200 draws are within 1 % of their share
    tables = [table for table in study.shown(found) if not isinstance(table, str)]
    assert [len(rows) for _, (_, rows) in tables] == [len(study.DRIVERS), len(study.DRIVERS), 2]


def test_a_study_learns_drives_and_is_resumed(tmp_path: Path) -> None:
    config = study.JourneyDriversConfig(cities=1, journeys=2, draws=3, steps=256, train_cities=1)
    first = study.assess_journeys(config, tmp_path)
    rows = {row["driver"]: row for row in first["drivers"]}
    assert rows["integrity_aware"]["unusable_s"] <= rows["shortest"]["unusable_s"]
    assert rows["fastest"]["fast"]["time_s"] <= rows["integrity_aware"]["fast"]["time_s"]
    assert json.loads((tmp_path / "results.json").read_text())["journeys"] == 2
    model = (tmp_path / study.MODEL).stat().st_mtime_ns
    assert study.assess_journeys(config, tmp_path) == first
    assert (tmp_path / study.MODEL).stat().st_mtime_ns == model
    with pytest.raises(InputError):
        study.assess_journeys(config.replace(draws=4), tmp_path)


def test_equal_seeds_learn_equal_policies(tmp_path: Path) -> None:
    seen = VectorJourney(16, CONFIG).reset(seed=0)[0]
    actions = []
    for name in ("a.zip", "b.zip"):
        train_journeys(CONFIG, 256, 3, tmp_path / name)
        envs = VectorJourney(16, CONFIG)
        envs.reset(seed=0)
        actions.append(LearntJourney(tmp_path / name, envs).predict(seen)[0])
        assert envs.action_masks()[np.arange(16), actions[-1]].all()
    np.testing.assert_array_equal(*actions)


def test_commands_that_drive_cars_name_the_one_for_journeys() -> None:
    for refused in (full_id, make_config):
        with pytest.raises(InputError, match="driving world"):
            refused(JOURNEY_ID)
    for command in (["drive", "journey"], ["envs", "Journey"], ["play", JOURNEY_ID]):
        result = CliRunner().invoke(app, command)
        assert result.exit_code != 0
        assert "assess journeys" in str(result.exception) + result.output


def test_the_environment_of_stable_baselines_ends_and_begins_journeys() -> None:
    env = JourneyVecEnv(4, CONFIG)
    env.seed(5)
    first = env.reset()
    again = VectorJourney(4, CONFIG).reset(seed=[5, 6, 7, 8])[0]
    np.testing.assert_array_equal(first, again)
    returns, ended = np.zeros(4), 0
    for _ in range(60):
        masks = np.stack(env.env_method("action_masks"))
        _, rewards, over, infos = env.step(masks.argmax(1))
        returns += rewards
        for row in np.flatnonzero(over):
            assert infos[row]["episode"]["r"] == pytest.approx(returns[row], abs=1e-4)
            assert infos[row]["terminal_observation"].shape == first[row].shape
            returns[row], ended = 0.0, ended + 1
    assert ended > 0
    with pytest.raises(InputError, match="action_masks"):
        env.env_method("render")
    with pytest.raises(InputError, match="configuration"):
        env.set_attr("config", 1)
