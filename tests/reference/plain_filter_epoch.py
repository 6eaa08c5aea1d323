"""The steps of an epoch of vehicle filters in NumPy: interaction, prediction, corrections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from plain_filter_belief import BIASES, FilterBelief
from plain_filter_figures import threshold
from plain_kalman import correct, innovate
from plain_multiple_models import (
    interact,
    mixing_weights,
    posterior,
    predicted_probabilities,
)
from plain_vehicle_filters import (
    ProcessNoise,
    predict_extended,
    predict_unscented,
)
from plain_vehicle_models import MotionInput

from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.positioning.filters.vehicle_models import Predictor, S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

__all__ = ["GateOutcome", "Observation", "advance", "conclude", "gates", "noise_of", "observe"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Observation:
    """A sensor vector of B vehicles, the same for all models.

    name; z (B, m); design (m, STATES); covariance (B, m, m) with which the state is corrected, and ``single`` (B, m, m)
    of one vector by itself, with which it is tested: smaller, where errors last and so bring less than they seem to;
    there (B,): it exists; threshold of the NIS, None: not tested; bias (m, BIASES): which bounded errors it has;
    slow (B, m, COMMON + S): change per sigma of the slow errors; angular: z is an angle.
    """

    name: str
    z: Array
    design: Array
    covariance: Array
    single: Array
    there: Bools
    threshold: float | None = None
    bias: Array | None = None
    slow: Array | None = None
    angular: bool = False


@dataclass(frozen=True)
class GateOutcome:
    """Of one observation: NIS (B,) of the model that fits best, ``used`` and ``rejected`` (B,)."""

    nis: Array
    used: Bools
    rejected: Bools


def noise_of(config: FilterConfig) -> ProcessNoise:
    """The process noise of the chosen models over an epoch."""
    dt, heading = config.dt_s, config.positioning.heading
    models = [getattr(config, name) for name in config.chosen_models]
    driven = config.motion.accelerometer == "input"
    rows = [
        [m.yaw_acceleration, config.motion.accelerometer_density if driven else m.acceleration, m.slip, m.slide]
        for m in models
    ]
    errors = np.zeros((STATES, STATES))
    if config.sensor_errors:
        for place, density in (
            (S.GYRO_BIAS, heading.bias_walk_radps),
            (S.ACCEL_BIAS, config.motion.accelerometer_walk),
        ):
            errors[place, place] = density**2 * dt
    errors[S.GYRO_ANGLE, S.GYRO_ANGLE] = heading.angle_random_walk_rad**2 * dt
    curved = np.array([name == "curved" for name in config.chosen_models])
    return ProcessNoise(curved, np.array(rows) / np.sqrt(dt), errors)


def advance(b: FilterBelief, config: FilterConfig, noise: ProcessNoise, u: MotionInput) -> Array:
    """Interaction and prediction; returns the probabilities after interaction, (B, r)."""
    predicted = b.probability
    if len(config.chosen_models) > 1:
        transition = np.array(config.transition)[: b.probability.shape[-1], : b.probability.shape[-1]]
        if config.models[0] == "curved":
            transition = transition[::-1, ::-1]
        weight = mixing_weights(b.probability, transition, config.interaction)
        predicted = predicted_probabilities(b.probability, transition)
        _lend_slip_rate(b, noise.curved)
        b.x, b.p = interact(b.x, b.p, weight)
        flat = b.influence.reshape(*b.influence.shape[:2], -1)
        b.influence = (np.swapaxes(weight, -1, -2) @ flat).reshape(b.influence.shape)
        _drop_slip_rate(b, noise.curved)
    predict = predict_unscented if config.predictor is Predictor.UNSCENTED else predict_extended
    b.x, b.p, f = predict(b.x, b.p, u, noise)
    b.influence = f @ b.influence
    return predicted


def _lend_slip_rate(b: FilterBelief, curved: Bools) -> None:
    """Before mixing, a straight model has the curved model's slip rate and its variance, which it does not estimate:
    without them the mixture would draw the slip rate towards 0."""
    straight, bend = np.flatnonzero(~curved), np.flatnonzero(curved)
    if straight.size and bend.size:
        b.x[:, straight, S.SLIP_RATE] = b.x[:, bend, S.SLIP_RATE]
        b.p[:, straight, S.SLIP_RATE, S.SLIP_RATE] = b.p[:, bend, S.SLIP_RATE, S.SLIP_RATE]


def _drop_slip_rate(b: FilterBelief, curved: Bools) -> None:
    """After mixing, a straight model has no slip rate."""
    for k in np.flatnonzero(~curved):
        b.x[:, k, S.SLIP_RATE] = 0.0
        b.p[:, k, S.SLIP_RATE, :] = b.p[:, k, :, S.SLIP_RATE] = 0.0
        b.influence[:, k, S.SLIP_RATE] = 0.0


def observe(b: FilterBelief, seen: Observation, likelihood: Array, gated: bool) -> GateOutcome:
    """Correct all models by an observation, and add its logarithmic likelihood (B, r).

    A vector is rejected when it fails the gate of every model, so that the likelihoods of the models are of the same
    measurements.
    """
    z = seen.z[:, None, :]
    if seen.angular:
        expected = (b.x @ seen.design.T)[..., :]
        z = expected + (z - expected + np.pi) % (2.0 * np.pi) - np.pi
    alone = innovate(b.x, b.p, z, seen.design, seen.single[:, None])
    best = alone.nis.min(-1)
    tested = gated and seen.threshold is not None
    passed = best <= seen.threshold if tested else np.ones(best.shape, np.bool_)
    used = seen.there & passed
    found = innovate(b.x, b.p, z, seen.design, seen.covariance[:, None])
    b.x, b.p, gain = correct(b.x, b.p, seen.design, found, used[:, None])
    likelihood += np.where(used[:, None], found.log_likelihood, 0.0)
    brought = -(seen.design @ b.influence)
    if seen.bias is not None:
        brought[..., :BIASES] += seen.bias
    if seen.slow is not None:
        brought[..., BIASES:] += seen.slow[:, None]
    b.influence = b.influence + gain @ brought
    return GateOutcome(np.where(seen.there, best, 0.0), used, seen.there & ~passed)


def conclude(b: FilterBelief, predicted: Array, likelihood: Array) -> None:
    """The probabilities of the models after the observations of an epoch."""
    b.probability = posterior(predicted, likelihood)


def gates(config: FilterConfig, dimension: int, gnss: bool) -> float:
    """The threshold of a sensor vector."""
    return threshold(config.gate.gnss if gnss else config.gate.motion, dimension)
