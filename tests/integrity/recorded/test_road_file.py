"""Road maps in GeoJSON: directions, limits, what is left out, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import survives
from road_files import collection, line

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.road_file import read_roads

PLACES = [[13.37, 52.50], [13.371, 52.501], [13.372, 52.501]]


def one(tmp_path: Path, **properties: Any) -> Any:
    return read_roads(collection(tmp_path / "map.geojson", line(PLACES, **properties))).lines[0]


@pytest.mark.parametrize(
    ("properties", "directions"),
    [
        ({}, (True, True)),
        ({"oneway": "yes"}, (True, False)),
        ({"oneway": True}, (True, False)),
        ({"oneway": 1}, (True, False)),
        ({"oneway": "-1"}, (False, True)),
        ({"oneway": "no"}, (True, True)),
        ({"oneway": None}, (True, True)),
        ({"oneway": "reversible"}, (True, True)),
        ({"junction": "roundabout"}, (True, False)),
        ({"highway": "motorway"}, (True, False)),
        ({"highway": "motorway", "oneway": "no"}, (True, True)),
    ],
)
def test_directions(tmp_path, properties, directions) -> None:
    found = one(tmp_path, **properties)
    assert (found.along, found.against) == directions


@pytest.mark.parametrize(
    ("given", "limit"), [(None, 50 / 3.6), ("30", 30 / 3.6), (80, 80 / 3.6), ("30 mph", 13.4112), ("none", 50 / 3.6)]
)
def test_limits(tmp_path, given, limit) -> None:
    assert one(tmp_path, maxspeed=given).limit_mps == pytest.approx(limit)


def test_names_vertices_and_what_is_left_out(tmp_path) -> None:
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [13.0, 52.0]}}
    parts = [[*PLACES, PLACES[-1]], [[13.0, 52.0, 35.0], PLACES[0]]]
    several = {
        "type": "Feature", "id": "way/7", "properties": None,
        "geometry": {"type": "MultiLineString", "coordinates": parts},
    }  # fmt: skip
    nothing = {"type": "Feature", "properties": {}, "geometry": None}
    found = read_roads(collection(
        tmp_path / "map.geojson", line(PLACES, name="Leipziger", ref="B1"), line(PLACES, highway="footway"), point,
        several, nothing,
    ))  # fmt: skip
    assert [r.name for r in found.lines] == ["Leipziger", "way/7", "way/7"]
    assert [len(r.lon_lat_deg) for r in found.lines] == [3, 3, 2]  # a vertex twice in a row counts once
    np.testing.assert_allclose(found.lines[2].lon_lat_deg[0], [13.0, 52.0])
    assert (found.others, found.without_cars) == (2, 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "must be GeoJSON, is no JSON"),
        (" \n", "must be GeoJSON, is empty"),
        ("<?xml version='1.0'?><osm/>", "is XML: convert an .osm file with osmtogeojson"),
        (
            json.dumps({"type": "FeatureCollection", "features": [line([[391000.0, 5819000.0], PLACES[0]])]}),
            "as of UTM",
        ),
        ("[1, 2]", "must hold a FeatureCollection, got list"),
        ('{"type": "Feature"}', "got type 'Feature'"),
        (json.dumps({"type": "FeatureCollection", "features": []}), "must hold a LineString that cars drive on, has 0"),
        (json.dumps({"type": "FeatureCollection", "features": [3]}), "feature 0 must be an object, got int"),
        (json.dumps({"type": "FeatureCollection", "features": [line([[1.0, 2.0]])]}), "must have two vertices, got 1"),
        (json.dumps({"type": "FeatureCollection", "features": [line([[1, 2], [1, 95]])]}), "vertex 1 must be long"),
        (
            json.dumps({"type": "FeatureCollection", "features": [], "crs": {"properties": {"name": "EPSG:25833"}}}),
            "must have coordinates in longitude and latitude .*25833",
        ),
    ],
)
def test_refusals_say_what_is_wrong(tmp_path, text, message) -> None:
    path = tmp_path / "map.geojson"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_roads(path)
    with pytest.raises(InputError, match="map must be a file that can be read"):
        read_roads(tmp_path / "none.geojson")


def test_single_bad_ways_and_limits_are_left_out_and_counted(tmp_path) -> None:
    good = [line(PLACES, name=f"w{k}") for k in range(9)]
    bad = line([[13.0, 52.0], [13.0, 99.0]])
    found = read_roads(collection(tmp_path / "map.geojson", *good, bad))
    assert (len(found.lines), found.malformed, found.limits) == (9, 1, 0)
    assert "feature 9: vertex 1 must be longitude" in found.first
    with pytest.raises(InputError, match=r"vertex 1 .* \(2 of 11 ways of the file are malformed\)"):
        read_roads(collection(tmp_path / "map.geojson", *good, bad, bad))
    for limit in (0, "0", "-30", "900"):
        slow = read_roads(collection(tmp_path / "map.geojson", line(PLACES, maxspeed=limit)))
        assert slow.lines[0].limit_mps == pytest.approx(50 / 3.6)
        assert slow.limits == 1


def test_speed_limits_that_no_road_has_are_counted_and_many_refused(tmp_path) -> None:
    good = [line(PLACES, maxspeed=word) for word in ("walk", "none", "signals", "variable", "DE:zone:30", "IT:urban")]
    assert read_roads(collection(tmp_path / "map.geojson", *good)).note == ""
    one = read_roads(collection(tmp_path / "map.geojson", *good, line(PLACES, maxspeed="fast")))
    assert one.note.endswith("feature 6: maxspeed 'fast'")
    assert "1 speed limits taken as 50 km/h, the first" in one.note
    bad = [line(PLACES, maxspeed=limit) for limit in ("-50", "500")]
    with pytest.raises(
        InputError, match=r"feature 6: maxspeed '-50' must be .* up to 360, .* \(2 of 8 ways have others\)"
    ):
        read_roads(collection(tmp_path / "map.geojson", *good, *bad))


def test_a_map_with_a_byte_order_mark(tmp_path) -> None:
    path = collection(tmp_path / "map.geojson", line(PLACES, name="a"))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_roads(path).lines[0].name == "a"


def test_damaged_files_are_refused_and_nothing_else(tmp_path) -> None:
    whole = collection(tmp_path / "map.geojson", line(PLACES, name="a"), line(PLACES[::-1])).read_bytes()
    rng, path = np.random.default_rng(3), tmp_path / "damaged.geojson"
    for _ in range(60):
        damaged = bytearray(whole[: rng.integers(1, len(whole))])
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        survives(lambda: read_roads(path))
    deep = "[" * 100_000
    path.write_text(deep, encoding="utf-8")
    survives(lambda: read_roads(path))
