"""Positioning services in environments: chosen by name, seen by the driver."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.config import EnvConfig
from lanebound.envs.observation import entries
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.modes import Mode

BASE = {"base": "LaneKeepingWorld"}
COARSE = {"start_sigma_m": 8.0}  # a car that is told its place to 5 cm needs no service for minutes


def _modes(config: EnvConfig) -> list[str]:
    return [e.name for e in entries(config.observation) if e.name.startswith("mode_")]


def test_an_observation_shows_the_services_of_the_navigator_and_no_others() -> None:
    usual = ["mode_none", "mode_rtk", "mode_doppler", "mode_imu_odometer", "mode_code"]
    assert _modes(EnvConfig.build(BASE, {})) == usual
    assert _modes(EnvConfig.build(BASE, {"navigator": {"service": "spp"}})) == [*usual, "mode_spp"]
    named = EnvConfig.build(BASE, {"navigator": "services/rtk_dfmc"})
    assert _modes(named) == [*usual, "mode_spp", "mode_sbas_dfmc"]
    assert _modes(named.replace(navigator={"service": ["dgps"]})) == [*usual, "mode_dgps"]
    assert EnvConfig.from_json(named.to_json()) == named


def test_a_service_that_does_not_exist_is_refused_where_it_is_named() -> None:
    with pytest.raises(ConfigError, match="service must be among rtk"):
        gymnasium.make("lanebound/LaneKeeping-v0", config={"navigator": {"service": "wifi"}}).reset(seed=1)


@pytest.mark.parametrize("service", ["spp", "sbas_dfmc"])
def test_a_car_drives_on_a_service_and_sees_it(service: str) -> None:
    env = gymnasium.make(
        "lanebound/LaneKeeping-v0", config={"navigator": f"services/{service}", "sky": "open", "navigation": COARSE}
    )
    observation, info = env.reset(seed=3)
    seen, modes = [], []
    place = [e.name for e in entries(env.unwrapped.config.observation) if e.group == "integrity"].index(
        f"mode_{service}"
    )
    for _ in range(10):
        seen.append(float(observation["integrity"][place]))
        modes.append(Mode(info["mode"]).key)
        observation, _, terminated, truncated, info = env.step(env.action_space.sample() * 0)
        if terminated or truncated:
            break
    assert seen == [float(mode == service) for mode in modes]
    assert np.mean(seen) > 0.8
    env.close()
