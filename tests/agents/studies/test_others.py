"""The comparison of surrogates with receivers: its tests keep their false-alarm rate, and find what differs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.studies import others
from lanebound.agents.studies.others import OthersConfig, _Exchange, _ratio, assess_others, difference_rows
from lanebound.envs import recordings
from lanebound.envs.registration import make_config
from lanebound.integrity.core.errors import InputError


def _p_value(shift: float, seed: int) -> float:
    """Of shares in 2 x 30 episodes that differ among themselves."""
    rng = np.random.default_rng(seed)
    shares = np.clip(rng.normal(0.3, 0.1, 60) + np.repeat([0.0, shift], 30), 0.0, 1.0)
    sums = np.column_stack([100.0 * shares, np.full(60, 100.0)])
    return _ratio(sums, _Exchange(np.arange(60), 30, 199, rng))["p"]


def test_alike_kinds_differ_as_rarely_as_stated() -> None:
    alarms = sum(_p_value(0.0, seed) <= 0.05 for seed in range(200))
    assert alarms <= 22  # of 10 expected; more by chance once in 4,000 runs


def test_a_difference_of_two_sigma_of_an_episode_is_found() -> None:
    assert all(_p_value(0.2, seed) == 1.0 / 200.0 for seed in range(5))


def test_a_study_of_few_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (recordings, others):
        monkeypatch.setattr(module, "EPISODES", 8)
    monkeypatch.setattr(recordings, "cache_root", lambda: tmp_path)
    recordings._recordings.cache_clear()
    env = make_config("lanebound/CarFollowing-v0", {"sky": "open", "cities": {"count": 3}, "duration_s": 2.0})
    result = assess_others(OthersConfig(episodes=8, exchanges=99), env, tmp_path / "out")
    recordings._recordings.cache_clear()
    assert json.loads((tmp_path / "out" / "results.json").read_text())["tests"].keys() == {"same", "other"}
    rows = difference_rows(result)[1]
    assert len(rows) == 18
    assert all(0.0 < test["p"] <= 1.0 for kind in result["tests"].values() for test in kind.values())
    with pytest.raises(InputError, match=r"cities\.count must be 3 or more for a test by city, got 2"):
        assess_others(OthersConfig(), env.replace(cities={"count": 2}), tmp_path / "few")
