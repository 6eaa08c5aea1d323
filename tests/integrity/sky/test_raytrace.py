"""Rays against triangles: published cases, a street canyon, and the grid against the plain form."""

from __future__ import annotations

import numpy as np
import pytest
from line_of_sight import line_of_sight

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.raytrace import build_grid, first_hits
from lanebound.integrity.sky.scene import City, Surface, prisms
from plain_rays import first_hits_reference, moller_trumbore

HALF_SQUARE = [[0, 0, 0], [2, 0, 0], [0, 2, 0]]
UNIT = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
OCTANT = [[10, 0, 0], [0, 10, 0], [0, 0, 10]]

# MEDYAN's RayTriangleIntersect test (first six), percepto's moller_trumbore test, mcbench
# rayTriangleIntersection/test.m, and two derived by hand: origin, direction, triangle, hit, (t, u, v)
CASES = [
    ("parallel", (0, 0, 2), (1, 1, 0), HALF_SQUARE, False, None),
    ("outside_v", (0, 0, 2), (1, -1, -2), HALF_SQUARE, False, (1.0, 0.5, -0.5)),
    ("outside_u", (0, 0, 2), (-1, 1, -2), HALF_SQUARE, False, (1.0, -0.5, 0.5)),
    ("outside_sum", (0, 0, 2), (2, 2, -2), HALF_SQUARE, False, (1.0, 1.0, 1.0)),
    ("inside", (0, 0, 2), (0.5, 0.5, -2), HALF_SQUARE, True, (1.0, 0.25, 0.25)),
    ("behind", (0, 0, 2), (-0.5, -0.5, 2), HALF_SQUARE, False, (-1.0, 0.25, 0.25)),
    ("quarter", (0.25, 0.25, 1), (0, 0, -1), UNIT, True, (1.0, 0.25, 0.25)),
    ("octant", (10, 10, 10), (-0.3, -0.5, -0.7), OCTANT, True, (40 / 3, 1 / 3, 1 / 15)),
    ("edge", (0, 1, 5), (0, 0, -1), HALF_SQUARE, True, (5.0, 0.0, 0.5)),
    ("vertex", (2, 0, 5), (0, 0, -1), HALF_SQUARE, True, (5.0, 1.0, 0.0)),
]


@pytest.mark.parametrize(("name", "origin", "direction", "triangle", "hit", "tuv"), CASES, ids=[c[0] for c in CASES])
def test_published_cases(name: str, origin, direction, triangle, hit: bool, tuv) -> None:  # type: ignore[no-untyped-def]
    found, *values = moller_trumbore(origin, direction, triangle)
    assert bool(found) is hit
    if tuv is not None:
        np.testing.assert_allclose(values, tuv, atol=1e-12)
    kernel = first_hits(build_grid([triangle], [False]), origin, direction)
    assert bool(kernel.triangle[0] == 0) is hit
    assert kernel.t[0] == (pytest.approx(tuv[0]) if hit else np.inf)


def test_line_of_sight_in_a_canyon_of_two_buildings() -> None:
    # Mask of trimesh 5.2.0 (ray.intersects_any): boxes 60 m long along East, 40 m high 10 m to the North, 20 m high
    # 10 m to the South. For each azimuth 0, 15, ... 345 deg, how many of elevations 10, 30, 45, 60, 75 deg are seen;
    # it is always the highest ones.
    seen = [0, 0, 0, 1, 1, 5, 5, 5, 3, 2, 2, 2, 2, 2, 2, 2, 3, 5, 5, 5, 1, 1, 0, 0]
    foot = [[[-30, 10], [30, 10], [30, 25], [-30, 25]], [[-30, -25], [30, -25], [30, -10], [-30, -10]]]
    city = City.of(prisms(foot, 0.0, [40.0, 20.0]))
    az, el = np.deg2rad(15.0 * np.arange(24))[:, None], np.deg2rad([10.0, 30.0, 45.0, 60.0, 75.0])
    los = np.stack(np.broadcast_arrays(np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), np.sin(el)), -1)
    clear = line_of_sight(city, [0.37, 1.13, 1.5], los.reshape(-1, 3)).reshape(24, 5)
    np.testing.assert_array_equal(clear, np.arange(5) >= 5 - np.array(seen)[:, None])


@pytest.mark.parametrize("cell_m", [3.0, 10.0, 500.0])
def test_grid_agrees_with_testing_every_triangle(cell_m: float) -> None:
    rng = np.random.default_rng(7)
    triangles = rng.uniform(-50, 50, (300, 1, 3)) + rng.uniform(-12, 12, (300, 3, 3))
    foliage = rng.random(300) < 0.3
    origin, direction = rng.uniform(-70, 70, (600, 3)), rng.normal(size=(600, 3))
    direction[:20, :2] = 0.0  # vertical
    direction[20:40, 2] = 0.0  # level
    direction[40:60, 0] = 0.0
    fast = first_hits(build_grid(triangles, foliage, cell_m), origin, direction)
    slow = first_hits_reference(origin, direction, triangles, foliage)
    np.testing.assert_array_equal(fast.triangle, slow.triangle)
    np.testing.assert_allclose(fast.t, slow.t, rtol=1e-9)
    before = slow.foliage_t < slow.t
    np.testing.assert_array_equal(fast.foliage_t < fast.t, before)
    np.testing.assert_allclose(fast.foliage_t[before], slow.foliage_t[before], rtol=1e-9)
    assert 0.1 < fast.clear.mean() < 0.9


def test_many_rays_take_the_same_answers_in_parallel() -> None:
    rng = np.random.default_rng(8)
    city = City.of(prisms([[[-5, 4], [5, 4], [5, 9], [-5, 9]]], 0.0, 12.0))
    direction = rng.normal(size=(5000, 3))
    many = first_hits(city.grid, np.zeros(3), direction)
    few = first_hits(city.grid, np.zeros(3), direction[:100])
    np.testing.assert_array_equal(many.t[:100], few.t)


def test_rays_through_the_seam_of_a_quad_do_not_leak() -> None:
    wall = City.of([[[-1, 5, 0], [1, 5, 0], [1, 5, 2]], [[-1, 5, 0], [1, 5, 2], [-1, 5, 2]]])
    x = np.linspace(-0.999, 0.999, 501)
    target = np.column_stack([x, np.full_like(x, 5.0), 1.0 + x])  # along the diagonal
    assert not first_hits(wall.grid, np.zeros(3), target).clear.any()


def test_triangles_without_area_and_no_triangles_at_all() -> None:
    flat = City.of([[[0, 1, 0], [0, 1, 0], [0, 1, 5]]])
    assert first_hits(flat.grid, np.zeros(3), [[0, 1.0, 0.5]]).clear.all()
    nothing = first_hits(City.empty().grid, np.zeros((4, 3)), np.ones((4, 3)))
    assert nothing.clear.all()
    assert first_hits_reference(np.zeros((4, 3)), np.ones((4, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool)).clear.all()


def test_joined_cities_keep_their_surfaces() -> None:
    both = City.of([UNIT]) + City.of([OCTANT], Surface.FOLIAGE)
    assert len(both) == 2
    assert both.foliage.tolist() == [False, True]


def test_bad_input_is_refused() -> None:
    grid = build_grid([UNIT], [False])
    with pytest.raises(InputError, match="origin"):
        first_hits(grid, [0, 0, np.nan], [0, 0, 1])
    with pytest.raises(InputError, match="direction"):
        first_hits(grid, [0, 0, 0], [0, 1])
    with pytest.raises(InputError, match="foliage"):
        build_grid([UNIT], [False, True])
    with pytest.raises(InputError, match="triangles"):
        City.of(np.full((1, 3, 3), np.inf))
    with pytest.raises(InputError, match="surface"):
        City(np.zeros((2, 3, 3)), np.zeros(1, dtype=np.uint8))
