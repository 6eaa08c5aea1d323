"""Reflecting faces and diffracting edges of a mask: against the geometry of plain walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Material, clad
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

HIGH_M, ANTENNA_M = 20.0, 1.5


def wall(
    north_m: float, height_m: float = HIGH_M, material: Material = Material.CONCRETE, half_m: float = 500.0
) -> City:
    """A wall along East, ``north_m`` north of the street, of two triangles."""
    y = north_m
    c = [[-half_m, y, 0.0], [half_m, y, 0.0], [half_m, y, height_m], [-half_m, y, height_m]]
    plain = City.of([[c[0], c[1], c[2]], [c[0], c[2], c[3]]])
    return City(plain.triangles_enu_m, plain.surface, plain.building, np.full(2, int(material)))


def mask_of(city: City) -> SkyMask:
    return SkyMask.of_stations(np.array([[[0.0, 0.0, ANTENNA_M]]]), city, az_step_deg=3.0, el_step_deg=3.0)


def cell(mask: SkyMask, azimuth_deg: float, elevation_deg: float) -> int:
    return int(azimuth_deg / 360.0 * mask.azimuths) * mask.elevations + int(elevation_deg / 90.0 * mask.elevations)


def test_the_triangles_of_a_wall_are_one_face_that_reflects_the_sky_across_the_street() -> None:
    mask = mask_of(wall(12.0))
    table, face = mask.faces.table, mask.faces.face[0, 0]
    assert len(table) == 1
    np.testing.assert_allclose(np.abs(table["normal"][0]), [0.0, 1.0, 0.0], atol=1e-12)
    assert table["offset"][0] * table["normal"][0, 1] == pytest.approx(12.0, abs=1e-9)
    assert face[cell(mask, 181.0, 40.0)].tolist() == [0, -1]
    assert face[cell(mask, 1.0, 40.0)].tolist() == [-1, -1]  # no wall in the south
    reflected = face[:, 0] >= 0
    np.testing.assert_array_equal(reflected, mask.excess_m[0, 0] > 0.0)


@pytest.mark.parametrize(("north_m", "height_m"), [(12.0, 20.0), (30.0, 200.0)])
def test_the_path_by_the_face_is_the_excess_of_the_mask_at_the_station(north_m: float, height_m: float) -> None:
    mask = mask_of(wall(north_m, height_m))
    at, az, el = cell(mask, 181.5, 40.5), np.radians(181.5), np.radians(40.5)  # the centre of a cell
    plane = mask.faces.table[mask.faces.face[0, 0, at, 0]]
    e = np.array([np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), np.sin(el)])
    d = abs(plane["normal"] @ [0.0, 0.0, ANTENNA_M] - plane["offset"])
    assert d == pytest.approx(north_m, abs=1e-9)
    assert 2.0 * d * abs(e @ plane["normal"]) == pytest.approx(mask.excess_m[0, 0, at], rel=1e-6)


def test_the_two_reflections_of_most_power_are_kept_in_order() -> None:
    """A concrete and a metal wall at a corner both reflect one satellite: metal comes first, though it is farther."""
    corner = wall(10.0) + City(
        wall(10.0).triangles_enu_m[..., [1, 0, 2]] + np.array([14.0, 0.0, 0.0]),
        np.zeros(2, np.uint8),
        material=np.full(2, int(Material.METAL)),
    )
    mask = mask_of(corner)
    found = mask.faces.face[0, 0, cell(mask, 226.0, 20.0)]
    assert [Material(mask.faces.table["material"][k]) for k in found] == [Material.METAL, Material.CONCRETE]


@pytest.mark.parametrize("azimuth_deg", [1.5, 31.5, 61.5])
def test_the_skyline_is_the_eave_of_the_wall(azimuth_deg: float) -> None:
    mask = mask_of(wall(12.0))
    a = int(azimuth_deg / 3.0)
    line = mask.faces.edges[mask.faces.edge[0, 0, a]]
    np.testing.assert_allclose(line["point"], [0.0, 12.0, HIGH_M], atol=1e-9)
    np.testing.assert_allclose(line["along"], [1.0, 0.0, 0.0], atol=1e-12)
    assert mask.faces.edge[0, 0, 60] == -1  # southward


def test_the_edges_of_a_street_are_those_of_its_roofs() -> None:
    """Every edge lies on its building's outline at the height of its roof, and is crossed in the azimuth it is for."""
    feet = [
        [[-30.0, 10.0], [-5.0, 10.0], [-5.0, 25.0], [-30.0, 25.0]],
        [[0.0, 8.0], [20.0, 12.0], [17.0, 27.0], [-3.0, 23.0]],
    ]
    mask = mask_of(City.of_buildings(feet, [15.0, 25.0]))
    lines, antenna = mask.faces.edges[mask.faces.edge[0, 0]], np.array([0.0, 0.0, ANTENNA_M])
    azimuth = 2.0 * np.pi * (np.arange(mask.azimuths) + 0.5) / mask.azimuths
    found = 0
    for az, line, number in zip(azimuth, lines, mask.faces.edge[0, 0], strict=True):
        if number < 0:
            continue
        found += 1
        assert line["along"][2] == pytest.approx(0.0, abs=1e-12)
        foot = np.array(feet[0] if line["point"][2] == pytest.approx(15.0) else feet[1])
        corner, side = foot - line["point"][:2], np.array([line["along"][1], -line["along"][0]])
        near = np.abs(corner @ side) < 1e-6
        assert np.sum(near) == 2
        way = np.array([np.sin(az), np.cos(az)])
        distance = ((line["point"] - antenna)[:2] @ side) / (way @ side)
        place = np.sort(foot[near] @ line["along"][:2])
        assert place[0] - 1e-6 <= distance * way @ line["along"][:2] <= place[1] + 1e-6
        top = np.array(
            [
                path in (SignalPath.BLOCKED, SignalPath.REFLECTED)
                for path in mask.path[0, 0].reshape(mask.azimuths, -1)[int(az / 2.0 / np.pi * mask.azimuths)]
            ]
        )
        skyline = np.arctan2(line["point"][2] - ANTENNA_M, distance)
        assert abs(np.degrees(skyline) / 3.0 - 0.5 - np.flatnonzero(top).max()) <= 1.0
    assert found > 30


def test_faces_survive_a_file(tmp_path: Path) -> None:
    one = mask_of(wall(12.0))
    one.save(tmp_path / "mask.npz")
    again = SkyMask.load(tmp_path / "mask.npz")
    np.testing.assert_array_equal(again.faces.face, one.faces.face)
    np.testing.assert_array_equal(again.faces.table, one.faces.table)
    np.testing.assert_array_equal(again.faces.edge, one.faces.edge)
    np.testing.assert_array_equal(again.faces.edges, one.faces.edges)
    assert [part.dtype.isalignedstruct for part in again.rows] == [part.dtype.isalignedstruct for part in one.rows], (
        "kernels are compiled for the one or the other"
    )


def test_an_open_sky_has_no_faces() -> None:
    assert SkyMask.open().faces.face.shape[0] == 0
    road = mask_of(City.empty())
    assert len(road.faces.table) == 0
    assert (road.path == SignalPath.LOS).all()


def test_buildings_are_clad_by_the_shares_and_the_rest_is_concrete() -> None:
    building = np.repeat(np.arange(4000), 3)
    material = clad(np.append(building, -1), (0.4, 0.2, 0.35, 0.05), np.random.default_rng(3))
    assert material[-1] == Material.CONCRETE
    each = material[:-1].reshape(-1, 3)
    assert (each == each[:, :1]).all()
    shares = np.bincount(each[:, 0], minlength=4) / 4000.0
    np.testing.assert_allclose(shares, (0.4, 0.2, 0.35, 0.05), atol=4.0 * 0.5 / np.sqrt(4000.0))  # 4 sigma each


def test_roads_and_stations_give_the_same_faces() -> None:
    city = wall(12.0)
    built = SkyMask.build(Road.straight(10.0, 0.5 * np.pi), city, station_spacing_m=10.0)
    assert built.faces.face.shape == (2, built.path.shape[1], built.path.shape[2], 2)
    assert len(built.faces.table) == 1
