"""Dead reckoning by wheel speed and yaw rate: the path, and how protection levels grow between solutions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.frames import rotate_covariance, track_from_enu_matrix
from lanebound.integrity.monitoring.dead_reckoning_pl import (
    HeadingStep,
    initial_growth,
    missed_detection_factors,
    odometer_step,
    protection_levels,
)
from lanebound.integrity.monitoring.risk import RiskConfig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DeadReckonedPath:
    """In its own frame, which starts at the origin with heading 0 (North).

    Times (T,) [s], heading clockwise from the initial one (T,) [rad], position (T, 2) [m], distance (T,) [m].
    """

    time_s: Array
    heading_rad: Array
    position_m: Array
    distance_m: Array


def reckon(time_s: Array, speed_mps: Array, yaw_rate_radps: Array, axle_m: float = 0.0) -> DeadReckonedPath:
    """``dp = V dt [sin t, cos t]`` with the means of speed and heading over each interval (inverse of S1 eq 4).

    All (T,); the yaw rate is positive to the right (clockwise). The rear axle moves in the direction of the heading.
    The path is that of a point ``axle_m`` ahead of it, which also moves sideways in a bend.
    """
    dt = np.diff(time_s)
    turn = 0.5 * (yaw_rate_radps[1:] + yaw_rate_radps[:-1]) * dt
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    run = 0.5 * (speed_mps[1:] + speed_mps[:-1]) * dt
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = run[:, None] * np.stack([np.sin(middle), np.cos(middle)], -1)
    ahead = axle_m * np.stack([np.sin(heading), np.cos(heading) - 1.0], -1)
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]) + ahead
    return DeadReckonedPath(time_s, heading, position, np.concatenate([[0.0], np.cumsum(np.abs(run))]))


def integral(time_s: Array, rate: Array) -> Array:
    """Integral of a rate from the first time on by trapezoids.  (T,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])


def turned(offset_m: Array, angle_rad: float) -> Array:
    """Rotate offsets (..., 2) clockwise by an angle, which increases the headings of a path by this angle."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    east, north = offset_m[..., 0], offset_m[..., 1]
    return np.stack([c * east + s * north, c * north - s * east], -1)


class BridgeConfig(Config):
    """Assumed errors of wheel speed and yaw rate between solutions."""

    speed_sigma_mps: float = Field(0.05, gt=0, description="wheel speed, 1 sigma [m/s]; S1 section 4")
    speed_tau_s: float = Field(1.0, gt=0, description="correlation time of the speed error [s]")
    speed_bias_mps: float = Field(
        0.01, ge=0, description="bound of a constant error of the speed [m/s]; b_v of S1 eq 19"
    )
    speed_scale: float = Field(0.02, ge=0, description="bound of the scale error of the wheel speed [-]")
    heading_sigma_deg: float = Field(2.0, ge=0, description="heading at the last solution, 1 sigma [deg]")
    heading_bias_deg: float = Field(0.2, ge=0, description="bound of the constant heading error [deg]; b_theta0 of S1")
    heading_drift_degps: float = Field(0.05, ge=0, description="growth of that bound [deg/s]; bias of a MEMS gyro")
    axle_bound_m: float = Field(
        0.05, ge=0, le=20, description="bound of the error of the distance to the rear axle [m]; measured with a tape"
    )
    heading_walk_deg_per_sqrt_s: float = Field(0.05, ge=0, description="random walk of the heading [deg/sqrt(s)]")


class Bridge:
    """Growth of the protection levels from those of a solution.

    The growth starts at the levels of the solution: the part of ``levels_m`` (..., 2) on AT, CT that exceeds
    ``K sigma`` of the fault-free covariance (..., 2, 2) in E, N [m^2] becomes a bias bound of either sign.
    ``with_heading`` (..., 3) are the covariances of E and N with the heading of the solution [m rad] and the variance
    of this heading [rad^2]; the larger of this variance and the configured one is used.

    A distance to the rear axle that is wrong by ``a`` moves the path since the solution by ``a (h - h_0)``, h the unit
    vectors of the headings: ``a abs(1 - cos t)`` along and ``a abs(sin t)`` across the track after a turn t.
    """

    def __init__(
        self, config: BridgeConfig, risk: RiskConfig, covariance_m2: Array, levels_m: Array, sigma_m: Array,
        heading_rad: ArrayLike, with_heading: Array | None = None,
    ) -> None:  # fmt: skip
        self.config, self.risk, self.elapsed_s = config, risk, 0.0
        excess = np.maximum(levels_m - missed_detection_factors(risk)[0] * sigma_m, 0.0)
        box = (np.abs(track_from_enu_matrix(heading_rad)) @ excess[..., None])[..., 0]
        self.start_rad = np.asarray(heading_rad, dtype=np.float64)
        own = np.zeros(3) if with_heading is None else with_heading
        heading_variance = np.maximum(math.radians(config.heading_sigma_deg) ** 2, own[..., 2])
        self.growth = initial_growth(covariance_m2, box, heading_variance, own[..., :2])

    def step(self, dt_s: float, speed_mps: ArrayLike, heading_rad: ArrayLike) -> tuple[Array, Array]:
        """Levels and sigmas (..., 2) on AT, CT [m] after another ``dt_s`` with mean speed and heading (...,)."""
        c = self.config
        self.elapsed_s += dt_s
        walk = math.radians(c.heading_walk_deg_per_sqrt_s) ** 2 * dt_s
        drift = math.radians(c.heading_bias_deg + c.heading_drift_degps * self.elapsed_s)
        self.growth = odometer_step(
            self.growth, dt_s, speed_mps, heading_rad, sigma_mps=c.speed_sigma_mps,
            bias_mps=c.speed_bias_mps + c.speed_scale * np.abs(speed_mps), heading_bias_rad=drift,
            phi_odometer=math.exp(-dt_s / c.speed_tau_s), heading=HeadingStep(walk),
        )  # fmt: skip
        turn = np.asarray(heading_rad) - self.start_rad
        axle = c.axle_bound_m * np.abs(np.stack([1.0 - np.cos(turn), np.sin(turn)], -1))
        levels = protection_levels(self.growth, heading_rad, self.risk)[..., 0, :] + axle
        variance = np.diagonal(rotate_covariance(self.growth.position_covariance_m2, heading_rad), axis1=-2, axis2=-1)
        return levels, np.sqrt(np.maximum(variance, 0.0))
