"""Separations of the heading filter: equal to two filters side by side, and within their covariance."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from lanebound.integrity.core.simd_kernel import padded
from lanebound.integrity.monitoring import dead_reckoning_pl_kernel as dk
from lanebound.integrity.monitoring import heading_separation_kernel as hs
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    IDLE,
    LOST,
    MONITORED,
    Influences,
    Separations,
)
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


def _courses(modes: int) -> hs.Courses:
    return hs.Courses(*(np.zeros(padded(modes)) for _ in hs.Courses._fields))


def _seen(c: hs.Courses, seen: Any, state: float) -> Influences:
    """Influences whose separation East is ``seen`` for the course of a vehicle that drives North at 1 m/s."""
    width, zeros = c.h.size, np.zeros(c.h.size)
    apart = np.broadcast_to(np.pad(np.atleast_1d(seen), (0, width - np.size(seen))), width).copy()
    return Influences(apart, zeros, np.full(width, APART_SIGMA), zeros, zeros, np.full(width, state))


def _advance(turn: Any, seen: Any, state: float, c: hs.Courses) -> float:
    """Advance with what each mode has done to the course, where the epoch has one."""
    if turn["k_h"] != 0.0:
        turn["right"] = 1.0, 0.0
    return float(hs.advance_courses(turn, _seen(c, seen, state), c))


def _state(c: hs.Courses) -> float:
    """State of the first mode."""
    out, width = np.zeros(c.h.size), c.h.size
    now, s = _seen(c, 0.0, IDLE), Separations(*(np.zeros(width) for _ in Separations._fields))
    hs.raise_states(now, s, c, out)
    hs.move_by_courses(1.0, 0.0, c, s)
    assert s.state[0] == out[0]
    return float(out[0])


def test_the_separation_is_the_difference_of_two_filters() -> None:
    rng, with_it, without, c = np.random.default_rng(1), _filter(), _filter(), _courses(1)
    apart = 0.0
    for k in range(EPOCHS):
        course, seen = 0.2 + 0.05 * rng.normal(), 0.02 + 0.03 * rng.normal()
        before = with_it["angle"] - without["angle"]
        predicted = [copy_of(h, k) for h in (with_it, without)]
        turn = _epoch(k, course - predicted[0], with_it)
        _epoch(k, course - seen - predicted[1], without)
        _advance(turn, seen, MONITORED, c)
        ahead = predicted[0] - predicted[1]
        apart = max(apart, abs(c.mean[0] - 0.5 * (before + ahead)))
    assert apart < 1e-9
    for name, own in (("h", "angle"), ("b", "gyro_bias"), ("s", "gyro_scale")):
        np.testing.assert_allclose(getattr(c, name)[0], with_it[own] - without[own], rtol=1e-7, atol=1e-12)
    assert hs.largest_course(c) == np.abs(c.h).max()
    assert _state(c) == MONITORED


def copy_of(h: Any, k: int) -> float:
    """Heading that the filter predicts for epoch k."""
    delta = 0.03 * np.sin(0.05 * k)
    return float(h["angle"] + delta * (1.0 - h["gyro_scale"]) - h["gyro_bias"] * DT)


def test_the_covariance_is_that_of_simulated_separations_and_of_what_they_move() -> None:
    """2000 separations by white courses; every variance within its two-sided 1e-3 bound of six together."""
    rng, runs = np.random.default_rng(2), 2000
    h, spread, g = _filter(), np.zeros(1, hs.SPREAD)[0], np.zeros(2, dk.GROWTH)
    courses, moved = _courses(runs), np.zeros((runs, 2))
    for k in range(EPOCHS):
        turn, drives = _epoch(k, 0.0, h), k > 150
        across = (1.1, -0.4) if drives else (0.0, 0.0)
        largest = _advance(turn, APART_SIGMA * rng.normal(size=runs), MONITORED, courses)
        assert largest == (APART_SIGMA**2 if k % 3 else 0.0)
        hs.advance_spread(turn, largest, *across, spread, g)
        moved += np.outer(courses.mean[:runs], across)
    low, high = chi2.ppf([5e-4 / 5, 1.0 - 5e-4 / 5], df=runs)
    for values, variance in (
        (courses.h, spread["hh"]), (courses.b, spread["bb"]), (courses.s, spread["ss"]),
        (moved[:, 0], g[0]["f_ee"]), (moved[:, 1], g[1]["f_nn"]),
    ):  # fmt: skip
        assert low < (values**2).sum() / variance < high


def test_what_is_no_longer_used_fades() -> None:
    h, c = _filter(), _courses(1)
    states = []
    for k in range(4000):
        state = LOST if k < 30 else MONITORED if k < 60 else IDLE
        turn = _epoch(1, 0.0, h)
        _advance(turn, 0.1 if state else 0.0, state, c)
        states.append(_state(c))
    assert states[10] == LOST
    assert states[100] == LOST
    assert MONITORED in states[100:]
    assert states[-1] == IDLE
    assert c.h[0] == 0.0
