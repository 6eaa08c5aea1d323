"""Chassis sensors and compass against rigid-body kinematics, and independence of their streams."""

from dataclasses import replace

import numpy as np

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.sensors.chassis import ChassisConfig, initial_chassis, sample_chassis, wheel_velocities
from lanebound.integrity.sensors.compass import CompassConfig, initial_compass, sample_compass
from lanebound.integrity.sensors.effects import FaultEffects

EXACT = ChassisConfig(
    fitted=True, wheelbase_m=3.0, track_m=1.6, axle_m=1.5, steering_offset_deg=0, steering_noise_deg=0,
    steering_step_deg=0, scale_sigma=0, noise_mps=0, slip_s2_per_m=0,
)  # fmt: skip


def turning(radius_m=20.0, speed_mps=8.0, axle_m=1.5, heading=0.7, dt=0.1):
    """A car on a circle to the right whose rear axle, axle_m behind the reference point, does not slip."""
    rate = speed_mps / radius_m  # speed of the rear axle
    h0, h1 = heading - rate * dt, heading
    velocity = []
    for h in (h0, h1):
        along, right = np.array([np.sin(h), np.cos(h)]), np.array([np.cos(h), -np.sin(h)])
        velocity.append((speed_mps * along + axle_m * rate * right)[None])
    truth = truth_between(1.0, dt, (np.zeros((1, 2)), dt * velocity[1]), (velocity[0], velocity[1]),
                          (np.array([h0]), np.array([h1])))  # fmt: skip
    return truth, rate


def sample(config, truth, seed=1, effects=None):
    streams = Streams([seed])
    state = initial_chassis(config, streams)
    return sample_chassis(config, state, truth, effects or FaultEffects.blank(1, 0), streams)


def test_wheels_and_steering_follow_the_geometry_of_a_bend():
    """Ackermann: the front left wheel of a right turn of radius R has tan(delta) = l / (R + b/2)."""
    truth, rate = turning()
    found = sample(EXACT, truth)
    np.testing.assert_allclose(np.tan(found.steering_rad[0]), 3.0 / (20.0 + 0.8), rtol=1e-9)
    rear_left, rear_right = rate * (20.0 + 0.8), rate * (20.0 - 0.8)
    np.testing.assert_allclose(found.wheel_mps[0, 2:], [rear_left, rear_right], rtol=1e-9)
    np.testing.assert_allclose(found.wheel_mps[0, 0], rate * np.hypot(20.8, 3.0), rtol=1e-9)


def test_the_rear_axle_does_not_slip():
    truth, _ = turning()
    _, right = wheel_velocities(EXACT, truth)
    np.testing.assert_allclose(right[0, 2:], 0.0, atol=1e-12)


def test_odometer_faults_act_on_the_wheels():
    truth, _ = turning()
    effects, frozen = FaultEffects.blank(1, 0), FaultEffects.blank(1, 0)
    effects.odometer_scale[:] = 1.1
    np.testing.assert_allclose(
        sample(EXACT, truth, effects=effects).wheel_mps, 1.1 * sample(EXACT, truth).wheel_mps, rtol=1e-12
    )
    frozen.odometer_frozen[:] = True
    assert (sample(EXACT, truth, effects=frozen).wheel_mps == 0.0).all()  # as before the first message


def test_errors_have_the_declared_spread():
    """4,000 vehicles: each standard deviation within 5 % (4.5 sigma)."""
    truth, _ = turning()
    config, streams = ChassisConfig(axle_m=1.5, wheelbase_m=3.0, track_m=1.6), Streams(3, 4000)
    many = replace(truth, **{name: np.repeat(getattr(truth, name), 4000, 0) for name in (
        "position_enu_m", "velocity_enu_mps", "heading_rad", "delta_theta_rad", "delta_v_mps", "distance_m", "arc_m",
        "lane",
    )})  # fmt: skip
    state = initial_chassis(config, streams)
    found = sample_chassis(config, state, many, FaultEffects.blank(4000, 0), streams)
    exact = sample(EXACT, truth)
    error = np.rad2deg(found.steering_rad - exact.steering_rad)
    np.testing.assert_allclose(error.std(), np.hypot(0.1, 0.02), rtol=0.05)
    np.testing.assert_allclose(found.wheel_mps[:, 3].std(), np.hypot(0.03, 0.003 * exact.wheel_mps[0, 3]), rtol=0.05)
    compass = CompassConfig()
    magnetic = initial_compass(compass, streams)
    heading = sample_compass(compass, magnetic, many, streams).heading_rad
    np.testing.assert_allclose(np.rad2deg((heading - many.heading_rad).std()), np.sqrt(1 + 4 + 0.09), rtol=0.05)


def test_a_compass_disturbance_lasts_as_declared():
    truth, _ = turning()
    config = CompassConfig(deviation_deg=0, noise_deg=0, disturbance_s=1.0)
    many = replace(truth, heading_rad=np.zeros(5000))
    streams = Streams(4, 5000)
    state = initial_compass(config, streams)
    before = state.disturbance_rad.copy()
    for _ in range(10):
        found = sample_compass(config, state, many, streams).heading_rad
    np.testing.assert_allclose(np.corrcoef(before, found)[0, 1], np.exp(-1.0), atol=0.06)  # 5 sigma


def test_draws_of_other_streams_do_not_move():
    """Fitting the sensors changes no draw of the others."""
    streams, plain = Streams([5]), Streams([5])
    initial_chassis(ChassisConfig(), streams)
    initial_compass(CompassConfig(), streams)
    for name in ("imu", "odometer", "gnss"):
        assert np.array_equal(streams.normal(name, 3), plain.normal(name, 3))
