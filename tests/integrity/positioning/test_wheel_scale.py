"""The estimate of the odometer's scale: closed forms, its bound with false windows, and what ends a window."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import CASE
from lanebound.integrity.positioning.wheel_scale_kernel import (
    WHEEL_SCALE,
    WHEEL_WINDOW,
    advance_window,
    close_window,
    estimate,
    open_window,
    scale_of,
)

Array = NDArray[np.float64]
K, LEVEL_M, DT_S, MPS = 4.0, 0.05, 0.1, 10.0
SCALE = 0.006


def declared(**changes: Any) -> Records:
    """The declared figures of an odometer whose scale is estimated."""
    reckoning = {"scale": "estimated", "odometer_scale": 0.027, **changes}
    return epoch_parameters(NavigatorConfig.load({"positioning": {"dead_reckoning": reckoning}}))["odometer"]


def cases() -> Records:
    """One level with this factor."""
    out = np.zeros(1, CASE)
    out["k_dead"] = K
    return out


@jit
def _drive(east, speed, turning, force, odometer, cases, level, p_bias, rows, windows):  # type: ignore[no-untyped-def]
    """Of each vehicle the first epoch whose window contradicts the others, -1 without one; its RTK is at ``east``."""
    found = np.full(rows.shape[0], -1)
    rules = odometer[0].estimate
    for v in range(rows.shape[0]):
        s = rows[v]
        for k in range(speed.shape[1]):
            advance_window(DT_S, speed[v, k], turning[k], force[k], rules, s)
            if s.open and s.path >= rules.length:
                fits = close_window(east[v, k], 0.0, level, p_bias, cases, odometer[0], windows[v], s)
                if not fits and found[v] < 0:
                    found[v] = k
            if not s.open and speed[v, k] >= rules.min_speed:
                open_window(east[v, k], 0.0, level, windows[v], s)
    return found


@jit
def _estimate(windows, count, cases, rules):  # type: ignore[no-untyped-def]
    """Estimate, its bound, and the bound if no window is false."""
    scale, bound = scale_of(windows, count, 0, cases[0], rules[0])
    return scale, bound, estimate(windows, count, 0, cases[0].k_dead[0], rules[0].slip, -1, -1)[1]


def driven(
    odometer: Records, speed: Array, east: Array, turning: Array | None = None, force: Array | None = None,
    p_bias: float = 0.0,
) -> tuple[Records, Records, NDArray[np.int64]]:  # fmt: skip
    """States and windows after speeds (B, T) by the odometer [m/s], with RTK positions (B, T) [m]."""
    rows = np.zeros(len(speed), WHEEL_SCALE)
    windows = np.zeros((len(speed), 24, 1), WHEEL_WINDOW)
    still, level = np.zeros(speed.shape[1]), np.full((1, 2), LEVEL_M)
    turning, force = still if turning is None else turning, still if force is None else force
    found = _drive(east, speed, turning, force, odometer, cases(), level, p_bias, rows, windows)
    return rows, windows, found


def steady(seconds: float, batch: int = 1, scale: float = SCALE) -> tuple[Array, Array]:
    """Speed by the odometer and true position of a steady drive; wheels count ``1 / (1 + scale)`` of the way."""
    true = np.full((batch, round(seconds / DT_S)), MPS)
    return true / (1.0 + scale), np.cumsum(true, -1) * DT_S


def test_without_errors_the_estimate_is_exact_and_its_bound_is_the_closed_form() -> None:
    odometer = declared()
    rows, windows, found = driven(odometer, *steady(100.0))
    n, w = int(rows["count"][0]), windows[0, :, 0]
    scale, bound, whole = _estimate(windows[0], n, cases(), odometer["estimate"])
    assert n == 24
    assert found[0] == -1
    assert scale == pytest.approx(SCALE, rel=1e-9)
    duration = w["path"][:n] * (1.0 + SCALE) / MPS
    assert (w["path"][:n] >= 30.0).all()
    assert (w["path"][:n] < 30.0 + MPS * DT_S).all()

    def closed(of: slice) -> float:
        noise = K * math.sqrt((2.0 * 0.05**2 * 1.0 * duration[of]).sum())
        return float((noise + (2.0 * LEVEL_M + 0.01 * duration[of]).sum()) / w["path"][of].sum())

    assert whole == pytest.approx(closed(slice(n)), rel=1e-6)
    assert bound == pytest.approx(closed(slice(2, n)) + 0.002, rel=1e-6)  # all windows are alike


def test_too_few_windows_make_no_estimate() -> None:
    odometer = declared()
    rows, windows, _ = driven(odometer, *steady(8.0))
    assert rows["count"][0] == 2
    assert math.isinf(_estimate(windows[0], 2, cases(), odometer["estimate"])[1])


def test_the_bound_holds_with_noise_of_the_wheels_at_its_declared_correlation() -> None:
    """2000 vehicles; noise that is as large as declared exceeds K sigma of the bound, which has more, not once."""
    odometer, batch = declared(odometer_bias_mps=0.0, estimate={"change": 0.0}), 2000
    speed, east = steady(90.0, batch)
    rng, phi, noise = np.random.default_rng(5), math.exp(-DT_S), np.empty_like(speed)
    noise[:, 0] = rng.normal(size=batch)
    for k in range(1, speed.shape[1]):
        noise[:, k] = phi * noise[:, k - 1] + math.sqrt(1.0 - phi * phi) * rng.normal(size=batch)
    rows, windows, found = driven(odometer, speed + 0.05 * noise, east + rng.normal(0.0, 0.01, east.shape))
    assert (found != -1).mean() < 29 * 4 * 6.3e-5  # false alarms: windows, comparisons, both tails at K = 4
    errors, sigmas = [], []
    for v in range(batch):
        n = int(rows["count"][v])
        scale, bound, _ = _estimate(windows[v], n, cases(), odometer["estimate"])
        assert abs(scale - SCALE) < bound
        errors.append(scale - SCALE)
        sigmas.append(math.sqrt(windows[v, :n, 0]["variance"].sum()) / windows[v, :n, 0]["path"].sum())
    assert 0.9 < np.std(errors) / np.mean(sigmas) < 1.05  # the noise of the bound is that of the wheels


@given(
    sizes=st.lists(st.floats(-30.0, 30.0), min_size=2, max_size=2),
    places=st.lists(st.integers(0, 7), min_size=2, max_size=2, unique=True),
)
def test_two_false_windows_of_any_size_are_within_the_bound(sizes: list[float], places: list[int]) -> None:
    odometer = declared()
    rows, windows, _ = driven(odometer, *steady(25.0))
    n = int(rows["count"][0])
    assert n == 8
    for size, place in zip(sizes, places, strict=True):
        windows["misfit"][0, place, 0] += size
    scale, bound, whole = _estimate(windows[0], n, cases(), odometer["estimate"])
    assert abs(scale - SCALE) <= bound
    if abs(sum(sizes)) > 10.0:
        assert abs(scale - SCALE) > whole  # the bound without false windows fails


def test_a_changed_scale_contradicts_and_a_constant_one_does_not() -> None:
    sizes = np.array([0.05, 0.02, 0.01, 0.002, 0.0])
    speed, east = steady(110.0, len(sizes))
    speed[:, 800:] *= 1.0 + sizes[:, None]
    _, _, found = driven(declared(), speed, east)
    assert ((found > 800) == [True, True, True, False, False]).all()
    paths = 0.1 * MPS * (found[:3] - 800)
    assert (paths < [62.0, 124.0, 280.0]).all()  # so many windows of 31 m
    assert (found[3:] == -1).all()


def test_a_slow_change_follows_the_declared_drift() -> None:
    """0.3 % that grow with 1000 s, four times as fast as declared in the beginning, stay within the bound."""
    speed, east = steady(600.0)
    time = np.arange(speed.shape[1]) * DT_S
    scale = SCALE + 0.003 * (1.0 - np.exp(-time / 1000.0))
    odometer = declared()
    rows, windows, found = driven(odometer, np.full_like(speed, MPS) / (1.0 + scale), east)
    found_scale, bound, _ = _estimate(windows[0], int(rows["count"][0]), cases(), odometer["estimate"])
    age = float(rows["time_s"][0] - windows["began_s"].min())
    assert found[0] == -1
    assert 0.0 < scale[-1] - found_scale < 3e-6 * age < bound


@pytest.mark.parametrize("what", ["bend", "stop"])
def test_bends_and_stops_end_a_window_unused(what: str) -> None:
    speed, east = steady(2.5)
    turning = np.zeros(speed.shape[1])
    if what == "bend":
        turning[15] = math.radians(2.5) / DT_S
    else:
        speed[0, 15] = 0.5
    rows, _, _ = driven(declared(), speed, east, turning)
    assert rows["count"][0] == 0
    assert rows["open"][0]
    assert rows["path"][0] < 12.0  # anew


def test_slip_and_an_unknown_gyro_bias_widen_the_bound() -> None:
    odometer, (speed, east) = declared(), steady(40.0)
    force = np.where(np.arange(speed.shape[1]) % 20 < 10, 1.5, -2.0)

    def bound(**more: Any) -> float:
        rows, windows, _ = driven(odometer, speed, east, **more)
        return float(_estimate(windows[0], int(rows["count"][0]), cases(), odometer["estimate"])[2])

    plain = bound()
    assert bound(force=force) - plain == pytest.approx(0.002 * 1.0, rel=0.05)  # half of the way under 2 m/s^2
    assert bound(p_bias=0.01**2) - plain == pytest.approx(1.0 - math.cos(5.0 * 0.01 * 3.1), rel=0.05)
