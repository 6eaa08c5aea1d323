"""Steering along the route by the present errors and the bend ahead; leading axes are a batch.

Symbols: e offset of the car's middle from the centreline, positive right [m], psi heading less the route's [rad], kappa
curvature [1/m], L length of the car, which is its wheelbase in highway-env [m], v speed [m/s], beta the angle of the
velocity to the heading, delta the steering angle, T length of a policy step [s].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.plans import EGO_LENGTH_M, CruiseConfig, pursuit_steering
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["LqrConfig", "LqrSteering", "PursuitSteering", "StanleyConfig", "StanleySteering", "Steering", "errors"]

Array = NDArray[np.float64]
Steering = Callable[[Observation], Array]
SPEEDS_MPS = np.arange(1.0, 41.0)  # gains are interpolated between these


class StanleyConfig(Config):
    """Gains of Stanley's law."""

    gain_per_s: float = Field(1.0, gt=0, description="k of the offset; Hoffmann 2007 has 2.5 at 200 Hz, here 5 Hz")
    soft_mps: float = Field(1.0, gt=0, description="added to the speed, for small speeds; Hoffmann 2007 eq 10")


class LqrConfig(Config):
    """Deviations that weigh alike (Bryson's rule), one policy step each."""

    offset_m: float = Field(0.3, gt=0, description="offset; half of what a lane of 3.25 m leaves, chosen")
    heading_rad: float = Field(0.1, gt=0, description="heading; chosen")
    steering_rad: float = Field(0.05, gt=0, description="steering beyond that of the bend; 2 m/s2 at 14 m/s, chosen")
    aside_m: float = Field(1.5, gt=0, description="largest offset that counts on the way to another line; chosen")


def errors(reader: Reader, observation: Observation) -> tuple[Array, Array, Array, Array]:
    """The errors to correct: e, psi less its steady value in the bend, and beta and delta of that bend.

    kappa is the route's turn up to the nearest preview over its distance. A car on the bend has ``sin(beta) = kappa L /
    2``, ``tan(delta) = 2 tan(beta)`` and ``psi = -beta`` (psi_ss of Hoffmann et al. 2007, equation 11).
    """
    e = reader.value(observation, "ego.lateral_offset")
    psi = np.arctan2(reader.value(observation, "ego.heading_sin"), reader.value(observation, "ego.heading_cos"))
    d = reader.previews_m[0]
    turn = wrap_angle(reader.value(observation, f"road.preview_{d:g}m_heading") + psi)
    beta = np.arcsin(np.clip(0.5 * EGO_LENGTH_M * turn / d, -0.7, 0.7))
    return e, psi + beta, beta, np.arctan(2.0 * np.tan(beta))


class PursuitSteering:
    """Pure pursuit: see :func:`.plans.pursuit_steering`."""

    def __init__(self, env: DrivingEnv, reader: Reader, config: CruiseConfig | None = None) -> None:
        self.reader, self.config = reader, CruiseConfig() if config is None else config

    def __call__(self, observation: Observation) -> Array:
        """Steering angle [rad], positive right."""
        return pursuit_steering(self.reader, observation, self.config)


class StanleySteering:
    """Stanley's law, about the steady state of the bend (Hoffmann et al. 2007, equations 9 to 11).

    ``delta = delta_bend - psi - atan(k e_f / (v_soft + v))``, e_f the offset of the front axle from where it runs in
    the bend.
    """

    def __init__(self, env: DrivingEnv, reader: Reader, config: StanleyConfig | None = None) -> None:
        self.reader, self.config = reader, StanleyConfig() if config is None else config

    def __call__(self, observation: Observation) -> Array:
        """Steering angle [rad], positive right."""
        c, v = self.config, np.maximum(self.reader.value(observation, "ego.speed"), 0.0)
        e, psi, _, bend = errors(self.reader, observation)
        front = e + 0.5 * EGO_LENGTH_M * np.sin(psi)
        return np.asarray(bend - psi - np.arctan(c.gain_per_s * front / (c.soft_mps + v)))


class LqrSteering:
    """Linear-quadratic regulator of offset and heading, its gains scheduled by speed.

    Small angles about the steady state of the bend, held for T (Rajamani 2012, chapter 2, kinematic):
    ``e' = e + v T psi + (v T / 2 + (v T)^2 / 2 L) u``, ``psi' = psi + v T / L u``, ``u = delta - delta_bend = -K(v) (e,
    psi)``.
    """

    def __init__(self, env: DrivingEnv, reader: Reader, config: LqrConfig | None = None) -> None:
        self.reader, self.config = reader, LqrConfig() if config is None else config
        self.gains = np.array([self._gain(v * env.dt_s) for v in SPEEDS_MPS])

    def _gain(self, way_m: float) -> Array:
        c = self.config
        a = np.array([[1.0, way_m], [0.0, 1.0]])
        b = np.array([[0.5 * way_m + 0.5 * way_m**2 / EGO_LENGTH_M], [way_m / EGO_LENGTH_M]])
        q, r = np.diag([c.offset_m**-2, c.heading_rad**-2]), np.array([[c.steering_rad**-2]])
        p = solve_discrete_are(a, b, q, r)
        return np.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0])

    def __call__(self, observation: Observation, aside_m: Array | float = 0.0) -> Array:
        """Steering angle [rad], positive right, to a line that runs ``aside_m`` to the right of the centreline."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        e, psi, _, bend = errors(self.reader, observation)
        e = np.where(np.asarray(aside_m) == 0.0, e, np.clip(e - aside_m, -c.aside_m, c.aside_m))
        by_e, by_psi = (np.interp(v, SPEEDS_MPS, self.gains[:, i]) for i in range(2))
        return np.asarray(bend - by_e * e - by_psi * psi)
