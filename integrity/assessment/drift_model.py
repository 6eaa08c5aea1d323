"""Monte Carlo of errors between fixes, compared with the levels of modes without redundancy (S1 eq 18-21).

A run is one outage with constant speed and turn rate, and either Doppler velocities or odometer and heading. The errors
of many vehicles follow the processes assumed by the levels, with biases at their bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.dead_reckoning_pl import (
    Growth,
    HeadingStep,
    doppler_step,
    initial_growth,
    odometer_step,
    protection_levels,
)
from lanebound.integrity.monitoring.risk import RiskConfig, Variant

__all__ = ["DriftConfig", "Outage", "draw_drift", "drift_exceedance"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class DriftConfig(Config):
    """Parameters of the error processes between fixes."""

    dt_s: float = Field(0.1, gt=0, description="length of an epoch [s]; 10 Hz GNSS, S1 section 4")
    fix_sigma_m: float = Field(0.01, gt=0, description="1-sigma of the last fix, each axis [m]")
    doppler_sigma_mps: float = Field(0.10, gt=0, description="Doppler velocity, 1-sigma [m/s]; S1 section 3")
    doppler_tau_s: float = Field(0.54, gt=0, description="correlation time of Doppler [s]; fits S1's Doppler levels")
    doppler_bias_mps: float = Field(0.01, ge=0, description="bound of the Doppler bias, East and North [m/s]")
    odometer_sigma_mps: float = Field(0.05, gt=0, description="odometer, 1-sigma [m/s]; S1 section 3")
    odometer_tau_s: float = Field(1.0, gt=0, description="correlation time of the odometer error [s]")
    odometer_bias_mps: float = Field(0.01, ge=0, description="bound of the odometer bias [m/s]")
    heading_sigma_deg: float = Field(0.3, gt=0, description="heading at the start, 1-sigma [deg]")
    heading_walk_degps: float = Field(0.02, gt=0, description="random walk of the heading [deg/sqrt(s)]")
    heading_bias_deg: float = Field(0.1, ge=0, description="bound of the heading bias [deg]")


@dataclass(frozen=True)
class Outage:
    """One outage: source of the velocity, length [s], speed [m/s], initial heading [rad] and turn rate [rad/s]."""

    source: Literal["doppler", "odometer"]
    length_s: float
    speed_mps: float
    heading_rad: float
    turn_radps: float


def draw_drift(
    outage: Outage, config: DriftConfig, vehicles: int, generator: np.random.Generator
) -> tuple[Array, dict[Variant, Growth], float]:
    """Draw errors of V vehicles at the end of an outage (V, 2) East and North [m]; also returns the error growth
    assumed by the levels, by variant, and the final heading [rad]."""
    steps = max(round(outage.length_s / config.dt_s), 1)
    heading = outage.heading_rad + outage.turn_radps * config.dt_s * np.arange(1, steps + 1)
    error = _Errors(config, vehicles, generator, heading[-1])
    growths = {
        v: initial_growth(np.eye(2) * config.fix_sigma_m**2, [0.0, 0.0], error.heading_variance) for v in Variant
    }
    for t in heading:
        for variant in Variant:
            growths[variant] = error.grow(growths[variant], outage, t, variant)
        error.step(outage, t)
    return error.position, growths, float(heading[-1])


def drift_exceedance(
    outage: Outage, config: DriftConfig, risks: ArrayLike, vehicles: int, generator: np.random.Generator
) -> dict[Variant, Ints]:
    """Count vehicles whose error exceeds the level at the end, along, across and on either axis, by variant: (R, 3)."""
    error, growths, heading = draw_drift(outage, config, vehicles, generator)
    track = np.abs(error @ track_from_enu_matrix(heading).T)
    out = {}
    for variant, growth in growths.items():
        level = protection_levels(growth, heading, RiskConfig(variant=variant), risks)
        beyond = track > level[:, None, :]
        out[variant] = np.concatenate([beyond.sum(1), beyond.any(-1).sum(1)[:, None]], -1).astype(np.int64)
    return out


class _Errors:
    """Errors of many vehicles (unit processes, heading and position) and the growth of their covariance."""

    def __init__(self, config: DriftConfig, vehicles: int, generator: np.random.Generator, last_rad: float) -> None:
        self.config, self._generator = config, generator
        self.heading_variance = float(np.deg2rad(config.heading_sigma_deg) ** 2)
        self._walk = float(np.deg2rad(config.heading_walk_degps) ** 2 * config.dt_s)
        self.position = config.fix_sigma_m * self._draw(vehicles, 2)
        self._velocity = self._draw(vehicles, 2)
        self._speed = self._draw(vehicles, 1)[:, 0]
        self._heading = np.sqrt(self.heading_variance) * self._draw(vehicles, 1)[:, 0]
        self._phi_d = float(np.exp(-config.dt_s / config.doppler_tau_s))
        self._phi_o = float(np.exp(-config.dt_s / config.odometer_tau_s))
        self._first = True
        self._bias_en = config.doppler_bias_mps * np.sign(track_from_enu_matrix(last_rad)[0])  # worst sign at the end

    def _draw(self, *shape: int) -> Array:
        return self._generator.standard_normal(shape)

    def grow(self, growth: Growth, outage: Outage, heading_rad: float, variant: Variant) -> Growth:
        """Covariance and biases of the levels after one more epoch; called before :meth:`step`."""
        c = self.config
        phi = {"phi_doppler": self._phi_d, "phi_odometer": self._phi_o}
        if outage.source == "doppler":
            factor = c.doppler_sigma_mps * np.eye(2)
            return doppler_step(
                growth, c.dt_s, None if self._first else factor, factor, bias_mps=c.doppler_bias_mps,
                heading=HeadingStep(self._walk), variant=variant, **phi,
            )  # fmt: skip
        return odometer_step(
            growth, c.dt_s, outage.speed_mps, heading_rad, sigma_mps=c.odometer_sigma_mps,
            bias_mps=c.odometer_bias_mps, heading_bias_rad=np.deg2rad(c.heading_bias_deg),
            heading=HeadingStep(self._walk),
            variant=variant, **phi,
        )  # fmt: skip

    def step(self, outage: Outage, heading_rad: float) -> None:
        """Advance the errors by one epoch."""
        c, n = self.config, len(self.position)
        before, heading_before = self._velocity, self._heading
        self._velocity = self._phi_d * before + np.sqrt(1.0 - self._phi_d**2) * self._draw(n, 2)
        self._speed = self._phi_o * self._speed + np.sqrt(1.0 - self._phi_o**2) * self._draw(n, 1)[:, 0]
        self._heading = heading_before + np.sqrt(self._walk) * self._draw(n, 1)[:, 0]
        if outage.source == "doppler":
            mean = self._velocity if self._first else 0.5 * (before + self._velocity)
            self.position = self.position + c.dt_s * (c.doppler_sigma_mps * mean + self._bias_en)
        else:
            along, across = track_from_enu_matrix(heading_rad)
            speed = c.odometer_sigma_mps * self._speed + c.odometer_bias_mps
            turn = 0.5 * (heading_before + self._heading) + np.deg2rad(c.heading_bias_deg)
            self.position = self.position + c.dt_s * (
                speed[:, None] * along + outage.speed_mps * turn[:, None] * across
            )
        self._first = False
