"""Ego and neighbours drive in one area: the same atmosphere, station and network, instruments of their own."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401  registers the ids
from lanebound.envs.core import DrivingEnv


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
    assert env.cockpit is not None
    ego, others = env.cockpit.around.navigator, env.cockpit.around.fleet.navigator
    assert ego is not None
    assert others is not None
    for name in ("memory", "message", "clock", "reference_enu_m"):
        one, two = (getattr(n.state.area.signals, name) for n in (ego, others))
        np.testing.assert_array_equal(one, two)
    one, two = ego.state.area.network, others.state.area.network
    assert (one.epoch, one.message.tolist()) == (two.epoch, two.message.tolist())
    np.testing.assert_array_equal(one.until, two.until)
    np.testing.assert_array_equal(one.outage_left, two.outage_left)
    assert not np.array_equal(ego.state.gnss.signals[0], others.state.gnss.signals[0])
    assert ego.state.gnss.vehicles["drift"][0] != others.state.gnss.vehicles["drift"][0]


def test_other_episodes_have_other_areas() -> None:
    stations = []
    for seed in (1, 2):
        cockpit = _env({"sky": "open"}, seed).cockpit
        assert cockpit is not None
        assert cockpit.around.navigator is not None
        stations.append(cockpit.around.navigator.state.area.signals.memory)
    assert not np.array_equal(*stations)
