"""Sensors against a reference: units, signs, axes and lags, with noise on both, and what a drive cannot show."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.replay.sensor_checks import (
    ACCELERATION,
    SPEED,
    YAW_RATE,
    Quantity,
    require_agreement,
    require_changing,
    require_lag,
    require_same_times,
    require_throughout,
    with_rate,
)

TIME = np.arange(0.0, 60.0, 0.1)
TURNS = np.radians(12.0) * np.sin(0.5 * TIME) * np.sin(0.07 * TIME)
SPEEDS = 10.0 + 4.0 * np.sin(0.2 * TIME)


def noisy(value: np.ndarray, sigma: float, seed: int = 1) -> np.ndarray:
    return value + sigma * np.random.default_rng(seed).standard_normal(value.size)


@pytest.mark.parametrize(("quantity", "unit", "truth", "factor", "likely"), [
    (YAW_RATE, "deg/s", TURNS, np.pi / 180.0, "probably in rad/s, not in deg/s"),
    (YAW_RATE, "rad/s", TURNS, 180.0 / np.pi, "probably in deg/s, not in rad/s"),
    (YAW_RATE, "deg/s", TURNS, 1000.0, "probably in mdeg/s"),
    (YAW_RATE, "deg/s", TURNS, -1.0, "its sign is reversed; convert"),
    (YAW_RATE, "deg/s", TURNS, -np.pi / 180.0, "its sign is reversed and it is probably in rad/s"),
    (YAW_RATE, "deg/s", TURNS, 0.5, "no usual unit"),
    (SPEED, "m/s", SPEEDS, 3.6, "probably in km/h"),
    (SPEED, "m/s", SPEEDS, 2.23694, "probably in mph"),
    (SPEED, "m/s", SPEEDS, 1.94384, "probably in knots"),
    (SPEED, "m/s", SPEEDS, 3.28084, "probably in ft/s"),
    (SPEED, "m/s", SPEEDS, 1000.0, "probably in mm/s"),
    (SPEED, "m/s", SPEEDS, -1.0, "its sign is reversed"),
    (SPEED, "m/s", SPEEDS, 0.0, "without a signal"),
    (ACCELERATION, "g", 20.0 * TURNS, 9.80665, "probably in m/s\\^2"),
    (ACCELERATION, "m/s^2", 20.0 * TURNS, 1.0 / 9.80665, "probably in g"),
])  # fmt: skip
def test_units_and_signs_are_refused_with_slope_correlation_and_the_likely_cause(
    quantity: Quantity, unit: str, truth: np.ndarray, factor: float, likely: str
) -> None:
    sensed = factor * noisy(truth, 0.05 * float(np.std(truth)))
    with pytest.raises(
        InputError, match=rf"{quantity.name} of log .* slope on it is -?\d.* correlation -?[01]\..*{likely}"
    ):
        require_agreement(quantity, unit, "log", truth, sensed, 60.0)
    right = require_agreement(quantity, unit, "log", truth, noisy(truth, 0.05 * float(np.std(truth))), 60.0)
    assert right.tested
    assert right.slope == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("scale", [0.9, 0.97, 1.03, 1.1])
def test_scales_of_real_sensors_pass(scale: float) -> None:
    assert require_agreement(SPEED, "m/s", "log", SPEEDS, scale * SPEEDS, 60.0).tested
    assert require_agreement(YAW_RATE, "deg/s", "log", TURNS, scale * TURNS + 0.01, 60.0).tested  # a bias is no scale


def test_another_axis_or_a_dead_sensor_is_refused_where_the_car_turns() -> None:
    for sensed in (noisy(0.0 * TURNS, 0.01), 0.0 * TURNS, noisy(0.0 * TURNS, 1.0, 3)):
        with pytest.raises(InputError, match="another axis, another drive, or a sensor without a signal"):
            require_agreement(YAW_RATE, "deg/s", "log", TURNS, sensed, 60.0)


@pytest.mark.parametrize("seed", range(20))
def test_a_straight_drive_proves_nothing_and_refuses_nothing(seed: int) -> None:
    """The reference's noise alone pulls the slope to 0; a drive that is nearly straight must pass."""
    rng = np.random.default_rng(seed)
    truth = np.radians(0.3) * np.sin(0.3 * TIME)
    reference, sensed = (truth + np.radians(s) * rng.standard_normal(TIME.size) for s in (0.6, 0.2))
    require_agreement(YAW_RATE, "deg/s", "log", reference, sensed, 60.0)
    found = require_agreement(YAW_RATE, "deg/s", "log", reference, rng.standard_normal(TIME.size) * 1e-3, 60.0)
    assert not found.tested


def test_degrees_show_even_on_a_nearly_straight_drive() -> None:
    rng = np.random.default_rng(4)
    truth = np.radians(0.8) * np.sin(0.3 * TIME)
    reference = truth + np.radians(0.5) * rng.standard_normal(TIME.size)
    with pytest.raises(InputError, match="probably in deg/s, not in rad/s"):
        require_agreement(YAW_RATE, "rad/s", "log", reference, np.degrees(truth), 60.0)


def shifted(lag_s: float, sign: float = 1.0):
    fine = np.arange(-30.0, 90.0, 0.01)
    value = np.radians(12.0) * np.sin(0.5 * fine) * np.sin(0.07 * fine)
    return lambda lag: sign * np.interp(TIME + lag - lag_s, fine, value)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("lag_s", [0.0, 0.12, -0.3, 0.45])
def test_a_lag_within_the_search_is_found_whatever_the_sign(lag_s: float, sign: float) -> None:
    lag, values = require_lag("log", TURNS, shifted(lag_s, sign), YAW_RATE)
    assert lag == pytest.approx(lag_s, abs=0.011)
    np.testing.assert_allclose(values, sign * TURNS, atol=2e-3)


@pytest.mark.parametrize("lag_s", [0.52, 1.12, -1.0, 3.0, -18.0, 18.0])
def test_a_lag_beyond_the_search_is_refused_and_named(lag_s: float) -> None:
    with pytest.raises(InputError, match=rf"clocks of log .* comes \{lag_s:+.2f} s later".replace(r"\+", r"\+")):
        require_lag("log", TURNS, shifted(lag_s), YAW_RATE)


def test_without_motion_there_is_no_lag() -> None:
    assert require_lag("log", 0.0 * TURNS, shifted(5.0), YAW_RATE)[0] is None


@pytest.mark.parametrize("late_s", [18.0, -18.0, 1.0])
def test_positions_whose_times_are_off_are_refused_and_those_of_a_car_at_rest_are_not(late_s: float) -> None:
    time = np.arange(0.0, 120.0, 0.2)
    way = np.stack([np.cumsum(2.0 + np.sin(0.1 * time)), np.cumsum(np.cos(0.07 * time)), 0.0 * time], -1)
    noise = 0.5 * np.random.default_rng(1).standard_normal(way.shape)
    require_same_times("a", time, way + noise, time, way)
    require_same_times("a", time - late_s, 0.0 * way + noise, time, 0.0 * way)
    with pytest.raises(InputError, match=rf"times of a .* with times \{late_s:+.1f} s later: is one in UTC"):
        require_same_times("a", time - late_s, way + noise, time, way)


@pytest.mark.parametrize(("quantity", "truth", "change", "message"), [
    (YAW_RATE, TURNS, lambda v: -v, "yaw rate of log between 30 and 38 s .* its sign is reversed"),
    (YAW_RATE, TURNS, np.radians, "probably in rad/s, not in deg/s"),
    (ACCELERATION, 20.0 * TURNS, lambda v: 9.80665 * v, r"acceleration of log between 2. .* probably in m/s\^2, not"),
    (SPEED, SPEEDS, lambda v: 3.6 * v, "probably in km/h"),
])  # fmt: skip
def test_a_part_of_a_drive_that_contradicts_is_refused_with_its_time(
    quantity: Quantity, truth: np.ndarray, change, message: str
) -> None:
    unit = {"yaw rate": "deg/s", "speed": "m/s", "acceleration": "g"}[quantity.name]
    reference, sane = noisy(truth, 0.1 * quantity.strong), noisy(truth, 0.02 * quantity.strong, 2)
    part = np.where((TIME >= 30.0) & (TIME < 42.0), change(sane), sane)
    require_throughout(quantity, unit, "log", TIME, reference, lambda lag: np.interp(TIME + lag, TIME, sane), 0.0)
    with pytest.raises(InputError, match=message):
        require_throughout(quantity, unit, "log", TIME, reference, lambda lag: np.interp(TIME + lag, TIME, part), 0.0)


@pytest.mark.parametrize(("quantity", "truth", "one"), [
    (YAW_RATE, 0.0 * TURNS, 0.01), (ACCELERATION, 20.0 * TURNS, 0.3), (SPEED, SPEEDS, 12.0),
    (SPEED, 0.0 * SPEEDS + 9.0, 0.0),
])  # fmt: skip
def test_a_sensor_that_keeps_one_value_while_the_car_drives_is_refused(
    quantity: Quantity, truth: np.ndarray, one: float
) -> None:
    reference, sane = noisy(truth, 0.1 * quantity.strong), noisy(truth, 0.02 * quantity.strong, 2)
    part = np.where((TIME >= 30.0) & (TIME < 36.0), one, sane)
    require_changing(quantity, "log", TIME, sane, TIME, reference)
    with pytest.raises(InputError, match=rf"{quantity.name} of log .* one value, {one:g}, for 5\.9 s from 30\.0 s on"):
        require_changing(quantity, "log", TIME, part, TIME, reference)


def test_wheels_that_stand_with_the_car_are_right() -> None:
    standing = np.where((TIME > 20.0) & (TIME < 40.0), 0.0, SPEEDS)
    require_changing(SPEED, "log", TIME, standing, TIME, noisy(standing, 0.1))
    rest = standing == 0.0
    require_changing(YAW_RATE, "log", TIME, np.where(rest, 0.0, noisy(TURNS, 0.01)), TIME[~rest], TURNS[~rest])


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_wrong_scale_is_no_other_time(scale: float) -> None:
    sensed = scale * SPEEDS
    require_throughout(SPEED, "m/s", "log", TIME, SPEEDS, lambda lag: np.interp(TIME + lag, TIME, sensed), 0.0)


def test_epochs_beside_a_stop_have_no_rate() -> None:
    assert with_rate(np.array([1, 1, 1, 0, 0, 1, 1, 1]) > 0).tolist() == [True, True, *4 * [False], True, True]
    assert with_rate(np.zeros(0, np.bool_)).size == 0


def test_a_clock_that_jumps_inside_a_drive_is_refused() -> None:
    usual, late = shifted(0.1), shifted(0.6)
    require_throughout(YAW_RATE, "deg/s", "log", TIME, TURNS, usual, 0.1)
    with pytest.raises(InputError, match=r"clocks of log between .* comes \+0.50 s later .* one of them jumped"):
        require_throughout(
            YAW_RATE, "deg/s", "log", TIME, TURNS, lambda lag: np.where(TIME < 30.0, usual(lag), late(lag)), 0.1
        )
