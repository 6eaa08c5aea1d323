"""An epoch of vehicle filters that have a confirmed pose, in NumPy: the reference of ``epoch_kernel``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import plain_filter_epoch as steps
import plain_filter_observations as seen
from numpy.typing import NDArray
from plain_filter_belief import FilterBelief, take_slow_error
from plain_filter_figures import bounds_of, position_factors
from plain_filter_levels import ModelPositions, covariance_levels, horizontal_trust_level, with_slow_errors
from plain_kalman import innovate
from plain_multiple_models import combine
from plain_vehicle_models import MotionInput

from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.navigators.navigator import Measurements
from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.navigators.vehicle_filter.records_kernel import BIASES, FilterState
from lanebound.integrity.positioning.filters.code_position import locate_by_codes
from lanebound.integrity.positioning.filters.vehicle_models import S

__all__ = ["PlainSolution", "belief_of", "locate"]

Array = NDArray[np.float64]
VECTORS = ("gnss", "wheels", "gyro", "steering", "slip", "compass")


@dataclass(frozen=True)
class PlainSolution:
    """Position E, N (B, 2), levels (B, R, 2), trust level (B,), NIS (B, 6) of VECTORS."""

    position_m: Array
    levels_m: Array
    trust_m: Array
    nis: Array


def belief_of(state: FilterState) -> FilterBelief:
    """An independent copy of the state of the kernels."""
    v = state.vehicles
    return FilterBelief(
        state.models["x"].copy(), state.models["p"].copy(), state.probability.copy(), state.influence.copy(),
        v["turned"].copy(), v["known"].copy(), v["biased"].copy(), state.satellites["gain"].copy(),
        state.satellites["own"].copy(), v["common"].copy(), v["fix_age"].copy(), v["moved"].copy(),
        v["rejected"].copy(), v["excess"].copy(),
    )  # fmt: skip


def locate(c: FilterConfig, b: FilterBelief, m: Measurements) -> PlainSolution:
    """Advance the belief by the measurements of an epoch."""
    batch, turn = b.known.size, m.imu.delta_theta_rad[:, 2]
    fix, likelihood, nis = locate_by_codes(c.position.codes, m), np.zeros_like(b.probability), np.zeros((batch, 6))
    b.turned_rad = b.turned_rad + turn
    a = seen.acceleration_along(m, b, c.dt_s)
    printed = None
    if c.motion.accelerometer == "observation":
        x, p = combine(b.x, b.p, b.probability)
        printed = seen.printed_inertial(c, x, p, (b.probability * a).sum(-1))
    u = MotionInput(c.dt_s, turn[:, None], a, c.motion.accelerometer == "input")
    predicted = steps.advance(b, c, steps.noise_of(c), u)
    if printed is not None:
        steps.observe(b, printed, likelihood, c.gate.enabled)
    for observation in seen.motion_observations(c, m, b):
        outcome = steps.observe(b, observation, likelihood, c.gate.enabled)
        if observation.name in VECTORS:
            nis[:, VECTORS.index(observation.name)] = outcome.nis
    b.fix_age_s, b.moved_m = b.fix_age_s + c.dt_s, b.moved_m + np.abs(m.odometer.distance_m)
    p = c.position
    resting = b.moved_m < p.least_move_m
    interval = np.where(resting, max(p.interval_s, p.rest_interval_s), p.interval_s)
    due = fix.valid & b.known & (b.fix_age_s >= interval - 1e-9)
    if due.any():
        if c.sensor_errors:
            take_slow_error(b, fix, due, p.slow_tau_s)
        moving, still = position_factors(c)
        lasting = np.where(resting, still, moving)
        heading = (b.probability * b.x[..., S.HEADING]).sum(-1)
        observation = _grown(c, b, seen.gnss_position(c, fix, heading, due, lasting))
        nis[:, 0] = steps.observe(b, observation, likelihood, c.gate.enabled).nis
        b.fix_age_s, b.moved_m = np.where(due, 0.0, b.fix_age_s), np.where(due, 0.0, b.moved_m)
    steps.conclude(b, predicted, likelihood)
    return _levels(c, b, nis)


def _grown(c: FilterConfig, b: FilterBelief, seen: steps.Observation) -> steps.Observation:
    """The position with the noise that the NIS of the last positions shows."""
    nis = innovate(b.x, b.p, seen.z[:, None], seen.design, seen.single[:, None]).nis.min(-1)
    age = np.where(np.isfinite(b.fix_age_s), b.fix_age_s, c.position.interval_s)
    kept = np.exp(-age / c.position.excess_tau_s)
    b.excess = np.where(seen.there, kept * b.excess + (1.0 - kept) * 0.5 * nis, b.excess)
    return replace(seen, covariance=seen.covariance * np.maximum(b.excess, 1.0)[:, None, None])


def _levels(c: FilterConfig, b: FilterBelief, nis: Array) -> PlainSolution:
    x, p = combine(b.x, b.p, b.probability)
    trust = horizontal_trust_level(p[:, :2, :2])
    models = ModelPositions(
        b.probability, b.x[..., :2] - x[:, None, :2],
        with_slow_errors(b.p[..., :2, :2], b.influence[:, :, :2, BIASES:]), b.influence[:, :, :2, :BIASES],
    )  # fmt: skip
    heading = np.asarray(wrap_angle(x[:, S.HEADING]))
    levels = covariance_levels(c.cases, c.risk, models, bounds_of(c), heading, trust)
    if c.position.excess_tau_s > 0.0 and c.position.level_misfit:
        exact = np.array([case.variant is not Variant.PUBLISHED for case in c.cases])[None, :, None]
        levels = levels * np.where(exact, np.sqrt(np.maximum(b.excess, 1.0))[:, None, None], 1.0)
    return PlainSolution(x[:, :2], levels, trust, nis)
