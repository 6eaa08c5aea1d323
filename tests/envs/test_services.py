"""Positioning services in environments: chosen by name, seen by the driver."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.batch.navigation import place_all
from lanebound.envs.config import EnvConfig
from lanebound.envs.manual import markdown
from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.observation import entries
from lanebound.envs.vector.env import VectorDrivingEnv
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


def test_a_policy_sees_the_same_entries_with_each_of_several_services() -> None:
    given = {"observation": {"services": ["ppp", "spp", "rtk"]}}
    of = {name: EnvConfig.build(BASE, {**given, "navigator": {"service": name}}) for name in ("rtk", "spp", "ppp")}
    expected = [*_modes(EnvConfig.build(BASE, {})), "mode_spp", "mode_ppp"]  # by code, not as given
    assert [_modes(config) for config in of.values()] == [expected] * 3
    other = of["spp"].replace(navigator={"service": "dgps"})
    assert _modes(other) == [*expected[:-1], "mode_dgps", "mode_ppp"]
    assert _modes(other.replace(navigator={"service": "rtk"})) == expected, "what was given remains, no more"
    for config in (*of.values(), other):
        assert EnvConfig.from_json(config.to_json()) == config
    assert _modes(EnvConfig.build(BASE, {"observation": {"services": "spp"}})) == expected[:-1]


def test_a_single_environment_and_the_engine_show_given_services_alike() -> None:
    config = {"sky": "open", "navigator": {"service": "spp"}, "observation": {"services": ["ppp", "dgps"]}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=config)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=1, config=config)
    assert isinstance(engine.unwrapped, VectorDrivingEnv)
    names = [e.name for e in entries(env.unwrapped.config.observation) if e.group == "integrity"]
    places = [names.index(f"mode_{key}") for key in ("spp", "dgps", "ppp")]
    assert places == sorted(places)
    seen, many = env.reset(seed=4), engine.reset(seed=4)
    for _ in range(3):
        assert seen[-1]["mode"] == Mode.SPP
        np.testing.assert_array_equal(seen[0]["integrity"][places], [1.0, 0.0, 0.0])
        np.testing.assert_array_equal(many[0]["integrity"][0, places], [1.0, 0.0, 0.0])
        assert many[0]["integrity"].shape == (1, len(names))
        seen, many = env.step(np.zeros(2, np.float32)), engine.step(np.zeros((1, 2), np.float32))
    env.close()
    engine.close()


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({"services": ["spq"]}, r"observation\.services must be among spp, dgps, .*, got 'spq': did you mean 'spp'\?"),
        ({"services": ["wifi"]}, r"observation\.services must be among spp, dgps, .*, got 'wifi': import the module"),
        ({"services": [3]}, r"observation\.services\.0 must be text, got 3"),
        ({"navigator_services": ["spp"]}, r"observation\.navigator_services must be left to navigator\.service, got"),
    ],
)
def test_services_of_an_observation_that_cannot_be_are_refused(observation: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{message}"):
        EnvConfig.build(BASE, {"observation": observation})


def test_a_service_of_a_module_is_observed_by_its_bare_name() -> None:
    config = EnvConfig.build(BASE, {"observation": {"services": ["galileo:galileo"]}})
    assert _modes(config)[-1] == "mode_galileo"
    assert EnvConfig.from_json(config.to_json()) == config


def test_the_page_tells_the_codes_of_all_modes() -> None:
    page = " ".join(markdown().split())
    for mode in Mode:
        assert f" {int(mode)} {mode.label}" in page


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
        assert navigator.state.belief.vehicles["growth"]["p_ee"][0, 0] == pytest.approx(sigma**2)
        np.testing.assert_allclose(np.abs(navigator.state.belief.vehicles["position"][0, :2]), sigma)
