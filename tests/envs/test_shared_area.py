"""Ego and neighbours drive in one area: the same atmosphere, station and network, instruments of their own."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401  registers the ids
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.navigators.navigator import Navigator


def _env(config: dict[str, Any], seed: int = 3) -> DrivingEnv:
    env = gymnasium.make("lanebound/CarFollowing-v0", config=config).unwrapped
    assert isinstance(env, DrivingEnv)
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize("warm_up_s", [1.0, 5.0])
def test_the_navigators_of_ego_and_others_have_the_same_area(warm_up_s: float) -> None:
    env = _env({"sky": "dense", "navigation": {"warm_up_s": warm_up_s}})
    for _ in range(10):
        env.step(np.zeros(2, np.float32))
    state = _navigator(env).state
    for name in ("memory", "message", "site"):
        ego, other = getattr(state.area.signals, name)
        np.testing.assert_array_equal(ego, other, err_msg=name)
    network = state.area.network
    for name in ("message", "until", "outage_left"):
        ego, other = network.areas[name]
        np.testing.assert_array_equal(ego, other, err_msg=name)
    assert not np.array_equal(*state.gnss.signals)
    assert state.gnss.vehicles["drift"][0] != state.gnss.vehicles["drift"][1]


def _navigator(env: DrivingEnv) -> Navigator:
    """Of the ego, and in its second row of the vehicle ahead."""
    assert env.belief_loop is not None
    navigation = env.belief_loop.episodes.navigation
    assert navigation is not None
    return navigation.navigator


def test_other_episodes_have_other_areas() -> None:
    stations = []
    for seed in (1, 2):
        stations.append(_navigator(_env({"sky": "open"}, seed)).state.area.signals.memory)
    assert not np.array_equal(*stations)
