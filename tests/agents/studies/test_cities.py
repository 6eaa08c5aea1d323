"""Drivers in tuned cities and in others: figures of episodes, gaps and the table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes.opening import open_env
from lanebound.agents.studies.cities import (
    CITIES,
    ROADS,
    SECTIONS,
    GeneralisationConfig,
    assess_cities,
    kinds_of,
    tables,
)
from lanebound.integrity.core.errors import InputError

SHORT: dict[str, Any] = {"extent_m": 300.0, "duration_s": 3.0}
CONFIG = GeneralisationConfig.load({"envs": ["LaneKeeping"], "drivers": ["nominal"], "seeds": 3, "overrides": SHORT})


def driven(cities: str, number: int) -> tuple[float, float, float]:
    """Reward, cost and share of usable decisions of an episode of a single environment."""
    env, seed = open_env("lanebound/LaneKeeping-v0", CONFIG.changes(cities)), SPLITS["test"][0] + number
    agent, (observation, _), found = make_agent("nominal", env), env.reset(seed=seed), []
    over, state, start = False, None, True
    while not over:
        action, state = agent.predict(observation, state=state, episode_start=np.array([start]), deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        found.append((reward, info["cost"], info["available"]))
        over, start = terminated or truncated, False
    reward, cost, available = np.array(found, dtype=np.float64).T
    return float(reward.sum()), float(cost.sum()), float(available.mean())


def test_figures_are_those_of_single_episodes_in_the_same_cities(tmp_path: Path) -> None:
    found = assess_cities(CONFIG, tmp_path)
    part = found["envs"]["LaneKeeping"]["nominal"]
    assert tuple(part) == (*CITIES, ROADS)
    assert kinds_of("Merge") == tuple(CITIES)
    for cities, figures in part.items():
        for n in range(CONFIG.seeds):
            own = driven(cities, n)
            assert [figures[name][n] for name in ("reward", "cost", "available")] == pytest.approx(own, abs=1e-9)
    heads, rows = tables(found)[SECTIONS[0]]
    assert [row[2] for row in rows] == [*CITIES, ROADS]
    assert all(len(row) == len(heads) for row in rows)
    assert rows[0][5] == "", "the tuned cities have no gap to themselves"
    assert assess_cities(CONFIG, tmp_path)["envs"] == found["envs"]  # as kept


def test_a_clear_gap_is_bold_and_none_is_not() -> None:
    same = {"reward": [10.0] * 12, "cost": [1.0] * 12, "available": [0.8] * 12, "success": [1.0] * 12}
    worse = {**same, "reward": [5.0 + 0.1 * n for n in range(12)]}
    found = {"envs": {"Merge": {"ppo": {"tuned": same, "test": same, "varied": worse}}}}
    _, (tuned, test, varied) = tables(found)[SECTIONS[0]]
    assert tuned[:5] == ("Merge", "`ppo`", "tuned", "100", "10")
    assert test[5] == "+0"
    assert varied[5].startswith("**-4.5 (-4.7 to -4.2")
    assert varied[7] == "+0"


def test_an_unknown_driver_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nobody"):
        assess_cities(CONFIG.replace(drivers=("nobody",)), tmp_path)
    assert not any(tmp_path.iterdir())
