"""Sensors of the chassis: the steering angle of the front left wheel and the speeds of the four wheels (ABS).

S4's odometry takes them in place of one distance counter. A wheel at an offset (x forward, y to the right) from the
reference point of a body that moves with (u, w) forward and to the right, and turns with r clockwise, moves with
``u - r y`` and ``w + r x``. It rolls in that direction and does not slip sideways; the rear axle lies ``axle_m`` behind
the reference point. Motion is taken at the end of the epoch, the yaw rate as the mean over the epoch.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors.effects import FaultEffects

__all__ = ["ChassisConfig", "ChassisSample", "ChassisState", "initial_chassis", "sample_chassis"]

Array = NDArray[np.float64]
ROLLING_MPS = 0.1  # slower, the direction of a wheel's motion is not defined


class ChassisConfig(Config):
    """Geometry of the vehicle, and true errors of its chassis sensors."""

    fitted: bool = Field(False, description="the navigator reads these sensors")
    wheelbase_m: float = Field(2.7, gt=0, le=20, description="front axle ahead of the rear axle [m]; compact car")
    track_m: float = Field(1.5, gt=0, le=5, description="distance between the wheels of an axle [m]; compact car")
    axle_m: float = Field(0.0, ge=0, le=20, description="reference point ahead of the rear axle [m]")
    steering_offset_deg: float = Field(
        0.1, ge=0, description="1-sigma of the constant error of the wheel's angle [deg]; chosen, 1.6 at the hand wheel"
    )
    steering_noise_deg: float = Field(0.02, ge=0, description="white noise of the wheel's angle [deg]; chosen")
    steering_step_deg: float = Field(
        0.1 / 16.0, ge=0, description="resolution [deg]; 0.1 deg of the hand wheel over a ratio of 16"
    )
    scale_sigma: float = Field(0.003, ge=0, description="1-sigma of each wheel's scale [-]; as of the odometer")
    noise_mps: float = Field(0.03, ge=0, description="white noise of a wheel's speed [m/s]; chosen")
    slip_s2_per_m: float = Field(0.001, ge=0, description="longitudinal slip per acceleration [s^2/m]; as the odometer")
    dropout_mps: float = Field(0.15, ge=0, description="slower than this a wheel shows rest [m/s]; inductive sensors")


@dataclass(frozen=True)
class ChassisSample:
    """At the end of an epoch: steering_rad (B,) of the front left wheel, positive to the right; wheel_mps (B, 4)."""

    steering_rad: Array
    wheel_mps: Array


@dataclass
class ChassisState:
    """Lasting errors and the last outputs of B vehicles: offset, last angle (B,) [rad]; scale, last speeds (B, 4)."""

    offset_rad: Array
    steering_rad: Array
    scale: Array
    wheel_mps: Array

    def copy(self) -> ChassisState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_chassis(config: ChassisConfig, streams: Streams) -> ChassisState:
    """Draw offset and scales, from streams ``steering`` and ``wheels``."""
    offset = np.deg2rad(config.steering_offset_deg) * streams.normal("steering")
    scale = 1.0 + config.scale_sigma * streams.normal("wheels", 4)
    return ChassisState(offset, np.zeros(streams.batch), scale, np.zeros((streams.batch, 4)))


def sample_chassis(
    config: ChassisConfig, state: ChassisState, truth: Truth, effects: FaultEffects, streams: Streams
) -> ChassisSample:
    """Measure one epoch; ``state`` advances in place. Faults of the odometer act on the wheels alike."""
    forward, right = wheel_velocities(config, truth)
    rolling = np.hypot(forward, right) > ROLLING_MPS
    angle = np.arctan2(right[:, 0] * np.sign(forward[:, 0]), np.abs(forward[:, 0]))
    z = streams.normal("steering")
    measured = angle + state.offset_rad + np.deg2rad(config.steering_noise_deg) * z
    step = np.deg2rad(config.steering_step_deg)
    measured = np.round(measured / step) * step if step > 0.0 else measured
    state.steering_rad[:] = np.where(rolling[:, 0], measured, state.steering_rad)
    speed = np.copysign(np.hypot(forward, right), forward)
    slip = 1.0 + config.slip_s2_per_m * truth.delta_v_mps[:, :1] / truth.dt_s
    fault = np.asarray(effects.odometer_scale)[:, None]
    shown = state.scale * fault * slip * speed + config.noise_mps * streams.normal("wheels", 4)
    shown = np.where(np.abs(speed) < config.dropout_mps, 0.0, shown)
    state.wheel_mps[:] = np.where(np.asarray(effects.odometer_frozen)[:, None], state.wheel_mps, shown)
    return ChassisSample(state.steering_rad.copy(), state.wheel_mps.copy())


def wheel_velocities(config: ChassisConfig, truth: Truth) -> tuple[Array, Array]:
    """True velocities of the wheels along and across the body, (B, 4) each [m/s]; front left, front right,
    rear left, rear right."""
    sine, cosine = np.sin(truth.heading_rad), np.cos(truth.heading_rad)
    east, north = truth.velocity_enu_mps[:, 0], truth.velocity_enu_mps[:, 1]
    u, w = sine * east + cosine * north, cosine * east - sine * north
    rate = (truth.delta_theta_rad[:, 2] / truth.dt_s)[:, None]
    front, half = config.wheelbase_m - config.axle_m, 0.5 * config.track_m
    x = np.array([front, front, -config.axle_m, -config.axle_m])
    y = np.array([-half, half, -half, half])
    return u[:, None] - rate * y, w[:, None] + rate * x
