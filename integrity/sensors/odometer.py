"""The wheel odometer: pulses of a toothed wheel, with a wrong circumference, slip and speed noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import odometer_kernel as kernel
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.observed_kernel import OBSERVED_VEHICLE

__all__ = ["OdometerConfig", "OdometerSample", "OdometerState", "initial_odometer", "sample_odometer"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometerSample:
    """What the wheels say about one epoch, positive forward.

    Attributes
    ----------
    distance_m : (B,) path length over the epoch
    speed_mps : (B,) its mean speed
    """

    distance_m: Array
    speed_mps: Array


class OdometerConfig(Config):
    """A wheel-speed sensor after the calibration of its scale."""

    scale_mean: float = Field(1.0, gt=0, description="mean of the scale [-]; uncalibrated cars show 0.987 to 0.990")
    scale_sigma: float = Field(0.003, ge=0, description="1-sigma of the scale left after calibration [-]; tyre wear")
    noise_mps: float = Field(
        0.05, ge=0, description="1-sigma of the speed [m/s]; S1 section 4, comma2k19 residual 0.05"
    )
    noise_tau_s: float = Field(0.0, ge=0, description="correlation time of that noise, 0 = white [s]")
    pulses_per_revolution: int = Field(
        2000,
        ge=1,
        description="pulses of a wheel [-]; optical encoder of a survey car, or 48 teeth whose edges are timed",
    )
    circumference_m: float = Field(1.95, gt=0, description="rolling circumference [m]; tyre 205/55 R16")
    slip_s2_per_m: float = Field(
        0.001,
        ge=0,
        description="longitudinal slip per acceleration [s^2/m]; 3 to 4 % at the 1 g limit, linear below half",
    )
    dropout_mps: float = Field(0.15, ge=0, description="slower than this no pulse is detected [m/s]; inductive sensors")


@dataclass
class OdometerState:
    """What lasts of the odometers, wheels (B,) of WHEELS, a record of :mod:`.odometer_kernel`."""

    wheels: Records

    def copy(self) -> OdometerState:
        """An independent copy."""
        return OdometerState(self.wheels.copy())


def initial_odometer(config: OdometerConfig, streams: Streams) -> OdometerState:
    """Draw the scale of each of ``streams.batch`` vehicles, from stream ``odometer``."""
    z, wheels = streams.normal("odometer", 2), np.zeros(streams.batch, kernel.WHEELS)
    wheels["scale"] = config.scale_mean + config.scale_sigma * z[:, 0]
    if config.noise_tau_s > 0:
        wheels["noise_mps"] = config.noise_mps * z[:, 1]
    wheels["last_true_mps"] = np.nan
    return OdometerState(wheels)


@lru_cache(maxsize=64)
def odometer_parameters(config: OdometerConfig, dt_s: float) -> Records:
    """The figures of the sensor as the kernel takes them, (1,) of ODOMETER_RULES; white or Gauss-Markov noise."""
    a = math.exp(-dt_s / config.noise_tau_s) if config.noise_tau_s > 0 else 0.0
    return one_record(
        kernel.ODOMETER_RULES,
        dt=dt_s,
        decay=a,
        innovation=config.noise_mps * math.sqrt(1.0 - a * a),
        pulse=config.circumference_m / config.pulses_per_revolution,
        slip=config.slip_s2_per_m,
        dropout=config.dropout_mps,
    )


def sample_odometer(
    config: OdometerConfig, state: OdometerState, truth: Truth, effects: FaultEffects, streams: Streams
) -> OdometerSample:
    """Measure one epoch; ``state`` advances in place.

    ``d = trunc_pulse(carry + k f (1 + s a) d_true + n dt)`` with scale k, fault factor f, slip s per acceleration a and
    noise n. Quantisation loses no distance, noise is silent below the dropout speed, a frozen odometer repeats itself.

    Raises
    ------
    InputError
        When truth and streams serve different numbers of vehicles.
    """
    if truth.batch != streams.batch:
        raise InputError(f"truth holds {truth.batch} vehicles, streams {streams.batch}: make both the same batch")
    rules, out = odometer_parameters(config, truth.dt_s), np.zeros(truth.batch, OBSERVED_VEHICLE)
    z = streams.normal("odometer", 1)
    kernel.measure_rows(rules, state.wheels, z, truth.records, effects.vehicles, out)
    return OdometerSample(out["distance"], out["speed"])
