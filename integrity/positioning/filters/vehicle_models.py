"""States of the vehicle models of S4 (eq 1-2), with the errors of its sensors as further states.

S4's state is position, heading, yaw rate, speed, slip angle and slide correction; the curved model adds the rate of the
slip angle. Both models are one function here: a straight model's slip rate is 0 with variance 0. They differ in their
noise, ``x(k+1) = f(x(k)) + G(x(k)) v(k)``: a yaw acceleration, an acceleration, the rate (straight) or the acceleration
(curved) of the slip angle, and the rate of the slide.

The velocity has the azimuth ``heading + slip + slide``. S4 measures angles from the x axis; here they are azimuths, so
that sine and cosine change places.

S4 tried sensor errors as states and left them out, because its tests showed no correlation in time. Ours are correlated
by construction (a gyro bias, a wheel scale, an atmosphere), so the states below the line in :class:`S` exist. With
initial variances and noise of 0 they vanish, and S4's own filter remains.
"""

from __future__ import annotations

from enum import Enum, IntEnum

__all__ = ["NOISES", "STATES", "TRANSITION", "WHITE", "Interaction", "Predictor", "S"]


class S(IntEnum):
    """Place of each state. Position East, North [m]; angles [rad], clockwise from North; speed [m/s]."""

    EAST = 0
    NORTH = 1
    HEADING = 2
    YAW_RATE = 3
    SPEED = 4
    SLIP = 5
    SLIDE = 6
    SLIP_RATE = 7
    # errors of sensors
    GYRO_BIAS = 8  # [rad/s]
    GYRO_SCALE = 9  # [-]
    GYRO_ANGLE = 10  # integrated gyro less heading [rad]
    WHEEL_SCALE = 11  # [-]
    ACCEL_BIAS = 12  # [m/s^2]
    COMPASS = 13  # deviation [rad]
    GNSS_EAST = 14  # slow error of the position [m]
    GNSS_NORTH = 15


STATES = len(S)
NOISES = 4  # of S4 eq 2
WHITE = NOISES + 3  # with the independent parts of white accelerations

# for kernels
EAST, NORTH, HEADING, YAW_RATE, SPEED, SLIP, SLIDE, SLIP_RATE = (int(S(k)) for k in range(8))
GYRO_BIAS, GYRO_SCALE, GYRO_ANGLE, WHEEL_SCALE, ACCEL_BIAS, COMPASS, GNSS_EAST, GNSS_NORTH = (
    int(S(k)) for k in range(8, 16)
)

TRANSITION = ((0.7, 0.3), (0.4, 0.6))
"""S4 eq 9: from straight and from curved, to straight and to curved, at each scan [-]."""


class Interaction(Enum):
    """How the filters of the models begin a scan (:mod:`.mixing_kernel`)."""

    STANDARD = "standard"
    PUBLISHED = "published"


class Predictor(Enum):
    """Which prediction the filters use (:mod:`.prediction_kernel`)."""

    EXTENDED = "ekf"
    UNSCENTED = "ukf"
