"""With perfect navigation the engine is the single environment: poses to 1e-9, no other decision, end or number.

This holds up to the step in which rounding parts the two; :mod:`side_by_side` says where that may be.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from parted import COMPARISONS, CROWDED, DENSE, LAPS, Comparison

from side_by_side import PERFECT, Tally, drive, pair, require_equal

CASES: list[tuple[str, dict[str, Any], int]] = [
    ("Highway", DENSE, 12),
    ("Highway", {**DENSE, "action": "continuous"}, 6),
    ("CarFollowing", PERFECT, 30),
    ("CarFollowing", {**PERFECT, "action": "meta"}, 12),
    ("LaneKeeping", {**PERFECT, "world": {"lanes_count": 2}}, 30),
    ("LaneKeeping", {**PERFECT, "action": "meta", "world": {"lanes_count": 2}}, 12),
    ("UrbanCanyon", PERFECT, 30),
    ("UrbanCanyon", {**PERFECT, "action": "continuous", "world": {"vehicles_count": 5}}, 15),
    ("WorkZone", PERFECT, 40),
    ("Platoon", PERFECT, 40),
    ("Platoon", {**PERFECT, "action": "meta"}, 20),
    ("Racetrack", {**LAPS, "action_options": {"longitudinal": True}}, 40),
    ("Merge", PERFECT, 30),
    ("Merge", {**PERFECT, "action": "continuous"}, 12),
    ("Roundabout", PERFECT, 30),
    ("Roundabout", {**PERFECT, "action": "continuous"}, 12),
    ("Intersection", PERFECT, 30),
    ("Intersection", {**PERFECT, "action": "continuous", "action_options": {"dynamical": False}}, 12),
]
OTHERS: list[tuple[str, dict[str, Any]]] = [
    ("Highway", {"observation": {"integrity": "oracle"}}),
    ("Highway", {"observation": {"integrity": "blind"}, "keep_lane": False, "perception": {"source": "none"}}),
    ("Highway", {"action_options": {"lateral": False}, "cost": {"response_s": 1.0}, "reward": {"base": 0.5}}),
    ("Highway", {"action": "continuous", "action_options": {"lateral": False}, "actuators": None}),
    ("Highway", {"simulation_hz": 15, "policy_hz": 1, "navigation": {"rate_hz": 5.0}, "duration_s": 6.0}),
    ("Highway", {"simulation_hz": 4, "policy_hz": 1, "navigation": {"rate_hz": 4.0}, "duration_s": 12.0}),
    ("LaneKeeping", {"navigation": {"source": "offset", "offset_at_m": 0.7, "offset_ct_m": -0.4}}),
    ("LaneKeeping", {"off_road_ends": False, "wrong_way_s": 0.5, "actuators": {"steering_rate_radps": None}}),
    ("Racetrack", {"base": "racetrack-large-v1", "action_options": {"longitudinal": True}}),
    ("Merge", {"base": "merge-v0", "actuators": {}, "reward": {"base": 0.5}}),
    ("Merge", {"duration_s": 2.3}),
    ("Roundabout", {"navigation": {"source": "offset", "offset_ct_m": 0.9}, "observation": {"integrity": "oracle"}}),
    ("Roundabout", {"world": {"incoming_vehicle_destination": 2, "normalize_reward": False}, "actuators": None}),
    ("Intersection", {"base": "intersection-v0", "world": {"normalize_reward": True}, "off_road_ends": True}),
]


def _named(value: Any) -> str:
    return value if isinstance(value, str) else value.get("action", "") if isinstance(value, dict) else ""


@pytest.mark.parametrize(("name", "config", "steps"), CASES, ids=_named)
def test_it_drives_as_the_single_environment(name: str, config: dict[str, Any], steps: int) -> None:
    single, engine = pair(name, config)
    tally = Tally()
    for seed in range(3):
        drive(single, engine, seed, tally, steps)
    require_equal(tally, parted=1 if name == "Intersection" else 0)  # whose drivers wait, and so crawl
    assert tally.steps >= 12


@pytest.mark.parametrize(("name", "config"), OTHERS, ids=_named)
def test_other_configurations_are_the_same_as_well(name: str, config: dict[str, Any]) -> None:
    few = {"world": {"vehicles_count": 8}} if name == "Highway" else {}
    navigation = {**PERFECT["navigation"], **config.get("navigation", {})}
    single, engine = pair(name, {**PERFECT, **few, **config, "navigation": navigation})
    tally = Tally()
    for seed in (3, None):  # the second episode goes on from where the generators are
        drive(single, engine, seed, tally, 12)
    require_equal(tally, parted=2 if name in ("Roundabout", "Intersection") else 0)  # whose cars stop, and so crawl
    assert tally.steps >= 8


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("Highway", {**DENSE, "world": {"vehicles_count": 20, "vehicles_density": 3.0}}),
        ("UrbanCanyon", CROWDED),
        ("UrbanCanyon", {**CROWDED, "action": "continuous"}),
    ],
    ids=_named,
)
def test_crashes_and_ends_are_the_same(name: str, config: dict[str, Any]) -> None:
    single, engine = pair(name, config, count=2)
    tally = Tally()
    for seed in range(8):
        drive(single, engine, seed, tally, 40, row=seed % 2)
    require_equal(tally, parted=2)
    assert tally.crashes >= 1
    assert tally.lane_changes >= 10


def test_to_stand_on_the_merging_lane_has_finite_rewards() -> None:
    """highway-env divides there by the speed that a vehicle wants."""
    navigation = {"source": "offset", "offset_ct_m": -2.4}
    single, engine = pair("Merge", {**PERFECT, "navigation": navigation, "duration_s": 60.0, "off_road_ends": False})
    single.reset(seed=1)
    engine.reset(np.arange(1), [1])
    stood = 0
    while stood < 3:
        x, speed = single.world.vehicle.position[0], single.world.vehicle.speed
        action = 4 if x > 245.0 or speed > 12.0 else 1 if speed > 8.0 else 3
        _, reward, terminated, truncated, info = single.step(action)
        engine.step(np.array([action]))
        assert np.isfinite([reward, info["rewards"]["base"]]).all()
        assert engine.outcome["reward"][0] == pytest.approx(reward, abs=1e-9)
        assert engine.outcome["base"][0] == pytest.approx(info["rewards"]["base"], abs=1e-9)
        there = single.world.vehicle.lane_index == ("b", "c", 2)
        stood += there and single.belief_loop is not None and single.belief_loop.believed.target_speed == 0.0
        assert not terminated
        assert not truncated


@pytest.mark.slow
@pytest.mark.parametrize("comparison", COMPARISONS, ids=lambda c: f"{c.label}, {c.episodes}")
def test_844_episodes(comparison: Comparison) -> None:
    comparison.drive()
