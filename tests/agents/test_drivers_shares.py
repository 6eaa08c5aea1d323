"""Shares of a range: its ends, its middle, and back again."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lanebound.agents.drivers.shares import share_of, value_of

BOUNDS = (-5.0, 3.0)


def test_the_ends_are_minus_one_and_one_and_nothing_lies_beyond() -> None:
    np.testing.assert_array_equal(share_of(np.array([-9.0, -5.0, -1.0, 3.0, 4.0]), BOUNDS), [-1.0, -1.0, 0.0, 1.0, 1.0])


@given(st.floats(*BOUNDS))
def test_a_value_within_its_bounds_comes_back(value: float) -> None:
    np.testing.assert_allclose(value_of(share_of(np.array(value), BOUNDS), BOUNDS), value, atol=1e-12)
