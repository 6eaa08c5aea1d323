"""Prediction of satellites and their geometry along a street."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.prediction import pdop, predict_street


def directions(count: int, seed: int) -> np.ndarray:
    e = np.random.default_rng(seed).normal(size=(count, 3))
    return e / np.linalg.norm(e, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(5))
def test_pdop_is_that_of_the_design_with_a_clock_for_each_system(seed: int) -> None:
    los, system = directions(12, seed), np.arange(12) % 3
    used = np.random.default_rng(seed).random((8, 12)) < 0.75
    for row, found in zip(used, pdop(los, system, used), strict=True):
        clocks = np.unique(system[row])
        design = np.column_stack([los[row], system[row, None] == clocks])
        assert np.linalg.matrix_rank(design) == design.shape[1]
        expected = np.sqrt(np.trace(np.linalg.inv(design.T @ design)[:3, :3]))
        assert found == pytest.approx(expected, rel=1e-9)


def test_too_few_satellites_determine_no_position() -> None:
    los, system = directions(5, 1), np.array([0, 0, 0, 0, 1])
    used = np.array([[1, 1, 1, 0, 0], [1, 1, 1, 0, 1], [1, 1, 1, 1, 0], [0, 0, 0, 0, 0]], bool)
    assert np.isinf(pdop(los, system, used)).tolist() == [True, True, False, True]


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(S, 3\), \(S,\), \(N, S\)"):
        pdop(directions(4, 0), np.zeros(4), np.ones((1, 5)))


def test_the_lane_that_sees_the_fewest_is_predicted() -> None:
    config = SkyConfig()
    view = config.satellites().view(np.array([config.start_gps_s]), *config.place_rad, config.mask_rad)
    free = np.ones((3, 2, 36 * 18), dtype=np.bool_)
    free[1, 1, : 18 * 18] = False  # the eastern half of the sky, for one lane of one station
    street = predict_street(SkyForecast(free, 36, 18, 5.0), view)
    east = view.azimuth_rad[0] < np.pi
    above = int(view.above[0].sum())
    assert street.satellites.tolist() == [above, int((view.above[0] & ~east).sum()), above]
    assert street.pdop[1] > street.pdop[0] == street.pdop[2]
