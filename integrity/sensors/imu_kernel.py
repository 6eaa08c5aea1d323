"""Inertial increments of vehicles as a linear map of their error state and the draws of the epoch."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["AXIS", "IMU_RULES", "INERTIAL", "TRIAD", "measure", "measure_rows"]

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

INERTIAL = record(
    axes=(AXIS, (2, 3), "of the gyros and of the accelerometers"),
    moving_bias="of the yaw gyro in motion [rad/s]",
    on_s="time since switch-on [s]",
    warm_up="on the accelerometers in this epoch [m/s]",
)
"""What lasts of the inertial sensors of a vehicle."""


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
def measure(rules, sensor, z, truth, gyro_bias, out):  # type: ignore[no-untyped-def]
    """Measure a vehicle by the draws z (2, 3, 5): turn and delta_v of ``out`` (OBSERVED_VEHICLE); ``sensor`` (INERTIAL)
    advances.

    ``gyro_bias`` [rad/s] is a fault of the yaw gyro.
    """
    measure_triad(rules.gyro, sensor.axes[0], z[0], truth.turn, out.turn)
    measure_triad(rules.accel, sensor.axes[1], z[1], truth.delta_v, out.delta_v)
    out.turn[2] += gyro_bias * rules.dt
    if abs(truth.distance) > rules.moving:
        out.turn[2] += sensor.moving_bias * rules.dt
    for i in range(3):
        out.delta_v[i] += sensor.warm_up


@jit
def measure_rows(rules, sensors, z, truths, moved, out):  # type: ignore[no-untyped-def]
    """:func:`measure` for B vehicles: rules (1,), z (B, 2, 3, 5), ``moved`` (B,) of VEHICLE_EFFECTS."""
    for v in range(out.shape[0]):
        measure(rules[0], sensors[v], z[v], truths[v], moved[v].gyro_bias_radps, out[v])
