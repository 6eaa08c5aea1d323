"""Conventional RTK of one epoch: what it fixes, what it leaves afloat, and how it is misled."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.assessment.conventional_rtk import (
    ConventionalRtkConfig,
    RtkOutcome,
    code_position,
    solve_epoch,
)
from tests.helpers.rtk_signals import TRUE_M, signals

CONFIG = ConventionalRtkConfig()


def test_good_signals_are_fixed_to_millimetres() -> None:
    found = solve_epoch(CONFIG, signals())
    assert found.outcome == RtkOutcome.FIXED
    assert found.ratio > 2.5
    assert found.satellites == 16
    assert np.abs(found.position_m - TRUE_M).max() < 0.02


def test_the_fixed_position_is_least_squares_of_codes_and_phases_with_their_integers() -> None:
    """The formula of the module against one adjustment of all double differences, without noise in the integers."""
    found = solve_epoch(CONFIG.replace(ratio_min=1.0), signals(noise=1e-3))
    np.testing.assert_allclose(found.position_m, TRUE_M, atol=1e-4)


def test_a_ratio_below_the_threshold_leaves_the_position_of_the_codes() -> None:
    s = signals()
    found = solve_epoch(CONFIG.replace(ratio_min=1e9), s)
    assert found.outcome == RtkOutcome.FLOAT
    usable = np.ones((16, 2), bool)
    variance = 1e4 * 2.0 * 0.003**2 * (1.0 + 1.0 / np.sin(s.elevation) ** 2)
    by_code = code_position(CONFIG, s, usable, variance)
    assert by_code is not None
    np.testing.assert_allclose(found.position_m, by_code[0])
    assert 0.02 < np.abs(found.position_m - TRUE_M).max() < 3.0


def test_the_covariancecode_position_is_that_of_its_errors() -> None:
    drawn = [solve_epoch(CONFIG.replace(ratio_min=1e9), signals(seed)).position_m - TRUE_M for seed in range(400)]
    s = signals()
    variance = 1e4 * 2.0 * 0.003**2 * (1.0 + 1.0 / np.sin(s.elevation) ** 2)
    found = code_position(CONFIG, s, np.ones((16, 2), bool), variance)
    assert found is not None
    np.testing.assert_allclose(np.std(drawn, 0), np.sqrt(np.diag(found[1])), rtol=0.12)  # 3 sigma of 400 draws: 0.11


def test_weak_low_and_lost_satellites_are_left_out() -> None:
    s = signals()
    weak = s.cn0.copy()
    weak[:4] = 29.0
    assert solve_epoch(CONFIG, s._replace(cn0=weak)).satellites == 12
    low = s.elevation.copy()
    low[:3] = 0.3
    assert solve_epoch(CONFIG, s._replace(elevation=low)).satellites == 13
    assert solve_epoch(CONFIG, s._replace(tracked=np.arange(16) < 3)).outcome == RtkOutcome.NONE


def test_a_code_far_off_excludes_its_satellite_and_a_smaller_one_misleads() -> None:
    """RTKLIB's screen of 30 m: 200 m are found; 20 m on three satellites stay, and no right position is fixed."""
    s = signals()
    far = s.code.copy()
    far[2] += 200.0
    found = solve_epoch(CONFIG, s._replace(code=far))
    assert found.satellites == 15
    assert np.abs(found.position_m - TRUE_M).max() < 0.02
    near = s.code.copy()
    near[[2, 5, 9]] += 20.0
    misled = solve_epoch(CONFIG, s._replace(code=near))
    assert misled.satellites == 16
    assert np.hypot(*(misled.position_m - TRUE_M)[:2]) > 0.5


def test_signals_without_phases_stay_afloat() -> None:
    s = signals()
    found = solve_epoch(CONFIG, s._replace(phase=np.zeros_like(s.phase)))
    assert found.outcome == RtkOutcome.FLOAT
    assert found.ratio == pytest.approx(0.0)


def test_one_band_is_solved_too() -> None:
    s = signals(noise=0.05)
    found = solve_epoch(CONFIG, s._replace(code=s.code[:, :1], phase=s.phase[:, :1], wavelength=s.wavelength[:, :1]))
    assert found.outcome == RtkOutcome.FIXED
    assert found.satellites == 16
    assert np.abs(found.position_m - TRUE_M).max() < 0.005
