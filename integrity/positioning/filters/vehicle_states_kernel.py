"""Places of the states of vehicle filters, as kernels take them; :class:`~.vehicle_models.S` says what they are."""

from __future__ import annotations

EAST, NORTH, HEADING, YAW_RATE, SPEED, SLIP, SLIDE, SLIP_RATE = 0, 1, 2, 3, 4, 5, 6, 7
GYRO_BIAS, GYRO_SCALE, GYRO_ANGLE, WHEEL_SCALE, ACCEL_BIAS, COMPASS, GNSS_EAST, GNSS_NORTH = (
    8,
    9,
    10,
    11,
    12,
    13,
    14,
    15,
)

STATES = 16
NOISES = 4  # of S4 eq 2
WHITE = NOISES + 3  # with the independent parts of white accelerations
