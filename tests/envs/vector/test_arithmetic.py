"""The engine's own functions against NumPy's, over the whole of their ranges."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lanebound.envs.vector import arithmetic_kernel as arithmetic
from lanebound.integrity.core.accel import jit

STEPS = 200_001


@jit
def sines(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.sine(x[i])


@jit
def cosines(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.cosine(x[i])


@jit
def arcsines(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.arcsine(x[i])


@jit
def powers(x: Any, y: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.power(x[i], y[i])


@pytest.mark.parametrize(
    ("own", "theirs", "most"),
    [
        (sines, np.sin, arithmetic.FLAT_MOST_RAD),
        (cosines, np.cos, arithmetic.FLAT_MOST_RAD),
        (arcsines, np.arcsin, arithmetic.SINE_MOST),
    ],
)
def test_off_by_two_units_of_the_last_place_at_most(
    own: Callable[..., None], theirs: Callable[..., Any], most: float
) -> None:
    x = np.linspace(-most, most, STEPS)
    found = np.empty(STEPS)
    own(x, found)
    assert (np.abs(found - theirs(x)) <= 2.0 * np.spacing(np.abs(theirs(x)))).all()


def test_nothing_turns_by_nothing() -> None:
    found = np.empty((3, 1))
    for row, own in zip(found, (sines, cosines, arcsines), strict=True):
        own(np.zeros(1), row)
    assert found.ravel().tolist() == [0.0, 1.0, 0.0]


def test_powers_of_speed_ratios() -> None:
    x, y = np.geomspace(1e-12, 1e4, STEPS), np.random.default_rng(0).uniform(3.5, 4.5, STEPS)
    x[0], found = 0.0, np.empty(STEPS)
    powers(x, y, found)
    assert found[0] < 1e-280  # zero, as far as anything that is added to it can tell
    x, y, found = x[1:], y[1:], found[1:]
    exponent = np.maximum(np.abs(y * np.log2(x)), 1.0)
    assert (np.abs(found / np.power(x, y) - 1.0) <= 4e-16 * exponent + 4e-16).all()
