"""The inertial sensor: increments of angle and velocity, drawn once an epoch with the statistics of 100 Hz sampling.

White rate noise of density N adds up to ``N(0, N^2 dt)`` over an epoch, whatever the sampling. The two wandering biases
are integrated exactly, each with the joint law of (bias at the end, integral over the epoch).
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import imu_kernel as kernel
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.observed_kernel import OBSERVED_VEHICLE

__all__ = [
    "AxisNoise",
    "ImuConfig",
    "ImuSample",
    "ImuState",
    "gauss_markov_step",
    "initial_imu",
    "random_walk_step",
    "sample_imu",
]

Array = NDArray[np.float64]
DEG = math.pi / 180.0
MOVING_MPS = 0.1  # slower is standing still, for the bias that comes with motion


@dataclass(frozen=True)
class ImuSample:
    """Increments over one epoch in body axes (forward, right, down).

    Attributes
    ----------
    delta_theta_rad : (B, 3) integrated angular rate
    delta_v_mps : (B, 3) integrated specific force
    """

    delta_theta_rad: Array
    delta_v_mps: Array


class AxisNoise(Config):
    """Errors of one triad, in the unit u of its rate: rad/s for gyros, m/s^2 for accelerometers."""

    density: float = Field(ge=0, description="white noise density N [u/sqrt(Hz)]")
    instability: float = Field(0.0, ge=0, description="1-sigma of the wandering bias, first-order Gauss-Markov [u]")
    instability_s: float = Field(100.0, gt=0, description="its correlation time [s]; gnss-ins-sim low accuracy")
    random_walk: float = Field(0.0, ge=0, description="rate random walk K [u/sqrt(s)]")
    turn_on: float = Field(0.0, ge=0, description="1-sigma of the bias drawn at switch-on [u]")
    scale: float = Field(0.0, ge=0, description="1-sigma of the scale factor error drawn at switch-on [-]")


class ImuConfig(Config):
    """A grade of inertial sensor; the default is a consumer MEMS (BMI088)."""

    grade: Literal["consumer", "automotive", "tactical", "s1_consumer"] = "consumer"
    gyro: AxisNoise = Field(
        AxisNoise(density=0.014 * DEG, instability=6.0 * DEG / 3600, random_walk=2e-6, turn_on=0.1 * DEG, scale=3e-3),
        description="gyros; BMI088 0.014 deg/s/sqrt(Hz), after a standstill calibration of the 1 deg/s offset",
    )
    accel: AxisNoise = Field(
        AxisNoise(density=1.72e-3, instability=4e-4, random_walk=1e-5, turn_on=0.05, scale=5e-3),
        description="accelerometers; BMI088 175 ug/sqrt(Hz), zero offset 20 mg before calibration to 5 mg",
    )
    moving_gyro_bias_degps: float = Field(
        0.0,
        ge=0,
        description="largest heading-rate bias that appears with motion, uniform within +- it; S1 states 0.004 [deg/s]",
    )
    mems_exponential: bool = Field(False, description="add the S4 warm-up error to the accelerometers")
    mems_c1_mps2: float = Field(-0.0043, description="C1 of S4 section III-A [m/s^2]")
    mems_c2_mps2: float = Field(-0.007, description="C2 of S4 section III-A [m/s^2]")
    mems_tau_s: float = Field(500.0, gt=0, description="tau of S4 section III-A [s]")


@dataclass
class ImuState:
    """What persists: ``sensors`` (B,) of INERTIAL, a record of :mod:`.imu_kernel`."""

    sensors: Records

    def advance(self, config: ImuConfig, dt_s: float) -> None:
        """Set the warm-up error of the epoch that begins, and count its time."""
        if config.mems_exponential:
            self.sensors["warm_up"] = warm_up(config, self.sensors["on_s"], dt_s)
        self.sensors["on_s"] += dt_s

    def copy(self) -> ImuState:
        """An independent copy."""
        return copy.deepcopy(self)


def gauss_markov_step(bias: Array, sigma: Array | float, tau_s: float, dt_s: float, z: Array) -> tuple[Array, Array]:
    """Advance a first-order Gauss-Markov bias and integrate it over the step, exactly.

    With ``r = dt / tau`` and ``a = exp(-r)``: mean of (end, integral) is ``(a b, tau (1 - a) b)``; covariance
    ``s^2 [[1 - a^2, tau (1 - a)^2], [., tau^2 (2 r - 3 + 4 a - a^2)]]`` (Ito integral of the Ornstein-Uhlenbeck law).

    Parameters
    ----------
    bias : (...,) at the start [u];  sigma : stationary 1-sigma [u];  z : (..., 2) standard normal

    Returns
    -------
    end, integral : (...,) [u] and [u s]
    """
    r = dt_s / tau_s
    a, lost = math.exp(-r), -math.expm1(-r)
    c11 = -math.expm1(-2.0 * r)
    c12 = tau_s * lost * lost
    # The closed form cancels to nothing for short steps; its series is exact to 2e-7 of itself below r = 1e-2.
    c22 = tau_s**2 * (2 * r - 3 + 4 * a - a * a if r > 1e-2 else r**3 * (2 / 3 - r / 2 + 7 * r * r / 30))
    l11 = math.sqrt(c11)
    l21 = c12 / l11
    l22 = math.sqrt(max(c22 - l21 * l21, 0.0))
    end = a * bias + sigma * l11 * z[..., 0]
    integral = tau_s * lost * bias + sigma * (l21 * z[..., 0] + l22 * z[..., 1])
    return end, integral


def random_walk_step(bias: Array, density: Array | float, dt_s: float, z: Array) -> tuple[Array, Array]:
    """Advance a random-walk bias and integrate it: covariance ``K^2 [[dt, dt^2/2], [., dt^3/3]]``.

    bias (...,) [u], density [u/sqrt(s)], z (..., 2) standard normal -> end [u], integral [u s].
    """
    root = math.sqrt(dt_s)
    end = bias + density * root * z[..., 0]
    integral = bias * dt_s + density * dt_s * root * (0.5 * z[..., 0] + z[..., 1] / math.sqrt(12.0))
    return end, integral


def warm_up(config: ImuConfig, on_s: Array, dt_s: float) -> Array:
    """Integral [m/s] of ``e(t) = C1 (1 - exp(-t/tau)) + C2`` (S4 section III-A) over an epoch; 0 if it is off.

    on_s (B,): time since switch-on at the start of the epoch [s].
    """
    if not config.mems_exponential:
        return np.zeros(on_s.shape)
    c1, c2, tau = config.mems_c1_mps2, config.mems_c2_mps2, config.mems_tau_s
    return (c1 + c2) * dt_s + c1 * tau * np.exp(-on_s / tau) * math.expm1(-dt_s / tau)


def _pair(config: ImuConfig, name: str) -> Array:
    """A parameter of both triads as (2, 1), gyro first."""
    return np.array([[getattr(config.gyro, name)], [getattr(config.accel, name)]])


def initial_imu(config: ImuConfig, streams: Streams) -> ImuState:
    """Draw what is fixed at switch-on for each of ``streams.batch`` vehicles, from stream ``imu``."""
    z = streams.normal("imu", 3, 2, 3)
    u = streams.uniform("imu", 1)[:, 0]
    sensors = np.zeros(streams.batch, kernel.INERTIAL)
    for k, name in enumerate(("turn_on", "scale", "instability")):
        sensors["axes"][name] = z[:, k] * _pair(config, name)
    sensors["moving_bias"] = (2.0 * u - 1.0) * config.moving_gyro_bias_degps * DEG
    return ImuState(sensors)


@lru_cache(maxsize=64)
def imu_parameters(config: ImuConfig, dt_s: float) -> Records:
    """The figures of the sensor as the kernel takes them, (1,) of IMU_RULES."""
    gyro, accel = (_triad(triad, dt_s) for triad in (config.gyro, config.accel))
    return one_record(kernel.IMU_RULES, dt=dt_s, moving=MOVING_MPS * dt_s, gyro=gyro, accel=accel)


def _triad(triad: AxisNoise, dt_s: float) -> Records:
    """What the kernel multiplies states and draws of a triad with: the steps above, applied to unit vectors."""
    zero, unit = np.zeros(3), np.eye(3, 2, k=-1)  # one state and two draws, each 1 in its turn
    state = np.array([1.0, 0.0, 0.0])
    end, integral = gauss_markov_step(state, triad.instability, triad.instability_s, dt_s, unit)
    walk_end, walk = random_walk_step(zero, triad.random_walk, dt_s, unit)
    return one_record(
        kernel.TRIAD,
        turn_on=dt_s,
        white=triad.density * math.sqrt(dt_s),
        decay=end[0],
        end_1=end[1],
        integral=integral[0],
        integral_1=integral[1],
        integral_2=integral[2],
        walk_end_1=walk_end[1],
        walk_1=walk[1],
        walk_2=walk[2],
    )


def sample_imu(config: ImuConfig, state: ImuState, truth: Truth, effects: FaultEffects, streams: Streams) -> ImuSample:
    """Measure one epoch; ``state`` advances in place.

    Raises
    ------
    InputError
        When truth and streams serve different numbers of vehicles.
    """
    if truth.batch != streams.batch:
        raise InputError(f"truth holds {truth.batch} vehicles, streams {streams.batch}: make both the same batch")
    rules, out = imu_parameters(config, truth.dt_s), np.zeros(truth.batch, OBSERVED_VEHICLE)
    state.advance(config, truth.dt_s)
    kernel.measure_rows(rules, state.sensors, streams.normal("imu", 2, 3, 5), truth.records, effects.vehicles, out)
    return ImuSample(out["turn"], out["delta_v"])
