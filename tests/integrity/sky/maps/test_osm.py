"""Reader of OpenStreetMap: what it finds, counts and refuses."""

from __future__ import annotations

import gzip
import sys
import xml.etree.ElementTree as ET
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from osm_files import PLACE, STREET, blocks, node, osm, relation, square, way, with_outlines
from recordings import real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps import osm as reader
from lanebound.integrity.sky.maps.files import map_of, packaged_maps
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.osm import read_osm
from lanebound.integrity.sky.maps.records import MapFrame, Restriction
from lanebound.integrity.sky.maps.tags import DRIVABLE

CM = 0.02  # places have seven digits of a degree


def written(tmp_path: Path, text: str, name: str = "map.osm") -> Path:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return file


def test_the_frame_is_metres_east_and_north() -> None:
    frame = MapFrame(52.5, 13.4)
    # Length of a degree of latitude and of longitude on WGS 84 (Snyder, USGS Professional Paper 1395, p. 25)
    phi = np.radians(52.5)
    north = 111132.954 - 559.822 * np.cos(2 * phi) + 1.175 * np.cos(4 * phi)
    east = 111412.84 * np.cos(phi) - 93.5 * np.cos(3 * phi) + 0.118 * np.cos(5 * phi)
    np.testing.assert_allclose(frame.en_of(52.501, 13.4), (0.0, 1e-3 * north), atol=1e-3)
    np.testing.assert_allclose(frame.en_of(52.5, 13.401), (1e-3 * east, 0.0), atol=1e-3)
    places = np.array([(0.0, 0.0), (500.0, -300.0), (-5000.0, 4000.0)])
    np.testing.assert_allclose(frame.en_of(*frame.lat_lon_of(places).T), places, atol=5.0e-3)


def test_a_street_has_what_its_tags_say(tmp_path: Path) -> None:
    tags = {"highway": "primary", "lanes": "3", "lanes:forward": "2", "width": "10.5", "maxspeed": "50", "layer": "1",
            "bridge": "yes"}  # fmt: skip
    nodes = node(1, -50.0, 0.0), node(2, 0.0, 10.0), node(3, 50.0, 0.0)
    found = read_osm(written(tmp_path, osm(*nodes, way(7, [1, 2, 3], tags))))
    (street,), (bridge,) = found.streets, found.bridges
    assert (street.number, street.nodes, street.kind) == (7, (1, 2, 3), "primary")
    assert (street.lanes, street.lanes_back, street.lane_width_m) == (2, 1, 3.5)
    assert street.speed_limit_mps == pytest.approx(50.0 / 3.6)
    assert (street.level, street.bridge, street.covered) == (1, True, False)
    steps = np.linalg.norm(np.diff(street.points_en_m, axis=0), axis=1)
    np.testing.assert_allclose(steps, np.hypot(50.0, 10.0), atol=CM)
    assert (bridge.width_m, bridge.level) == (10.5, 1)
    assert not found.assumed
    assert not found.skipped


def test_lanes_for_buses_or_turns_are_counted(tmp_path: Path) -> None:
    kinds = {"lanes:psv": "1"}, {"turn:lanes:forward": "left|through"}, {"placement": "right_of:1"}, {"lanes": "2"}
    ways = [way(10 + k, [901, 902], {"highway": "primary", **more}) for k, more in enumerate(kinds)]
    found = read_osm(written(tmp_path, osm(STREET[0], *ways)))
    assert found.assumed["lanes for buses or turns taken for any other lane, by street"] == 3


def test_ways_that_no_car_drives_through_are_counted(tmp_path: Path) -> None:
    kinds = {"footway": {}, "construction": {}, "service": {}, "residential": {"access": "private"}}
    ways = [way(10 + k, [901, 902], {"highway": kind, **more}) for k, (kind, more) in enumerate(kinds.items())]
    found = read_osm(written(tmp_path, osm(STREET[0], STREET[1], *ways)))
    assert len(found.streets) == 1
    assert dict(found.skipped) == {
        "ways of highway that are no streets for through traffic": 3,
        "streets closed to private cars": 1,
    }


def test_a_street_is_cut_where_its_points_are_missing(tmp_path: Path) -> None:
    nodes = [node(k, 10.0 * k, 0.0) for k in (1, 2, 4, 5)]
    nodes.append('<node id="6" version="1" lat="95" lon="13.4"/>')
    found = read_osm(written(tmp_path, osm(*nodes, way(7, [1, 2, 3, 4, 5, 6], {"highway": "residential"}))))
    assert [street.nodes for street in found.streets] == [(1, 2), (4, 5)]
    assert found.skipped["points of streets that lie outside of the file or have no place"] == 2


def test_restrictions_of_turns(tmp_path: Path) -> None:
    members = [("way", 1, "from"), ("node", 2, "via"), ("way", 101, "to")]
    by_way = [("way", 1, "from"), ("way", 2, "via"), ("way", 101, "to")]
    kinds = (("no_left_turn", members, ""), ("only_straight_on", members, ""), ("no_left_turn", by_way, ""),
             ("no_left_turn", members, "motorcar;bus"), ("no_sense", [members[0]], ""))  # fmt: skip
    text = "".join(
        relation(50 + k, ms, {"type": "restriction", "restriction": kind, **({"except": but} if but else {})})
        for k, (kind, ms, but) in enumerate(kinds)
    )
    found = read_osm(blocks(tmp_path / "map.osm", streets=text))
    assert found.restrictions == (Restriction(1, 2, 101, False), Restriction(1, 2, 101, True))
    assert found.skipped["restrictions of turns by way, or not of cars"] == 3


def test_trees_and_rows_of_trees(tmp_path: Path) -> None:
    trees = node(1, 0.0, 0.0, natural="tree", height="12", diameter_crown="8"), node(2, 40.0, 0.0, natural="tree")
    row = [node(3, 0.0, 20.0), node(4, 80.0, 20.0)]
    near = node(5, 4.0, 20.0, natural="tree")
    ways = way(9, [3, 4], {"natural": "tree_row"}), STREET[1]
    text = osm(*trees, *row, near, node(901, -100.0, 0.0), node(902, 100.0, 0.0), *ways)
    found = read_osm(written(tmp_path, text))
    first, second, third, *rest = found.trees
    assert (first.height_m, first.crown_m, second.height_m) == (12.0, 8.0, None)
    assert third.north_m - first.north_m == pytest.approx(20.0, abs=CM)
    assert len(rest) == 9  # of ten places 8 m apart, one is the mapped tree
    np.testing.assert_allclose(np.diff([tree.east_m for tree in rest]), 8.0, atol=CM)


def test_long_rows_of_trees_are_refused_before_they_are_planted(tmp_path: Path) -> None:
    zigzag = [(-4000.0 + 4.0 * k, 6000.0 * (-1) ** k) for k in range(2000)]
    row = [node(1 + k, *place) for k, place in enumerate(zigzag)]
    street = [node(5000 + k, 9.0 * k, 0.0) for k in range(9)]
    ways = way(9, list(range(1, 2001)), {"natural": "tree_row"}), way(8, range(5000, 5009), {"highway": "primary"})
    text = osm(*row, *street, *ways)
    with pytest.raises(InputError, match="at most 500000 trees, got more"):
        read_osm(written(tmp_path, text))


def test_outlines_that_are_none_are_counted(tmp_path: Path) -> None:
    bow = [(0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)]
    rings = [square(20.0, 20.0, 10.0), bow, [(40.0, 20.0), (50.0, 20.0), (60.0, 20.0)], square(20.0, 40.0, 10.0)]
    tags = [{"building": "yes", "height": "9"}] * 3 + [{"building": "yes", "layer": "-1"}]
    found = read_osm(with_outlines(tmp_path / "map.osm", rings, tags))
    assert [solid.top_m for solid in found.solids] == [9.0]
    assert found.skipped["buildings whose outline crosses itself or lacks points"] == 2
    assert found.skipped["buildings under the ground"] == 1


def test_what_is_far_from_the_middle_is_left_out(tmp_path: Path) -> None:
    far = node(1, 30_000.0, 0.0) + node(2, 30_010.0, 0.0)
    text = osm(far, *[node(k, 10.0 * k, 0.0) for k in range(3, 9)], way(1, [1, 2], {"highway": "residential"}),
               way(2, list(range(3, 9)), {"highway": "residential"}))  # fmt: skip
    found = read_osm(written(tmp_path, text))
    assert [street.number for street in found.streets] == [2]
    assert found.skipped == {"objects farther than 10 km from the middle": 1}


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{("&" + chr(97 + k) + ";") * 10}">' for k in range(9))
    + ']><osm version="0.6"><node id="1" lat="1" lon="1"><tag k="name" v="&j;"/></node></osm>'
)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.osm", b"", "must have 1 to"),
        ("map.txt", b"x", "must end in one of"),
        ("text.osm", b"hello", "syntax error"),
        ("bomb.osm", BOMB.encode(), "entities are not supported"),
        ("cut.osm", osm(*STREET).encode()[:-20], "must be a whole OpenStreetMap file"),
        ("nan.osm", b'<osm version="0.6"><node id="1" lat="nan" lon="13.4"/></osm>', "wrong format for coordinate"),
        ("far.osm", b'<osm version="0.6"><node id="1" lat="52" lon="1300"/></osm>', "wrong format for coordinate"),
        ("ref.osm", osm(way(1, [1], {}).replace('ref="1"', 'ref="x"')).encode(), "illegal id"),
        ("plain.osm.gz", b"hello", "must be a whole gzip file"),
        ("cut.osm.gz", gzip.compress(osm(*STREET).encode())[:-12], "must be a whole gzip file"),
        ("noise.osm.pbf", bytes(range(200)), "must be a whole OpenStreetMap file"),
        ("none.osm", osm(node(1, 0.0, 0.0)).encode(), "must hold streets for cars, got none"),
        ("one.osm", osm(node(1, 0.0, 0.0), way(1, [1], {"highway": "residential"})).encode(), "must hold streets"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_osm(file)


def test_a_packaged_map_cut_short_is_refused(tmp_path: Path) -> None:
    content = packaged_maps()["berlin_kreuzberg"].read_bytes()
    file = tmp_path / "cut.osm.pbf"
    for size in (len(content) // 2, len(content) - 1):
        file.write_bytes(content[:size])
        with pytest.raises(InputError, match="must be a whole OpenStreetMap file"):
            read_osm(file)


def test_too_much_is_refused_before_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "blank.osm.gz"
    with gzip.open(file, "wb") as stream:
        stream.write(b" " * 4_000_000)
    monkeypatch.setattr(reader, "LARGEST_TEXT_BYTES", 3_000_000)
    with pytest.raises(InputError, match="at most 3000000 bytes of text"):
        read_osm(file)
    monkeypatch.setattr(reader, "MOST_OBJECTS", {"streets": 4, "outlines": 1, "trees": 1, "points": 100})
    with pytest.raises(InputError, match="at most 4 streets, got more: cut a part"):
        read_osm(blocks(tmp_path / "map.osm"))
    deck = way(1, [901, 902], {"railway": "rail", "bridge": "yes"})
    monkeypatch.setattr(reader, "MOST_OBJECTS", {"points": 3})
    with pytest.raises(InputError, match="at most 3 points, got more"):
        read_osm(written(tmp_path, osm(*STREET, deck), "deck.osm"))
    monkeypatch.setattr(reader, "LARGEST_BYTES", 100)
    with pytest.raises(InputError, match="must have 1 to 100 bytes"):
        read_osm(tmp_path / "map.osm")


def test_a_small_pbf_that_holds_much_is_refused(tmp_path: Path) -> None:
    block = zlib.compress(bytes(2**25))
    blob = b"\x10" + varint(2**25) + b"\x1a" + varint(len(block)) + block
    header = b"\x0a\x07OSMData\x18" + varint(len(blob))
    file = tmp_path / "bomb.osm.pbf"
    file.write_bytes(9 * (len(header).to_bytes(4, "big") + header + blob))
    assert file.stat().st_size < 400_000
    with pytest.raises(InputError, match="at most 268435456 bytes, got more"):
        read_osm(file)


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def test_without_the_extra_its_name_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = blocks(tmp_path / "map.osm")
    graph = StreetGraph.of(read_osm(file))
    for module in ("osmium", "rustworkx"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=r"needs the extra maps: pip install 'lanebound\[maps\]'"):
        read_osm(file)
    with pytest.raises(InputError, match=r"needs the extra maps: pip install 'lanebound\[maps\]'"):
        _ = graph.connected


def test_maps_by_name(tmp_path: Path) -> None:
    first = map_of("berlin_kreuzberg")
    assert map_of("berlin_kreuzberg") is first
    with pytest.raises(InputError, match="did you mean 'berlin_kreuzberg'"):
        map_of("berlin_kreuzbreg")
    with pytest.raises(InputError, match="packaged one or a file"):
        map_of(str(tmp_path / "none.osm"))


def test_the_packaged_map_names_its_license_and_no_author() -> None:
    import osmium

    file = packaged_maps()["berlin_kreuzberg"]
    assert file.stat().st_size < 150_000
    assert "OpenStreetMap contributors" in (file.parent / "ATTRIBUTION.md").read_text(encoding="utf-8")
    assert {one.user for one in osmium.FileProcessor(str(file))} == {""}


@pytest.mark.parametrize("name", ["berlin_kreuzberg", "berlin_neukoelln"])
def test_counts_are_those_of_the_xml(name: str) -> None:
    file = real("maps_osm") / f"{name}.osm.gz"
    root = ET.fromstring(gzip.decompress(file.read_bytes()))
    tags = [{t.get("k"): t.get("v") for t in one.iter("tag")} for one in root.iter("way")]
    closed = {"access": ("private", "no"), "motor_vehicle": ("private", "no"), "vehicle": ("no",)}
    streets = [
        t for t in tags if t.get("highway") in DRIVABLE and not any(t.get(key) in bad for key, bad in closed.items())
    ]
    outlines = [t for t in tags if t.get("building", "no") != "no" or t.get("building:part", "no") != "no"]
    found = read_osm(file)
    assert found.found["streets"] == len(streets)
    assert Counter(street.kind for street in found.streets) <= Counter(t["highway"] for t in streets)
    assert found.found["outlines of buildings"] >= len(outlines)  # and those of relations
    heights = sorted(float(t["height"].split()[0]) for t in outlines if "height" in t and "roof:height" not in t)
    tops = [solid.top_m for solid in found.solids]
    assert all(height in tops for height in heights if height > 3.0) or name == "berlin_neukoelln"
    assert PLACE.lat_deg == pytest.approx(found.frame.lat_deg, abs=0.1)
