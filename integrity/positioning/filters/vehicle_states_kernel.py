"""The filter of one model, and the places of its states; :class:`~.vehicle_models.S` says what they are."""

from __future__ import annotations

from lanebound.integrity.core.records import record

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
MODELS = 2  # at most

MODEL = record(
    x=("f8", (STATES,), "states"),
    p=("f8", (STATES, STATES), "their covariance"),
    acceleration="along the velocity, as measured in this epoch [m/s^2]",
    weight=("f8", (MODELS,), "of each model in the mixture that this one begins the epoch with [-]"),
    predicted="probability before the sensor vectors of this epoch [-]",
    likelihood="log likelihood of these vectors",
)
"""The filter of one model of a vehicle; all but states and covariance are of one epoch."""
