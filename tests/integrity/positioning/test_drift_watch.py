"""The drift watch: found drifts, false alarms within their allocation, and what a healthy window may misfit by."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.config import DriftWatchConfig, PositioningConfig, drift_parameters
from lanebound.integrity.positioning.drift_watch_kernel import (
    ANCHOR,
    DRIFT,
    advance,
    find_drift,
    learn,
    odometer_variance,
)

DT, SPEED = 0.1, 10.0
RTK_M = 0.01
WARM_S = 60.0
BIAS_RADPS = 1e-4  # what is left of a gyro's bias
WATCH = DriftWatchConfig(window_s=16.0)
WALK = 2.5e-4**2 + BIAS_RADPS**2 * WATCH.window_s


@jit
def _watched(noise, gyro, rtk, turning, scale, course, drift_e, drift_n, onset, rules, rows, anchors):
    """For each vehicle the time from the onset until a drift is found, inf without one; whether there is one before.

    noise (B, T) of the odometer [m/s], gyro (B, T) [rad/s], rtk (B, T, 2) [m], turning (T,) [rad/s]; scale and course
    (B,).
    """
    batch, epochs = noise.shape
    found, before = np.full(batch, np.inf), np.zeros(batch, np.bool_)
    for v in range(batch):
        heading, east, north = 0.0, 0.0, 0.0
        for k in range(epochs):
            heading += 0.5 * DT * turning[k]
            d = rows[v]
            advance(DT, DT * (SPEED + noise[v, k]), 0.0, turning[k] + gyro[v, k], False, WALK, rules, d)
            true = DT * SPEED * (1.0 + scale[v])
            east += true * math.sin(heading + course[v])
            north += true * math.cos(heading + course[v])
            heading += 0.5 * DT * turning[k]
            off = max(0.0, (k + 1) * DT - onset)
            e, n = east + rtk[v, k, 0] + off * drift_e[v], north + rtk[v, k, 1] + off * drift_n[v]
            alarm, _, _ = find_drift(e, n, 2.0 * RTK_M**2, SPEED, rules, d, anchors[v])
            if alarm:
                found[v], before[v] = (off, False) if off > 0.0 else (np.inf, True)
                break
            learn(e, n, 2.0 * RTK_M**2, SPEED, 0.0, 1e-5, rules, d, anchors[v])
    return found, before


def _drive(batch, seconds, drift=None, onset=np.inf, tau=1.0, false_alarms_per_h=0.01, turning_radps=0.0):
    """Drive vehicles of declared errors: scale, course, odometer noise of a correlation time, white RTK errors."""
    rng, epochs = np.random.default_rng(5), round(seconds / DT)
    p = PositioningConfig().replace(rtk={"drift": {"window_s": 16.0, "false_alarms_per_h": false_alarms_per_h}})
    rules = drift_parameters(p, DT)[0]
    decay, noise = math.exp(-DT / tau), np.zeros((batch, epochs))
    z, last = rng.standard_normal((batch, epochs)), rng.standard_normal(batch)
    for k in range(epochs):
        last = decay * last + math.sqrt(1.0 - decay**2) * z[:, k]
        noise[:, k] = p.dead_reckoning.odometer_sigma_mps * last
    rtk = RTK_M * rng.standard_normal((batch, epochs, 2))
    turning = turning_radps * np.sign(np.sin(2.0 * np.pi * np.arange(epochs) * DT / 30.0))
    scale, course = 0.003 * rng.standard_normal(batch), 0.002 * rng.standard_normal(batch)
    drift = np.zeros((batch, 2)) if drift is None else drift
    rows, anchors = np.zeros(batch, DRIFT), np.zeros((batch, p.rtk.drift.anchors), ANCHOR)
    gyro = 2.5e-4 / math.sqrt(DT) * rng.standard_normal((batch, epochs))
    gyro += BIAS_RADPS * rng.standard_normal((batch, 1))
    return _watched(noise, gyro, rtk, turning, scale, course, drift[:, 0], drift[:, 1], onset, rules, rows, anchors)


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


@pytest.mark.parametrize("turning_radps", [0.0, 0.1])
def test_false_alarms_stay_within_their_allocation(turning_radps):
    """The union bound over dependent epochs and windows allows 60 % of the vehicles an alarm; 1 % have one at most."""
    _, before = _drive(400, 60.0, false_alarms_per_h=36.0, turning_radps=turning_radps)
    assert before.sum() <= 4


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
