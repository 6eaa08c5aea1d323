"""The city as mapped: buildings off by errors of the stated size, all else as it is, trees left out."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Surface, prisms
from lanebound.integrity.sky.survey import LEAST_HEIGHT_M, MapConfig, as_mapped

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
EXACT = MapConfig(height_sigma_m=0.0, position_sigma_m=0.0, trees=True)


def blocks(count: int, height_m: float) -> City:
    return City.of_buildings(SQUARE + 50.0 * np.arange(count)[:, None, None], np.full(count, height_m))


def test_errors_of_heights_and_places_have_their_sizes() -> None:
    """4000 errors each: 4.5 sigma of a mean and of a standard deviation, once in 100,000 each."""
    count = 4000
    city = blocks(count, 30.0)
    before = city.triangles_enu_m.reshape(count, -1, 3)
    after = as_mapped(city, MapConfig(), np.random.default_rng(1)).triangles_enu_m.reshape(count, -1, 3)
    errors = np.column_stack(
        [(after - before)[:, 0, :2], (after - before)[..., 2].max(1) + (after - before)[..., 2].min(1)]
    )
    sigma = np.array([0.7, 0.7, 2.5])
    np.testing.assert_allclose(errors.mean(0), 0.0, atol=4.5 * sigma.max() / np.sqrt(count))
    np.testing.assert_allclose(errors.std(0) / sigma, 1.0, atol=4.5 / np.sqrt(2.0 * count))
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 4.5 / np.sqrt(count)


def test_a_building_keeps_its_shape_and_stays_on_the_ground() -> None:
    city = blocks(3, 12.0)
    before, after = (
        c.triangles_enu_m.reshape(3, -1, 3) for c in (city, as_mapped(city, MapConfig(), np.random.default_rng(2)))
    )
    moved = (after - before)[..., :2]
    np.testing.assert_allclose(moved, np.broadcast_to(moved[:, :1], moved.shape), atol=1e-9)
    np.testing.assert_array_equal(after[..., 2] == 0.0, before[..., 2] == 0.0)
    assert len(np.unique(after[..., 2].max(1))) == 3


def test_no_building_vanishes() -> None:
    low = as_mapped(blocks(500, 2.0), MapConfig(), np.random.default_rng(3))
    heights = low.triangles_enu_m.reshape(500, -1, 3)[..., 2].max(1)
    assert heights.min() == pytest.approx(LEAST_HEIGHT_M)


def test_bridges_stay_and_trees_are_left_out_unless_mapped() -> None:
    slab = City.of(prisms(SQUARE[None], 6.0, 7.5, floor=True))
    tree = City.of(prisms(SQUARE[None] + 40.0, 4.5, 9.0, floor=True), Surface.FOLIAGE)
    city = slab + blocks(2, 9.0) + tree
    mapped = as_mapped(city, MapConfig(), np.random.default_rng(4))
    np.testing.assert_array_equal(mapped.triangles_enu_m[: len(slab)], slab.triangles_enu_m)
    assert not mapped.foliage.any()
    assert len(mapped) == len(city) - len(tree)
    with_trees = as_mapped(city, MapConfig(trees=True), np.random.default_rng(4))
    np.testing.assert_array_equal(with_trees.triangles_enu_m[with_trees.foliage], tree.triangles_enu_m)


def test_an_exact_map_is_the_city_and_draws_as_much_as_any() -> None:
    road = Road.straight(200.0)
    city = build_city(road, CityConfig.uniform(SectionKind.TREES), np.random.default_rng(0))
    ours, theirs = np.random.default_rng(5), np.random.default_rng(5)
    np.testing.assert_allclose(as_mapped(city, EXACT, ours).triangles_enu_m, city.triangles_enu_m, atol=1e-12)
    as_mapped(city, MapConfig(), theirs)
    assert ours.random() == theirs.random()


def test_an_empty_city_has_an_empty_map() -> None:
    assert len(as_mapped(City.empty(), MapConfig(), np.random.default_rng(0))) == 0


def test_buildings_are_told_apart_through_sums_of_cities() -> None:
    both = blocks(2, 9.0) + City.of(prisms(SQUARE[None], 6.0, 7.5)) + blocks(3, 9.0)
    assert both.buildings == 5
    np.testing.assert_array_equal(np.bincount(both.building + 1), 6 * [10])
