"""``lanebound map``: figures, files and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from osm_files import blocks, node, way
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.street_map import about_map


def test_figures_files_and_a_picture(tmp_path: Path) -> None:
    house = "".join(node(50 + k, *place) for k, place in enumerate([(30, 30), (60, 30), (60, 60), (30, 60)]))
    house += way(200, [50, 51, 52, 53, 50], {"building": "yes", "height": "12"}) + node(70, 10, 10, natural="tree")
    file = blocks(tmp_path / "grid.osm", streets=house)
    done = CliRunner().invoke(app, ["map", str(file), "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found == json.loads((tmp_path / "out" / "map.json").read_text(encoding="utf-8"))
    assert found["found"] == {"trees": 1, "streets": 5, "outlines of buildings": 1}
    assert (found["junctions"], found["pieces"], found["connected"], found["in_buildings"]) == (6, 14, 14, 0)
    assert (found["solids"], found["height_median_m"]) == (1, 12.0)
    assert [round(way["length_m"] / 240.0) for way in found["ways"]] == [3, 3, 2, 2, 2, 2]
    assert (tmp_path / "out" / "map.png").read_bytes()[:4] == b"\x89PNG"
    shown = CliRunner().invoke(app, ["map", str(file)])
    assert shown.exit_code == 0
    assert "world.route" in shown.stdout


def test_a_map_without_closed_ways_and_a_file_that_is_none(tmp_path: Path) -> None:
    found, roads = about_map(str(blocks(tmp_path / "grid.osm", oneway="yes")))
    assert (roads, found["ways"], found["height_max_m"]) == ([], [], None)
    refused = CliRunner().invoke(app, ["map", str(tmp_path / "none.osm")])
    assert refused.exit_code == 2
    assert "packaged one or a file" in refused.stderr
    with pytest.raises(ValueError, match="packaged one or a file"):
        about_map("nowhere")


def test_a_city_model(tmp_path: Path) -> None:
    corners = [[x, y, z] for z in (5.0, 17.0) for x, y in ((0, 0), (20, 0), (20, 10), (0, 10))]
    faces = [[[0, 1, 5, 4]], [[1, 2, 6, 5]], [[2, 3, 7, 6]], [[3, 0, 4, 7]], [[4, 5, 6, 7]]]
    shape = {"type": "MultiSurface", "lod": "1", "boundaries": faces}
    objects = {"a": {"type": "Building", "geometry": [shape]}, "t": {"type": "Road"}}
    file = tmp_path / "model.city.json"
    file.write_text(json.dumps({"type": "CityJSON", "CityObjects": objects, "vertices": corners}), encoding="utf-8")
    done = CliRunner().invoke(app, ["map", str(file), "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert (found["found"], found["lat_deg"]) == ({"buildings": 1, "surfaces": 5}, None)
    assert (found["height_median_m"], found["height_max_m"]) == (12.0, 12.0)
    assert (tmp_path / "out" / "map.png").read_bytes()[:4] == b"\x89PNG"
    shown = CliRunner().invoke(app, ["map", str(file)])
    assert "objects that are no buildings" in shown.stdout
    file.write_text("{}", encoding="utf-8")
    assert CliRunner().invoke(app, ["map", str(file)]).exit_code == 2
