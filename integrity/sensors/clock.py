"""Clocks of receivers: offset and drift as a random walk on a random walk, two states.

White frequency noise of density ``h0`` and a random walk of frequency ``h-2`` (power-law coefficients of the relative
frequency) make, with ``S_f = h0 / 2`` and ``S_g = 2 pi^2 h-2``, over a step dt::

    offset' = offset + drift dt + w1,  drift' = drift + w2,
    cov(w) = c^2 [[S_f dt + S_g dt^3 / 3, S_g dt^2 / 2], [S_g dt^2 / 2, S_g dt]]

Source: Brown and Hwang, Introduction to Random Signals and Applied Kalman Filtering, 4th ed., section 9.3; the flicker
floor h-1, which no finite state describes, is left out. Receivers that steer their clock or let it jump by whole
milliseconds differ by what every epoch's solution takes out anyway.
"""

from __future__ import annotations

import math

from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

__all__ = ["OCXO_H0", "OCXO_HM2", "TCXO_H0", "TCXO_HM2", "clock_gains"]

TCXO_H0, TCXO_HM2 = 2e-19, 2e-20  # temperature-compensated crystal [s], [Hz]; Brown and Hwang, table 9.3, low quality
OCXO_H0, OCXO_HM2 = 2e-25, 6e-25  # oven-controlled crystal; the same table


def clock_gains(h0: float, hm2: float, dt_s: float) -> tuple[float, float, float]:
    """Cholesky factor (l11, l21, l22) of cov(w) above, in [m] and [m/s]: ``w1 = l11 z1``, ``w2 = l21 z1 + l22 z2``."""
    s_f, s_g = 0.5 * h0 * SPEED_OF_LIGHT_MPS**2, 2.0 * math.pi**2 * hm2 * SPEED_OF_LIGHT_MPS**2
    l11 = math.sqrt(s_f * dt_s + s_g * dt_s**3 / 3.0)
    l21 = 0.5 * s_g * dt_s**2 / l11 if l11 > 0.0 else 0.0
    return l11, l21, math.sqrt(max(s_g * dt_s - l21 * l21, 0.0))
