"""The declared figures of a filter as its kernels take them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.alerts import alert_parameters
from lanebound.integrity.monitoring.risk import Variant, upper_quantile
from lanebound.integrity.monitoring.sbas import Operation
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.navigators.vehicle_filter.levels_kernel import CASE
from lanebound.integrity.navigators.vehicle_filter.records_kernel import PARAMETERS
from lanebound.integrity.positioning.filters.code_position import CodeSource
from lanebound.integrity.positioning.filters.odometry_kernel import CAR
from lanebound.integrity.positioning.filters.vehicle_models import Interaction, Predictor, S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODELS, STATES, WHITE

__all__ = ["correlation_factor", "filter_parameters", "gate_threshold", "initial_sigmas", "level_cases"]

Array = NDArray[np.float64]


def gate_threshold(false_rejection: ArrayLike, dimension: int) -> Array:
    """``g^2`` of S4 eq 8: the chi-square quantile that a right observation exceeds with this probability.  (...,)."""
    share = require_in_range("false_rejection", false_rejection, 0.0, 1.0, low_open=True, high_open=True)
    return np.asarray(chdtri(dimension, share))


def correlation_factor(tau_s: float, step_s: float) -> float:
    """Variance factor of white noise that bounds a Gauss-Markov error of this correlation time in sums of many steps:
    ``coth(step / 2 tau)``, the spectral density at frequency 0 over the variance."""
    return 1.0 if tau_s <= 0.0 else float(1.0 / np.tanh(0.5 * step_s / tau_s))


def filter_parameters(c: FilterConfig) -> Records:
    """PARAMETERS (1,)."""
    motion, position, dead, heading = c.motion, c.position, c.positioning.dead_reckoning, c.positioning.heading
    models = c.chosen_models
    curved, order = np.zeros(MODELS, np.int64), np.array(c.transition)
    curved[: len(models)] = [name == "curved" for name in models]
    forward, right = c.positioning.lever_arm_m
    return one_record(
        PARAMETERS,
        dt=c.dt_s,
        driven=motion.accelerometer == "input",
        printed=motion.accelerometer == "observation",
        unscented=c.predictor is Predictor.UNSCENTED,
        standard=c.interaction is Interaction.STANDARD,
        sensor_errors=c.sensor_errors,
        chassis=c.chassis.fitted,
        compass=c.compass.fitted,
        curved=curved,
        noise=_noise(c),
        errors=_errors(c),
        transition=order[::-1, ::-1] if models[0] == "curved" else order,
        **_gates(c),
        lost=c.gate.lost_s,
        doubt=c.gate.doubt_s,
        interval=position.interval_s,
        least_move=position.least_move_m,
        rest_interval=position.rest_interval_s,
        rest_factor=correlation_factor(_rest_tau_s(c), position.rest_interval_s),
        slow_tau=position.slow_tau_s,
        fast_factor=correlation_factor(position.fast_tau_s, position.interval_s),
        excess_tau=position.excess_tau_s,
        level_misfit=position.level_misfit,
        misfit_alert=math.inf if c.gate.misfit_alert is None else c.gate.misfit_alert,
        forward=forward,
        right=right,
        **_body_sensors(c),
        still_speed=dead.standstill_speed_mps,
        walk=heading.angle_random_walk_rad,
        axle=c.positioning.axle_m,
        car=one_record(CAR, wheelbase=c.chassis.wheelbase_m, track=c.chassis.track_m, axle=c.chassis.axle_m),
        doppler_sigma=c.positioning.doppler.sigma_mps,
        wheel_bound=dead.odometer_scale,
        bounds=[
            position.bias_m,
            position.bias_m,
            np.deg2rad(dead.heading_bias_deg),
            dead.odometer_bias_mps,
            dead.standstill_speed_mps,
        ],
        sbas=position.codes.source is CodeSource.SBAS,
        sbas_sigmas=Operation.EN_ROUTE.value[0],
        alert=alert_parameters(c.alert),
    )


def _body_sensors(c: FilterConfig) -> dict[str, Any]:
    """Declared errors of accelerometers, wheels, slip by the geometry, steering and compass."""
    motion = c.motion
    return {
        "accelerometer_density": motion.accelerometer_density,
        "accelerometer_bias": motion.accelerometer_bias_mps2,
        "speed_sigma": motion.speed_sigma_mps,
        "speed_factor": correlation_factor(motion.speed_tau_s, c.dt_s),
        "creep_factor": correlation_factor(motion.creep_tau_s, c.dt_s),
        "slip_sigma": np.deg2rad(motion.slip_sigma_deg),
        "steering_sigma": np.deg2rad(motion.steering_sigma_deg),
        "steering_factor": correlation_factor(motion.steering_tau_s, c.dt_s),
        "compass_sigma": np.deg2rad(motion.compass_sigma_deg),
        "compass_factor": correlation_factor(motion.compass_tau_s, c.dt_s),
        "compass_start": 1.5 * np.deg2rad(math.hypot(motion.compass_sigma_deg, motion.compass_deviation_deg)),
        "rest_mps2": motion.rest_mps2,
    }


def _rest_tau_s(c: FilterConfig) -> float:
    """How long errors of the codes last at rest."""
    codes = c.position.codes
    errors = codes.errors if codes.source is CodeSource.UNDIFFERENCED else codes.differential_errors
    return max(errors.rest_tau_s, c.position.fast_tau_s)


def _gates(c: FilterConfig) -> dict[str, Any]:
    """Largest NIS of each sensor vector."""

    def largest(share: float, dimension: int) -> float:
        return float(gate_threshold(share, dimension)) if c.gate.enabled else math.inf

    return {
        "gate_gnss": largest(c.gate.gnss, 2),
        "gate_compass": largest(c.gate.gnss, 1),
        "gate_motion": largest(c.gate.motion, 1),
        "gate_printed": largest(c.gate.motion, 3),
    }


def _noise(c: FilterConfig) -> Array:
    """1-sigma of the motion's noise over an epoch, (MODELS, WHITE); its last columns are those of its first three."""
    found, driven = np.zeros((MODELS, WHITE)), c.motion.accelerometer == "input"
    for row, name in zip(found, c.chosen_models, strict=False):
        m = getattr(c, name)
        acceleration = c.motion.accelerometer_density if driven else m.acceleration
        row[:] = [m.yaw_acceleration, acceleration, m.slip, m.slide, m.yaw_acceleration, acceleration, m.slip]
    return np.asarray(found / np.sqrt(c.dt_s))


def _errors(c: FilterConfig) -> Array:
    """Variance that the states of sensor errors gain in an epoch, (STATES,)."""
    found, heading = np.zeros(STATES), c.positioning.heading
    if c.sensor_errors:
        found[S.GYRO_BIAS] = heading.bias_walk_radps**2 * c.dt_s
        found[S.ACCEL_BIAS] = c.motion.accelerometer_walk**2 * c.dt_s
    found[S.GYRO_ANGLE] = heading.angle_random_walk_rad**2 * c.dt_s
    return found


def level_cases(c: FilterConfig) -> Records:
    """CASE (R,), the operative one first."""
    budgets = 0.5 * c.risk.axis_budgets([case.integrity_risk for case in c.cases], c.risk.unmonitored_risk)
    cases = np.zeros(len(c.cases), CASE)
    cases["published"] = [case.variant is Variant.PUBLISHED for case in c.cases]
    cases["budget"], cases["factor"] = budgets, upper_quantile(budgets)
    return cases


def initial_sigmas(c: FilterConfig) -> dict[S, float]:
    """1-sigma of the states that have a prior of their own."""
    heading, motion = c.positioning.heading, c.motion
    found = {
        S.YAW_RATE: 0.2,  # any turn
        S.SPEED: 3.0,  # until the first wheel speed, of the same epoch
        S.SLIP: np.deg2rad(2.0),
        S.SLIDE: np.deg2rad(motion.slide_sigma_deg),
    }
    if "curved" in c.chosen_models:
        found[S.SLIP_RATE] = 0.05
    if c.sensor_errors:
        found |= {
            S.GYRO_BIAS: heading.bias_initial_radps,
            S.GYRO_SCALE: heading.gyro_scale,
            S.WHEEL_SCALE: c.wheel_scale,
            S.ACCEL_BIAS: motion.accelerometer_bias_mps2,
            S.COMPASS: np.deg2rad(motion.compass_deviation_deg),
        }
    return found
