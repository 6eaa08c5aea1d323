"""Separations of the heading filter: equal to two filters side by side, and within their covariance."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from scipy.stats import chi2

from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring import dead_reckoning_pl_kernel as dk
from lanebound.integrity.monitoring import heading_separation_kernel as hs
from lanebound.integrity.monitoring.doppler_separation_kernel import IDLE, LOST, MONITORED, SEPARATION
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import FAULT
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


@numba.njit
def _advance_all(turn: Any, faults: Records) -> float:
    largest = 0.0
    for k in range(faults.shape[0]):
        largest = max(largest, hs.advance_course(turn, faults[k].now, faults[k].course))
    return largest


def _advance(turn: Any, seen: Any, state: int, faults: Records) -> float:
    """Advance with what each mode has done to the course, where the epoch has one.

    The velocity less that without the mode is ``seen`` East, for the course of a vehicle that drives North at 1 m/s.
    """
    if turn["k_h"] != 0.0:
        turn["right"] = 1.0, 0.0
    now = faults["now"]
    now["d_e"], now["l_ee"], now["state"] = seen, APART_SIGMA, state
    return float(_advance_all(turn, faults))


def _state(faults: Records) -> int:
    """State of the first mode."""
    s = np.zeros(1, SEPARATION)[0]
    hs.move_by_course(1.0, 0.0, faults["course"][0], s)
    assert s["state"] == hs.state_of(faults["course"][0])
    return int(s["state"])


def test_the_separation_is_the_difference_of_two_filters() -> None:
    rng, with_it, without, faults = np.random.default_rng(1), _filter(), _filter(), np.zeros(1, FAULT)
    apart = 0.0
    for k in range(EPOCHS):
        course, seen = 0.2 + 0.05 * rng.normal(), 0.02 + 0.03 * rng.normal()
        before = with_it["angle"] - without["angle"]
        predicted = [copy_of(h, k) for h in (with_it, without)]
        turn = _epoch(k, course - predicted[0], with_it)
        _epoch(k, course - seen - predicted[1], without)
        _advance(turn, seen, MONITORED, faults)
        ahead = predicted[0] - predicted[1]
        apart = max(apart, abs(faults["course"]["mean"][0] - 0.5 * (before + ahead)))
    assert apart < 1e-9
    for name, own in (("h", "angle"), ("b", "gyro_bias"), ("s", "gyro_scale")):
        np.testing.assert_allclose(faults["course"][name][0], with_it[own] - without[own], rtol=1e-7, atol=1e-12)
    assert hs.largest_course(faults) == np.abs(faults["course"]["h"]).max()
    assert _state(faults) == MONITORED


def copy_of(h: Any, k: int) -> float:
    """Heading that the filter predicts for epoch k."""
    delta = 0.03 * np.sin(0.05 * k)
    return float(h["angle"] + delta * (1.0 - h["gyro_scale"]) - h["gyro_bias"] * DT)


def test_the_covariance_is_that_of_simulated_separations_and_of_what_they_move() -> None:
    """2000 separations by white courses; every variance within its two-sided 1e-3 bound of six together."""
    rng, runs = np.random.default_rng(2), 2000
    h, spread, g = _filter(), np.zeros(1, hs.SPREAD)[0], np.zeros(2, dk.GROWTH)
    faults, moved = np.zeros(runs, FAULT), np.zeros((runs, 2))
    courses = faults["course"]
    for k in range(EPOCHS):
        turn, drives = _epoch(k, 0.0, h), k > 150
        across = (1.1, -0.4) if drives else (0.0, 0.0)
        largest = _advance(turn, APART_SIGMA * rng.normal(size=runs), MONITORED, faults)
        assert largest == (APART_SIGMA**2 if k % 3 else 0.0)
        hs.advance_spread(turn, largest, *across, (1.0, 1.0), spread, g)
        moved += np.outer(courses["mean"], across)
    low, high = chi2.ppf([5e-4 / 5, 1.0 - 5e-4 / 5], df=runs)
    for values, variance in (
        (courses["h"], spread["hh"]), (courses["b"], spread["bb"]), (courses["s"], spread["ss"]),
        (moved[:, 0], g[0]["f_ee"]), (moved[:, 1], g[1]["f_nn"]),
    ):  # fmt: skip
        assert low < (values**2).sum() / variance < high


def test_what_is_no_longer_used_fades() -> None:
    h, faults = _filter(), np.zeros(1, FAULT)
    states = []
    for k in range(4000):
        state = LOST if k < 30 else MONITORED if k < 60 else IDLE
        turn = _epoch(1, 0.0, h)
        _advance(turn, 0.1 if state else 0.0, state, faults)
        states.append(_state(faults))
    assert states[10] == LOST
    assert states[100] == LOST
    assert MONITORED in states[100:]
    assert states[-1] == IDLE
    assert faults["course"]["h"][0] == 0.0
