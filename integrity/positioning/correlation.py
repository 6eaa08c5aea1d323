"""Bounds of errors whose correlation in time is known within a range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

__all__ = ["CorrelationBound", "bound_correlation", "overbounding_walk"]


@dataclass(frozen=True)
class CorrelationBound:
    """Errors that overbound unit Gauss-Markov errors of every correlation time in a range: Gauss-Markov plus white.

    Attributes
    ----------
    decay : of the Gauss-Markov part over an epoch, variance 1
    white : variance of the white part of an epoch
    course : variance of a white error alone that bounds both
    """

    decay: float
    white: float
    course: float


def bound_correlation(shortest_s: float, longest_s: float, dt_s: float) -> CorrelationBound:
    """Overbound of a stationary unit Gauss-Markov error with a correlation time in [shortest, longest].

    The variance of a linear filter's output is ``int |W|^2 S / 2 pi``, whatever its weights, so an error with a larger
    power spectral density at every frequency has the larger variance in every linear filter, a time-varying one too,
    and the errors of satellites may have different correlation times. With ``g = tanh(dt / (2 tau))`` and ``t =
    tan(omega / 2)`` the density of a sampled Gauss-Markov error is ``S = (1 + t^2) g / (g^2 + t^2)``. At a frequency it
    is largest for ``g = t``, or for the nearest end of the range. The longest correlation time bounds it at ``t <= g``
    and misses ``(1 + t^2) (1 / (2 t) - g / (g^2 + t^2))`` beyond; a white error of the largest such difference
    (``0.1349 tau / dt`` at ``t = 3.383 g`` for long correlation times) completes the bound. The same density at
    frequency 0 plus this white part, ``1 / g + white``, bounds both by a white error alone.

    The spectral form of the bound of Langel, Crespillo and Joerger, "Bounding sequential estimation errors due to
    Gauss-Markov noise with uncertain parameters", ION GNSS+ 2019, who bound by one process of larger variance.
    """
    slow, fast = math.tanh(0.5 * dt_s / longest_s), math.tanh(0.5 * dt_s / shortest_s)
    t = np.geomspace(slow, 1e3, 20_001)
    g = np.clip(t, slow, fast)
    missed = (1.0 + t**2) * (g / (g**2 + t**2) - slow / (slow**2 + t**2))
    white = max(1.0001 * float(missed.max()), 0.0)
    return CorrelationBound((1.0 - slow) / (1.0 + slow), white, 1.0 / slow + white)


def overbounding_walk(sigma: float, tau_s: float, random_walk: float = 0.0) -> float:
    """Random walk that overbounds a gyro's wander [rad/s/sqrt(s)]: ``sqrt(2 sigma^2 / tau + K^2)``.

    The wander is a Gauss-Markov bias of 1-sigma ``sigma`` [rad/s] and of a correlation time of at least ``tau_s``,
    and a rate random walk K. The initial variance of the bias must hold ``2 sigma^2`` in addition to the turn-on bias
    (:mod:`.heading_kernel`).
    """
    return math.sqrt(2.0 * sigma**2 / tau_s + random_walk**2)
