"""Generated city maps: the same for a seed, in two disjoint splits, and streets that lead past buildings."""

from __future__ import annotations

import doctest

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps import generated
from lanebound.integrity.sky.maps.generated import TEST_MAPS, TRAIN_MAPS, generated_map, map_seed, named_map
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.loops import through_buildings
from lanebound.integrity.sky.maps.polygons import inside, signed_area

SEEDS = (0, 1, 4, TRAIN_MAPS, TRAIN_MAPS + 7)


def test_a_seed_gives_one_city_and_another_seed_another_one() -> None:
    first = generated_map(3)
    generated_map.cache_clear()
    again, other = generated_map(3), generated_map(4)
    assert again is not first
    assert [w.nodes for w in again.streets] == [w.nodes for w in first.streets]
    assert again.restrictions == first.restrictions
    assert again.trees == first.trees
    assert [s.top_m for s in again.solids] == [s.top_m for s in first.solids]
    assert [s.top_m for s in other.solids] != [s.top_m for s in first.solids]


def test_splits_are_disjoint_and_the_test_cities_are_fixed_in_number() -> None:
    assert doctest.testmod(generated).failed == 0
    test = {map_seed("test", k) for k in range(TEST_MAPS)}
    assert min(test) > map_seed("train", TRAIN_MAPS - 1)
    assert len(test) == TEST_MAPS
    for split, index in (("test", TEST_MAPS), ("train", -1), ("tests", 0)):
        with pytest.raises(InputError):
            map_seed(split, index)


@pytest.mark.parametrize("seed", SEEDS)
def test_streets_are_connected_and_lead_past_the_buildings(seed: int) -> None:
    streets = generated_map(seed)
    graph = StreetGraph.of(streets)
    assert len(graph.connected) > 0.9 * len(graph.edges)
    assert through_buildings(streets, graph.edges).max() == 0.0
    assert {way.kind for way in streets.streets} <= {"primary", "tertiary", "residential"}
    points = np.concatenate([way.points_en_m for way in streets.streets])
    assert np.all(np.ptp(points, axis=0) > 800.0)
    assert np.all(np.ptp(points, axis=0) < 1800.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_buildings_stand_apart_and_have_the_heights_of_districts(seed: int) -> None:
    solids = generated_map(seed).solids
    assert len(solids) > 300
    assert all(signed_area(s.rings_en_m[0]) >= 40.0 for s in solids)
    assert min(s.top_m for s in solids) >= 3.0
    assert max(s.top_m for s in solids) <= 150.0
    middles = np.array([s.rings_en_m[0].mean(0) for s in solids])
    for solid in solids[::20]:
        assert inside(middles, solid.rings_en_m).sum() == 1  # its own


def test_names_of_generated_maps() -> None:
    assert named_map("generated:3").found == generated_map(3).found
    for name in ("generated:", "generated:-1", "generated:x", f"generated:{TRAIN_MAPS + TEST_MAPS}", "nowhere"):
        with pytest.raises(InputError, match="map must be"):
            named_map(name)
