"""Separations of the heading filter: equal to two filters side by side, and within their covariance."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from lanebound.integrity.monitoring import dead_reckoning_pl_kernel as dk
from lanebound.integrity.monitoring import heading_separation_kernel as hs
from lanebound.integrity.monitoring.doppler_separation_kernel import IDLE, LOST, MONITORED
from lanebound.integrity.positioning import heading_kernel as hk

DT, ARW, WALK, COURSE_SIGMA, APART_SIGMA = 0.1, 2.5e-4, 5e-6, 0.05, 0.03
EPOCHS = 300


def _filter() -> Any:
    h = np.zeros(1, hk.HEADING)[0]
    h["p_hh"], h["p_bb"], h["p_ss"] = 1.0, 7e-3**2, 4e-3**2
    return h


def _epoch(k: int, innovation: float, h: Any) -> Any:
    """One epoch of the filter with a course two thirds of the time; its TURN."""
    turn, delta = np.zeros(1, hk.TURN)[0], 0.03 * np.sin(0.05 * k)
    hk.expect_turn(delta, DT, ARW, 0.0, h, turn)
    hk.predict_heading(delta, DT, ARW, WALK, h)
    if k % 3:
        hk.observe(hk.correct(innovation, 1.0, 0.0, COURSE_SIGMA**2, h), False, 0.0, h, turn)
    return turn


def test_the_separation_is_the_difference_of_two_filters() -> None:
    rng, with_it, without, c = np.random.default_rng(1), _filter(), _filter(), np.zeros(1, hs.COURSE)[0]
    apart = 0.0
    for k in range(EPOCHS):
        course, seen = 0.2 + 0.05 * rng.normal(), 0.02 + 0.03 * rng.normal()
        before = with_it["angle"] - without["angle"]
        predicted = [copy_of(h, k) for h in (with_it, without)]
        turn = _epoch(k, course - predicted[0], with_it)
        _epoch(k, course - seen - predicted[1], without)
        mean = hs.advance_course(turn, seen if k % 3 else 0.0, MONITORED if k % 3 else IDLE, c)
        ahead = predicted[0] - predicted[1]
        apart = max(apart, abs(mean - 0.5 * (before + ahead)))
    assert apart < 1e-9
    for name, own in (("h", "angle"), ("b", "gyro_bias"), ("s", "gyro_scale")):
        np.testing.assert_allclose(c[name], with_it[own] - without[own], rtol=1e-7, atol=1e-12)
    assert hs.course_state(c) == MONITORED


def copy_of(h: Any, k: int) -> float:
    """Heading that the filter predicts for epoch k."""
    delta = 0.03 * np.sin(0.05 * k)
    return float(h["angle"] + delta * (1.0 - h["gyro_scale"]) - h["gyro_bias"] * DT)


def test_the_covariance_is_that_of_simulated_separations_and_of_what_they_move() -> None:
    """2000 separations by white courses; every variance within its two-sided 1e-3 bound of six together."""
    rng, runs = np.random.default_rng(2), 2000
    h, spread, g = _filter(), np.zeros(1, hs.SPREAD)[0], np.zeros(2, dk.GROWTH)
    courses, moved = np.zeros(runs, hs.COURSE), np.zeros((runs, 2))
    for k in range(EPOCHS):
        turn, drives = _epoch(k, 0.0, h), k > 150
        across = (1.1, -0.4) if drives else (0.0, 0.0)
        hs.advance_spread(turn, APART_SIGMA**2, *across, spread, g)
        seen = APART_SIGMA * rng.normal(size=runs) if k % 3 else np.zeros(runs)
        for i in range(runs):
            mean = hs.advance_course(turn, seen[i], MONITORED if k % 3 else IDLE, courses[i])
            moved[i] += np.multiply(across, mean)
    low, high = chi2.ppf([5e-4 / 5, 1.0 - 5e-4 / 5], df=runs)
    for values, variance in (
        (courses["h"], spread["hh"]), (courses["b"], spread["bb"]), (courses["s"], spread["ss"]),
        (moved[:, 0], g[0]["f_ee"]), (moved[:, 1], g[1]["f_nn"]),
    ):  # fmt: skip
        assert low < (values**2).sum() / variance < high


def test_what_is_no_longer_used_fades() -> None:
    h, c = _filter(), np.zeros(1, hs.COURSE)[0]
    states = []
    for k in range(4000):
        state = LOST if k < 30 else MONITORED if k < 60 else IDLE
        turn = _epoch(1, 0.0, h)
        hs.advance_course(turn, 0.1 if state else 0.0, state, c)
        states.append(hs.course_state(c))
    assert states[10] == LOST
    assert states[100] == LOST
    assert MONITORED in states[100:]
    assert states[-1] == IDLE
    assert c["h"] == 0.0
