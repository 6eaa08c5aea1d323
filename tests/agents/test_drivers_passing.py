"""Passing by steering alone: nobody in the way changes nothing, somebody slower is gone round."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.nominal import Nominal, PassingSteering
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.agents.episodes import open_env

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}


@pytest.fixture(scope="module")
def env() -> Any:
    return open_env("Racetrack", GIVEN | {"observation": {"form": "flat"}, "duration_s": 40.0})


def seen(plan: Nominal, **values: float) -> np.ndarray:
    """A flat observation of a straight road at 10 m/s, but for quantities in their units, dots written as ``__``."""
    reader = plan.reader
    shown = {"ego__speed": 10.0, "ego__heading_cos": 1.0, "ego__lane_width": 5.0, "road__junction": 500.0}
    shown |= {"road__speed_limit": 10.0, "road__lane_end": 1e6}
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = np.clip(value / reader.scale(column), -1.0, 1.0)
    return out


def slower_ahead(**more: float) -> dict[str, float]:
    row = {"present": 1, "lane_gap": 20, "ahead": 20, "own_lane": 1, "velocity_ahead": -4, "length": 5, "width": 2}
    return {f"traffic__v0_{name}": float(value) for name, value in row.items()} | more


@pytest.fixture(scope="module")
def plan(env: Any) -> Nominal:
    return Nominal(env, CruiseConfig())


def test_only_a_car_that_cannot_slow_down_passes_by_steering(plan):
    assert isinstance(plan.steering, PassingSteering)
    other = open_env("LaneKeeping", GIVEN)
    assert isinstance(Nominal(other, CruiseConfig()).steering, LqrSteering)


@pytest.mark.parametrize("offset_m", [-2.0, 0.0, 0.3])
def test_on_a_free_lane_it_steers_as_the_regulator_does(plan, offset_m):
    alone = seen(plan, ego__left_exists=1.0, ego__lateral_offset=offset_m)
    assert plan.steering(alone) == plan.steering.law(alone)


def test_it_is_led_to_the_lane_there_is_and_nowhere_without_one(plan):
    left = seen(plan, ego__left_exists=1.0, **slower_ahead())
    right = seen(plan, ego__right_exists=1.0, **slower_ahead())
    assert plan.steering(left) < -0.02
    assert plan.steering(right) == pytest.approx(-plan.steering(left), abs=1e-6)
    neither = seen(plan, **slower_ahead())
    assert plan.steering(neither) == pytest.approx(0.0, abs=1e-6)


def test_the_way_to_another_line_is_no_steeper_than_that_of_its_largest_offset(plan):
    law, there = plan.steering.law, seen(plan)
    assert law(there, 5.0) == law(there, law.config.aside_m)
    assert law(there, 0.5) < law(there, 5.0)


def test_the_slower_car_on_the_track_is_passed(env):
    driver = make_agent("nominal", env)
    for seed in range(2000, 2006):
        observation, info = env.reset(seed=seed)
        ended = False
        while not ended:
            action, _ = driver.predict(observation)
            observation, _, terminated, truncated, info = env.step(action)
            ended = terminated or truncated
        assert info["is_success"], seed
        assert info["off_road"] is False
