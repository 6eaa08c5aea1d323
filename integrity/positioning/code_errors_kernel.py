"""Variance of a code range: the one error budget of all positions by codes, compiled.

With the variance factor ``f`` of elevation and C/N0, the slant factors ``F`` of the ionosphere and ``m`` of the
troposphere, the amplitude ``a`` of the noise of a combination of bands, and the ages ``t`` of corrections::

    fast  = f a^2 (w noise^2 + s multipath^2)
    own   = satellite^2 + g_sat t + F^2 (own share of iono^2 + give^2 + g_iono t_iono)
    iono  = (F - 1) common part of iono          tropo = (m - 1) zenith delay

``w`` and ``s`` are what carrier smoothing leaves of white noise and of multipath (:mod:`.smoothing_kernel`), 1 without.
``iono`` and ``tropo`` act on all satellites at once: the part that is the same at all elevations is in the clocks of
the systems, exactly, so that ``F - 1`` and ``m - 1`` remain. A variance for each range by itself takes them as
independent, ``fast + own + iono^2 + tropo^2``.

The simulated codes of an open sky have 0.167 m sqrt(f) at every elevation and C/N0. Sources: f of Hartinger and Brunner
1999 and RTKLIB; F and m of RTCA DO-229, A.4.4.10.4 and A.4.2.4.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = [
    "CODE_ERRORS",
    "CODE_PARTS",
    "fill_parts",
    "ionosphere_slant",
    "ionosphere_variance",
    "multipath_time",
    "receiver_variance",
    "satellite_variance",
    "troposphere_slant",
    "troposphere_variance",
    "variance_factor",
]

Array = NDArray[np.float64]

TENTH = math.log(10.0) / 10.0
EARTH_RATIO = 6378136.3 / (6378136.3 + 350e3)  # Earth's radius over that of the ionospheric shell, DO-229
LEAST_SINE = 0.05
CODE_ERRORS = record(
    noise="white noise of the code of one band, strong and at the zenith [m]",
    multipath="its multipath, zenith [m]",
    phase="carrier of one band, zenith [m]",
    knee="C/N0 at which the variance doubles [dB-Hz]",
    moving_tau="longest correlation time of multipath in motion [s]",
    rest_tau="the same at rest [s]",
    length="way over which it lasts [m]",
    satellite="ephemeris and clock without a provider [m]",
    satellite_growth="growth of its variance with the age of corrections [m^2/s]",
    iono="vertical ionosphere on the first band without a provider [m]",
    iono_common="share of its variance that is common to all satellites [-]",
    iono_growth="growth of its variance with the age of the correction [m^2/s]",
    iono_rate="rate of the vertical ionosphere [m/s]",
    tropo="zenith troposphere after the model [m]",
)
"""CodeErrorBudget as kernels take it; 1 sigma each."""

CODE_PARTS = record(
    fast="variance of noise and multipath [m^2]",
    own="variance of ephemeris, clock and the ionosphere of the satellite's own [m^2]",
    iono="effect of the ionosphere that is common to all satellites, 1 sigma [m]",
    tropo="effect of the zenith troposphere, 1 sigma [m]",
    factor="variance factor f of elevation and C/N0 [-]",
)
"""Parts of the variance of a code."""


@jit
def variance_factor(sine: float, cn0: float, knee: float) -> float:
    """``f = (1 + 1/sin^2 el)/2 (1 + 10^((knee - C/N0)/10))``: 1 at the zenith, doubled at the knee."""
    return 0.5 * (1.0 + 1.0 / (sine * sine)) * (1.0 + math.exp(TENTH * (knee - cn0)))


@jit
def ionosphere_slant(sine: float) -> float:
    """F: slant over vertical delay of a shell at 350 km, by the sine of the elevation."""
    return 1.0 / math.sqrt(1.0 - EARTH_RATIO**2 * (1.0 - sine * sine))


@jit
def troposphere_slant(sine: float) -> float:
    """m: slant over zenith delay, ``1.001 / sqrt(0.002001 + sin^2 el)``."""
    return 1.001 / math.sqrt(0.002001 + sine * sine)


@jit
def receiver_variance(rules: Any, factor: float, white: float, lasting: float) -> float:
    """Variance of noise and multipath of the code of one band; ``white`` and ``lasting`` as smoothing leaves them."""
    return float(factor * (white * rules.noise * rules.noise + lasting * rules.multipath * rules.multipath))


@jit
def multipath_time(rules: Any, speed: float, still: float) -> float:
    """Longest correlation time of multipath at a speed: ``length / speed``, from that of motion to that at rest."""
    if not abs(speed) > still:
        return float(rules.rest_tau)
    return float(min(max(rules.moving_tau, rules.length / abs(speed)), rules.rest_tau))


@jit
def satellite_variance(rules: Any, declared: float, age: float) -> float:
    """Variance of ephemeris and clock: as declared at age 0, and growing with the age [s] of a correction."""
    return float(declared * declared + rules.satellite_growth * age)


@jit
def ionosphere_variance(rules: Any, slant: float, declared: float, age: float) -> tuple[float, float]:
    """Variance of each satellite's own slant delay, and the effect of the common one [m].

    declared : vertical 1 sigma of a provider at age 0 [m], each satellite's own, in addition to what the rules state
    """
    vertical = (1.0 - rules.iono_common) * rules.iono * rules.iono + declared * declared + rules.iono_growth * age
    return slant * slant * vertical, (slant - 1.0) * rules.iono * math.sqrt(rules.iono_common)


@jit
def troposphere_variance(rules: Any, slant: float) -> float:
    """Variance of the residual troposphere in one range, as if it were each range's own."""
    return float(((slant - 1.0) * rules.tropo) ** 2)


@jit
def fill_parts(first: int, last: int, rules: Records, sine: Array, cn0: Array, parts: Records) -> None:
    """The CODE_PARTS (n,) of codes of one band without corrections; sine and cn0 (n,)."""
    r = rules[0]
    for k in range(first, last):
        level, part = max(sine[k], LEAST_SINE), parts[k]
        slant = ionosphere_slant(level)
        own, part.iono = ionosphere_variance(r, slant, 0.0, 0.0)
        part.factor = variance_factor(level, cn0[k], r.knee)
        part.fast = receiver_variance(r, part.factor, 1.0, 1.0)
        part.own = satellite_variance(r, r.satellite, 0.0) + own
        part.tropo = (troposphere_slant(level) - 1.0) * r.tropo
