"""Radio link of the reference station: age of the newest reference data at the rover.

The reference station measures every ``interval_s``. Each message arrives ``latency_s`` later unless the link is in an
outage. The data at the rover then age; the largest usable age is a parameter of the rover.

An outage affects either the network, for all vehicles of an area at once, or the reception of one vehicle. In total the
link is down for ``lambda m / (1 + lambda m)`` of the time, with the rate lambda of outages while the link is up and
their mean length m. With the rate lambda_1 = share lambda of the network, the receptions fail at the rate

    lambda_2 = (lambda - lambda_1) / ((1 + lambda_1 m) kappa),   kappa = E[D exp(-lambda_1 D)] / m

of which the share kappa takes place; the rest would overlap an outage of the network. The initial state of a link is
stationary: it is in an outage with the probability above, and the residual length follows from a length-biased draw
with a uniform position in the outage. The rover starts without data and waits for the first message.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtri

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors import corrections_kernel as kernel
from lanebound.integrity.sensors.gnss_kernel import STATION

__all__ = [
    "CorrectionsConfig",
    "CorrectionsState",
    "NetworkState",
    "initial_network",
    "initial_state",
    "link_parameters",
]

Array = NDArray[np.float64]
QUANTILES = 1024  # of the length of an outage, for what is found at the start


class CorrectionsConfig(Config):
    """The reference link and its outages."""

    interval_s: float = Field(1.0, gt=0, description="time between reference epochs [s]; RTCM 3 observations at 1 Hz")
    latency_s: float = Field(0.3, ge=0, description="delay of a message over the mobile network [s]; NTRIP over LTE")
    outage_per_h: float = Field(0.0, ge=0, description="rate at which outages begin while the link is up [1/h]")
    outage_median_s: float = Field(11.5, gt=0, description="median length of an outage [s]; fits S1 section 5")
    outage_log_sd: float = Field(0.8, ge=0, description="1-sigma of the length's logarithm [-]; fits S1 section 5")
    outage_max_s: float = Field(49.2, gt=0, description="longest outage [s]; S1 section 5, longer draws are limited")
    network_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of outages that affect all vehicles of an area [-]; chosen: server, radio",
    )


@dataclass
class NetworkState:
    """Networks of A areas; times are counted in whole epochs to avoid accumulated rounding.

    Attributes
    ----------
    epoch : epoch of the common clock of all areas
    areas : (A,) of NETWORK, a record of :mod:`.corrections_kernel`
    """

    epoch: int
    areas: Records

    def copy(self) -> NetworkState:
        """An independent copy."""
        return copy.deepcopy(self)

    @property
    def own_epoch(self) -> NDArray[np.int64]:
        """Epochs since the start of each area's own clock.  (A,)."""
        return np.asarray(self.epoch - self.areas["begun"])


@dataclass
class CorrectionsState:
    """Reception of reference data by B vehicles.

    Attributes
    ----------
    links : (B,) of LINK, a record of :mod:`.corrections_kernel`
    held : (B, S) of STATION, the station's own errors in the message held (:mod:`.gnss_kernel`)
    """

    links: Records
    held: Records

    def copy(self) -> CorrectionsState:
        """An independent copy."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class _OutageModel:
    """Outages in epochs: the kernel's figures, lengths by quantile, and how likely one is found at the start."""

    rules: Records
    length: NDArray[np.int64]
    network_down: float
    own_down: float


@lru_cache(maxsize=64)
def _outage_model(config: CorrectionsConfig, dt_s: float) -> _OutageModel:
    normal = ndtri((np.arange(QUANTILES) + 0.5) / QUANTILES)
    length_s = np.minimum(config.outage_median_s * np.exp(config.outage_log_sd * normal), config.outage_max_s)
    length = np.maximum(np.ceil(length_s / dt_s - kernel.ROUNDING), 1.0)
    rate = config.outage_per_h / 3600.0
    network, mean = config.network_share * rate, dt_s * float(length.mean())
    fits = np.exp(-network * dt_s * length)
    kappa = max(float((length * fits).mean() / length.mean()), 0.1)
    own = (rate - network) / ((1.0 + network * mean) * kappa)
    odds = own * mean * kappa
    lasts = float((-np.expm1(-network * dt_s * length)).mean()) / (network * mean) if network > 0.0 else 1.0
    return _OutageModel(
        rules=one_record(
            kernel.LINK_RULES,
            dt=dt_s,
            latency=config.latency_s,
            interval=config.interval_s,
            outages=config.outage_per_h > 0.0,
            onset=-math.expm1(-own * dt_s),
            network_rate=network,
            median=config.outage_median_s,
            log_sd=config.outage_log_sd,
            longest=config.outage_max_s,
        ),
        length=length.astype(np.int64),
        network_down=network * mean / (1.0 + network * mean),
        own_down=odds / (1.0 + odds) / lasts,
    )


def _residual(law: _OutageModel, u: Array) -> NDArray[np.int64]:
    """Remaining epochs of an outage at the start, from two uniform draws: u (..., 2) -> (...,)."""
    share = np.cumsum(law.length) / law.length.sum()
    length = law.length[np.minimum(np.searchsorted(share, u[..., 0], side="right"), QUANTILES - 1)]
    return np.asarray(1 + np.floor(u[..., 1] * length), dtype=np.int64)


def initial_network(config: CorrectionsConfig, dt_s: float, streams: Streams) -> NetworkState:
    """Create the networks of ``streams.batch`` areas at time 0 in their stationary state.

    Raises
    ------
    InputError
        ``dt_s`` is not positive.
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of the epoch in seconds")
    law, u, z = _outage_model(config, dt_s), streams.uniform("network", 3), streams.normal("network")
    down, areas = u[:, 0] < law.network_down, np.zeros(streams.batch, kernel.NETWORK)
    areas["message"], areas["up"], areas["outage_left"] = -1, ~down, np.where(down, _residual(law, u[:, 1:]), 0)
    areas["until"] = [0 if d else 1 + kernel.quiet_epochs(law.rules[0], q) for d, q in zip(down, z, strict=True)]
    return NetworkState(epoch=0, areas=areas)


def initial_state(
    config: CorrectionsConfig, network: NetworkState, satellites: int, dt_s: float, streams: Streams
) -> CorrectionsState:
    """Create the reception of ``streams.batch`` vehicles that start in these networks.

    Raises
    ------
    InputError
        The number of networks is neither 1 nor the number of vehicles.
    """
    batch = streams.batch
    if network.areas.size not in (1, batch):
        raise InputError(f"network must be of 1 or {batch} areas, got {network.areas.size}: make both agree")
    law, u = _outage_model(config, dt_s), streams.uniform("corrections", 3)
    left = _residual(law, u[:, 1:])
    areas = network.areas
    down = (u[:, 0] < law.own_down) & areas["up"] & (left <= areas["until"])
    links = np.zeros(batch, kernel.LINK)
    links["newest"], links["outage_left"], links["up"] = -1, np.where(down, left, 0), areas["up"] & ~down
    return CorrectionsState(links, np.zeros((batch, satellites), STATION))


def link_parameters(config: CorrectionsConfig, dt_s: float) -> Records:
    """The figures of the link as the kernel takes them, (1,) of LINK_RULES."""
    return _outage_model(config, dt_s).rules
