"""Readers of CityGML and CityJSON: boxes of known size, levels of detail, and a drive through Berlin's model."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.sky.maps import city_models
from lanebound.integrity.sky.maps.city_models import read_city_model
from lanebound.integrity.sky.raytrace import first_hits

DATA = "city3d_berlin_lod2"
HEAD = '<CityModel xmlns="http://www.opengis.net/citygml/1.0" xmlns:b="urn:b" xmlns:g="http://www.opengis.net/gml">'


def box(east: float, north: float, base: float, size: float, height: float) -> list[np.ndarray]:
    """Walls and roof of a box, (4, 3) each."""
    foot = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * size + (east, north)
    low, high = (np.insert(foot, 2, z, 1) for z in (base, base + height))
    walls = [np.array([low[k], low[k - 3], high[k - 3], high[k]]) for k in range(4)]
    return [*walls, high]


def gml(*buildings: str, crs: str = "EPSG:25833") -> str:
    return f'{HEAD}<g:Envelope srsName="{crs}"/>{"".join(buildings)}</CityModel>'


def polygon(*rings: np.ndarray) -> str:
    texts = [" ".join(f"{v:.3f}" for v in np.vstack([ring, ring[:1]]).ravel()) for ring in rings]
    parts = [f"<g:LinearRing><g:posList>{text}</g:posList></g:LinearRing>" for text in texts]
    inner = "".join(f"<g:interior>{part}</g:interior>" for part in parts[1:])
    return f"<g:Polygon><g:exterior>{parts[0]}</g:exterior>{inner}</g:Polygon>"


def building(polygons: list[np.ndarray], lod: int = 2, kind: str = "WallSurface") -> str:
    inside = "".join(polygon(one) for one in polygons)
    return f"<b:Building><b:{kind}><b:lod{lod}MultiSurface>{inside}</b:lod{lod}MultiSurface></b:{kind}></b:Building>"


def cityjson(**changes: Any) -> dict[str, Any]:
    corners = np.concatenate(box(1000.0, 2000.0, 5.0, 10.0, 8.0))
    surfaces = [[[4 * k + i for i in range(4)]] for k in range(5)]
    solid = {"type": "Solid", "lod": "1.2", "boundaries": [surfaces]}
    return {
        "type": "CityJSON",
        "version": "2.0",
        "transform": {"scale": [0.001] * 3, "translate": [0.0, 0.0, 0.0]},
        "CityObjects": {"a": {"type": "Building", "geometry": [solid]}, "w": {"type": "WaterBody"}},
        "vertices": np.round(corners * 1000).astype(int).tolist(),
    } | changes


def extent(triangles: np.ndarray) -> np.ndarray:
    return np.ptp(triangles.reshape(-1, 3), axis=0)


def test_boxes_of_citygml(tmp_path: Path) -> None:
    low, tall = box(390_500.0, 5_819_300.0, 30.0, 10.0, 8.0), box(390_540.0, 5_819_300.0, 36.0, 20.0, 25.0)
    ground = building([tall[4] - (0.0, 0.0, 25.0)], kind="GroundSurface").replace("</b:Building>", "")
    both = building(tall) + building(low, 1).replace("</b:Building>", "") + building(low).replace("<b:Building>", "")
    file = tmp_path / "model.gml"
    file.write_text(gml(both, ground + "</b:Building>"), encoding="utf-8")
    found = read_city_model(file)
    assert found.found == {"buildings": 2, "surfaces": 10}  # of the second its LoD2 alone
    first, second = (found.city.triangles_enu_m[found.city.building == k] for k in (0, 1))
    np.testing.assert_allclose(extent(first), (20.0, 20.0, 25.0), atol=0.5)  # turned by 1.3 degrees
    np.testing.assert_allclose(extent(second), (10.0, 10.0, 8.0), atol=0.3)
    assert first[..., 2].min() == second[..., 2].min() == 0.0
    assert found.frame is not None
    assert found.frame.lat_deg == pytest.approx(52.5128, abs=1e-3)


def test_holes_of_citygml(tmp_path: Path) -> None:
    roof = box(0.0, 0.0, 0.0, 20.0, 10.0)[4]
    hole = (0.5 * roof + (5.0, 5.0, 5.0))[::-1]
    text = building([roof]).replace(polygon(roof), polygon(roof, hole))
    file = tmp_path / "model.gml.gz"
    file.write_bytes(gzip.compress(gml(text, crs="local").encode()))
    found = read_city_model(file)
    u, v = (found.city.triangles_enu_m[:, k] - found.city.triangles_enu_m[:, 0] for k in (1, 2))
    assert 0.5 * np.linalg.norm(np.cross(u, v), axis=1).sum() == pytest.approx(300.0)
    assert found.frame is None


def test_holes_of_a_solid(tmp_path: Path) -> None:
    roof = box(0.0, 0.0, 0.0, 20.0, 10.0)[4]
    surface = polygon(roof, (0.5 * roof + (5.0, 5.0, 5.0))[::-1])
    solid = (
        f"<g:Solid><g:exterior><g:Shell><g:surfaceMember>{surface}</g:surfaceMember></g:Shell></g:exterior></g:Solid>"
    )
    file = tmp_path / "model.gml"
    file.write_text(gml(f"<b:Building><b:lod2Solid>{solid}</b:lod2Solid></b:Building>", crs="local"), encoding="utf-8")
    u, v = ((walls := read_city_model(file).city.triangles_enu_m)[:, k] - walls[:, 0] for k in (1, 2))
    assert 0.5 * np.linalg.norm(np.cross(u, v), axis=1).sum() == pytest.approx(300.0)


def test_a_box_of_cityjson(tmp_path: Path) -> None:
    file = tmp_path / "model.city.json"
    file.write_text(json.dumps(cityjson()), encoding="utf-8")
    found = read_city_model(file)
    assert found.found == {"buildings": 1, "surfaces": 5}
    assert found.skipped == {"objects that are no buildings": 1}
    np.testing.assert_allclose(extent(found.city.triangles_enu_m), (10.0, 10.0, 8.0))
    data = cityjson()
    data["CityObjects"]["a"]["geometry"][0]["semantics"] = {
        "surfaces": [{"type": "WallSurface"}, {"type": "GroundSurface"}], "values": [[0, 0, 0, 0, 1]],
    }  # fmt: skip
    file.write_text(json.dumps(data), encoding="utf-8")
    assert read_city_model(file).found["surfaces"] == 4


BOMB = '<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><CityModel>&b;</CityModel>'


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("model.obj", "x", "must end in one of"),
        ("empty.gml", "", "must have 1 to"),
        ("bomb.gml", BOMB, "must have no entities"),
        ("cut.gml", gml(building(box(0, 0, 0, 9, 9)))[:-40], "must be whole XML"),
        ("none.gml", gml(), "must hold a building with surfaces, got none"),
        ("nan.gml", gml(building(box(0, 0, 0, 9, 9)).replace("9.000", "nan")), "must have finite coordinates"),
        ("word.gml", gml(building(box(0, 0, 0, 9, 9)).replace("9.000", "nine")), "must have the form of its format"),
        ("flat.gml", gml(building([np.zeros((4, 3))])), "must hold a surface with an area"),
        ("odd.gml", gml(building(box(0, 0, 0, 9, 9)).replace(" 9.000<", "<")), "must have the form of its format"),
        ("text.json", "{", "must have the form of its format"),
        ("deep.json", "[" * 100_000, "must have the form of its format"),
        ("other.json", "{}", "must have the type CityJSON"),
        ("huge.json", json.dumps(cityjson(vertices=[[10**400, 0, 0]])), "must have the form of its format"),
        ("lost.json", json.dumps(cityjson(vertices=[[0, 0, 0]])), "must name vertices 0 to 0"),
        ("plain.json.gz", "{}", "must be a whole gzip file"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, content: str, words: str) -> None:
    file = tmp_path / name
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_city_model(file)
    with pytest.raises(InputError, match="does not exist"):
        read_city_model(tmp_path / "absent.gml")


def test_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "model.gml"
    file.write_text(gml(building(box(0, 0, 0, 9, 9))), encoding="utf-8")
    monkeypatch.setattr(city_models, "MOST_POLYGONS", 3)
    with pytest.raises(InputError, match="at most 200000 buildings and 3 surfaces"):
        read_city_model(file)
    monkeypatch.setattr(city_models, "LARGEST_BYTES", 100)
    with pytest.raises(InputError, match="must have 1 to 100 bytes"):
        read_city_model(file)


def test_a_recorded_drive_keeps_to_the_streets_of_berlins_model() -> None:
    model = read_city_model(real(DATA) / "berlin_open_data_sample_data.citygml.gz")
    assert model.found["buildings"] == 61
    assert model.frame is not None
    rows = [line.split()[2:5] for line in (real(DATA) / "Berlin_Gendarmenmarkt_GT.txt").read_text().splitlines()]
    lat, lon, _ = geodetic_from_ecef(np.array(rows, dtype=np.float64))
    places = model.frame.en_of(np.rad2deg(lat), np.rad2deg(lon))
    corners = model.city.triangles_enu_m.reshape(-1, 3)
    within = ((places > corners[:, :2].min(0)) & (places < corners[:, :2].max(0))).all(1)
    assert within.sum() > 1000
    above = np.column_stack([places[within], np.full(within.sum(), 500.0)])
    assert first_hits(model.city.grid, above, np.array([0.0, 0.0, -1.0])).clear.all()
    assert np.ptp(corners[:, 2]) == pytest.approx(34.9, abs=0.1)


def test_delft_in_cityjson() -> None:
    model = read_city_model(real(DATA) / "delft_lod1_cityjson.json.gz")
    assert (model.found["buildings"], model.frame) == (160, None)
    np.testing.assert_array_less(extent(model.city.triangles_enu_m), (526.0, 329.0, 18.0))
