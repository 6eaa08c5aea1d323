"""The cities of an engine: more than it holds at a time, and the same episodes as those of single environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.skies import NO_SEED, Cities, Sites
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.sky import Street, build_street
from lanebound.envs.vector.engine import Engine
from lanebound.envs.worlds.base import Seat
from lanebound.envs.worlds.networks import node_at
from lanebound.integrity.sky.visibility import SkyMask
from tests.helpers.side_by_side import Pairs, require_equal

MANY: dict[str, Any] = {"cities": {"count": 200}, "extent_m": 300.0, "duration_s": 2.0}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("LaneKeeping", {"cities": {"count": 200, "vary": True}}),
        ("UrbanCanyon", {"world": {"vehicles_count": 2}}),
        ("Merge", {"cities": {"split": "test"}}),
        ("LaneKeeping", {"world": {"layout": 7, "roads": 5, "lanes_count": 2}}),
        ("CarFollowing", {"world": {"roads": 3}}),
    ],
)
def test_an_episode_in_any_city_is_the_single_one(name: str, change: dict[str, Any]) -> None:
    pairs = Pairs(name, {**MANY, **change}, 2, 5)
    for start in range(3):
        pairs.step(3)
        pairs.reset(np.array([start % 2]), None)  # the next of its generator, prepared with others
    pairs.step(2)
    require_equal(pairs.tally)


def test_episodes_of_city_are_in_cities_with_their_own_streets() -> None:
    world = {"vehicles_count": 2}
    pairs = Pairs("City", {"world": world, "duration_s": 2.0, "cities": {"split": "test", "count": 3}}, 2, 5)
    roads = set()
    for start in range(4):
        pairs.step(2)
        pairs.reset(np.array([start % 2]), None)
        roads |= {str(one.world.vehicle.lane_index[0]).partition("@")[2] for one in pairs.singles}
    require_equal(pairs.tally)
    assert len(roads) > 1


def test_a_road_measures_alike_at_any_site(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same road as the first and as the third of several: equal errors and levels in the same city and hour."""
    found = []
    for layout, roads in ((9, 1), (7, 3)):
        config = {"world": {"layout": layout, "roads": roads}, "cities": {"count": 1}, "extent_m": 300.0}
        single = DrivingEnv(make_config("lanebound/LaneKeeping-v0", config))
        seat = Seat((node_at("start", roads - 1), node_at("end", roads - 1), 0), 30.0, 8.0)
        monkeypatch.setattr(type(single.world), "draw_seats", lambda *_, seat=seat: ([seat], None))
        single.reset(seed=3)
        rows = [single.step(np.array([0.0, 0.0], np.float32))[4] for _ in range(5)]
        found.append([(row["err_at_m"], row["err_ct_m"], row["pl_at_m"], row["pl_ct_m"]) for row in rows])
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-6)


def street_of(seed: int, extent_m: float = 60.0) -> Street:
    """The street of a city along the first metres of a road."""
    config = make_config("lanebound/LaneKeeping-v0", {"sky": "dense"})
    network = DrivingEnv(config).world.road.network
    return build_street(network, config.level, seed, (), extent_m)


def cities_of(slots: int) -> Cities:
    table, one = lane_table(DrivingEnv(make_config("lanebound/LaneKeeping-v0")).world.road.network), street_of(0)
    number, (begin_m, reach_m) = np.zeros(len(table.index), np.int64), np.zeros((2, len(table.index)))
    return Cities(
        lambda seed, _: street_of(seed),
        Sites(number, begin_m, reach_m, one.lanes.count, np.array([NO_SEED])),
        slots,
        (0, 0),
        one,
    )


def city_at(cities: Cities, arc_m: float, seed: int, extent_m: float = 60.0) -> None:
    """The slot at an arc holds the mask of a city."""
    own = street_of(seed, extent_m)
    n = len(own.mask.rows.cell)
    at = slice(begin := round(arc_m / own.mask.spacing_m), begin + n)
    held, faces = cities.mask, own.mask.faces
    np.testing.assert_array_equal(held.path[at], own.mask.path)
    np.testing.assert_array_equal(held.excess_m[at], own.mask.excess_m)
    np.testing.assert_array_equal(cities.forecast.free[at], own.forecast.free)
    there = faces.face >= 0
    np.testing.assert_array_equal(held.faces.table[held.faces.face[at][there]], faces.table[faces.face[there]])
    seen = faces.edge >= 0
    np.testing.assert_array_equal(held.faces.edges[held.faces.edge[at][seen]], faces.edges[faces.edge[seen]])


def test_a_slot_is_taken_over_when_nobody_is_in_it() -> None:
    cities = cities_of(3)
    running, waiting = cities.where(2), cities.where(1)
    for seeds in ([1, 2], [3, 2], [3, 4], [5, 5], [6, 1]):
        cities.settle(running, np.arange(2), np.array(seeds), np.zeros(2, np.int64))
        cities.settle(waiting, np.arange(1), np.array(seeds[:1]), np.zeros(1, np.int64))
        for arc, seed in zip([*running.city.tolist(), *waiting.city.tolist()], [*seeds, seeds[0]], strict=True):
            city_at(cities, arc, seed)
    assert cities.made == 8, "of 0 to 6, and 1 again"


def test_slots_grow_with_the_largest_city() -> None:
    cities = cities_of(2)
    cities._widen([1, 1, 1])  # as if the first one had been nearly empty
    where = cities.where(1)
    for seed in (7, 8):
        cities.settle(where, np.arange(1), np.array([seed]), np.zeros(1, np.int64))
        city_at(cities, float(where.city[0]), seed)


def test_a_shorter_road_leaves_the_rest_of_its_slot_unused() -> None:
    """A slot that held a city along a longer road holds the next one whole."""
    table, long = (
        lane_table(DrivingEnv(make_config("lanebound/LaneKeeping-v0")).world.road.network),
        street_of(0, 120.0),
    )
    where = np.zeros(2 * len(table.index)).reshape(2, -1)
    sites = Sites(np.zeros(len(table.index), np.int64), *where, long.lanes.count, np.array([NO_SEED, NO_SEED]))
    cities = Cities(lambda seed, _: street_of(seed, 60.0 if seed % 2 else 120.0), sites, 2, (0, 0), long)
    here, none = cities.where(1), np.zeros(1, np.int64)
    for seed in (1, 2, 3, 4, 5):
        cities.settle(here, none, np.array([seed]), none)
        city_at(cities, float(here.city[0]), seed, 60.0 if seed % 2 else 120.0)


def test_memory_is_that_of_the_episodes_and_not_of_the_cities() -> None:
    def held(count: int) -> int:
        config = make_config("lanebound/LaneKeeping-v0", {**MANY, "cities": {"count": count}})
        return Engine(DrivingEnv(config), 2).episodes.navigation.cities.nbytes  # type: ignore[union-attr]

    assert held(2**31) == held(200) == held(10), "2 environments that run, and 4 next episodes of each"
    assert held(5) < 0.6 * held(10)


def test_a_cell_takes_about_four_bytes() -> None:
    mask = street_of(3).mask
    assert mask.nbytes < 6 * mask.rows.cell.size
    assert mask.rows.reflection.size > 0.05 * mask.rows.cell.size


def test_open_cities_are_one() -> None:
    config = make_config("lanebound/LaneKeeping-v0", {**MANY, "sky": "open"})
    engine = Engine(DrivingEnv(config), 2)
    engine.reset(np.arange(2), [3, 4])
    cities = engine.episodes.navigation.cities  # type: ignore[union-attr]
    assert cities.mask.rows.cell.size == SkyMask.open().rows.cell.size
    assert not engine.episodes.navigation.where.city.any()  # type: ignore[union-attr]
