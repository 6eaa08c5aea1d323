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

from lanebound.integrity.positioning.filters import vehicle_states_kernel as places

__all__ = ["TRANSITION", "Interaction", "Predictor", "S"]


class S(IntEnum):
    """Place of each state. Position East, North [m]; angles [rad], clockwise from North; speed [m/s]."""

    EAST = places.EAST
    NORTH = places.NORTH
    HEADING = places.HEADING
    YAW_RATE = places.YAW_RATE
    SPEED = places.SPEED
    SLIP = places.SLIP
    SLIDE = places.SLIDE
    SLIP_RATE = places.SLIP_RATE
    # errors of sensors
    GYRO_BIAS = places.GYRO_BIAS  # [rad/s]
    GYRO_SCALE = places.GYRO_SCALE  # [-]
    GYRO_ANGLE = places.GYRO_ANGLE  # integrated gyro less heading [rad]
    WHEEL_SCALE = places.WHEEL_SCALE  # [-]
    ACCEL_BIAS = places.ACCEL_BIAS  # [m/s^2]
    COMPASS = places.COMPASS  # deviation [rad]
    GNSS_EAST = places.GNSS_EAST  # slow error of the position [m]
    GNSS_NORTH = places.GNSS_NORTH


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
