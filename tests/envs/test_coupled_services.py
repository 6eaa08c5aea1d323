"""Coupled services, a barometer and a limit of SDOP by configuration, in single environments and in the engine."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation import entries

BASE = {"base": "LaneKeepingWorld"}
LIMIT = {"positioning": {"mode": {"doppler_max_sdop": 2.0}}}
COUPLED = {"service": ["sbas_dfmc", "spp"], "gnss": {"bands": [0, 2]}, "barometer": {"fitted": True}, **LIMIT}


@pytest.mark.parametrize(
    ("change", "has"),
    [
        ({}, False),
        ({"navigator": LIMIT}, True),
        ({"navigator": {}, "observation": {"speed_geometry": True}}, False),
        ({"navigator": LIMIT, "observation": {"integrity": "blind"}}, False),
    ],
)
def test_sdop_has_an_entry_where_it_has_a_limit(change: dict, has: bool) -> None:
    config = EnvConfig.build(BASE, change)
    assert ("sdop" in [e.name for e in entries(config.observation)]) is has
    assert EnvConfig.from_json(config.to_json()) == config


@pytest.mark.parametrize("kind", ["loose", "tight"])
def test_a_single_environment_and_the_engine_show_the_same(kind: str) -> None:
    navigator = {**COUPLED, "services": {"coupling": kind}}
    settings = {"navigator": navigator, "duration_s": 4.0, "sky": "urban", "observation": {"form": "flat"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=settings)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=settings)
    seen, rows = env.reset(seed=1)[0], engine.reset(seed=1)[0]
    assert np.array_equal(seen, rows[0])
    for _ in range(10):  # the car leaves the road after 11 steps
        seen, rows = env.step(np.zeros(2, np.float32))[0], engine.step(np.zeros((2, 2), np.float32))[0]
        assert np.array_equal(seen, rows[0])
    shown = {e.name: float(v) * e.scale for e, v in zip(entries(env.unwrapped.config.observation), seen, strict=True)}
    assert 0.2 < shown["sdop"] <= 10.0
    assert shown["mode_sbas_dfmc"] + shown["mode_spp"] + shown["mode_doppler"] + shown["mode_imu_odometer"] == 1.0
    env.close()
    engine.close()
