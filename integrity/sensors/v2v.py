"""Vehicle-to-vehicle broadcasts of estimated states over a radio channel with delay and loss."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.sensors.effects import FaultEffects

__all__ = ["V2vConfig", "V2vInbox", "V2vMessage", "V2vState", "exchange", "forget", "initial_v2v"]

Array = NDArray[np.float64]
ROUNDING = 1e-9

MESSAGE = record(
    position=("f8", (2,), "East, North [m]"),
    heading="azimuth [rad]",
    speed="[m/s]",
    pl_at="protection level along track, inf: none [m]",
    pl_ct="protection level across track, inf: none [m]",
    time="at which the state was valid [s]",
)
"""What a vehicle broadcasts of itself."""


class V2vConfig(Config):
    """The radio channel of one street."""

    rate_hz: float = Field(
        10.0, gt=0, description="messages of a vehicle per second; SAE J2735 BSM, ETSI CAM up to 10 Hz"
    )
    latency_s: float = Field(
        0.05, ge=0, description="shortest delay of a message [s]; 3GPP TS 22.185 requires <= 100 ms"
    )
    jitter_s: float = Field(0.03, ge=0, description="mean of the additional exponential delay [s]; congestion")
    latency_max_s: float = Field(0.5, gt=0, description="messages with a longer delay are dropped [s]")
    loss: float = Field(0.05, ge=0, le=1, description="loss rate at close range [-]; C-V2X field tests: 90 % at 300 m")
    range_m: float = Field(300.0, gt=0, description="radio range [m]; urban street, line of sight")


@dataclass(frozen=True)
class V2vMessage:
    """Broadcast states of B vehicles: estimates, not true values.

    Attributes
    ----------
    position_en_m : (B, 2)
    heading_rad, speed_mps, pl_at_m, pl_ct_m : (B,); a missing protection level is inf
    """

    position_en_m: Array
    heading_rad: Array
    speed_mps: Array
    pl_at_m: Array
    pl_ct_m: Array


@dataclass(frozen=True)
class V2vInbox:
    """The newest message that each of R receivers (rows) has from each of B senders (columns).

    Attributes
    ----------
    heard : (R, B) bool, a message was received; without one the entries are 0, age and protection levels are inf
    age_s : (R, B) time since the time of validity of the state
    position_en_m : (R, B, 2)
    heading_rad, speed_mps, pl_at_m, pl_ct_m : (R, B)
    """

    heard: NDArray[np.bool_]
    age_s: Array
    position_en_m: Array
    heading_rad: Array
    speed_mps: Array
    pl_at_m: Array
    pl_ct_m: Array


@dataclass
class V2vState:
    """Messages in transmission to R receivers, and the newest received ones.

    Attributes
    ----------
    epoch : epochs since the start
    sent : number of the newest transmission slot used
    broadcasts : (L, B) of MESSAGE, what was broadcast in the last L epochs
    arriving : (L, R, B) int64, epoch of origin of the message that arrives in a coming epoch, -1 for none
    origin : (R, B) int64, epoch of origin of the message held, -1 for none
    held : (R, B) of MESSAGE, its content; for none zeros, levels of inf and a time of -inf
    """

    epoch: int
    sent: int
    broadcasts: Records
    arriving: NDArray[np.int64]
    origin: NDArray[np.int64]
    held: Records

    def copy(self) -> V2vState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_v2v(config: V2vConfig, batch: int, dt_s: float, receivers: int | None = None) -> V2vState:
    """Create a channel without messages from ``batch`` vehicles to ``receivers`` of them (None: all), epochs ``dt_s``.

    Raises
    ------
    InputError
        ``batch`` or ``dt_s`` is not positive, or the number of receivers is not in [1, batch].
    """
    if batch < 1 or not dt_s > 0.0:
        raise InputError(f"batch and dt_s must be positive, got {batch} and {dt_s}: pass vehicles and seconds")
    rows = batch if receivers is None else receivers
    if not 1 <= rows <= batch:
        raise InputError(f"receivers must lie in [1, {batch}], got {rows}: pass the number of receiving vehicles")
    slots = math.ceil(config.latency_max_s / dt_s) + 2
    return V2vState(
        epoch=0,
        sent=-1,
        broadcasts=np.zeros((slots, batch), MESSAGE),
        arriving=np.full((slots, rows, batch), -1, dtype=np.int64),
        origin=np.full((rows, batch), -1, dtype=np.int64),
        held=_no_messages(rows, batch),
    )


def _no_messages(*shape: int) -> Records:
    held = np.zeros(shape, MESSAGE)
    held["pl_at"] = held["pl_ct"] = np.inf
    held["time"] = -np.inf
    return held


def forget(state: V2vState, senders: NDArray[np.int64]) -> None:
    """Delete all messages from ``senders`` (rows), because other vehicles use these rows from now on."""
    state.arriving[:, :, senders] = -1
    state.origin[:, senders] = -1
    state.held[:, senders] = _no_messages(state.origin.shape[0], senders.size)


def _write(content: Records, message: V2vMessage, effects: FaultEffects, time_s: float) -> None:
    """Fill in the messages as sent (B,): liars displace their position and scale their protection levels."""
    content["position"] = message.position_en_m + effects.v2v_offset_enu_m[:, :2]
    content["heading"], content["speed"] = message.heading_rad, message.speed_mps
    content["pl_at"] = message.pl_at_m * effects.v2v_pl_scale
    content["pl_ct"] = message.pl_ct_m * effects.v2v_pl_scale
    content["time"] = time_s


def _reaches(
    config: V2vConfig,
    antenna_en_m: Array,
    street: NDArray[np.int64],
    sending: NDArray[np.bool_],
    receivers: NDArray[np.int64],
    u: Array,
) -> NDArray[np.bool_]:
    """Whether each message is received (R, B), with ``P = (1 - loss) (1 - (d / range)^4)`` within the range."""
    gap = (antenna_en_m[receivers, None] - antenna_en_m) / config.range_m
    gap *= gap
    fade = np.minimum(gap[..., 0] + gap[..., 1], 1.0)
    heard = u < (1.0 - config.loss) * (1.0 - fade * fade)
    heard &= sending
    if street.ndim:
        heard &= street[receivers, None] == street
    heard[np.arange(receivers.size), receivers] = False
    return heard


def _send(config: V2vConfig, state: V2vState, dt_s: float, through: NDArray[np.bool_], u: Array) -> None:
    """Schedule the messages of this epoch; of two messages that arrive together only the later one is kept."""
    delay_s = config.latency_s - config.jitter_s * np.log1p(-u)
    through &= delay_s <= config.latency_max_s
    receiver, sender = np.nonzero(through)
    wait = np.ceil(delay_s[through] / dt_s - ROUNDING).astype(np.int64)
    state.arriving[(state.epoch + wait) % state.arriving.shape[0], receiver, sender] = state.epoch


def _receive(state: V2vState) -> None:
    """Store the messages that arrive in this epoch, unless a newer one is stored."""
    slot = state.epoch % state.arriving.shape[0]
    arriving = state.arriving[slot]
    newer = arriving > state.origin
    origin = arriving[newer]
    state.origin[newer] = origin
    state.held[newer] = state.broadcasts[origin % state.broadcasts.shape[0], np.nonzero(newer)[1]]
    arriving[:] = -1


def exchange(
    config: V2vConfig,
    state: V2vState,
    time_s: float,
    dt_s: float,
    message: V2vMessage,
    antenna_en_m: ArrayLike,
    effects: FaultEffects,
    streams: Streams,
    street: ArrayLike = 0,
    receivers: ArrayLike | None = None,
    sending: ArrayLike = True,
) -> V2vInbox:
    """Simulate one epoch of the channel (sending, delay, reception); ``state`` advances in place.

    Parameters
    ----------
    time_s, dt_s : end and length of the epoch
    message : broadcast state of each vehicle
    antenna_en_m : (B, 2) true positions of the antennas, used only for the radio range
    streams : random streams, one row for each receiver
    street : (B,) or scalar; there is no reception between different streets
    receivers : (R,) rows of the receiving vehicles; None for all
    sending : (B,) bool or scalar; rows of ``message`` of vehicles that do not send must only be finite

    Returns
    -------
    V2vInbox
        Newest messages of every receiver at ``time_s``. A message with a delay above one epoch arrives in a later
        epoch.

    Raises
    ------
    InputError
        Shapes do not agree, or a position is not finite.
    """
    listening, batch = state.origin.shape
    rows = np.arange(batch) if receivers is None else np.asarray(receivers, dtype=np.int64)
    if rows.size != listening:
        raise InputError(f"receivers must be {listening} rows, got {rows.size}: use the number in initial_v2v")
    antenna = require_finite("antenna_en_m", antenna_en_m)
    require_shape("antenna_en_m", antenna, (batch, 2))
    require_shape("message.position_en_m", require_finite("message.position_en_m", message.position_en_m), (batch, 2))
    if streams.batch != listening:
        raise InputError(f"streams must serve {listening} receivers, got {streams.batch}: make both agree")
    u = streams.uniform("v2v", batch, 2)
    state.epoch += 1
    _write(state.broadcasts[state.epoch % state.broadcasts.shape[0]], message, effects, time_s)
    slot = math.floor(state.epoch * dt_s * config.rate_hz + ROUNDING)
    if slot > state.sent:
        state.sent = slot
        streets, sends = np.asarray(street, dtype=np.int64), np.asarray(sending, dtype=np.bool_)
        _send(config, state, dt_s, _reaches(config, antenna, streets, sends, rows, u[..., 0]), u[..., 1])
    _receive(state)
    return _inbox(state, time_s)


def _inbox(state: V2vState, time_s: float) -> V2vInbox:
    held = state.held.copy()
    return V2vInbox(
        heard=state.origin >= 0,
        age_s=time_s - held["time"],
        position_en_m=held["position"],
        heading_rad=held["heading"],
        speed_mps=held["speed"],
        pl_at_m=held["pl_at"],
        pl_ct_m=held["pl_ct"],
    )
