"""The records of vehicle filters: parameters, state, measurements and outputs of B vehicles with r models each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.alerts_kernel import ALERT, ALERT_RULES
from lanebound.integrity.positioning.filters.odometry_kernel import CAR
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES, WHITE

__all__ = [
    "BIASES",
    "COMMON",
    "COMPASS",
    "COURSE_BIAS",
    "GNSS",
    "GNSS_EAST_BIAS",
    "GNSS_NORTH_BIAS",
    "GYRO",
    "MOTION",
    "PARAMETERS",
    "REST_BIAS",
    "SLIPPING",
    "SPEED_BIAS",
    "STEERING",
    "VECTORS",
    "VEHICLE",
    "FilterOutputs",
    "FilterState",
    "MeasuredMotion",
    "PositionFix",
]  # fmt: skip

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

BIASES = 5  # bounded constant errors
GNSS_EAST_BIAS, GNSS_NORTH_BIAS, COURSE_BIAS, SPEED_BIAS, REST_BIAS = range(BIASES)
COMMON = 2  # slow errors common to all satellites: ionosphere, troposphere
VECTORS = 6  # sensor vectors whose NIS is reported: position, wheels, gyro, steering, slip, compass
GNSS, MOTION, GYRO, STEERING, SLIPPING, COMPASS = range(VECTORS)
MODELS = 2  # at most

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


class FilterState(NamedTuple):
    """Filters of B vehicles.

    vehicles (B,) VEHICLE; x (B, r, STATES), p (B, r, STATES, STATES), probability (B, r); influence (B, r, STATES,
    BIASES + COMMON + S): change of the state per unit of each bounded constant error, and per sigma of each slow error,
    common ones and those of the S satellites; gain (B, S, 2), own (B, S), common (B, 2, 2) of the last position used,
    :class:`~lanebound.integrity.positioning.filters.code_position.CodePosition`.
    """

    vehicles: Records
    x: Array
    p: Array
    probability: Array
    influence: Array
    gain: Array
    own: Array
    common: Array


class MeasuredMotion(NamedTuple):
    """Motion measured in an epoch: turn (B, 3) [rad], delta_v (B, 3) [m/s] increments; speed (B,) [m/s], distance (B,)
    [m] by the odometer; wheel (B, 4) [m/s], steering (B,) [rad]; compass (B,) azimuth [rad]. Zeros where not fitted."""

    turn: Array
    delta_v: Array
    speed: Array
    distance: Array
    wheel: Array
    steering: Array
    compass: Array


class PositionFix(NamedTuple):
    """Position by codes: position (B, 3) [m], velocity (B, 2) [m/s]; fast, slow, velocity_m2 (B, 2, 2) covariances;
    valid (B,), satellites (B,); gain (B, S, 2), own (B, S), common (B, 2, 2)."""

    position: Array
    velocity: Array
    fast: Array
    slow: Array
    velocity_m2: Array
    valid: Bools
    satellites: Ints
    gain: Array
    own: Array
    common: Array


class FilterOutputs(NamedTuple):
    """Of an epoch: fields of a solution and of a report, (B, ...)."""

    position: Array
    heading: Array
    velocity: Array
    covariance: Array
    sigma: Array
    levels: Array
    mode: Ints
    alert: Bools
    available: Bools
    reason: Ints
    trust: Array
    level_sbas: Array
    nis: Array
    last_nis: Array
    curved: Array
    used: Bools
    rejected: Bools
    probability: Array
