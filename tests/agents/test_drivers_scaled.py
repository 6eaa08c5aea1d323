"""The driver whose control follows the size of levels, and its twin by a clock."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.agents.drivers.scaled import ClockScaled, ClockScaledConfig, LevelScaled, ScaledConfig
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.studies.decisions import DecisionsConfig
from lanebound.agents.studies.limits import first_episodes

LIMIT_MPS, WIDTH_M = 50.0 / 3.6, 3.25
FLAT: dict[str, Any] = {"observation": {"form": "flat"}}
GIVEN = FLAT | {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
DRIVEN = [name for name in DecisionsConfig().envs if name != "Tolling"]  # where it decides on charges alone


@pytest.fixture(scope="module")
def env() -> Any:
    with closing(open_env("CarFollowing", GIVEN)) as made:
        yield made


def shown(reader: Reader, **values: float) -> np.ndarray[Any, Any]:
    """A calm moment in the middle of a straight lane with levels of a millimetre; dots are written as ``__``."""
    calm = {"ego__speed": 10.0, "ego__lane_width": WIDTH_M, "ego__heading_cos": 1.0, "road__speed_limit": LIMIT_MPS}
    calm |= {"road__lane_end": 150.0, "road__junction": 150.0, "integrity__pl_at": 1e-3, "integrity__pl_ct": 1e-3}
    calm |= {"integrity__al_at": 1.5, "integrity__al_ct": 0.625}
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in (calm | values).items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


def test_speed_falls_as_the_level_across_grows(env: Any) -> None:
    """In the middle of a straight lane of 3.25 m a car of 2 m has 0.525 m less 0.1 m of tracking to each side."""
    driver = LevelScaled(env, ScaledConfig(fill=0.8))
    levels = np.array([0.1, 0.42, 0.6, 1.0, 2.0, 5.0, 10.0])
    speeds = np.array([driver.wanted_speed(shown(driver.reader, integrity__pl_ct=pl)) for pl in levels])
    room = 0.5 * (WIDTH_M - 2.0) - env.config.budget.tracking_m
    assert_allclose(speeds, LIMIT_MPS * np.minimum(0.8 * room / levels, 1.0), rtol=1e-4)
    assert (np.diff(speeds)[1:] < 0.0).all()


def test_room_is_less_aside_askew_and_in_bends(env: Any) -> None:
    driver = LevelScaled(env, ScaledConfig(fill=1.0))
    wide = {"integrity__pl_ct": 2.0}
    middle = driver.wanted_speed(shown(driver.reader, **wide))
    askew = {"ego__heading_sin": 0.02, "ego__heading_cos": np.sqrt(1.0 - 0.02**2)}
    bend = {f"road__preview_{d:g}m_curvature": 0.02 for d in driver.reader.previews_m}
    for less in ({"ego__lateral_offset": 0.2}, askew, bend):
        assert driver.wanted_speed(shown(driver.reader, **wide, **less)) < middle - 0.1
    outwards = driver.wanted_speed(shown(driver.reader, **wide, **askew, ego__lateral_offset=0.15))
    assert outwards < driver.wanted_speed(shown(driver.reader, **wide, **askew, ego__lateral_offset=-0.15))
    along = [driver.wanted_speed(shown(driver.reader, **wide, **bend, integrity__pl_at=pl)) for pl in (0.1, 0.5, 1.0)]
    assert along[0] > along[1] > along[2]
    v, sine = float(outwards), 0.02
    body = 0.5 * (2.0 * np.cos(np.arcsin(sine)) + 5.0 * sine)
    room = 0.5 * WIDTH_M - 0.15 - body - v * env.dt_s * sine
    assert v * 2.0 == pytest.approx(LIMIT_MPS * room, rel=1e-3), "what the level sweeps fills the room at that speed"


def test_under_an_alert_a_level_counts_as_its_limit_at_least(env: Any) -> None:
    driver = LevelScaled(env, ScaledConfig(fill=1.0))
    limit = driver.wanted_speed(shown(driver.reader, integrity__pl_ct=0.625))
    assert driver.wanted_speed(shown(driver.reader, integrity__pl_ct=0.1, integrity__alert=1.0)) == pytest.approx(limit)
    assert driver.wanted_speed(shown(driver.reader, integrity__pl_ct=0.1)) > limit + 1.0


def test_gaps_are_less_the_levels_of_both(env: Any) -> None:
    driver = LevelScaled(env, ScaledConfig(fill=1.0))
    ahead = {"present": 1.0, "own_lane": 1.0, "lane_gap": 25.0, "length": 5.0, "pl_exists": 1.0}
    ahead = {f"traffic__v0_{name}": value for name, value in ahead.items()}
    seen = [shown(driver.reader, **ahead, traffic__v0_pl_at=pl) for pl in (0.0, 1.0, 3.0, 8.0)]
    assert_allclose([driver.lead(one)[0] for one in seen], [20.0, 19.0, 17.0, 12.0], rtol=1e-5)
    speeds = [driver.top_speed(one) for one in seen]
    assert speeds == sorted(speeds, reverse=True)


def test_a_position_whose_level_exceeds_the_room_steers_less(env: Any) -> None:
    driver, plain = LevelScaled(env, ScaledConfig(fill=1.0)), Nominal(env, CruiseConfig())
    aside = {"ego__lateral_offset": 0.4}
    room = 0.5 * (WIDTH_M - 2.0) - env.config.budget.tracking_m
    full = plain.steering(shown(driver.reader, **aside))
    assert full < 0.0
    for level in (room, 2.0 * room, 10.0 * room):
        steered = driver.steering(shown(driver.reader, **aside, integrity__pl_ct=level))
        assert steered == pytest.approx(full * room / level, rel=1e-3)
    askew = {"ego__heading_sin": 0.05, "integrity__pl_ct": 5.0}
    assert driver.steering(shown(driver.reader, **askew)) == plain.steering(shown(driver.reader, **askew))


def test_no_lane_is_changed_while_the_level_reaches_the_next_one() -> None:
    with closing(open_env("UrbanCanyon", GIVEN)) as street:
        driver = LevelScaled(street, ScaledConfig(fill=1.0))
    slow = {"present": 1.0, "own_lane": 1.0, "lane_gap": 25.0, "length": 5.0, "velocity_ahead": -7.0}
    slow = {f"traffic__v0_{name}": value for name, value in slow.items()} | {"ego__left_exists": 1.0}
    assert driver.change(shown(driver.reader, **slow)) == -1
    assert driver.change(shown(driver.reader, **slow, integrity__pl_ct=0.4 * WIDTH_M)) == -1
    assert driver.change(shown(driver.reader, **slow, integrity__pl_ct=0.6 * WIDTH_M)) == 0


def test_beside_another_road_the_speed_falls_to_its_limit() -> None:
    with closing(open_env("Guidance", GIVEN)) as road:
        driver = LevelScaled(road, ScaledConfig(fill=1.0))
    beside = {"road__speed_limit": 27.8, "road__other_limit": 13.9, "road__other_road": 12.0}
    levels = (2.0, 12.0, 16.0, 23.9, 30.0)
    speeds = [driver.wanted_speed(shown(driver.reader, **beside, integrity__pl_ct=pl)) for pl in levels]
    assert_allclose(speeds, [27.8, 27.8, 27.8 * 12.0 / 16.0, 27.8 * 12.0 / 23.9, 13.9], rtol=1e-4)


@pytest.mark.parametrize("name", ["LaneKeeping", "CarFollowing", "UrbanCanyon", "WorkZone", "Guidance"])
def test_at_tiny_levels_it_drives_as_nominal_does(name: str) -> None:
    """Where no gap is short: RSS is a rule of its own."""
    with closing(open_env(name, GIVEN)) as made:
        scaled, nominal = LevelScaled(made, ScaledConfig(fill=1.0)), Nominal(made, CruiseConfig())
        seen, _ = made.reset(seed=1004)
        for column in scaled.reader.columns:
            if "_pl_" in column or column.startswith(("integrity.pl_", "integrity.alert")):
                seen[scaled.reader.columns.index(column)] = 1e-4 if column[-2:] in ("at", "ct") else 0.0
        assert scaled.free_speed(seen) == nominal.free_speed(seen)
        assert scaled.change(seen) == nominal.change(seen)
        if scaled.reader.previews_m and hasattr(made.action_space, "shape") and made.action_space.shape:
            assert scaled.steering(seen) == pytest.approx(nominal.steering(seen))


def test_the_twin_differs_by_the_level_alone(env: Any) -> None:
    """Where the clock's level is that of the navigator both do the same, and the clock reads no other one."""
    figures: dict[str, Any] = {"age_s": [0.0, 10.0], "pl_at_m": [0.0, 4.0], "pl_ct_m": [0.0, 2.0]}
    twin = ClockScaled(env, ClockScaledConfig.load(figures | {"fill": 1.0}))
    driver = LevelScaled(env, ScaledConfig(fill=1.0))
    lead = {"present": 1.0, "own_lane": 1.0, "lane_gap": 30.0, "length": 5.0, "pl_exists": 1.0}
    lead = {f"traffic__v0_{name}": value for name, value in lead.items()} | {"ego__lateral_offset": 0.2}
    for age in (1.0, 3.0, 7.0):
        levels = {"integrity__pl_at": 0.4 * age, "integrity__pl_ct": 0.2 * age, "integrity__since_rtk": age}
        levels |= {"traffic__v0_pl_at": 0.4 * age, "traffic__v0_pl_ct": 0.2 * age}
        levels["integrity__alert"] = float(0.4 * age > 1.5 or 0.2 * age > 0.625)
        seen = shown(driver.reader, **lead, **levels)
        other = shown(driver.reader, **lead, integrity__since_rtk=age, integrity__alert=1.0, integrity__pl_ct=9.0)
        for of in ("acceleration", "steering", "top_speed"):
            expected = getattr(driver, of)(seen)
            assert getattr(twin, of)(seen) == pytest.approx(expected, rel=1e-4), of
            assert getattr(twin, of)(other) == pytest.approx(expected, rel=1e-4), of


@pytest.mark.parametrize("agent", ["level_scaled", "clock_scaled"])
@pytest.mark.parametrize("env_id", DRIVEN)
def test_it_drives_every_id_in_the_engine_as_one_by_one(env_id: str, agent: str) -> None:
    steps = first_episodes(env_id, FLAT, agent, 2, 1000)
    with closing(open_env(full_id(env_id), FLAT)) as single:
        driver = make_agent(agent, single)
        seen, _ = single.reset(seed=1000)
        for _ in range(4):
            step = next(steps)
            seen, _, terminated, truncated, info = single.step(driver.predict(seen)[0])
            for name in ("speed_mps", "err_ct_m", "cost"):
                assert info[name] == pytest.approx(step.infos[name][0], rel=1e-9), name
            if terminated or truncated:
                break
    steps.close()
