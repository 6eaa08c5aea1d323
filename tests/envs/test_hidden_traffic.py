"""Vehicles that the sensor cannot see: behind others of a platoon and behind buildings; and senders that are wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.plans import EGO_LENGTH_M, CruiseConfig, nearest_ahead
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.perception import _walls
from lanebound.envs.batch.perception_kernel import behind_wall
from lanebound.envs.worlds.drivers import HARD_MPS2, LeadVehicle, follow_all, speed_profile
from lanebound.integrity.core.errors import ConfigError
from side_by_side import PERFECT, Pairs, Tally, drive, pair, require_equal
from vehicles import cars_at

FOLLOWING, CROSSING = "lanebound/CarFollowing-v0", "lanebound/Intersection-v0"
DT_S = 0.05
Array = NDArray[np.float64]


def hidden(ego: Any, other: Any, walls: Array) -> bool:
    return bool(behind_wall(cars_at([ego, other]), walls, 1))


@pytest.mark.parametrize(
    ("ego", "other", "expected"),
    [
        ((2.0, 40.0), (40.0, -2.0), True),  # on the next arm, far from the corner
        ((2.0, 40.0), (2.0, -40.0), False),  # straight on
        ((2.0, 8.5), (20.0, 2.0), False),  # at the crossing the view opens
        ((2.0, 20.0), (12.0, 2.0), True),
        ((6.9, 40.0), (6.9, -40.0), False),  # along a wall
        ((7.0, 40.0), (7.0, -40.0), False),  # on its face
        ((7.1, 40.0), (7.1, -40.0), True),
    ],
)
def test_corners_hide_what_lies_behind_them(ego: Any, other: Any, expected: bool) -> None:
    assert hidden(ego, other, _walls(7.0)) == hidden(other, ego, _walls(7.0)) == expected


@given(seed=st.integers(0, 10_000))
def test_a_building_hides_where_the_line_has_a_stretch_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = np.sort(rng.uniform(-20, 20, (1, 2, 2)), axis=-1).reshape(1, 4)
    ego, other = rng.uniform(-40, 40, (2, 2))
    t = np.linspace(0.0, 1.0, 20_001)[:, None]
    points = ego + t * (other - ego)
    margin = np.min(
        [points[:, 0] - wall[0, 0], wall[0, 1] - points[:, 0], points[:, 1] - wall[0, 2], wall[0, 3] - points[:, 1]],
        axis=0,
    ).max()
    if abs(margin) > 0.01:  # between samples of 6 mm at most
        assert hidden(ego, other, wall) == (margin > 0.0)


def test_without_corners_nothing_hides() -> None:
    assert _walls(None).shape == (0, 4)
    assert not hidden((0.0, 0.0), (30.0, 30.0), _walls(None))


def crossing(corner_m: float | None) -> list[int]:
    """How many vehicles the sensor perceives, by decision, before the car reaches the crossing."""
    sensor = {} if corner_m is None else {"corner_m": corner_m}
    config = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "sensor", "sensor": sensor}}
    env = DrivingEnv(make_config(CROSSING, config))
    env.reset(seed=4)
    found = []
    for _ in range(6):
        env.step(0)
        assert env.belief_loop is not None
        found.append(len(env.belief_loop.traffic.key))
    return found


def test_before_a_crossing_with_buildings_fewer_vehicles_are_seen() -> None:
    free, between = crossing(None), crossing(7.0)
    assert all(a >= b for a, b in zip(free, between, strict=True))
    assert sum(free) > sum(between)


def test_a_platoon_behind_a_steady_vehicle_stays_steady_and_brakes_later() -> None:
    steady = np.full(400, 10.0)
    gap = 2.0 + 3.0 + 7.0  # wider than wanted: it closes up
    rows = follow_all(steady, [gap, gap], DT_S)
    assert rows.shape == (3, 400)
    assert np.array_equal(rows[-1], steady)
    assert np.abs(np.diff(rows)).max() / DT_S <= HARD_MPS2
    braking = np.concatenate([np.full(400, 12.0), np.maximum(12.0 - 6.0 * DT_S * np.arange(200), 0.0)])
    rows = follow_all(braking, [14.0, 14.0], DT_S)
    begins = [int(np.argmax(row[400:] < row[399] - 1.0)) for row in rows[::-1]]
    assert begins[0] < begins[1] < begins[2]
    assert rows[:, -1] == pytest.approx(0.0, abs=0.5)


def test_no_platoon_runs_into_itself() -> None:
    way = lambda v: np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * DT_S])  # noqa: E731
    for seed in range(40):
        rng = np.random.default_rng(seed)
        first = speed_profile(rng, 120.0, DT_S)
        gaps = (2.0 + rng.uniform(0.8, 1.0, 3) * first[0]).tolist()
        rows = follow_all(first, gaps, DT_S)
        for gap, own, ahead in zip(gaps, rows, rows[1:], strict=False):
            assert (gap + way(ahead) - way(own)).min() > 1.0


def test_the_vehicles_of_a_platoon_drive_their_profiles() -> None:
    env = DrivingEnv(make_config(FOLLOWING, {**PERFECT, "sky": "open", "world": {"platoon": 3}}))
    env.reset(seed=1)
    leaders = [v for v in env.world.road.vehicles if isinstance(v, LeadVehicle)]
    assert len(leaders) == 3
    stations = [v.lane.local_coordinates(v.position)[0] for v in (env.world.vehicle, *leaders)]
    assert np.all(np.diff(stations) > LeadVehicle.LENGTH)
    for _ in range(10):
        env.step(np.zeros(2, np.float32))
    assert [v.speed for v in leaders] == pytest.approx([v.profile_mps[v.steps_driven] for v in leaders])


def test_one_vehicle_ahead_is_as_before() -> None:
    poses = []
    for world in ({}, {"platoon": 1}, {"platoon": 2}):
        env = DrivingEnv(make_config(FOLLOWING, {**PERFECT, "sky": "open", "world": world}))
        env.reset(seed=7)
        poses.append([tuple(v.position) for v in env.world.road.vehicles[:2]])
    assert poses[0] == poses[1] == poses[2]


@pytest.mark.parametrize(
    ("name", "config", "steps"),
    [
        ("CarFollowing", {**PERFECT, "world": {"platoon": 3}}, 40),
        ("CarFollowing", {**PERFECT, "perception": {"source": "sensor"}, "world": {"platoon": 3}}, 20),
        ("Intersection", {**PERFECT, "perception": {"source": "sensor", "sensor": {"corner_m": 7.0}}}, 15),
    ],
)
def test_the_engine_drives_them_as_the_single_environment(name: str, config: dict[str, Any], steps: int) -> None:
    single, engine = pair(name, config)
    tally = Tally()
    for seed in range(2):
        drive(single, engine, seed, tally, steps)
    require_equal(tally, parted=1 if name == "Intersection" else 0)  # whose drivers wait, and so crawl


def test_wrong_senders_are_the_same_in_the_engine() -> None:
    few = {
        "sky": "open",
        "cities": {"count": 1},
        "extent_m": 300.0,
        "perception": {"source": "both", "wrong_share": 0.7},
    }
    pairs = Pairs("CarFollowing", {**few, "world": {"platoon": 2}}, 2, 3)
    pairs.step(6)
    require_equal(pairs.tally)


def sighted(share: float) -> tuple[Array, Array, Array]:
    """Where the vehicles of a platoon are perceived, where they are, and their levels."""
    config: dict[str, Any] = {"sky": "open", "world": {"platoon": 3}, "perception": {"wrong_share": share}}
    env = DrivingEnv(make_config(FOLLOWING, config))
    env.reset(seed=3)
    for _ in range(5):
        env.step(np.zeros(2, np.float32))
    assert env.belief_loop is not None
    seen = env.belief_loop.traffic
    order = np.argsort(seen.key)
    truth = np.array([v.position for v in env.world.road.vehicles if isinstance(v, LeadVehicle)])
    return seen.position_m[order], truth, np.asarray(seen.pl_at_m)[order]


def test_a_wrong_sender_is_displaced_and_its_level_does_not_tell() -> None:
    honest, wrong = sighted(0.0), sighted(1.0)
    off = np.hypot(*(wrong[0] - wrong[1]).T)
    assert np.hypot(*(honest[0] - honest[1]).T).max() < 1.5
    assert np.all((off > 4.0) & (off < 21.5))
    assert wrong[2] == pytest.approx(honest[2])


@pytest.mark.parametrize(
    ("env_id", "config", "name"),
    [
        (FOLLOWING, {"world": {"platoon": 5}}, "world.platoon"),
        (FOLLOWING, {"perception": {"source": "sensor", "sensor": {"corner_m": 7.0}}}, "corner_m"),
        (CROSSING, {"perception": {"source": "v2v", "sensor": {"corner_m": 7.0}}}, "corner_m"),
        (CROSSING, {"perception": {"source": "both", "sensor": {"corner_m": 5.0}}}, "corner_m"),
        (CROSSING, {"perception": {"source": "truth", "wrong_share": 0.1}}, "wrong_share"),
        (CROSSING, {"perception": {"wrong_share": 0.1, "wrong_m": [9.0, 3.0]}}, "wrong_m"),
        (CROSSING, {"perception": {"wrong_share": 0.1}, "faults": "one"}, "wrong_share"),
    ],
)
def test_what_would_have_no_effect_is_refused(env_id: str, config: dict[str, Any], name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        DrivingEnv(make_config(env_id, config))


def test_of_several_leaders_the_one_that_leaves_the_least_safe_speed_counts() -> None:
    env = DrivingEnv(make_config(FOLLOWING, {**PERFECT, "sky": "open", "world": {"platoon": 3}}))
    observation, _ = env.reset(seed=1)
    reader = Reader(env.config.observation)
    changed = {group: part.copy() for group, part in observation.items()}
    place = {e.column: n for n, e in enumerate(e for e in env.observer.index if e.group == "traffic")}
    for row, (gap, closing) in enumerate(((20.0, 0.0), (30.0, -10.0), (60.0, 0.0))):
        for name, value, scale in (("lane_gap", gap, 150.0), ("ahead", gap, 150.0), ("velocity_ahead", closing, 40.0)):
            changed["traffic"][place[f"traffic.v{row}_{name}"]] = value / scale
    speed = float(reader.value(changed, "ego.speed"))
    one = nearest_ahead(reader, changed, c=CruiseConfig())
    several = nearest_ahead(reader, changed, c=CruiseConfig(leaders=3))
    assert (float(one[0]), float(one[1])) == pytest.approx((15.0, speed), abs=1e-3)
    between = EGO_LENGTH_M + CruiseConfig().standstill_m
    assert (float(several[0]), float(several[1])) == pytest.approx((25.0 - between, max(speed - 10.0, 0.0)), abs=1e-3)
