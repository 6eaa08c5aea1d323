"""The drift watch: found drifts, false alarms within their allocation, and what a healthy window may misfit by."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.config import PositioningConfig
from lanebound.integrity.positioning.drift_watch_kernel import (
    ANCHOR,
    DRIFT,
    advance,
    blames_odometer,
    find_drift,
    fold_doppler,
    learn,
    odometer_variance,
    rates_of,
)
from lanebound.integrity.positioning.parameters import drift_parameters
from lanebound.integrity.positioning.rtk_config import DriftWatchConfig

DT, SPEED = 0.1, 10.0
RTK_M = 0.01
WARM_S = 60.0
BIAS_RADPS = 1e-4  # what is left of a gyro's bias
WATCH = DriftWatchConfig(window_s=16.0)
WALK = 2.5e-4**2 + BIAS_RADPS**2 * WATCH.window_s


@jit
def _watched(speed, noise, gyro, rtk, turning, scale, course, drift_e, drift_n, onset, rules, rows, anchors):
    """For each vehicle the time from the onset until a drift is found, inf without one; whether there is one before.

    speed (T,) [m/s], noise (B, T) of the odometer [m/s], gyro (B, T) [rad/s], rtk (B, T, 2) [m], turning (T,) [rad/s];
    scale and course (B,).
    """
    batch, epochs = noise.shape
    found, before = np.full(batch, np.inf), np.zeros(batch, np.bool_)
    for v in range(batch):
        heading, east, north = 0.0, 0.0, 0.0
        for k in range(epochs):
            heading += 0.5 * DT * turning[k]
            d = rows[v]
            advance(DT, DT * (speed[k] + noise[v, k]), 0.0, turning[k] + gyro[v, k], speed[k] == 0.0, WALK, rules, d)
            true = DT * speed[k] * (1.0 + scale[v])
            east += true * math.sin(heading + course[v])
            north += true * math.cos(heading + course[v])
            heading += 0.5 * DT * turning[k]
            off = max(0.0, (k + 1) * DT - onset)
            e, n = east + rtk[v, k, 0] + off * drift_e[v], north + rtk[v, k, 1] + off * drift_n[v]
            if find_drift(e, n, RTK_M**2, speed[k], rules, d, anchors[v]) >= 0:
                found[v], before[v] = (off, False) if off > 0.0 else (np.inf, True)
                break
            learn(e, n, RTK_M**2, speed[k], 0.0, 1e-5, rules, d, anchors[v])
    return found, before


def _rules(false_alarms_per_h=0.01, k_factor=1.0, **figures):
    """The rules as configured; a factor on K; declared figures replaced."""
    rules = drift_parameters(PositioningConfig().replace(
        rtk={"drift": {"window_s": 16.0, "false_alarms_per_h": false_alarms_per_h}}), DT)[0]  # fmt: skip
    rules["k"] *= k_factor
    for name, value in figures.items():
        rules[name] = value
    return rules


def _drive(batch, seconds, drift=None, onset=np.inf, turning_radps=0.0, rules=None, speed=None, slip=0.0):
    """Drive vehicles of declared errors: scale, course, odometer noise of a correlation time, white RTK errors.

    speed (T,) [m/s]; slip per acceleration [s^2/m], by which the odometer shows more.
    """
    rng, epochs = np.random.default_rng(5), round(seconds / DT)
    rules = _rules() if rules is None else rules
    p = PositioningConfig().replace(rtk={"drift": {"window_s": 16.0}})
    decay, noise = math.exp(-DT), np.zeros((batch, epochs))
    z, last = rng.standard_normal((batch, epochs)), rng.standard_normal(batch)
    for k in range(epochs):
        last = decay * last + math.sqrt(1.0 - decay**2) * z[:, k]
        noise[:, k] = p.dead_reckoning.odometer_sigma_mps * last
    speed = np.full(epochs, SPEED) if speed is None else speed
    noise = np.where(speed > 0.0, noise, 0.0) + slip * np.gradient(speed, DT) * speed
    rtk = RTK_M * rng.standard_normal((batch, epochs, 2))
    turning = turning_radps * np.sign(np.sin(2.0 * np.pi * np.arange(epochs) * DT / 30.0))
    scale, course = 0.003 * rng.standard_normal(batch), 0.002 * rng.standard_normal(batch)
    drift = np.zeros((batch, 2)) if drift is None else drift
    rows, anchors = np.zeros(batch, DRIFT), np.zeros((batch, p.rtk.drift.anchors), ANCHOR)
    gyro = 2.5e-4 / math.sqrt(DT) * rng.standard_normal((batch, epochs))
    gyro += BIAS_RADPS * rng.standard_normal((batch, 1))
    return _watched(
        speed, noise, gyro, rtk, turning, scale, course, drift[:, 0], drift[:, 1], onset, rules, rows, anchors
    )


def _towards(size, batch):
    azimuth = 2.0 * np.pi * np.arange(batch) / batch
    return size * np.stack([np.sin(azimuth), np.cos(azimuth)], -1)


@pytest.mark.parametrize("turning_radps", [0.0, 0.1])
def test_a_drift_of_two_decimetres_a_second_is_found_before_it_is_hazardous(turning_radps):
    """Across the track it is found in less than a second; along it, beside the declared odometer, in some seconds."""
    found, before = _drive(64, WARM_S + 20.0, _towards(0.2, 64), WARM_S, turning_radps=turning_radps)
    assert not before.any()
    assert np.isfinite(found).all()
    assert (found < 5.0).mean() > 0.75
    assert np.median(found) < 1.5


def test_a_drift_along_of_two_centimetres_a_second_is_not_found():
    along = np.tile([0.0, 0.02], (64, 1))
    found, _ = _drive(64, WARM_S + 20.0, along, WARM_S)
    assert np.isinf(found).all()


NO_BOUNDS = {"phase": 0.0, "bias": 0.0, "heading_drift": 0.0, "axle": 0.0, "slip": 0.0, "creep": 0.0}


def test_k_alone_holds_the_false_alarms_and_half_of_it_does_not():
    """Bounds are zero. The union bound allows 60 % of the vehicles an alarm, of which dependent windows leave few."""
    _, before = _drive(200, 60.0, rules=_rules(36.0, **NO_BOUNDS))
    assert before.mean() < 0.1
    _, before = _drive(200, 60.0, rules=_rules(36.0, 0.5, **NO_BOUNDS))
    assert before.mean() > 0.8


def test_false_alarms_stay_within_their_allocation_in_turns():
    """The union bound over dependent epochs and windows allows 60 % of the vehicles an alarm; 1 % have one at most."""
    _, before = _drive(200, 60.0, rules=_rules(36.0), turning_radps=0.1)
    assert before.sum() <= 2


def _stop_and_go(seconds):
    """Speed [m/s] from rest to 10 m/s and back at 2.5 m/s^2, with rests of four seconds."""
    t = np.arange(round(seconds / DT)) * DT % 16.0
    return np.interp(t, [0.0, 4.0, 8.0, 12.0, 16.0], [0.0, SPEED, SPEED, 0.0, 0.0])


def test_stop_and_go_with_slip_at_its_bound_raises_no_alarm():
    """Slip as declared, 0.5 % at 2.5 m/s^2, shows 0.1 m more in each start; ten times as much is found.

    Of the bounds, slip alone counts. The union bound allows 70 % of the vehicles an alarm; the scale takes some slip
    for its own, of which its variance knows nothing, so more have one than in steady motion.
    """
    slip, speed = PositioningConfig().rtk.drift.slip_s2_per_m, _stop_and_go(120.0)
    alone = {name: 0.0 for name in NO_BOUNDS if name != "slip"}
    _, before = _drive(100, 120.0, rules=_rules(36.0, **alone), speed=speed, slip=slip)
    assert before.mean() < 0.3
    _, before = _drive(100, 120.0, rules=_rules(36.0), speed=speed, slip=slip)
    assert before.sum() <= 2
    _, before = _drive(100, 120.0, rules=_rules(36.0), speed=speed, slip=10.0 * slip)
    assert before.mean() > 0.5


@pytest.mark.parametrize(
    ("odometer", "doppler", "drift", "blamed"),
    [
        (1.0135, 1.0, (0.0, 0.0), True),  # a step of the declared scale
        (1.0, 1.0, (0.0, 0.27), False),  # RTK drifts as fast along, Doppler agrees with the odometer
        (1.0135, None, (0.0, 0.0), False),  # no Doppler
        (1.05, 1.0, (0.0, 0.0), False),  # more than declared
        (1.0, 1.0, (0.27, 0.0), False),  # across
    ],
)
def test_a_step_of_scale_within_its_bound_is_the_odometers_where_doppler_says_so(odometer, doppler, drift, blamed):
    """20 m/s to the North, free of noise: every case is found; Doppler alone tells scale from drift."""
    rules, d, anchors, v, n = _rules(), np.zeros(1, DRIFT)[0], np.zeros(16, ANCHOR), 20.0, 0.0
    for k in range(1, 800):
        late = max(0.0, (k - 600) * DT)
        shown = v * (odometer if late else 1.0)
        advance(DT, DT * shown, 0.0, 0.0, False, WALK, rules, d)
        fold_doppler(DT, doppler is not None, 0.0, v, d)
        n += DT * v
        here = (late * drift[0], n + late * drift[1], RTK_M**2, shown, rules, d, anchors)
        found = find_drift(*here)
        if found >= 0:
            true, rate = max(v * (odometer - 1.0), *drift), max(map(abs, rates_of(*here)))
            assert (0.8 if late > 1.0 else 0.3) * true < rate < 1.1 * true
            assert blames_odometer(*here[:-1], anchors[found]) == blamed
            return
        learn(*here[:4], 0.0, 1e-5, rules, d, anchors)
    raise AssertionError("not found")


@pytest.mark.parametrize("off_rad", [0.0, 0.1, math.pi / 2.0, math.pi])
def test_a_start_with_an_unknown_heading_is_no_drift(off_rad):
    """At rest for 10 s, then 2 m/s^2; the heading is known to 104 degrees, and to 0.3 from the third second of motion.

    A course that is 90 degrees wrong shortens the path to nothing. Street 11 of seed 3 took that for a drift along.
    Then a drift along of 0.3 m/s is found: windows have begun anew.
    """
    rules, d, anchors, n, v = _rules(), np.zeros(1, DRIFT)[0], np.zeros(16, ANCHOR), 0.0, 0.0
    for k in range(1, 1200):
        t = k * DT
        v = min(max(0.0, 2.0 * (t - 10.0)), SPEED)
        n += DT * v
        advance(DT, DT * v, 0.0, 0.0, v == 0.0, WALK, rules, d)
        late = max(0.0, t - 90.0)
        found = find_drift(0.0, n + 0.3 * late, RTK_M**2, v, rules, d, anchors)
        if found >= 0:
            assert 0.0 < late < 6.0
            return
        known = t > 13.0
        heading, sigma = (0.0, math.radians(0.3)) if known else (off_rad, math.radians(104.0))
        learn(0.0, n + 0.3 * late, RTK_M**2, v, heading, sigma**2, rules, d, anchors)
        if known:
            assert abs(d["course"]) < 0.01
    raise AssertionError("not found")


def test_a_drift_at_rest_is_found_while_the_heading_is_unknown():
    rules, d, anchors = _rules(), np.zeros(1, DRIFT)[0], np.zeros(16, ANCHOR)
    for k in range(1, 400):
        advance(DT, 0.0, 0.0, 0.0, True, WALK, rules, d)
        east = 0.2 * max(0.0, k * DT - 20.0)
        if find_drift(east, 0.0, RTK_M**2, 0.0, rules, d, anchors) >= 0:
            assert 0.1 < east < 3.5
            return
        learn(east, 0.0, RTK_M**2, 0.0, 0.0, math.radians(104.0) ** 2, rules, d, anchors)
    raise AssertionError("not found")


def test_the_variance_of_the_odometer_is_that_of_its_sum():
    k, sigma, tau, moving = np.arange(20_000), 0.05, 1.0, 8.0
    dt = moving / k.size
    covariance = sigma**2 * math.exp(-dt / tau) ** k
    summed = dt**2 * (k.size * covariance[0] + 2.0 * ((k.size - k[1:]) * covariance[1:]).sum())
    assert odometer_variance(moving, sigma, tau) == pytest.approx(summed, rel=1e-3)


def test_without_a_window_there_is_no_anchor():
    assert DriftWatchConfig(window_s=0.0).anchors == 0
    with pytest.raises(ConfigError, match="false_alarms_per_h"):
        DriftWatchConfig.load({"false_alarms_per_h": 0.0})
