"""Buildings and trees of a map as obstacles: heights of tags, parts in place of outlines, roofs where they are."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from osm_files import square, with_outlines

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps import city as obstacles
from lanebound.integrity.sky.maps.buildings import STOREY_M, USUAL_M, Outline
from lanebound.integrity.sky.maps.city import bridges_above, city_of, in_buildings
from lanebound.integrity.sky.maps.files import map_of
from lanebound.integrity.sky.maps.osm import read_osm
from lanebound.integrity.sky.maps.polygons import inside
from lanebound.integrity.sky.maps.records import BridgeAxis, MapFrame, Solid, StreetMap, StreetWay, Tree
from lanebound.integrity.sky.raytrace import first_hits
from lanebound.integrity.sky.scene import City


def solids(tmp_path: Path, *tags: dict[str, str], rings: list | None = None) -> StreetMap:
    given = rings or [square(30.0 * k, 20.0, 20.0) for k in range(len(tags))]
    return read_osm(with_outlines(tmp_path / "map.osm", given, tags))


def roof_m(city: City, places: np.ndarray) -> np.ndarray:
    """Height of the highest solid above places (n, 2), NaN for none: by rays from above."""
    origin = np.column_stack([places, np.full(len(places), 1000.0)])
    hits = first_hits(city.grid, origin, np.array([0.0, 0.0, -1.0]))
    return np.where(hits.clear, np.nan, 1000.0 - hits.t)


@pytest.mark.parametrize(
    ("tags", "bottom_m", "top_m"),
    [
        ({"height": "20"}, 0.0, 20.0),
        ({"height": "20", "building:levels": "2"}, 0.0, 20.0),
        ({"height": "20", "roof:height": "5"}, 0.0, 15.0),
        ({"building:levels": "5"}, 0.0, 5 * STOREY_M),
        ({"height": "20", "min_height": "8"}, 8.0, 20.0),
        ({"height": "20", "building:min_level": "2"}, 2 * STOREY_M, 20.0),
        ({}, 0.0, USUAL_M),
        ({"height": "1e6"}, 0.0, USUAL_M),
        ({"building": "garage"}, 0.0, 3.0),
        ({"building": "roof", "height": "5"}, 4.5, 5.0),
    ],
)
def test_heights(tmp_path: Path, tags: dict[str, str], bottom_m: float, top_m: float) -> None:
    (solid,) = solids(tmp_path, {"building": "yes", **tags}).solids
    assert (solid.bottom_m, solid.top_m) == (bottom_m, pytest.approx(top_m))


def test_unknown_heights_are_the_median_of_enough_known_ones(tmp_path: Path) -> None:
    known = [{"building": "yes", "height": str(h)} for h in (10, 14, 30, 31, 90)]
    found = solids(tmp_path, *known, {"building": "yes"})
    assert found.solids[-1].top_m == 30.0
    assert found.assumed["heights of 30 m, where nothing is tagged"] == 1
    assert solids(tmp_path, *known[:4], {"building": "yes"}).solids[-1].top_m == USUAL_M


def test_parts_take_the_place_of_their_outline(tmp_path: Path) -> None:
    outline = square(0.0, 20.0, 20.0)
    halves = [[(begin + 0.5 * east, north) for east, north in outline] for begin in (0.0, 10.0)]
    tags = ({"building": "yes", "height": "40"}, {"building:part": "yes", "height": "9"}, {"building:part": "yes"})
    found = solids(tmp_path, *tags, rings=[outline, *halves])
    assert sorted(solid.top_m for solid in found.solids) == [9.0, 40.0]  # the second has the height of its building
    assert len({solid.building for solid in found.solids}) == 1
    assert found.skipped["outlines replaced by building:part"] == 1
    porch = square(2.0, 22.0, 3.0)
    found = solids(tmp_path, tags[0], tags[1], rings=[outline, porch])
    assert sorted(solid.top_m for solid in found.solids) == [9.0, 40.0]  # a small part does not replace it


def test_storeys_are_assumed_where_no_height_is_that_of_the_solid(tmp_path: Path) -> None:
    outline = square(0.0, 20.0, 20.0)
    halves = [[(begin + 0.5 * east, north) for east, north in outline] for begin in (0.0, 10.0)]
    parts = {"building:part": "yes", "building:levels": "2"}, {"building:part": "yes"}
    found = solids(tmp_path, {"building": "yes", "height": "40"}, *parts, rings=[outline, *halves])
    assert sorted(solid.top_m for solid in found.solids) == [2 * STOREY_M, 40.0]
    assert found.assumed["storeys of 3.6 m"] == 1


def test_roofs_are_where_and_as_high_as_the_buildings(tmp_path: Path) -> None:
    found = map_of("berlin_kreuzberg")
    city = city_of(found)
    rng = np.random.default_rng(1)
    places = rng.uniform((-300.0, -300.0), (350.0, 350.0), (4000, 2))
    highest = np.full(len(places), -np.inf)
    for solid in found.solids:
        within = inside(places, solid.rings_en_m)
        highest[within] = np.maximum(highest[within], solid.top_m)
    houses = City(city.triangles_enu_m[~city.foliage], city.surface[~city.foliage])
    seen = roof_m(houses, places)
    built = np.isfinite(highest)
    assert 0.1 < built.mean() < 0.6
    np.testing.assert_allclose(seen[built], highest[built], atol=1e-6)
    assert np.isnan(seen[~built]).all()
    low = np.array([solid.bottom_m < 4.5 for solid in found.solids])
    assert low.mean() > 0.9
    assert np.all(built[in_buildings(places, found)])


def test_many_outlines_and_places_take_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-5000.0, 5000.0, (50_000, 2))
    unit = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)])
    solids = tuple(Solid((unit + corner,), 0.0, 9.0, k) for k, corner in enumerate(corners))
    places = rng.uniform(-5000.0, 5000.0, (100_000, 2))
    begin = time.process_time()
    found = in_buildings(places, StreetMap(MapFrame(52.5, 13.4), solids=solids))
    assert time.process_time() - begin < 20.0
    assert found.mean() == pytest.approx(1.0 - np.exp(-0.05), abs=0.003)  # share of a plane below random squares
    monkeypatch.setattr(obstacles, "MOST_TESTS", 1000)
    with pytest.raises(InputError, match=r"at most 1e\+03 tests .*: cut a part"):
        in_buildings(places, StreetMap(MapFrame(52.5, 13.4), solids=solids))


def test_walls_leave_no_gap() -> None:
    found = map_of("berlin_kreuzberg")
    city = city_of(found)
    azimuth = np.radians(np.arange(0.5, 360.0, 3.0))
    ways = np.column_stack([np.sin(azimuth), np.cos(azimuth), np.zeros(azimuth.size)])
    grounded = [solid for solid in found.solids if solid.bottom_m == 0.0][::4]
    for solid in grounded:
        middle = Outline(solid.rings_en_m, {}).middle_en_m
        hits = first_hits(city.grid, np.append(middle, 0.5 * solid.top_m), ways)
        assert not hits.clear.any()
        size = np.ptp(solid.rings_en_m[0], axis=0)
        assert hits.t.max() <= np.hypot(*size)
    assert city.buildings == len(np.unique(city.building[~city.foliage])) > 200
    assert (city.building[city.foliage] == -1).all()


def test_trees_are_foliage_of_their_size() -> None:
    trees = (Tree(0.0, 0.0, 12.0, 8.0), Tree(30.0, 0.0))
    city = city_of(StreetMap(MapFrame(52.5, 13.4), trees=trees))
    assert city.foliage.all()
    assert len(city) == 24
    first, second = city.triangles_enu_m[:12].reshape(-1, 3), city.triangles_enu_m[12:].reshape(-1, 3)
    np.testing.assert_allclose((first.min(0), first.max(0)), ((-4.0, -4.0, 4.5), (4.0, 4.0, 12.0)))
    np.testing.assert_allclose((second.min(0), second.max(0)), ((27.0, -3.0, 4.5), (33.0, 3.0, 9.0)))


def test_only_what_is_near_a_way_is_an_obstacle() -> None:
    found = map_of("berlin_kreuzberg")
    way = np.array([(-5000.0, 0.0), (-4900.0, 0.0)])
    assert len(city_of(found, way)) == 0
    assert 0 < len(city_of(found, way + np.array([4200.0, 0.0]))) < len(city_of(found))


def test_bridges_stand_above_a_lower_way_only() -> None:
    bridge = BridgeAxis(np.array([(0.0, -30.0), (0.0, 30.0)]), 8.0, 1, (7, 8))
    streets = StreetMap(MapFrame(52.5, 13.4), bridges=(bridge,))
    way = np.array([(-100.0, 0.0), (100.0, 0.0), (100.0, 80.0)])

    def street(level: int, *nodes: int) -> StreetWay:
        return StreetWay(1, nodes, way, "residential", 1, 1, None, 14.0, level)

    deck = bridges_above(streets, way, [street(0, 1, 2)] * 2)
    assert len(deck) == 12
    low, high = deck.triangles_enu_m.reshape(-1, 3).min(0), deck.triangles_enu_m.reshape(-1, 3).max(0)
    np.testing.assert_allclose((low, high), ((-4.0, -12.0, 6.0), (4.0, 12.0, 7.5)))
    assert not len(bridges_above(streets, way, [street(1, 1, 2)] * 2))
    assert not len(bridges_above(streets, way, [street(0, 1, 8), street(0, 1, 2)]))  # a side street, up a ramp
    assert not len(bridges_above(streets, way + np.array([0.0, 40.0]), [street(0, 1, 2)] * 2))
    assert not len(bridges_above(streets, way + np.array([0.0, 30.0]), [street(0, 1, 2)] * 2))  # it ends there
