"""The reference station's radio link: how old the newest reference data are when the rover needs them.

The reference measures every ``interval_s``; each message arrives ``latency_s`` later unless the link is in an outage.
What the rover holds then ages, and the rover itself decides how old is too old.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.config import Config
from lanebound.integrity.errors import InputError
from lanebound.integrity.sensors import corrections_kernel as kernel
from lanebound.integrity.streams import Streams

__all__ = ["CorrectionsConfig", "CorrectionsState", "initial_state", "step"]

Array = NDArray[np.float64]
NO_DRAWS: Array = np.empty(0)


class CorrectionsConfig(Config):
    """The reference link and its outages."""

    interval_s: float = Field(1.0, gt=0, description="time between reference epochs [s]; RTCM 3 observations at 1 Hz")
    latency_s: float = Field(0.3, ge=0, description="delay of a message over the mobile network [s]; NTRIP over LTE")
    outage_per_h: float = Field(0.0, ge=0, description="rate at which outages begin while the link is up [1/h]")
    outage_median_s: float = Field(11.5, gt=0, description="median length of an outage [s]; fits S1 section 5")
    outage_log_sd: float = Field(0.8, ge=0, description="1-sigma of the length's logarithm [-]; fits S1 section 5")
    outage_max_s: float = Field(49.2, gt=0, description="longest outage [s]; S1 section 5, longer draws are cut off")


@dataclass
class CorrectionsState:
    """The link of B vehicles, counted in whole epochs so that nothing drifts.

    Attributes
    ----------
    epoch : (B,) int64, epochs since the start
    due : (B,) int64, number of the newest reference epoch whose message has been due, -1 before the first
    newest : (B,) int64, number of the newest reference epoch received, -1 before the first
    outage_left : (B,) int64, epochs for which the present outage still lasts
    """

    epoch: NDArray[np.int64]
    due: NDArray[np.int64]
    newest: NDArray[np.int64]
    outage_left: NDArray[np.int64]

    def copy(self) -> CorrectionsState:
        """An independent copy."""
        return CorrectionsState(self.epoch.copy(), self.due.copy(), self.newest.copy(), self.outage_left.copy())


def initial_state(batch: int) -> CorrectionsState:
    """The links of ``batch`` vehicles that have just been switched on, at a reference epoch."""
    if batch < 1:
        raise InputError(f"batch must be >= 1, got {batch}: pass the number of vehicles")
    zero = np.zeros(batch, dtype=np.int64)
    return CorrectionsState(epoch=zero, due=zero - 1, newest=zero - 1, outage_left=zero.copy())


def step(
    config: CorrectionsConfig, state: CorrectionsState, dt_s: float, lost: NDArray[np.bool_], streams: Streams
) -> Array:
    """Age of the newest reference data at the end of an epoch; ``state`` advances in place.

    Outages begin as a Poisson process while the link is up and last ``min(median exp(sd z), max)``. With no outage the
    age runs from ``latency`` to ``latency + interval - dt``, again and again.

    Parameters
    ----------
    dt_s : float, length of an epoch, the same in every call
    lost : (B,) bool, the link is cut by a fault

    Returns
    -------
    (B,) age [s], inf before the first message

    Raises
    ------
    InputError
        When ``dt_s`` is not positive, or ``lost`` or the streams serve another number of vehicles than ``state``.
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of the epoch in seconds")
    batch = state.epoch.shape[0]
    if lost.shape != (batch,) or streams.batch != batch:
        raise InputError(f"lost and streams must serve {batch} vehicles, got {lost.shape} and {streams.batch}")
    u = z = NO_DRAWS
    if config.outage_per_h > 0.0:
        u, z = streams.uniform("corrections"), streams.normal("corrections")
    age = np.empty(batch)
    par = parameters(config, dt_s)
    kernel.advance(par, dt_s, u, z, lost, state.epoch, state.due, state.newest, state.outage_left, age)
    return age


@lru_cache(maxsize=64)
def parameters(config: CorrectionsConfig, dt_s: float) -> Array:
    """The configuration in the kernel's columns."""
    onset = -math.expm1(-config.outage_per_h * dt_s / 3600.0)
    outage = (config.outage_median_s, config.outage_log_sd, config.outage_max_s)
    return np.array([config.latency_s, config.interval_s, onset, *outage])
