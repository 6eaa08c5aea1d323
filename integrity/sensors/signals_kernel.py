"""Signal laws of one satellite on scalars, compiled; :mod:`lanebound.integrity.sensors.signals` explains them."""

from __future__ import annotations

import math

from lanebound.integrity.accel import jit

__all__ = ["excess_of_uniform", "excess_probability", "normal_cdf", "thermal_factor"]


@jit
def normal_cdf(z: float) -> float:
    """``Phi(z)``."""
    return 0.5 * math.erfc(-z * 0.7071067811865476)


@jit
def thermal_factor(cn0: float, reference: float) -> float:
    """``g = 10^((c_ref - c) / 10)``: noise power against that at the reference C/N0 [dB-Hz]."""
    return math.exp((reference - cn0) * 0.23025850929940458)


@jit
def excess_probability(cn0: float, middle: float, width: float) -> float:
    """Share of signals with an excess delay: logistic in C/N0 [dB-Hz]."""
    return 1.0 / (1.0 + math.exp((cn0 - middle) / width))


@jit
def excess_of_uniform(upper: float, cn0: float, scale_35: float, decay: float, shape_35: float, growth: float) -> float:
    """Weibull excess [m] whose upper-tail probability is ``upper``, at a C/N0 [dB-Hz]."""
    d = cn0 - 35.0
    scale = scale_35 * math.exp(-decay * d)
    shape = shape_35 * math.exp(-growth * d)
    return scale * (-math.log(upper)) ** (1.0 / shape)
