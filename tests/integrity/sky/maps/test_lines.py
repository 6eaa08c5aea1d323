"""Lines by arc length: parts with their ends, points in between, and places along them."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.sky.maps.lines import along, arcs_of, part_of, points_at

LINE = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0], [13.0, 10.0]])


def test_arcs_and_points() -> None:
    np.testing.assert_array_equal(arcs_of(LINE), [0.0, 5.0, 11.0, 21.0])
    np.testing.assert_array_equal(points_at(LINE, arcs_of(LINE)), LINE)
    np.testing.assert_allclose(points_at(LINE, np.array([2.5, 16.0, 99.0])), [[1.5, 2.0], [8.0, 10.0], [13.0, 10.0]])


@pytest.mark.parametrize(
    ("clear_m", "between"), [(0.0, [[3.0, 4.0], [3.0, 10.0]]), (1.0, [[3.0, 10.0]]), (9.0, np.zeros((0, 2)))]
)
def test_a_part_has_its_ends_and_the_points_that_are_clear_of_them(clear_m: float, between: list[list[float]]) -> None:
    found = part_of(LINE, 4.5, 16.0, clear_m)
    np.testing.assert_allclose(found, [[2.7, 3.6], *between, [8.0, 10.0]])


def test_two_parts_have_the_length_of_the_whole() -> None:
    for cut in (0.5, 5.0, 12.0):
        lengths = [arcs_of(part_of(LINE, *ends, 1e-6))[-1] for ends in ((0.0, cut), (cut, 21.0))]
        assert sum(lengths) == pytest.approx(21.0)


def test_places_along_are_at_most_so_far_apart() -> None:
    found = along(LINE, 4.0)
    assert len(found) == 7
    np.testing.assert_array_equal(found[[0, -1]], LINE[[0, -1]])
