"""Polygons: triangles cover them exactly, holes stay open, and inside is what Matplotlib says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path as Outline

from lanebound.integrity.sky.maps.polygons import cleaned, crossing, inside, signed_area, triangulated


def star(seed: int, corners: int, size_m: float = 20.0) -> np.ndarray:
    """A polygon with corners at rising angles and random distances: it does not cross itself."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(corners) + 0.8 * rng.random(corners)) / corners
    ring = cleaned(size_m * rng.uniform(0.3, 1.0, corners)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1))
    assert ring is not None
    return ring


def areas(triangles: np.ndarray) -> np.ndarray:
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


@given(st.integers(0, 2**31), st.integers(5, 40))
@settings(max_examples=60, deadline=None)
def test_triangles_cover_a_polygon_and_nothing_else(seed: int, corners: int) -> None:
    ring = star(seed, corners)
    triangles = triangulated([ring])
    assert len(triangles) == len(ring) - 2
    assert areas(triangles).min() > -1e-9  # none is turned over, so that equal areas mean no overlap
    assert areas(triangles).sum() == pytest.approx(signed_area(ring), rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_holes_stay_open(seed: int) -> None:
    ring = star(seed, 24, 60.0)
    hole, other = (cleaned(0.2 * star(seed + k, 7) + (0.0, 6.0 * k - 3.0), clockwise=True) for k in (0, 1))
    assert hole is not None
    assert other is not None
    triangles = triangulated([ring, hole, other])
    assert areas(triangles).sum() == pytest.approx(sum(map(signed_area, (ring, hole, other))), rel=1e-9)
    sound = areas(triangles) > 1e-9
    assert inside(triangles[sound].mean(1), [ring, hole, other]).all()


@given(st.integers(0, 2**31), st.integers(1, 30), st.integers(3, 9))
@settings(max_examples=200, deadline=None)
def test_cuts_to_holes_cross_no_other_hole(seed: int, holes: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.permutation(36)[:holes]
    middles = 10.0 * np.stack([cells % 6, cells // 6], -1) + 5.0
    turned = np.array([[np.cos(seed), -np.sin(seed)], [np.sin(seed), np.cos(seed)]]) if seed % 2 else np.eye(2)
    outline = np.array([(0.0, 0.0), (60.0, 0.0), (60.0, 60.0), (0.0, 60.0)])
    shapes = [np.round(star(seed + k, corners, 5.0) + middle, seed % 3) for k, middle in enumerate(middles)]
    rings = [ring for k, shape in enumerate([outline, *shapes])
             if (ring := cleaned(shape @ turned.T, clockwise=k > 0)) is not None]  # fmt: skip
    found = areas(triangulated(rings))  # of corners in whole metres some touch
    assert found.min() > -1e-3
    assert np.abs(found).sum() == pytest.approx(sum(map(signed_area, rings)), rel=1e-6)


def test_two_courtyards_and_many() -> None:
    outline = np.array([(0.0, 0.0), (50.0, 0.0), (50.0, 40.0), (0.0, 40.0)])
    holes = [np.array([(x, 10.0), (x, 30.0), (x + w, 30.0), (x + w, 10.0)]) for x, w in ((5.0, 1.0), (25.0, 1.0))]
    assert np.abs(areas(triangulated([outline, *holes]))).sum() == pytest.approx(1960.0)
    many = [np.array([(x, y), (x, y + 0.5), (x + 0.5, y)]) for x in 1.0 + np.arange(48) for y in 1.0 + np.arange(27)]
    found = areas(triangulated([outline, *many]))  # as many corners as a polygon may have
    assert found.min() > -1e-9
    assert np.abs(found).sum() == pytest.approx(2000.0 - 0.125 * len(many))


@pytest.mark.parametrize("seed", range(8))
def test_inside_is_what_matplotlib_says(seed: int) -> None:
    ring = star(seed, 17)
    points = np.random.default_rng(seed).uniform(-25.0, 25.0, (2000, 2))
    expected = Outline(np.vstack([ring, ring[:1]])).contains_points(points)
    assert 0.05 < expected.mean() < 0.6
    np.testing.assert_array_equal(inside(points, [ring]), expected)


def test_rings_without_area_are_none() -> None:
    for points in ([(0, 0), (1, 0)], [(0, 0), (1, 0), (2, 0)], [(0, 0), (0, 0), (5, 0)], [(0, 0)] * 4):
        assert cleaned(np.array(points, dtype=float)) is None
    ring = cleaned(np.array([(0, 0), (0, 1), (0, 1), (1, 1), (1, 0), (0, 0)], dtype=float))
    assert ring is not None
    assert len(ring) == 4
    assert signed_area(ring) == 1.0


def test_the_work_ends_for_polygons_that_touch_and_cross_themselves() -> None:
    bow = np.array([(0, 0), (2, 2), (2, 0), (0, 2)], dtype=float)
    assert triangulated([bow]).shape == (2, 3, 2)
    rng = np.random.default_rng(0)
    assert triangulated([rng.random((300, 2))]).shape == (298, 3, 2)


def test_where_lines_cross() -> None:
    line = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    at = crossing(line, np.array([5.0, -5.0]), np.array([5.0, 5.0]))
    np.testing.assert_allclose(at[0], (5.0, 0.0))
    assert np.isnan(at[1]).all()
    assert np.isnan(crossing(line, np.array([0.0, 1.0]), np.array([9.0, 1.0]))).all()  # parallel to the first
