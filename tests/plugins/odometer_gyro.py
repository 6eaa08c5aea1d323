"""Navigator kind ``odometer_gyro``: dead reckoning from the prior position and heading, without satellites."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from lanebound.integrity.core.config import Field
from lanebound.integrity.monitoring.alerts import AlertState, step
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig, register_navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode

Array = NDArray[np.float64]


class OdometerGyroConfig(NavigatorConfig):
    kind: Literal["odometer_gyro"] = "odometer_gyro"
    scale: float = Field(0.02, ge=0, description="bound of the odometer's error, as a share of the distance [-]")
    drift_radps: float = Field(0.04, ge=0, description="bound of the gyro's bias [rad/s]; 23 sigma of its turn-on")
    creep_mps: float = Field(0.15, ge=0, description="speed that the odometer may show as rest [m/s]")
    noise_m2ps: float = Field(5e-3, ge=0, description="growth of the variance by the odometer's noise, 2 sigma^2 tau")


@dataclass
class Belief:
    """All (B,), the position (B, 2)."""

    position_m: Array
    heading_rad: Array
    sigma_m: Array  # of the prior position, inf without one
    sigma_rad: Array  # of the prior heading
    time_s: Array  # since then
    grown_m: Array  # (B, R) bound of the error that has been added since then, for each level reported
    alert: AlertState


class OdometerGyroNavigator(Navigator):
    config: OdometerGyroConfig

    def initial_belief(self, batch: int) -> Belief:
        def zeros(*shape: int) -> Array:
            return np.zeros((batch, *shape))

        levels, alert = zeros(len(self.config.cases)), AlertState.initial(batch)
        return Belief(zeros(2), zeros(), zeros() + np.inf, zeros(), zeros(), levels, alert)

    def align(self, heading_rad: Array, sigma_rad: float) -> None:
        self.state.belief.heading_rad[:], self.state.belief.sigma_rad[:] = heading_rad, sigma_rad

    def place_rows(self, rows: Any, position_en_m: Array, heading_rad: Array, sigma_m: float, sigma_rad: float) -> None:
        b = self.state.belief
        b.position_m[rows], b.heading_rad[rows] = position_en_m, heading_rad
        b.sigma_m[rows], b.sigma_rad[rows], b.time_s[rows], b.grown_m[rows] = sigma_m, sigma_rad, 0.0, 0.0

    def locate(self, m: Measurements) -> Solution:
        c, b = self.config, self.state.belief
        k = norm.isf(np.array([case.integrity_risk for case in c.cases]) / 8.0)
        speed, turn = m.odometer.speed_mps, m.imu.delta_theta_rad[:, 2]
        b.position_m += c.dt_s * velocity(speed, b.heading_rad + 0.5 * turn)
        b.heading_rad += turn
        b.time_s += c.dt_s
        heading = k * b.sigma_rad[:, None] + (c.drift_radps * b.time_s)[:, None]
        b.grown_m += (
            (c.scale + heading) * np.abs(speed)[:, None] + c.creep_mps * (np.abs(speed) < 0.5)[:, None]
        ) * c.dt_s
        b.sigma_m = np.sqrt(b.sigma_m**2 + c.noise_m2ps * c.dt_s)
        levels = k * b.sigma_m[:, None] + b.grown_m
        level = levels[:, 0].copy()
        status = step(c.alert, b.alert, level, level, c.dt_s)
        return replace(
            Solution.blank(m, len(c.cases)),
            position_en_m=b.position_m.copy(),
            heading_rad=b.heading_rad.copy(),
            velocity_en_mps=velocity(speed, b.heading_rad),
            pl_at_m=level,
            pl_ct_m=level,
            pl_cases_m=np.repeat(levels[:, :, None], 2, axis=2),
            mode=np.where(np.isfinite(level), int(Mode.IMU_ODOMETER), int(Mode.NONE)),
            alert=status.alert,
            available=status.available,
            reason=status.reason,
        )


def velocity(speed_mps: Array, heading_rad: Array) -> Array:
    """East, North (B, 2) [m/s]."""
    return speed_mps[:, None] * np.stack([np.sin(heading_rad), np.cos(heading_rad)], -1)


register_navigator(OdometerGyroConfig, OdometerGyroNavigator)
