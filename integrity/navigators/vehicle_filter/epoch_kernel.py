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
    FilterState,
    PositionFix,
)
from lanebound.integrity.navigators.vehicle_filter.start_kernel import begin, judge_start
from lanebound.integrity.positioning.codes_kernel import CODE, IMU_ODOMETER
from lanebound.integrity.positioning.codes_kernel import NONE as NO_MODE
from lanebound.integrity.positioning.filters.correction_kernel import Models, Vector, vector_of
from lanebound.integrity.positioning.filters.mixing_kernel import combine, mixing_weights, posterior
from lanebound.integrity.positioning.filters.motion_kernel import move_rows, slopes_of
from lanebound.integrity.positioning.filters.prediction_kernel import (
    PREDICTION,
    predict_extended,
    predict_unscented,
)
from lanebound.integrity.positioning.filters.vehicle_states_kernel import (
    HEADING,
    MODEL,
    SLIDE,
    SLIP,
    SLIP_RATE,
    SPEED,
    STATES,
)

__all__ = ["Filters", "run_epoch"]

Array = NDArray[np.float64]


class Filters(NamedTuple):
    """What the kernel of an epoch takes, of B vehicles.

    parameters (1,) of PARAMETERS, cases (R,) of CASE; state; measured (B,) of MEASURED and fix; out (B,) of OUT,
    levels (B, R, 2) along and across the heading [m].
    """

    parameters: Records
    cases: Records
    state: FilterState
    measured: Records
    fix: PositionFix
    out: Records
    levels: Array


class Scratch(NamedTuple):
    """Memory of an epoch of one vehicle: prediction (1,) of PREDICTION; models (r,) of MODEL and influence (r, STATES,
    J), mixed; mixture (1,) of MODEL, of all models."""

    prediction: Records
    models: Records
    influence: Array
    mixture: Records


@jit
def run_epoch(first: int, last: int, filters: Filters) -> None:
    """Advance vehicles by an epoch; each depends on its own row alone."""
    par, state = filters.parameters[0], filters.state
    models, errors = state.models.shape[1], state.influence.shape[3]
    w, printed = vector_of(errors), vector_of(errors)
    s = Scratch(
        np.zeros(1, PREDICTION), np.zeros(models, MODEL), np.zeros((models, STATES, errors)), np.zeros(1, MODEL)
    )
    for v in range(first, last):
        measured, nis = filters.measured[v], filters.out[v].nis
        rows = Models(state.models[v], state.influence[v])
        nis[:] = 0.0
        _predict(par, state, v, measured, rows, printed, s)
        if par.printed:
            correct_by_printed(par, rows, printed)
        correct_by_motion(par, state.vehicles[v], measured, rows, w, nis)
        outcome = correct_by_position(par, state, v, measured.distance, filters.fix, rows, w, nis)
        posterior(rows.filters, state.probability[v])
        judge_start(state, v, outcome)
        begin(par, state, v, measured, filters.fix, w)
        _report(par, filters, v, outcome, s.mixture[0])


@jit
def _predict(par: Any, state: FilterState, v: int, measured: Any, rows: Models, printed: Vector, s: Scratch) -> None:
    """Interaction of the models and prediction of each."""
    turn, models, probability = measured.turn[2], rows.filters, state.probability[v]
    state.vehicles[v].turned += turn
    for j in range(models.shape[0]):
        models[j].acceleration = acceleration_along(models[j].x, measured.delta_v, par.dt)
        models[j].likelihood = 0.0
    if par.printed:
        printed_inertial(par, models, probability, printed, s.mixture[0])
    if models.shape[0] > 1:
        _interact(par, probability, rows, s)
    else:
        models[0].predicted = probability[0]
    for j in range(models.shape[0]):
        model, curved = models[j], par.curved[j] == 1
        f = slopes_of(model.x, par.dt, turn, model.acceleration, par.driven)
        move_rows(f, rows.influence[j])
        if par.unscented:
            predict_unscented(model, f, curved, par.noise[j], par.errors, s.prediction[0])
        else:
            predict_extended(model, f, curved, par.noise[j], par.errors, s.prediction[0])


@jit
def _interact(par: Any, probability: Array, rows: Models, s: Scratch) -> None:
    """Each model begins with a mixture of the models.

    Before, a straight model has the curved model's slip rate and its variance, which it does not estimate: without
    them the mixture would draw the slip rate towards 0. After, it has none.
    """
    models, influence = rows.filters, rows.influence
    r = models.shape[0]
    for j in range(r):
        bend = 1 - j
        if par.curved[j] == 0 and par.curved[bend] == 1:
            models[j].x[SLIP_RATE] = models[bend].x[SLIP_RATE]
            models[j].p[SLIP_RATE, SLIP_RATE] = models[bend].p[SLIP_RATE, SLIP_RATE]
    mixing_weights(models, probability, par.transition, par.standard)
    for j in range(r):
        weight = models[j].weight
        combine(models, weight, STATES, s.models[j])
        for k in range(STATES):
            for e in range(influence.shape[2]):
                total = 0.0
                for i in range(r):
                    total += weight[i] * influence[i, k, e]
                s.influence[j, k, e] = total
    influence[:] = s.influence
    for j in range(r):
        model = models[j]
        model.x[:] = s.models[j].x
        model.p[:] = s.models[j].p
        if par.curved[j] == 0:
            model.x[SLIP_RATE] = 0.0
            influence[j, SLIP_RATE] = 0.0
            for k in range(STATES):
                model.p[SLIP_RATE, k] = model.p[k, SLIP_RATE] = 0.0


@jit
def _report(par: Any, filters: Filters, v: int, outcome: int, mixture: Any) -> None:
    """Position, levels, alert; where no pose is known, the code position without levels."""
    state, fix, out, levels = filters.state, filters.fix.vehicles[v], filters.out[v], filters.levels[v]
    vehicle, probability = state.vehicles[v], state.probability[v]
    combine(state.models[v], probability, STATES, mixture)
    mean, covariance, heading = mixture.x, mixture.p, wrap(mixture.x[HEADING])
    trust = HTL_SIGMAS * major_axis(covariance[0, 0], covariance[1, 1], covariance[0, 1])
    find_levels(filters.cases, par.bounds, state, v, mean, heading, trust, levels)
    _widen(par, filters.cases, vehicle, levels)
    posed = vehicle.known and vehicle.aligned and math.isfinite(mean[0] + mean[1] + heading)
    ready = posed and vehicle.unconfirmed == 0
    if not ready:
        levels[:] = math.inf
    _covariance(probability, state.influence[v], covariance, out.covariance)
    sin, cos = math.sin(heading), math.cos(heading)
    out.sigma[0] = math.sqrt(track_variance(out.covariance, sin, cos))
    out.sigma[1] = math.sqrt(track_variance(out.covariance, cos, -sin))
    unbelieved = outcome == LOST or vehicle.excess > par.misfit_alert
    cause = INITIALISING if not ready and outcome != LOST else TEST_FAILED if unbelieved else NONE
    out.available = alert_step(
        cause, levels[0, 0], levels[0, 1], out.sigma[0], out.sigma[1], par.dt, par.alert, vehicle.alert
    )
    out.alert, out.reason = vehicle.alert.alert, vehicle.alert.reason
    for k in range(2):
        out.position[k] = mean[k] if posed else fix.position[k]
    out.heading, course = heading, mean[HEADING] + mean[SLIP] + mean[SLIDE]
    out.velocity[0], out.velocity[1] = mean[SPEED] * math.sin(course), mean[SPEED] * math.cos(course)
    if posed:
        out.mode = CODE if vehicle.used_age < par.interval else IMU_ODOMETER
    else:
        out.mode = CODE if fix.valid else NO_MODE
    out.trust, out.level_sbas = trust if posed else math.inf, math.inf
    if par.sbas and fix.valid:
        q = fix.fast + fix.slow
        out.level_sbas = par.sbas_sigmas * major_axis(q[0, 0], q[1, 1], q[0, 1])
    out.used, out.rejected = outcome == USED, outcome == REJECTED
    out.curved = 0.0
    for j in range(probability.shape[0]):
        if par.curved[j] == 1:
            out.curved += probability[j]
    for k in range(VECTORS):
        if out.nis[k] > 0.0:
            vehicle.nis[k] = out.nis[k]
        out.last_nis[k] = vehicle.nis[k]


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
def _covariance(probability: Array, influence: Array, covariance: Array, out: Array) -> None:
    """The covariance of the position with that of slow errors through all gains."""
    for i in range(2):
        for k in range(2):
            out[i, k] = covariance[i, k]
    for e in range(BIASES, influence.shape[2]):
        east, north = 0.0, 0.0
        for j in range(probability.shape[0]):
            east += probability[j] * influence[j, 0, e]
            north += probability[j] * influence[j, 1, e]
        out[0, 0] += east * east
        out[0, 1] += east * north
        out[1, 0] += east * north
        out[1, 1] += north * north
