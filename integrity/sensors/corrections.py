"""The reference station's radio link: how old the newest reference data are when the rover needs them.

The reference measures every ``interval_s``; each message arrives ``latency_s`` later unless the link is in an outage.
What the rover holds then ages, and the rover itself decides how old is too old.

Outages are of the network, which all vehicles of an area suffer at once, or of a vehicle's own reception. Together they
keep one law: the link is down for ``lambda m / (1 + lambda m)`` of the time, lambda the rate of outages while it is up
and m their mean length. With a share of the rate lambda_1 = share lambda in the network, receptions fail at

    lambda_2 = (lambda - lambda_1) / ((1 + lambda_1 m) kappa),   kappa = E[D exp(-lambda_1 D)] / m

of which the share kappa takes place, the rest would overlap an outage of the network. A link begins as it is found at
any time: in an outage with the probability above, of which a residual life is left (lengths drawn in proportion to
themselves, the place in them uniform). The rover has just been switched on: it holds nothing until the first message.
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
    "advance_network",
    "initial_network",
    "initial_state",
    "step",
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
    outage_max_s: float = Field(49.2, gt=0, description="longest outage [s]; S1 section 5, longer draws are cut off")
    network_share: float = Field(
        0.5, ge=0, le=1, description="share of outages that strike all vehicles of an area [-]; argued: server or radio"
    )


@dataclass
class NetworkState:
    """The networks of A areas, counted in whole epochs so that nothing drifts.

    Attributes
    ----------
    epoch : of the clock that all areas go by
    begun : (A,) int64, what that clock showed at zero of each area's own
    message : (A,) int64, number of the newest reference epoch whose message has been due, -1 before the first
    fresh : (A,) bool, that message was due in the last epoch
    up : (A,) bool, the network carried messages in the last epoch
    outage_left : (A,) int64, epochs for which the present outage still lasts
    until : (A,) int64, epochs until the next outage
    """

    epoch: int
    begun: NDArray[np.int64]
    message: NDArray[np.int64]
    fresh: NDArray[np.bool_]
    up: NDArray[np.bool_]
    outage_left: NDArray[np.int64]
    until: NDArray[np.int64]

    def copy(self) -> NetworkState:
        """An independent copy."""
        return copy.deepcopy(self)

    @property
    def rows(self) -> kernel.NetworkRows:
        """The arrays as kernels take them."""
        return kernel.NetworkRows(self.begun, self.message, self.fresh, self.up, self.outage_left, self.until)

    @property
    def own_epoch(self) -> NDArray[np.int64]:
        """(A,) epochs since zero of each area's own clock."""
        return self.epoch - self.begun


@dataclass
class CorrectionsState:
    """The reception of B vehicles.

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
class _Law:
    """Outages in epochs: the kernel's figures, lengths by quantile, and how likely one is found at the start."""

    rules: Records
    length: NDArray[np.int64]
    network_down: float
    own_down: float


@lru_cache(maxsize=64)
def _law(config: CorrectionsConfig, dt_s: float) -> _Law:
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
    return _Law(
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


def _residual(law: _Law, u: Array) -> NDArray[np.int64]:
    """Epochs left of an outage that is under way, from two uniforms: u (..., 2) -> (...,)."""
    share = np.cumsum(law.length) / law.length.sum()
    length = law.length[np.minimum(np.searchsorted(share, u[..., 0], side="right"), QUANTILES - 1)]
    return np.asarray(1 + np.floor(u[..., 1] * length), dtype=np.int64)


def initial_network(config: CorrectionsConfig, dt_s: float, streams: Streams) -> NetworkState:
    """The networks of ``streams.batch`` areas at zero of the clock, as they are found at any time.

    Raises
    ------
    InputError
        When ``dt_s`` is not positive.
    """
    if not dt_s > 0.0:
        raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of the epoch in seconds")
    law, u, z = _law(config, dt_s), streams.uniform("network", 3), streams.normal("network")
    down = u[:, 0] < law.network_down
    return NetworkState(
        epoch=0,
        begun=np.zeros(down.size, dtype=np.int64),
        message=np.full(down.size, -1, dtype=np.int64),
        fresh=np.zeros(down.size, dtype=np.bool_),
        up=~down,
        outage_left=np.where(down, _residual(law, u[:, 1:]), 0),
        until=np.array([0 if d else 1 + kernel.quiet_epochs(law.rules[0], q) for d, q in zip(down, z, strict=True)]),
    )


def advance_network(config: CorrectionsConfig, network: NetworkState, dt_s: float, streams: Streams) -> None:
    """Advance the networks by one epoch, in place; ``streams`` are those of the areas."""
    network.epoch += 1
    z = streams.normal("network", 2) if config.outage_per_h > 0.0 else np.empty((0, 2))
    kernel.advance_network(network.epoch, link_parameters(config, dt_s)[0], z, network.rows)


def initial_state(
    config: CorrectionsConfig, network: NetworkState, satellites: int, dt_s: float, streams: Streams
) -> CorrectionsState:
    """The reception of ``streams.batch`` vehicles that are switched on in these networks.

    Raises
    ------
    InputError
        When there are neither one network nor as many as vehicles.
    """
    batch = streams.batch
    if network.up.shape[0] not in (1, batch):
        raise InputError(f"network must be of 1 or {batch} areas, got {network.up.shape[0]}: make both agree")
    law, u = _law(config, dt_s), streams.uniform("corrections", 3)
    left = _residual(law, u[:, 1:])
    down = (u[:, 0] < law.own_down) & network.up & (left <= network.until)
    links = np.zeros(batch, kernel.LINK)
    links["newest"], links["outage_left"], links["up"] = -1, np.where(down, left, 0), network.up & ~down
    return CorrectionsState(links, np.zeros((batch, satellites), STATION))


def step(
    config: CorrectionsConfig,
    state: CorrectionsState,
    network: NetworkState,
    sent: Records,
    dt_s: float,
    lost: NDArray[np.bool_],
    streams: Streams,
) -> Array:
    """Age of the newest reference data at the end of an epoch; ``state`` advances in place.

    Outages last ``min(median exp(sd z), max)``. With no outage the age runs from ``latency`` to
    ``latency + interval - dt``, again and again.

    Parameters
    ----------
    network : NetworkState
        Of one area or one for each vehicle, advanced to this epoch.
    sent : (A, S) of STATION, the newest message of each area; a vehicle that receives it keeps it in ``state.held``
    dt_s : float, length of an epoch, the same in every call
    lost : (B,) bool, the link is cut by a fault

    Returns
    -------
    (B,) age [s], inf before the first message

    Raises
    ------
    InputError
        When ``lost``, the streams, the networks or messages serve another number of vehicles than ``state``.
    """
    batch = state.links.shape[0]
    if lost.shape != (batch,) or streams.batch != batch or network.up.shape[0] not in (1, batch):
        raise InputError(
            f"lost, streams and network must serve {batch} vehicles, got {lost.shape}, {streams.batch} and "
            f"{network.up.shape[0]} areas"
        )
    if sent.shape != (network.up.shape[0], *state.held.shape[1:]):
        raise InputError(f"sent must be of {network.up.shape[0]} areas with {state.held.shape[1:]}, got {sent.shape}")
    u = z = np.empty((0, 1))
    if config.outage_per_h > 0.0:
        u, z = streams.uniform("corrections", 1), streams.normal("corrections", 1)
    rows = kernel.LinkRows(link_parameters(config, dt_s), network.rows, sent, state.links, state.held, u, z)
    age = np.empty(batch)
    kernel.advance(0, batch, network.epoch, rows, lost, age)
    return age


def link_parameters(config: CorrectionsConfig, dt_s: float) -> Records:
    """The figures of the link as the kernel takes them, (1,) of LINK_RULES."""
    return _law(config, dt_s).rules
