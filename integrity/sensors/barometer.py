"""The barometer: height from air pressure, with an offset, the weather, the car's own wind, and noise."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth

__all__ = ["BarometerConfig", "BarometerSample", "BarometerState", "initial_barometer", "sample_barometer"]

Array = NDArray[np.float64]


class BarometerConfig(Config):
    """True errors of a barometric height whose offset was calibrated when the vehicle was switched on.

    A pascal is 0.083 m of height at sea level.
    """

    fitted: bool = Field(False, description="the navigator reads the barometer")
    offset_m: float = Field(
        0.5,
        ge=0,
        description="1-sigma of the offset left by the calibration at a known height [m]; Bosch BMP390: relative "
        "accuracy 3 Pa (0.25 m), absolute 50 Pa (4 m) without a calibration",
    )
    weather_m: float = Field(
        8.0,
        ge=0,
        description="1-sigma of the weather in the long run [m]; with its time 2.5 m (0.3 hPa) in half an hour",
    )
    weather_tau_s: float = Field(
        36000.0, gt=0, description="its correlation time [s]; chosen: pressure changes by 1 to 2 hPa in 3 h"
    )
    wind: float = Field(
        0.1,
        ge=0,
        description="1-sigma of the pressure coefficient where the sensor sits [-]: v^2 / (2 g) times it, 0.5 m at "
        "10 m/s (Bernoulli); Matyja, Kubik and Stanik 2022 find the same law; inside of a car, chosen",
    )
    noise_m: float = Field(0.1, ge=0, description="white noise [m]; BMP390, some pascals at 10 Hz without its filter")


@dataclass(frozen=True)
class BarometerSample:
    """height_m (B,), Up of the antenna in the local frame at the end of the epoch."""

    height_m: Array


@dataclass
class BarometerState:
    """Lasting errors of B vehicles (B,): offset and weather [m], pressure coefficient [-]."""

    offset_m: Array
    weather_m: Array
    wind: Array

    def copy(self) -> BarometerState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_barometer(config: BarometerConfig, streams: Streams) -> BarometerState:
    """Draw the lasting errors, from stream ``barometer``; the weather has not changed since the calibration."""
    z = streams.normal("barometer", 2)
    return BarometerState(config.offset_m * z[:, 0], np.zeros(z.shape[0]), config.wind * z[:, 1])


def sample_barometer(config: BarometerConfig, state: BarometerState, truth: Truth, streams: Streams) -> BarometerSample:
    """Measure one epoch; ``state`` advances in place. ``truth`` is that of the antenna."""
    z, a = streams.normal("barometer", 2), np.exp(-truth.dt_s / config.weather_tau_s)
    state.weather_m *= a
    state.weather_m += config.weather_m * np.sqrt(1.0 - a * a) * z[:, 0]
    square = np.square(truth.velocity_enu_mps[:, :2]).sum(-1)
    height = truth.position_enu_m[:, 2] + state.offset_m + state.weather_m + state.wind * square / (2.0 * GRAVITY_MPS2)
    return BarometerSample(height + config.noise_m * z[:, 1])
