"""The other drivers' lines in their lanes: their spread, correlation and limits, and where they begin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M, WANDER_SLOPE
from lanebound.envs.worlds.wander import Wander, WanderConfig

GIVEN: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
NONE = {"offset_sigma_m": 0.0, "wander_sigma_m": 0.0}


def made(name: str, **config: Any) -> DrivingEnv:
    return DrivingEnv(make_config(f"lanebound/{name}-v0", {**GIVEN, **config}))


def test_spread_and_correlation_are_those_declared() -> None:
    config = WanderConfig(offset_sigma_m=0.1, wander_sigma_m=0.2, correlation_s=4.0)
    weights = config.weights(np.random.default_rng(1), 20_000)
    lines = weights @ config.shapes(0, 81, 0.1).T  # (drivers, 8 s)
    assert lines.std(0) == pytest.approx(np.hypot(0.1, 0.2), rel=0.03)
    wander = lines - 0.1 * weights[:, :1]
    correlation = (wander * wander[:, :1]).mean(0) / np.square(wander).mean()
    share = (np.arange(3) + 0.5) / 3
    assert correlation == pytest.approx(
        np.cos(np.outer(0.1 * np.arange(81), np.tan(0.5 * np.pi * share) / 4.0)).mean(1), abs=0.04
    )
    assert 0.15 < correlation[40] < 0.55  # exp(-1) at the correlation time of a Gauss-Markov process
    later = weights @ config.shapes(50, 1, 0.1).T
    np.testing.assert_array_equal(later[:, 0], weights @ config.shapes(50, 1, 0.1)[0])
    assert lines[:, 50] == pytest.approx(later[:, 0], abs=1e-12)


@pytest.mark.parametrize("name", ["CarFollowing", "Highway", "UrbanCanyon", "Merge", "Roundabout", "Racetrack"])
def test_others_start_on_their_lines_and_zero_leaves_them_in_the_middle(name: str) -> None:
    aside = {}
    for kind, wander in (("default", {}), ("none", NONE)):
        env = made(name, wander=wander)
        env.reset(seed=3)
        others = [v for v in env.world.road.vehicles if v is not env.world.vehicle]
        aside[kind] = np.array([v.lane.local_coordinates(v.position)[1] for v in others])
    plain = np.abs(aside["none"])
    assert np.median(plain) < 1e-6
    moved = aside["default"] - aside["none"]
    assert (np.abs(moved) <= WANDER_MOST_M + 1e-6).all()
    assert np.abs(moved).max() > 0.02
    assert len(set(moved.round(9))) == moved.size, "each driver has a line of its own"


def test_lines_move_with_the_car_within_their_slope_and_stay_when_it_stands() -> None:
    env = made("CarFollowing", action="continuous", wander={"wander_sigma_m": 0.5, "correlation_s": 1.0})
    env.reset(seed=5)
    lead = env.world.lead
    line = lead.act.args[0]
    before, ways = line.aside_m, []
    for _ in range(30):
        place, start = lead.position.copy(), line.aside_m
        env.step(np.zeros(2, dtype=np.float32))
        ways.append((abs(line.aside_m - start), float(np.hypot(*(lead.position - place)))))
    assert all(aside <= WANDER_SLOPE * way + 0.02 for aside, way in ways)
    assert abs(line.aside_m - before) > 0.01
    lead.profile_mps[:], lead.speed = 0.0, 0.0
    stays = line.aside_m
    env.step(np.zeros(2, dtype=np.float32))
    assert line.aside_m == stays


def test_a_driver_stays_near_its_line() -> None:
    env = made("Highway", world={"vehicles_count": 12}, duration_s=20.0)
    env.reset(seed=2)
    off = []
    for _ in range(20):
        env.step(1)
        for v in env.world.road.vehicles[1:]:
            if v.lane_index == v.target_lane_index and not v.crashed:
                off.append(v.lane.local_coordinates(v.position)[1] - v.act.args[0].aside_m)
    assert np.quantile(np.abs(off), 0.9) < 0.15


def test_drivers_do_not_move_each_others_draws() -> None:
    config = WanderConfig()
    few, many = (config.weights(config.generator(7), n) for n in (3, 9))
    np.testing.assert_array_equal(many[:3], few)
    one_by_one = Wander(config, 7, 0.05)
    rows = [config.weights(one_by_one._generator, 1)[0] for _ in range(9)]
    np.testing.assert_array_equal(rows, many)
