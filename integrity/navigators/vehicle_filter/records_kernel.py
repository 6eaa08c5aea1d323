"""The records of vehicle filters: parameters, state, measurements and outputs of B vehicles with r models each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.alerts_kernel import ALERT, ALERT_RULES
from lanebound.integrity.positioning.filters.odometry_kernel import CAR
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODELS, STATES, WHITE

__all__ = [
    "BIASES",
    "COMMON",
    "COMPASS",
    "COURSE_BIAS",
    "GNSS",
    "GNSS_EAST_BIAS",
    "GNSS_NORTH_BIAS",
    "GYRO",
    "MEASURED",
    "MOTION",
    "OUT",
    "PARAMETERS",
    "POSITION",
    "REST_BIAS",
    "SLIPPING",
    "SLOW_ERROR",
    "SPEED_BIAS",
    "STEERING",
    "VECTORS",
    "VEHICLE",
    "FilterState",
    "PositionFix",
]  # fmt: skip

Array = NDArray[np.float64]

BIASES = 5  # bounded constant errors
GNSS_EAST_BIAS, GNSS_NORTH_BIAS, COURSE_BIAS, SPEED_BIAS, REST_BIAS = range(BIASES)
COMMON = 2  # slow errors common to all satellites: ionosphere, troposphere
VECTORS = 6  # sensor vectors whose NIS is reported: position, wheels, gyro, steering, slip, compass
GNSS, MOTION, GYRO, STEERING, SLIPPING, COMPASS = range(VECTORS)

PARAMETERS = record(
    dt="length of an epoch [s]",
    driven=("?", "the accelerometer is an input of the prediction"),
    printed=("?", "pseudo observations by accelerometers as S4 prints them"),
    unscented=("?", "unscented prediction"),
    standard=("?", "standard mixing of models, else the published one"),
    sensor_errors=("?", "errors of sensors are states"),
    chassis=("?", "front wheel and steering angle are measured"),
    compass=("?", "the magnetic heading is measured"),
    curved=("i8", (MODELS,), "1 for the curved model"),
    noise=("f8", (MODELS, WHITE), "1-sigma of the motion's noise over an epoch, by model"),
    errors=("f8", (STATES,), "variance that the states of sensor errors gain in an epoch"),
    transition=("f8", (MODELS, MODELS), "P(model after | model before) [-]"),
    gate_gnss="largest NIS of a position, inf: not tested",
    gate_compass="of the compass",
    gate_motion="of one motion measurement",
    gate_printed="of the pseudo observations",
    lost="rejections of positions for this long make the filter begin anew [s]",
    doubt="how long levels hold the distance then [s]",
    interval="least time between two positions used [s]",
    least_move="least distance driven between two [m]",
    rest_interval="time after which a position is used without that distance [s]",
    rest_factor="variance factor of the lasting errors of positions at rest [-]",
    slow_tau="correlation time of slow errors of positions [s]",
    fast_factor="variance factor of the lasting errors of positions [-]",
    excess_tau="memory of the innovations of positions, 0: none [s]",
    level_misfit=("?", "exact levels grow by the misfit of innovations"),
    misfit_alert="mean NIS / 2 of positions above which the filter is not believed, inf: none [-]",
    forward="antenna ahead of the reference point [m]",
    right="antenna to the right of it [m]",
    accelerometer_density="[m/s^2/sqrt(Hz)]",
    accelerometer_bias="1-sigma [m/s^2]",
    speed_sigma="speed by the wheels, 1 sigma [m/s]",
    speed_factor="variance factor of its lasting errors [-]",
    creep_factor="variance factor of a creep that the wheels show as rest [-]",
    slip_sigma="slip by the geometry, 1 sigma [rad]",
    steering_sigma="angle of the front wheel, 1 sigma [rad]",
    steering_factor="variance factor of its lasting errors [-]",
    compass_sigma="disturbances of the compass, 1 sigma [rad]",
    compass_factor="variance factor of its lasting errors [-]",
    compass_start="heading by the compass alone, 1 sigma [rad]",
    rest_mps2="acceleration above which a vehicle does not rest [m/s^2]",
    still_speed="speed that the odometer may show as rest [m/s]",
    walk="angle random walk of the gyro [rad/sqrt(s)]",
    axle="reference point ahead of the rear axle [m]",
    car=(CAR, "geometry of the chassis"),
    doppler_sigma="range rate, 1 sigma [m/s]",
    wheel_bound="bound of the odometer's scale error [-]",
    bounds=("f8", (BIASES,), "of constant errors: position East, North [m], course [rad], speed, and at rest [m/s]"),
    sbas=("?", "positions are corrected by SBAS"),
    sbas_sigmas="K_H of the SBAS level of a position [-]",
    alert=(ALERT_RULES, "alert limits and times"),
)
"""The declared figures of a filter."""

TRIAL = record(
    turned="azimuth of the Doppler velocity less the integrated gyro, mean of the trial [rad]",
    count=("i8", "velocities that agree"),
    moved="distance driven while they agreed [m]",
)
VEHICLE = record(
    turned="integrated gyro [rad]",
    known=("?", "a position has been begun with"),
    aligned=("?", "the heading is given"),
    unconfirmed=("i8", "positions that must agree before there is a level"),
    biased=("?", "the slow error of positions has its prior"),
    common=("f8", (2, 2), "of the last position used, as of POSITION [m]"),
    excess="mean of NIS / 2 of positions over the memory, rejected ones too; 1 when they are as declared [-]",
    fix_age="of the last position that was due, used or rejected, inf before [s]",
    used_age="of the last position used, inf before [s]",
    moved="distance driven since the last one that was due [m]",
    rejected=("f8", (2,), "how long positions and motion have been rejected throughout [s]"),
    nis=("f8", (VECTORS,), "the last of each sensor vector, 0 before [-]"),
    doubt="distance to the positions that the filter has begun anew with, which the levels hold [m]",
    doubt_left="and how much longer [s]",
    trial=(TRIAL, "of the first heading by Doppler"),
    alert=(ALERT, "state of the alert"),
)
"""What lasts of a vehicle beside its filters."""


SLOW_ERROR = record(
    gain=("f8", (2,), "change of the position East, North per error of the code [-]"),
    own="variance of its own slow error [m^2]",
)
"""What a satellite does to a position by codes; zeros without it."""

POSITION = record(
    position=("f8", (3,), "of the antenna, East North Up [m]"),
    velocity=("f8", (2,), "by Doppler, East North [m/s]"),
    fast=("f8", (2, 2), "covariance of fast errors [m^2]"),
    slow=("f8", (2, 2), "covariance of slow errors [m^2]"),
    velocity_m2=("f8", (2, 2), "covariance of the velocity by range rates of 1 m/s [-]"),
    common=("f8", (2, 2), "East, North by each slow error common to all satellites [m]"),
    valid=("?", "there is one"),
)
"""Position by codes of an epoch (:class:`~lanebound.integrity.positioning.filters.code_position.CodePosition`)."""

MEASURED = record(
    turn=("f8", (3,), "increments of the gyros [rad]"),
    delta_v=("f8", (3,), "increments of the accelerometers [m/s]"),
    speed="odometer [m/s]",
    distance="odometer [m]",
    wheel=("f8", (4,), "speeds of the wheels, 0 where not fitted [m/s]"),
    steering="angle of the front wheel, 0 where not fitted [rad]",
    compass="azimuth, 0 where not fitted [rad]",
)
"""Motion measured in an epoch."""

OUT = record(
    position=("f8", (2,), "East, North [m]"),
    heading="[rad]",
    velocity=("f8", (2,), "East, North [m/s]"),
    covariance=("f8", (2, 2), "of the position [m^2]"),
    sigma=("f8", (2,), "along and across the heading [m]"),
    mode=("i8", "code of Mode"),
    alert=("?", "an alert is on"),
    available=("?", "no level exceeds its limit"),
    reason=("i8", "code of AlertReason"),
    trust="horizontal trust level, inf without a pose [m]",
    level_sbas="of the GNSS position alone where SBAS corrects it, else inf [m]",
    nis=("f8", (VECTORS,), "of the sensor vectors of this epoch, 0 without [-]"),
    last_nis=("f8", (VECTORS,), "the last of each, 0 before [-]"),
    curved="probability of the curved model [-]",
    used=("?", "the position by codes was used"),
    rejected=("?", "it was rejected"),
)
"""What is found of a vehicle in an epoch."""


class FilterState(NamedTuple):
    """Filters of B vehicles.

    vehicles (B,) of VEHICLE; models (B, r) of MODEL, probability (B, r); influence (B, r, STATES, BIASES + COMMON + S):
    change of the state per unit of each bounded constant error, and per sigma of each slow error, common ones and those
    of the S satellites; satellites (B, S) of SLOW_ERROR, of the last position used.
    """

    vehicles: Records
    models: Records
    probability: Array
    influence: Array
    satellites: Records


class PositionFix(NamedTuple):
    """Position by codes of an epoch: vehicles (B,) of POSITION, satellites (B, S) of SLOW_ERROR."""

    vehicles: Records
    satellites: Records
