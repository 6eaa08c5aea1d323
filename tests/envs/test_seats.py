"""The vehicles of a single environment in the records: where they are, who has which slot, what they broadcast."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.envs import DrivingEnv, make_config, wrap
from lanebound.envs.belief_loop import BeliefLoop

IDLE = 1


@pytest.fixture(scope="module")
def loop() -> BeliefLoop:
    config = {"world": {"vehicles_count": 6}, "perception": {"source": "v2v"}, "sky": "open", "simulation_hz": 10}
    env = DrivingEnv(make_config("lanebound/Highway-v0", config))
    env.reset(seed=3)
    env.step(IDLE)
    assert env.belief_loop is not None
    return env.belief_loop


def test_the_records_are_the_vehicles_of_the_world_the_ego_first(loop: BeliefLoop) -> None:
    ego, cars = loop.ego, loop.episodes.cars[0]
    world, n = [ego, *(v for v in loop.world.road.vehicles if v is not ego)], int(loop.episodes.ego["vehicles"][0])
    assert n == len(world)
    np.testing.assert_array_equal(np.column_stack([cars["x"][:n], cars["y"][:n]]), [v.position for v in world])
    np.testing.assert_array_equal(cars["heading"][:n], [v.heading for v in world])
    np.testing.assert_array_equal(cars["speed"][:n], [v.speed for v in world])
    assert [loop.episodes.table.index[lane] for lane in cars["lane"][:n]] == [v.lane_index for v in world]
    assert cars["slot"][0] == -1
    assert sorted(cars["slot"][1:n]) == list(range(n - 1))
    assert (set(cars["length"][:n]), set(cars["width"][:n])) == ({ego.LENGTH}, {ego.WIDTH})


def test_claims_are_the_solutions_in_the_plane(loop: BeliefLoop) -> None:
    claims, solution = loop.episodes.perception.pictures.spoken[0], loop.solution
    assert solution is not None
    place = np.column_stack([claims["x_m"], claims["y_m"]])
    np.testing.assert_array_equal(place, solution.position_en_m[1:] * [1.0, -1.0])
    np.testing.assert_array_equal(claims["speed_mps"], solution.speed_mps[1:])
    np.testing.assert_array_equal(claims["pl_ct_m"], solution.pl_ct_m[1:])
    assert claims["sends"].all()
    true = np.array([v.position for v in loop.seats.slot])
    assert np.abs(place[list(loop.seats.slot.values())] - true).max() < 3.0


def test_slots_are_given_free_and_taken_over() -> None:
    env = wrap("intersection-v2", {"sky": "open", "world": {"spawn_probability": 1.0, "initial_vehicle_count": 3}})
    env.reset(seed=3)
    loop = env.belief_loop
    assert loop is not None
    seats, before = loop.seats, dict(loop.seats.slot)
    names = loop.episodes.perception.pictures.slots["key"][0]
    first = {int(names[slot]) for slot in before.values()}
    gone = next(iter(before))
    env.world.road.vehicles.remove(gone)
    over = False
    while not over and len(set(seats.slot) - set(before)) < 3:
        *_, terminated, truncated, _ = env.step(IDLE)
        over = terminated or truncated
    assert gone not in seats.slot
    assert len(set(seats.slot.values())) == len(seats.slot)
    fresh = [slot for vehicle, slot in seats.slot.items() if vehicle not in before]
    assert before[gone] in fresh, "the slot that was given back is taken first"
    assert not first & {int(names[slot]) for slot in fresh}, "no name is given twice"


def test_slots_are_taken_over_where_nobody_is_tracked() -> None:
    """Given traffic has no tracks: they take no memory, and newcomers are seen all the same."""
    world = {"spawn_probability": 1.0, "initial_vehicle_count": 3}
    config = {"sky": "open", "world": world, "perception": {"source": "truth"}, "navigation": {"source": "perfect"}}
    env = wrap("intersection-v2", config)
    env.reset(seed=3)
    loop = env.belief_loop
    assert loop is not None
    assert loop.episodes.perception.pictures.tracks.size == 0
    before = set(loop.seats.slot)
    over = False
    while not over and not set(loop.seats.slot) - before:
        *_, terminated, truncated, _ = env.step(IDLE)
        over = terminated or truncated
    assert set(loop.seats.slot) - before
    assert loop.episodes.perception.pictures.picture["seen"][0] == len(loop.seats.slot)
