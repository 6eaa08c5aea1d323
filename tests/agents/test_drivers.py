"""Drivers: they read observations by name, steer and brake as the formulas say, and bring their cars home."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from lanebound.agents.benchmark.scoring import outcome_of
from lanebound.agents.drivers import AGENTS, make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.learnt import policies
from lanebound.agents.drivers.plans import (
    CruiseConfig,
    following_acceleration,
    nearest_ahead,
    pursuit_steering,
    route_speed,
    safe_speed,
)
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.errors import InputError

CALM = CruiseConfig()
STEERERS = ("cbf", "lqr", "mpc", "stanley")
GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
LENGTH_M = 5.0


def observation(reader: Reader, **values: float) -> np.ndarray:
    """A flat observation of zeros but for quantities in their units, dots written as ``__``."""
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in values.items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


def opened(name: str, agent: str) -> Any:
    """An environment that shows what an agent needs."""
    return open_env(name, GIVEN | {"observation": {"integrity": "oracle" if agent == "oracle" else "full"}})


@pytest.fixture
def flat() -> Reader:
    return Reader(ObservationConfig(form="flat"))


@pytest.mark.parametrize("form", ["dict", "flat"])
@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("batch", [(), (4,)])
def test_reads_the_newest_of_what_is_stacked_in_its_unit(form, history, batch):
    config = ObservationConfig(form=form, history=history)
    reader, index = Reader(config), entries(config)
    frame = np.linspace(-1.0, 1.0, len(index), dtype=np.float32)
    stacked = np.stack([0.0 * frame] * (history - 1) + [frame])
    if form == "flat":
        shown: Any = np.broadcast_to(stacked.ravel(), (*batch, stacked.size))
    else:
        groups = {entry.group: [i for i, e in enumerate(index) if e.group == entry.group] for entry in index}
        shown = {g: np.broadcast_to(stacked[:, i].ravel(), (*batch, history * len(i))) for g, i in groups.items()}
    for i, entry in enumerate(index):
        value = reader.value(shown, entry.column)
        assert value.shape == batch
        assert value == pytest.approx(float(frame[i]) * entry.scale)


def test_a_missing_entry_is_refused_with_the_nearest(flat):
    with pytest.raises(InputError, match=r"'ego\.sped'.*did you mean 'ego\.speed'"):
        flat.require(["ego.sped"])


@pytest.mark.parametrize("radius_m", [15.0, 40.0, -25.0, 1e6])
@pytest.mark.parametrize("speed_mps", [0.0, 7.0, 14.0])
def test_steering_keeps_a_car_on_the_circle_that_it_is_on(flat, radius_m, speed_mps):
    """The middle of a car turns at ``sin(beta) = L / 2R`` to its heading, ``tan(delta) = 2 tan(beta)``."""
    beta = math.asin(0.5 * LENGTH_M / radius_m)
    points = {}
    for d in flat.previews_m[:3]:
        chord, bearing = 2.0 * radius_m * math.sin(0.5 * d / radius_m), 0.5 * d / radius_m + beta
        points |= {f"road__preview_{d:g}m_ahead": chord * math.cos(bearing)}
        points |= {f"road__preview_{d:g}m_right": chord * math.sin(bearing)}
    steering = pursuit_steering(flat, observation(flat, ego__speed=speed_mps, **points), CALM)
    assert steering == pytest.approx(math.atan(2.0 * math.tan(beta)), abs=1e-6)


def test_following_is_the_intelligent_driver_model():
    v, wanted, s = 10.0, 14.0, 60.0
    needed = CALM.standstill_m + v * CALM.time_gap_s
    expected = CALM.accelerate_mps2 * (1.0 - (v / wanted) ** 4 - (needed / s) ** 2)
    assert following_acceleration(*map(np.array, (v, wanted, s, v)), CALM) == pytest.approx(expected)
    assert following_acceleration(*map(np.array, (0.0, wanted, 1e6, 0.0)), CALM) == pytest.approx(CALM.accelerate_mps2)
    assert following_acceleration(*map(np.array, (wanted, wanted, 1e6, wanted)), CALM) == pytest.approx(0.0, abs=1e-6)
    assert following_acceleration(*map(np.array, (14.0, wanted, 5.0, 0.0)), CALM) == -CALM.brake_max_mps2


@pytest.mark.parametrize("gap_m", [2.0, 10.0, 50.0])
@pytest.mark.parametrize("lead_mps", [0.0, 8.0])
def test_from_the_safe_speed_a_car_stops_in_time(gap_m, lead_mps):
    v = float(safe_speed(np.array(gap_m), np.array(lead_mps), CALM))
    stopped = v * CALM.response_s + 0.5 * v * v / CALM.brake_max_mps2
    assert stopped == pytest.approx(gap_m - CALM.standstill_m + 0.5 * lead_mps**2 / CALM.lead_brake_mps2, abs=1e-9)


def test_speed_on_the_route_is_that_of_limit_and_bends(flat):
    free = observation(flat, road__speed_limit=12.0)
    assert route_speed(flat, free, CALM) == pytest.approx(12.0)
    assert route_speed(flat, observation(flat, road__speed_limit=40.0), CALM) == pytest.approx(CALM.speed_mps)
    bend = observation(flat, road__speed_limit=12.0, road__preview_20m_curvature=0.05)
    here = math.sqrt(CALM.lateral_mps2 / 0.05 + 2.0 * CALM.brake_mps2 * 20.0)
    assert route_speed(flat, bend, CALM) == pytest.approx(min(here, 12.0), rel=1e-6)
    sharp = observation(flat, road__speed_limit=12.0, road__preview_5m_curvature=0.1)
    assert route_speed(flat, sharp, CALM) == pytest.approx(math.sqrt(20.0 + 20.0), rel=1e-6)


def test_the_leader_is_the_nearest_ahead_in_the_own_lane(flat):
    rows = [(1.0, 1.0, -20.0, 3.0), (1.0, 0.0, 15.0, 3.0), (1.0, 1.0, 40.0, -2.0), (1.0, 1.0, 60.0, 1.0)]
    values = {"ego__speed": 10.0}
    for k, (present, own, gap, closing) in enumerate(rows):
        row = {"present": present, "own_lane": own, "lane_gap": gap, "velocity_ahead": closing, "length": LENGTH_M}
        values |= {f"traffic__v{k}_{name}": value for name, value in row.items()}
    gap, speed = nearest_ahead(flat, observation(flat, **values))
    assert (float(gap), float(speed)) == (pytest.approx(35.0, rel=1e-5), pytest.approx(8.0, rel=1e-5))
    gap, speed = nearest_ahead(flat, observation(flat, ego__speed=10.0))
    assert gap > 1e5
    assert speed == pytest.approx(10.0)


def test_agents_are_found_by_name_or_refused_with_the_nearest():
    env = opened("LaneKeeping", "oracle")
    assert all(hasattr(make_agent(name, env), "predict") for name in AGENTS)
    with pytest.raises(InputError, match="agent 'cruize' is unknown: did you mean 'cruise'"):
        make_agent("cruize", env)


def test_without_a_preview_there_is_nothing_to_steer_by():
    with pytest.raises(InputError, match=r"observation\.preview_m must name a distance"):
        make_agent("cruise", open_env("LaneKeeping", GIVEN | {"observation": {"preview_m": []}}))


@pytest.mark.parametrize("name", ["LaneKeeping", "UrbanCanyon", "Racetrack", "Intersection"])
@pytest.mark.parametrize("agent", sorted(AGENTS))
def test_actions_lie_in_the_space_for_one_observation_and_for_a_batch(name, agent):
    env = opened(name, agent)
    lateral_only = isinstance(env.action_space, spaces.Box) and env.action_space.shape == (1,)
    if agent == "ppo" and env.config.base not in policies():
        with pytest.raises(InputError, match="learn a policy there"):
            make_agent(agent, env)
        return
    needs_throttle = agent in ("cbf", "mpc")
    if agent in STEERERS and (not isinstance(env.action_space, spaces.Box) or (needs_throttle and lateral_only)):
        with pytest.raises(InputError, match="action must be continuous"):
            make_agent(agent, env)
        return
    if (agent in ("bank", "constant") and lateral_only) or (agent == "weave" and name == "Intersection"):
        with pytest.raises(InputError, match=r"action must (be one that commands speed|steer or change)"):
            make_agent(agent, env)
        return
    driver = make_agent(agent, env)
    env.observation_space.seed(1)
    seen = [env.observation_space.sample() for _ in range(3)]
    batch = {group: np.stack([one[group] for one in seen]) for group in seen[0]}
    singles = [driver.predict(one)[0] for one in seen]
    together, state = driver.predict(batch, state=None, episode_start=np.ones(3, dtype=np.bool_), deterministic=True)
    assert state is None or agent == "bank"
    for action in (*singles, *together):
        assert env.action_space.contains(action if isinstance(env.action_space, spaces.Box) else np.int64(action))
    if agent != "random":
        assert np.array_equal(np.stack(singles), together)


def test_random_actions_repeat_with_their_seed():
    env = open_env("LaneKeeping", GIVEN)
    seen = env.observation_space.sample()
    first, second = (make_agent("random", env) for _ in range(2))
    assert all(np.array_equal(first.predict(seen)[0], second.predict(seen)[0]) for _ in range(3))


def test_cruise_does_the_same_without_the_integrity_group():
    full, blind = (open_env("LaneKeeping", GIVEN | {"observation": {"integrity": kind}}) for kind in ("full", "blind"))
    actions = [make_agent("cruise", env).predict(env.reset(seed=2)[0])[0] for env in (full, blind)]
    assert np.array_equal(*actions)


@pytest.mark.parametrize(
    ("name", "seconds"), [("LaneKeeping", 30.0), ("CarFollowing", 60.0), ("UrbanCanyon", 20.0)]
)  # fmt: skip
def test_cruise_drives_well_when_it_knows_where_it_is(name, seconds):
    env = open_env(name, GIVEN | {"world": {"duration": seconds}})
    log = EpisodeLog()
    drive(env, make_agent("cruise", env), [3], [log])
    summary = outcome_of(log.episode(0), 0.0)
    assert (summary.ended, summary.success) == ("time up", True)
    assert summary.costs["cost_lane"] == 0.0
    assert summary.cost < 0.2


def test_stable_baselines3_takes_a_driver_for_a_policy():
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    config = GIVEN | {"world": {"duration": 2.0}}
    envs = DummyVecEnv([lambda: Monitor(open_env("LaneKeeping", config)) for _ in range(2)])
    reward, _ = evaluate_policy(make_agent("cruise", open_env("LaneKeeping", config)), envs, n_eval_episodes=2)
    assert reward > 1.0
