"""Second phase of S5: is the Doppler speed of the last N seconds to be trusted? S5 equations 5 to 8, Chalko 2009.

``MASE = sum_{0..N} SDOP_n / N - (SDOP_0 + SDOP_N) / (2 N)`` bounds the error of the average speed of N intervals,
``AS_D`` is the same mean of the Doppler speeds; the speed is valid when MASE is at least three standard errors.

Which standard error is the question:

- ``printed``: S5 equation 6, MASE / sqrt(N). The test then says N >= 9 and nothing about the measurements.
- ``trend``: of the N + 1 measured speeds about their straight trend, ``s / sqrt(N)``. Uneven braking raises alarms.
- ``wheel``: of the differences between Doppler and the mean wheel speed of each interval, which contain no motion; and
  their mean must lie within three standard errors and what is declared of the wheels. The standard error is that of
  pairs of speeds that share one: ``sqrt(2) s / sqrt(N)``. Only this form sees slip, frozen wheels and false Doppler. It
  is not in S5.

In S5 wheels alone decide what rest is. Wheels that are frozen at 0 would then say rest for ever. Rest is contradicted,
in all forms, where the Doppler speed exceeds the least speed by three deviations in two successive epochs.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.core.row_memory import EVERY, Memory, Rows

__all__ = ["SpeedForm", "SpeedPhase", "SpeedPhaseConfig", "SpeedTest", "interval_mean", "mase", "trend_error"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


SURE_SIGMAS = 3.0  # deviations by which Doppler contradicts rest
CONTRADICTIONS = 2  # successive epochs; one may lie between the mean speed of the wheels and the last one of Doppler


class SpeedForm(StrEnum):
    """Standard error that MASE is compared with."""

    PRINTED = "printed"
    TREND = "trend"
    WHEEL = "wheel"


class SpeedPhaseConfig(Config):
    """The second phase; S5 section 3.2."""

    least_mps: float = Field(2.0, ge=0, description="wheel speed below which Doppler is not used [m/s]; S5")
    intervals: int = Field(10, ge=2, le=600, description="N, length of the average [epochs]; Chalko: 10 s")
    sdop_sigmas: float = Field(
        4.37, gt=0, description="SDOP over the 1 sigma of the speed [-]; none of 81,000 speeds exceeded it, Chalko 2009"
    )
    errors: float = Field(3.0, gt=0, description="standard errors that MASE must reach [-]; S5")
    form: SpeedForm = Field(SpeedForm.WHEEL, description="printed (S5 eq 6), trend or wheel")
    wheel_scale: float = Field(0.02, ge=0, description="bound of the scale error of the wheels [-]; uncalibrated 1.3 %")


class SpeedTest(NamedTuple):
    """Results of B vehicles.

    moving (B,) the wheels are fast enough; known (B,) there are N + 1 speeds; consistent (B,) the test holds;
    average_mps (B,) average Doppler speed, 0 where not known; contradicted (B,) the wheels say rest, Doppler motion;
    surely_mps (B,) speed that the vehicle has at least by wheels or by Doppler.
    """

    moving: Bools
    known: Bools
    consistent: Bools
    average_mps: Array
    contradicted: Bools
    surely_mps: Array

    @property
    def at_rest(self) -> Bools:
        """The wheels say rest, and Doppler does not contradict."""
        return np.asarray(~self.moving & ~self.contradicted)

    @property
    def passed(self) -> Bools:
        """The speed may be used."""
        return np.asarray(self.moving & self.known & self.consistent)


def interval_mean(values: ArrayLike) -> Array:
    """Mean of N + 1 samples over N intervals, S5 equations 5 and 8.  (..., N + 1) -> (...,).

    ``sum_{0..N} x_n / N - (x_0 + x_N) / (2 N)``: the trapezoidal mean.
    """
    x = require_finite("values", values)
    if x.shape[-1] < 2:
        raise InputError(f"values must hold at least two samples, got {x.shape[-1]}: an interval has two ends")
    n = x.shape[-1] - 1
    return np.asarray(x.sum(-1) / n - (x[..., 0] + x[..., -1]) / (2 * n))


def mase(sdop_mps: ArrayLike) -> Array:
    """Maximum average speed error of SDOP values (..., N + 1) [m/s], S5 equation 5."""
    return interval_mean(sdop_mps)


def trend_error(values: ArrayLike) -> Array:
    """Standard error of the mean of N + 1 samples about their straight trend.  (..., N + 1) -> (...,).

    ``s / sqrt(N)``, s^2 the squared residuals of the fitted line over N - 1.
    """
    x = require_finite("values", values)
    n = x.shape[-1] - 1
    t = np.arange(n + 1) - 0.5 * n
    slope = (x * t).sum(-1) / (t * t).sum()
    rest = x - x.mean(-1, keepdims=True) - slope[..., None] * t
    return np.asarray(np.sqrt(np.square(rest).sum(-1) / max(n - 1, 1) / n))


class SpeedPhase:
    """The last N + 1 speeds of B vehicles and their test.

    Parameters
    ----------
    config : SpeedPhaseConfig
    batch : int

    Attributes
    ----------
    memory : what lasts, arrays with the vehicles as first axis: speeds (B, N + 1, 3) SDOP, Doppler and wheels, the
        newest last; count (B,) of them; against (B,) successive epochs in which Doppler contradicts rest
    """

    def __init__(self, config: SpeedPhaseConfig, batch: int) -> None:
        self.config = config
        self.memory: Memory = {
            "speeds": np.zeros((batch, config.intervals + 1, 3)), "count": np.zeros(batch, np.int64),
            "against": np.zeros(batch, np.int64),
        }  # fmt: skip

    def forget(self, rows: Rows) -> None:
        """Begin anew with these vehicles."""
        self.memory["count"][rows], self.memory["against"][rows] = 0, 0

    def step(
        self, velocity_en_mps: Array, covariance: Array, wheel_mps: Array, known: Bools, rows: Rows = EVERY
    ) -> SpeedTest:
        """Test the speeds of the vehicles in ``rows`` after one more epoch; B is their number.

        Parameters
        ----------
        velocity_en_mps, covariance : (B, 2) and (B, 2, 2), by Doppler
        wheel_mps : (B,), signed; the mean over the epoch, as a wheel sensor gives it
        known : (B,) there is a Doppler velocity; without one the average begins anew
        """
        c, n = self.config, self.config.intervals
        speed = np.hypot(velocity_en_mps[:, 0], velocity_en_mps[:, 1])
        unit = velocity_en_mps / np.maximum(speed, 1e-9)[:, None]
        along = np.einsum("bi,bij,bj->b", unit, covariance, unit)
        slow = 0.5 * np.trace(covariance, axis1=1, axis2=2)  # no direction: the mean of both axes
        sigma = np.sqrt(np.maximum(np.where(speed > 1e-6, along, slow), 0.0))
        wheels = np.abs(wheel_mps)
        sure = np.where(known, speed - SURE_SIGMAS * sigma, 0.0)
        moving, contradicted = wheels > c.least_mps, self._contradicted(wheels, sure, rows)
        sample = np.stack([c.sdop_sigmas * sigma, speed, wheels], -1)
        speeds, count = self.memory["speeds"][rows], self.memory["count"][rows]
        speeds = np.concatenate([speeds[:, 1:], np.where(known[:, None], sample, 0.0)[:, None]], 1)
        count = np.where(known, np.minimum(count + 1, n + 1), 0)
        self.memory["speeds"][rows], self.memory["count"][rows] = speeds, count
        full = count > n
        ordered = np.where(full[:, None, None], speeds, 0.0)
        bound, average = mase(ordered[..., 0]), interval_mean(ordered[..., 1])
        consistent = self._consistent(bound, ordered[..., 1], ordered[..., 2]) & full & ~contradicted
        return SpeedTest(moving, full, consistent, average, contradicted, np.maximum(wheels, sure))

    def _contradicted(self, wheels: Array, sure_mps: Array, rows: Rows) -> Bools:
        """Whether Doppler has contradicted the rest that wheels (B,) say for long enough."""
        least = self.config.least_mps
        against = np.where((wheels <= least) & (sure_mps > least), self.memory["against"][rows] + 1, 0)
        self.memory["against"][rows] = np.minimum(against, CONTRADICTIONS)
        return np.asarray(against >= CONTRADICTIONS)

    def _consistent(self, bound: Array, doppler: Array, wheels: Array) -> Bools:
        """Whether MASE reaches ``errors`` of the standard error."""
        c = self.config
        if c.form is SpeedForm.PRINTED:
            return np.asarray(bound >= c.errors * (bound / np.sqrt(c.intervals)))
        if c.form is SpeedForm.TREND:
            return np.asarray(bound >= c.errors * trend_error(doppler))
        off = 0.5 * (doppler[:, :-1] + doppler[:, 1:]) - wheels[:, 1:]  # wheels: means over the intervals
        error, mean = np.sqrt(2.0) * off.std(-1, ddof=1) / np.sqrt(c.intervals), off.mean(-1)
        allowed = c.errors * np.maximum(error, bound / np.sqrt(c.intervals) / c.sdop_sigmas)
        allowed = allowed + c.wheel_scale * wheels[:, 1:].mean(-1)
        return np.asarray((bound >= c.errors * error) & (np.abs(mean) <= allowed))
