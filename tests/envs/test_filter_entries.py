"""What a filter reports is observed where the navigator is a filter, and nowhere else."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation import entries

VECTORS = ["nis_position", "nis_wheels", "nis_gyro", "nis_steering", "nis_slip", "nis_compass"]
NAMES = ["model_curved", *VECTORS, "trust"]
BASE = {"base": "LaneKeepingWorld"}


@pytest.mark.parametrize(
    ("change", "has"),
    [
        ({}, False),
        ({"navigator": "filter"}, True),
        ({"navigator": "ekf_straight"}, True),
        ({"navigator": {"kind": "rtk_reckoning"}, "observation": {"filters": True}}, False),
        ({"navigator": {"kind": "filter"}, "observation": {"integrity": "blind"}}, False),
    ],
)
def test_entries_follow_the_kind_of_the_navigator(change: dict, has: bool) -> None:
    config = EnvConfig.build(BASE, change)
    assert [e.name for e in entries(config.observation) if e.name in NAMES] == (NAMES if has else [])
    assert EnvConfig.from_json(config.to_json()) == config


def test_a_single_environment_and_the_engine_show_the_same() -> None:
    """Flat observations are equal to the last bit, and the entries are those of the solution."""
    settings = {"navigator": "imm_differential", "duration_s": 3.0, "sky": "open", "observation": {"form": "flat"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=settings)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=settings)
    seen, rows = env.reset(seed=1)[0], engine.reset(seed=1)[0]
    assert np.array_equal(seen, rows[0])
    for _ in range(8):
        seen, rows = env.step(np.zeros(2, np.float32))[0], engine.step(np.zeros((2, 2), np.float32))[0]
        assert np.array_equal(seen, rows[0])
    index = entries(env.unwrapped.config.observation)
    shown = {e.name: float(v) * e.scale for e, v in zip(index, seen, strict=True) if e.name in NAMES}
    assert 0.0 < shown["model_curved"] < 1.0
    assert 0.0 < shown["nis_position"] < 20.0
    assert 0.0 < shown["nis_wheels"] < 20.0
    assert 0.0 < shown["nis_gyro"] < 20.0
    assert 0.0 <= shown["nis_slip"] < 20.0
    assert shown["nis_steering"] == shown["nis_compass"] == 0.0  # neither is fitted
    assert 0.1 < shown["trust"] < 10.0
    env.close()
    engine.close()


def test_all_six_vectors_of_s4s_sensors_are_observed() -> None:
    settings = {"navigator": "imm_s4", "duration_s": 3.0, "sky": "open", "observation": {"form": "flat"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=settings)
    seen = env.reset(seed=1)[0]
    for _ in range(8):
        seen = env.step(np.zeros(2, np.float32))[0]
    index = entries(env.unwrapped.config.observation)
    shown = {e.name: float(v) for e, v in zip(index, seen, strict=True) if e.name in VECTORS}
    assert len(shown) == 6
    assert all(0.0 < value < 1.0 for value in shown.values()), shown
    env.close()
