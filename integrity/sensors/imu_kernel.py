"""Inertial increments of vehicles as a linear map of their error state and the draws of the epoch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["AXIS", "IMU_RULES", "TRIAD", "ImuOutputs", "ImuRows", "measure"]

Array = NDArray[np.float64]

TRIAD = record(
    turn_on="of the turn-on bias and the random walk [s]",
    white="of the white noise [sqrt(s)]",
    decay="of the wandering bias over an epoch [-]",
    end_1="of the first draw in the wandering bias at the end",
    integral="of the wandering bias in the increment [s]",
    integral_1="of the first draw in the increment",
    integral_2="of the second draw in the increment",
    walk_end_1="of the third draw in the random walk at the end",
    walk_1="of the third draw in the increment",
    walk_2="of the fourth draw in the increment",
)
"""Coefficients of a triad."""

IMU_RULES = record(
    dt="length of an epoch [s]",
    moving="distance in an epoch from which on a vehicle moves [m]",
    gyro=(TRIAD, "gyros"),
    accel=(TRIAD, "accelerometers"),
)

AXIS = record(
    turn_on="bias drawn at switch-on [u]",
    scale="error of the scale [-]",
    instability="wandering bias [u]",
    walk="random walk [u]",
)
"""Errors of an axis in the unit u of its rate."""


class ImuRows(NamedTuple):
    """Inertial sensors of B vehicles.

    rules (1,) of IMU_RULES; axes (B, 2, 3) of AXIS, gyro first; moving_bias (B,) [rad/s] of the yaw gyro in motion;
    warm_up (B,) [m/s] on the accelerometers in this epoch; normals (B, 2, 3, 5), the draws of the epoch.
    """

    rules: Records
    axes: Records
    moving_bias: Array
    warm_up: Array
    normals: Array


class ImuOutputs(NamedTuple):
    """Increments turn, delta_v (B, 3), as in :class:`~lanebound.integrity.sensors.imu.ImuSample`."""

    turn: Array
    delta_v: Array


@jit(borrows=True)
def measure_triad(triad, axes, z, truth, out):  # type: ignore[no-untyped-def]
    """Increments ``out`` (3,) of a triad by the draws z (3, 5); the axes (3,) advance in place."""
    for i in range(3):
        axis = axes[i]
        error = triad.turn_on * (axis.turn_on + axis.walk) + triad.white * z[i, 0]
        error += triad.integral * axis.instability
        error += triad.integral_1 * z[i, 1] + triad.integral_2 * z[i, 2]
        error += triad.walk_1 * z[i, 3] + triad.walk_2 * z[i, 4]
        axis.instability = triad.decay * axis.instability + triad.end_1 * z[i, 1]
        axis.walk += triad.walk_end_1 * z[i, 3]
        out[i] = truth[i] * (1.0 + axis.scale) + error


@jit(borrows=True)
def measure(first, last, imu, motion, gyro_bias, out):  # type: ignore[no-untyped-def]
    """Vehicles ``first`` to ``last - 1``; gyro_bias (B,) [rad/s] is a fault of the yaw gyro."""
    rules = imu.rules[0]
    for v in range(first, last):
        turn, delta_v = out.turn[v], out.delta_v[v]
        measure_triad(rules.gyro, imu.axes[v, 0], imu.normals[v, 0], motion.turn[v], turn)
        measure_triad(rules.accel, imu.axes[v, 1], imu.normals[v, 1], motion.delta_v[v], delta_v)
        turn[2] += gyro_bias[v] * rules.dt
        if abs(motion.distance[v]) > rules.moving:
            turn[2] += imu.moving_bias[v] * rules.dt
        for i in range(3):
            delta_v[i] += imu.warm_up[v]
