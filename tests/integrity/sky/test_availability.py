"""The model of availability: fits, gaps, its file, and the packaged one."""

from __future__ import annotations

import json

import numpy as np

from lanebound.integrity.sky.availability import AvailabilityModel, gaps_along, likely, packaged_model


def samples(n: int = 4000) -> AvailabilityModel:
    """RTK by satellites; a usable position by the gap."""
    rng = np.random.default_rng(1)
    number = rng.integers(0, 30, n).astype(float)
    rtk = rng.random(n) < number / 30.0
    gap = rng.uniform(0.0, 60.0, n)
    usable = rng.random(n) < np.exp(-gap / 20.0)
    level = np.where(usable, 0.1, 10.0)
    return AvailabilityModel.fitted(number, np.full(n, 2.0), rtk, usable, level, lambda _: gap, (0.1, 0.5, 0.9))


def test_probabilities_are_those_of_the_samples() -> None:
    model = samples()
    gap = np.array([1.0, 10.0, 20.0, 40.0])
    np.testing.assert_allclose(model.probability(np.full(4, 15.0), gap), np.exp(-gap / 20.0), atol=0.1)
    np.testing.assert_array_equal(likely(model.fix, np.array([2.0, 29.0]), np.full(2, 2.0)), [False, True])
    assert np.all(np.diff(model.quantiles(np.array([0.5])), axis=1) >= 0.0)


def test_a_model_is_the_same_after_its_file() -> None:
    model = samples()
    again = AvailabilityModel.of(json.loads(json.dumps(model.to_dict())))
    number, gap = np.linspace(0.0, 30.0, 50), np.linspace(0.0, 70.0, 50)
    np.testing.assert_array_equal(again.probability(number, gap), model.probability(number, gap))
    np.testing.assert_array_equal(again.quantiles(np.linspace(0, 1, 9)), model.quantiles(np.linspace(0, 1, 9)))


def test_gaps_begin_where_rtk_was_last_likely() -> None:
    good = np.array([False, False, True, False, False, True])
    at_s = np.array([1.0, 3.0, 5.0, 7.0, 9.0, 11.0])
    np.testing.assert_allclose(gaps_along(good, at_s, 4.0), [5.0, 7.0, 0.0, 2.0, 4.0, 0.0])


def test_the_packaged_model_trusts_open_streets_and_no_long_gap() -> None:
    model = packaged_model()
    open_sky, canyon = model.probability([35.0, 8.0], [0.0, 60.0])
    assert open_sky > 0.8
    assert canyon < 0.3
    assert likely(model.fix, np.array([35.0]), np.array([1.0]))[0]
    assert model.levels.shape == (model.edges.size + 1, model.shares.size)
    assert np.all(np.diff(model.levels, axis=1) >= 0.0)
