"""The compass: magnetic heading with a deviation of its own and disturbances of the surroundings."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth

__all__ = ["CompassConfig", "CompassSample", "CompassState", "initial_compass", "sample_compass"]

Array = NDArray[np.float64]


class CompassConfig(Config):
    """True errors of a compass."""

    fitted: bool = Field(False, description="the navigator reads the compass")
    deviation_deg: float = Field(
        1.0, ge=0, description="1-sigma of the constant error [deg]; Xsens MTi and MTx, static accuracy of the heading"
    )
    disturbance_deg: float = Field(
        2.0, ge=0, description="1-sigma of disturbances by iron beside the road [deg]; MTi and MTx, dynamic accuracy"
    )
    disturbance_s: float = Field(5.0, gt=0, description="their correlation time [s]; chosen, some 50 m of street")
    noise_deg: float = Field(0.3, ge=0, description="white noise [deg]; chosen")


@dataclass(frozen=True)
class CompassSample:
    """heading_rad (B,), azimuth clockwise from North at the end of the epoch."""

    heading_rad: Array


@dataclass
class CompassState:
    """Lasting errors of B vehicles (B,) [rad]."""

    deviation_rad: Array
    disturbance_rad: Array

    def copy(self) -> CompassState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_compass(config: CompassConfig, streams: Streams) -> CompassState:
    """Draw the lasting errors, from stream ``compass``."""
    z = streams.normal("compass", 2)
    return CompassState(
        np.deg2rad(config.deviation_deg) * z[:, 0].copy(), np.deg2rad(config.disturbance_deg) * z[:, 1].copy()
    )


def sample_compass(config: CompassConfig, state: CompassState, truth: Truth, streams: Streams) -> CompassSample:
    """Measure one epoch; ``state`` advances in place, its disturbance as a Gauss-Markov error."""
    z, a = streams.normal("compass", 2), np.exp(-truth.dt_s / config.disturbance_s)
    state.disturbance_rad *= a
    state.disturbance_rad += np.deg2rad(config.disturbance_deg) * np.sqrt(1.0 - a * a) * z[:, 0]
    noise = np.deg2rad(config.noise_deg) * z[:, 1]
    return CompassSample(wrap_angle(truth.heading_rad + state.deviation_rad + state.disturbance_rad + noise))
