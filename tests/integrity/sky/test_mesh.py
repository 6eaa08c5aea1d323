"""City models from files, sound and broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from line_of_sight import line_of_sight

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import Surface, city_from_mesh

SUFFIXES = ["obj", "ply", "glb", "stl"]


def _house() -> trimesh.Trimesh:
    """10 m wide, 6 m deep, 8 m high, its front 5 m to the North."""
    house = trimesh.creation.box(extents=(10.0, 6.0, 8.0))
    house.apply_translation((0.0, 8.0, 4.0))
    return house


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_gives_the_same_house(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"house.{suffix}"
    _house().export(file)
    city = city_from_mesh(file)
    assert len(city) == 12
    assert not city.foliage.any()
    np.testing.assert_allclose(city.triangles_enu_m.min((0, 1)), [-5, 5, 0], atol=1e-5)
    np.testing.assert_allclose(city.triangles_enu_m.max((0, 1)), [5, 11, 8], atol=1e-5)
    los = np.array([[0, 1.0, 1.0], [0, 1.0, 2.0], [0, -1.0, 0.1]])
    assert line_of_sight(city, [0, 0, 1.5], los / np.linalg.norm(los, axis=1)[:, None]).tolist() == [
        [False, True, True]
    ]


def test_axes_origin_and_surface(tmp_path: Path) -> None:
    file = tmp_path / "house.obj"
    turned = _house()
    turned.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z up -> y up
    turned.export(file)
    city = city_from_mesh(file, y_up=True, origin_enu_m=(100.0, 0.0, 2.0), surface=Surface.FOLIAGE)
    np.testing.assert_allclose(city.triangles_enu_m.min((0, 1)), [95, 5, 2], atol=1e-5)
    np.testing.assert_allclose(city.triangles_enu_m.max((0, 1)), [105, 11, 10], atol=1e-5)
    assert city.foliage.all()


@pytest.mark.parametrize("suffix", ["ply", "glb", "stl"])
def test_files_cut_short_are_refused(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"house.{suffix}"
    _house().export(whole)
    content = whole.read_bytes()
    for share in (0.05, 0.5, 0.9):
        cut = tmp_path / f"cut.{suffix}"
        cut.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match="mesh"):
            city_from_mesh(cut)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.obj", "", "mesh"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "mesh"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "positive area"),
        ("infinite.obj", "v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "mesh"),
        ("missing.obj", "v 0 0 0\nv 1 0 0\nf 1 2 3\n", "mesh"),
        ("words.stl", "this is no mesh", "mesh"),
        ("house.dxf", "", "must end in"),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, name: str, content: str, words: str) -> None:
    file = tmp_path / name
    file.write_text(content)
    with pytest.raises(InputError, match=words):
        city_from_mesh(file)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a file"):
        city_from_mesh(tmp_path / "none.obj")
