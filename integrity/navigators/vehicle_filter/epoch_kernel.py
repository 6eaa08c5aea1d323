"""An epoch of vehicle filters: interaction, prediction, corrections, probabilities, start, levels, alert."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts_kernel import INITIALISING, NONE, TEST_FAILED, alert_step
from lanebound.integrity.navigators.vehicle_filter.levels_kernel import (
    HTL_SIGMAS,
    find_levels,
    major_axis,
    track_variance,
)
from lanebound.integrity.navigators.vehicle_filter.observations_kernel import (
    acceleration_along,
    correct_by_motion,
    correct_by_printed,
    printed_inertial,
)
from lanebound.integrity.navigators.vehicle_filter.position_kernel import LOST, REJECTED, USED, correct_by_position
from lanebound.integrity.navigators.vehicle_filter.records_kernel import (
    BIASES,
    VECTORS,
    FilterOutputs,
    FilterState,
    MeasuredMotion,
    PositionFix,
)
from lanebound.integrity.navigators.vehicle_filter.start_kernel import begin, judge_start
from lanebound.integrity.positioning.codes_kernel import CODE, IMU_ODOMETER
from lanebound.integrity.positioning.codes_kernel import NONE as NO_MODE
from lanebound.integrity.positioning.filters.correction_kernel import Models, Vector, vector_of
from lanebound.integrity.positioning.filters.mixing_kernel import combine, mix, mixing_weights, posterior
from lanebound.integrity.positioning.filters.motion_kernel import move_rows, slopes_of
from lanebound.integrity.positioning.filters.prediction_kernel import (
    PredictionWork,
    predict_extended,
    predict_unscented,
    prediction_work,
)
from lanebound.integrity.positioning.filters.vehicle_states_kernel import HEADING, SLIDE, SLIP, SLIP_RATE, SPEED, STATES

__all__ = ["Filters", "run_epoch"]

Array = NDArray[np.float64]


class Filters(NamedTuple):
    """What the kernel of an epoch takes: parameters (1,) PARAMETERS, cases (R,) CASE, and the records of B vehicles."""

    parameters: Records
    cases: Records
    state: FilterState
    measured: MeasuredMotion
    fix: PositionFix
    out: FilterOutputs


class Scratch(NamedTuple):
    """Memory of an epoch of one vehicle: accelerations, predicted probabilities, log likelihoods (r,); weights (r, r);
    mixed states (r, STATES), covariances, influences; mean (STATES,), covariance (STATES, STATES)."""

    acceleration: Array
    predicted: Array
    likelihood: Array
    weight: Array
    x: Array
    p: Array
    influence: Array
    mean: Array
    covariance: Array


@jit
def run_epoch(first: int, last: int, filters: Filters) -> None:
    """Advance vehicles by an epoch; each depends on its own row alone."""
    par, state, out = filters.parameters[0], filters.state, filters.out
    models, errors = state.x.shape[1], state.influence.shape[3]
    w, printed, prediction, s = vector_of(errors), vector_of(errors), prediction_work(), _scratch(models, errors)
    for v in range(first, last):
        rows = Models(state.x[v], state.p[v], state.influence[v], s.likelihood)
        s.likelihood[:] = 0.0
        out.nis[v] = 0.0
        _predict(par, state, v, filters.measured, rows, prediction, printed, s)
        if par.printed:
            correct_by_printed(par, rows, printed)
        correct_by_motion(par, state.vehicles[v], filters.measured, v, rows, w, out.nis[v])
        outcome = correct_by_position(par, state, v, filters.measured, filters.fix, rows, w, out.nis[v])
        posterior(s.predicted, s.likelihood, state.probability[v])
        judge_start(state, v, outcome)
        begin(par, state, v, filters.measured, filters.fix, w)
        _report(par, filters, v, outcome, s)


@jit
def _scratch(models: int, errors: int) -> Scratch:
    return Scratch(
        np.zeros(models), np.zeros(models), np.zeros(models), np.zeros((models, models)), np.zeros((models, STATES)),
        np.zeros((models, STATES, STATES)), np.zeros((models, STATES, errors)), np.zeros(STATES),
        np.zeros((STATES, STATES)),
    )  # fmt: skip


@jit
def _predict(
    par: Any,
    state: FilterState,
    v: int,
    measured: MeasuredMotion,
    rows: Models,
    prediction: PredictionWork,
    printed: Vector,
    s: Scratch,
) -> None:
    """Interaction of the models and prediction of each; probabilities after interaction into the scratch."""
    turn, r = measured.turn[v, 2], rows.x.shape[0]
    state.vehicles[v].turned += turn
    for j in range(r):
        s.acceleration[j] = acceleration_along(rows.x[j], measured.delta_v[v], par.dt)
    if par.printed:
        printed_inertial(par, rows.x, rows.p, state.probability[v], s.acceleration, printed, s.mean, s.covariance)
    if r > 1:
        _interact(par, state.probability[v], rows, s)
    else:
        s.predicted[0] = state.probability[v, 0]
    for j in range(r):
        f = slopes_of(rows.x[j], par.dt, turn, s.acceleration[j], par.driven)
        move_rows(f, rows.influence[j])
        if par.unscented:
            predict_unscented(
                rows.x[j], rows.p[j], f, s.acceleration[j], par.curved[j] == 1, par.noise[j], par.errors, prediction
            )
        else:
            predict_extended(
                rows.x[j], rows.p[j], f, s.acceleration[j], par.curved[j] == 1, par.noise[j], par.errors, prediction
            )


@jit
def _interact(par: Any, probability: Array, rows: Models, s: Scratch) -> None:
    """Each model begins with a mixture of the models.

    Before, a straight model has the curved model's slip rate and its variance, which it does not estimate: without
    them the mixture would draw the slip rate towards 0. After, it has none.
    """
    r = rows.x.shape[0]
    for j in range(r):
        bend = 1 - j
        if par.curved[j] == 0 and par.curved[bend] == 1:
            rows.x[j, SLIP_RATE] = rows.x[bend, SLIP_RATE]
            rows.p[j, SLIP_RATE, SLIP_RATE] = rows.p[bend, SLIP_RATE, SLIP_RATE]
    mixing_weights(probability, par.transition, par.standard, s.weight, s.predicted)
    mix(rows.x, rows.p, s.weight, s.x, s.p)
    for j in range(r):
        for k in range(STATES):
            for e in range(rows.influence.shape[2]):
                total = 0.0
                for i in range(r):
                    total += s.weight[i, j] * rows.influence[i, k, e]
                s.influence[j, k, e] = total
    rows.x[:] = s.x
    rows.p[:] = s.p
    rows.influence[:] = s.influence
    for j in range(r):
        if par.curved[j] == 0:
            rows.x[j, SLIP_RATE] = 0.0
            rows.influence[j, SLIP_RATE] = 0.0
            for k in range(STATES):
                rows.p[j, SLIP_RATE, k] = rows.p[j, k, SLIP_RATE] = 0.0


@jit
def _report(par: Any, filters: Filters, v: int, outcome: int, s: Scratch) -> None:
    """Position, levels, alert; where no pose is known, the code position without levels."""
    state, fix, out, vehicle = filters.state, filters.fix, filters.out, filters.state.vehicles[v]
    combine(state.x[v], state.p[v], state.probability[v], s.mean, s.covariance, STATES)
    mean, covariance, heading = s.mean, s.covariance, wrap(s.mean[HEADING])
    trust = HTL_SIGMAS * major_axis(covariance[0, 0], covariance[1, 1], covariance[0, 1])
    find_levels(filters.cases, par.bounds, state, v, mean, heading, trust, out.levels[v])
    _widen(par, filters.cases, vehicle, out.levels[v])
    posed = vehicle.known and vehicle.aligned and math.isfinite(mean[0] + mean[1] + heading)
    ready = posed and vehicle.unconfirmed == 0
    if not ready:
        out.levels[v] = math.inf
    _covariance(state, v, covariance, out.covariance[v])
    sin, cos = math.sin(heading), math.cos(heading)
    at = math.sqrt(track_variance(out.covariance[v], sin, cos))
    ct = math.sqrt(track_variance(out.covariance[v], cos, -sin))
    out.sigma[v, 0], out.sigma[v, 1] = at, ct
    unbelieved = outcome == LOST or vehicle.excess > par.misfit_alert
    cause = INITIALISING if not ready and outcome != LOST else TEST_FAILED if unbelieved else NONE
    out.available[v] = alert_step(
        cause, out.levels[v, 0, 0], out.levels[v, 0, 1], at, ct, par.dt, par.alert, vehicle.alert
    )
    out.alert[v], out.reason[v] = vehicle.alert.alert, vehicle.alert.reason
    for k in range(2):
        out.position[v, k] = mean[k] if posed else fix.position[v, k]
    out.heading[v], course = heading, mean[HEADING] + mean[SLIP] + mean[SLIDE]
    out.velocity[v, 0], out.velocity[v, 1] = mean[SPEED] * math.sin(course), mean[SPEED] * math.cos(course)
    if posed:
        out.mode[v] = CODE if vehicle.used_age < par.interval else IMU_ODOMETER
    else:
        out.mode[v] = CODE if fix.valid[v] else NO_MODE
    out.trust[v], out.level_sbas[v] = trust if posed else math.inf, math.inf
    if par.sbas and fix.valid[v]:
        q = fix.fast[v] + fix.slow[v]
        out.level_sbas[v] = par.sbas_sigmas * major_axis(q[0, 0], q[1, 1], q[0, 1])
    out.used[v], out.rejected[v] = outcome == USED, outcome == REJECTED
    out.probability[v] = state.probability[v]
    out.curved[v] = 0.0
    for j in range(state.x.shape[1]):
        if par.curved[j] == 1:
            out.curved[v] += state.probability[v, j]
    for k in range(VECTORS):
        if out.nis[v, k] > 0.0:
            vehicle.nis[k] = out.nis[v, k]
        out.last_nis[v, k] = vehicle.nis[k]


@jit
def _widen(par: Any, cases: Any, vehicle: Any, levels: Array) -> None:
    """The levels hold the distance that the filter has doubted, for its time, and what its innovations show.

    Positions whose mean NIS / 2 is m > 1 show that the filter, its positions, or both are off by more than declared:
    exact levels are ``sqrt(m)`` times as large. Published ones stay, the trust level and no more.
    """
    misfit = math.sqrt(max(vehicle.excess, 1.0)) if par.excess_tau > 0.0 and par.level_misfit else 1.0
    for k in range(levels.shape[0]):
        if not cases[k].published:
            for q in range(2):
                levels[k, q] = misfit * levels[k, q] + vehicle.doubt
    vehicle.doubt_left = max(vehicle.doubt_left - par.dt, 0.0)
    if vehicle.doubt_left == 0.0:
        vehicle.doubt = 0.0


@jit
def _covariance(state: FilterState, v: int, covariance: Array, out: Array) -> None:
    """The covariance of the position with that of slow errors through all gains."""
    for i in range(2):
        for k in range(2):
            out[i, k] = covariance[i, k]
    for e in range(BIASES, state.influence.shape[3]):
        east, north = 0.0, 0.0
        for j in range(state.x.shape[1]):
            east += state.probability[v, j] * state.influence[v, j, 0, e]
            north += state.probability[v, j] * state.influence[v, j, 1, e]
        out[0, 0] += east * east
        out[0, 1] += east * north
        out[1, 0] += east * north
        out[1, 1] += north * north
