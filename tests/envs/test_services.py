"""Positioning services in environments: chosen by name, seen by the driver."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.batch.navigation import place_all
from lanebound.envs.config import EnvConfig
from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.observation import entries
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode

BASE = {"base": "LaneKeepingWorld"}


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


@pytest.mark.parametrize("service", ["spp", "dgps", "sbas_l1", "sbas_dfmc", "ppp"])
def test_a_car_drives_on_a_service_and_sees_it(service: str) -> None:
    """By default: nothing tells the car its place so well that dead reckoning is better than its service."""
    env = gymnasium.make("lanebound/LaneKeeping-v0", config={"navigator": f"services/{service}", "sky": "open"})
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


def test_the_place_that_a_car_is_told_is_as_good_as_its_navigator() -> None:
    rtk, spp, both = (NavigatorConfig.preset(f"services/{name}") for name in ("nrtk", "spp", "rtk_dfmc"))
    assert (NavigatorConfig().told_sigma_m, rtk.told_sigma_m, both.told_sigma_m) == (0.05, 0.05, 0.05)
    assert NavigatorConfig.load({"kind": "filter"}).told_sigma_m == 0.05
    assert spp.told_sigma_m == 10.0
    for given, sigma in ((None, 10.0), (0.3, 0.3)):
        navigator = Navigator.nominal(spp, seeds=[1], duration_s=5.0)
        place_all(navigator, NavigationConfig(start_sigma_m=given), np.zeros((1, 2)), np.zeros(1), np.ones((1, 3)))
        assert navigator.state.belief.growth["p_ee"][0, 0] == pytest.approx(sigma**2)
        np.testing.assert_allclose(np.abs(navigator.state.belief.vehicles["position"][0, :2]), sigma)
