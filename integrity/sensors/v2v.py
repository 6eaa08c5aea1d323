"""Vehicle-to-vehicle broadcasts: every vehicle tells where it believes it is; some messages come late, some never."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lanebound.integrity.config import Config
from lanebound.integrity.errors import InputError, require_finite, require_shape
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.streams import Streams

__all__ = ["V2vConfig", "V2vInbox", "V2vMessage", "V2vState", "exchange", "initial_v2v"]

Array = NDArray[np.float64]
ROUNDING = 1e-9
EAST, NORTH, HEADING, SPEED, PL_AT, PL_CT, TIME = range(7)
N_FIELDS = 7


class V2vConfig(Config):
    """The radio channel of one street."""

    rate_hz: float = Field(
        10.0, gt=0, description="messages of a vehicle in a second; SAE J2735 BSM, ETSI CAM up to 10 Hz"
    )
    latency_s: float = Field(
        0.05, ge=0, description="shortest delay of a message [s]; 3GPP TS 22.185 asks for <= 100 ms"
    )
    jitter_s: float = Field(0.03, ge=0, description="mean of the exponential delay on top [s]; congestion")
    latency_max_s: float = Field(0.5, gt=0, description="later messages are dropped [s]")
    loss: float = Field(0.05, ge=0, le=1, description="share lost at close range [-]; C-V2X field tests: 90 % at 300 m")
    range_m: float = Field(300.0, gt=0, description="nothing is heard beyond [m]; urban street, line of sight")


@dataclass(frozen=True)
class V2vMessage:
    """What B vehicles broadcast of themselves: their belief, never the truth.

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
    """The newest message that each receiver (row) holds of each sender (column).

    Attributes
    ----------
    heard : (B, B) bool; entries never heard hold zeros, and age and protection levels inf
    age_s : (B, B) time since the sender's state was valid
    position_en_m : (B, B, 2)
    heading_rad, speed_mps, pl_at_m, pl_ct_m : (B, B)
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
    """Messages under way and held.

    Attributes
    ----------
    epoch : epochs since the start
    sent : number of the newest transmission slot used
    broadcasts : (L, B, 7) what was broadcast in the last L epochs
    arriving : (L, B, B) int64, epoch of origin of the message that arrives in a coming epoch, -1 for none
    origin : (B, B) int64, epoch of origin of the message held, -1 for none
    held : (B, B, 7) its content
    """

    epoch: int
    sent: int
    broadcasts: Array
    arriving: NDArray[np.int64]
    origin: NDArray[np.int64]
    held: Array

    def copy(self) -> V2vState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_v2v(config: V2vConfig, batch: int, dt_s: float) -> V2vState:
    """A silent channel between ``batch`` vehicles, for epochs of ``dt_s``.

    Raises
    ------
    InputError
        When ``batch`` or ``dt_s`` is not positive.
    """
    if batch < 1 or not dt_s > 0.0:
        raise InputError(f"batch and dt_s must be positive, got {batch} and {dt_s}: pass vehicles and seconds")
    slots = math.ceil(config.latency_max_s / dt_s) + 2
    return V2vState(
        epoch=0,
        sent=-1,
        broadcasts=np.zeros((slots, batch, N_FIELDS)),
        arriving=np.full((slots, batch, batch), -1, dtype=np.int64),
        origin=np.full((batch, batch), -1, dtype=np.int64),
        held=np.zeros((batch, batch, N_FIELDS)),
    )


def _content(message: V2vMessage, effects: FaultEffects, time_s: float) -> Array:
    """The messages as sent (B, 7): liars displace their position and scale their protection levels."""
    return np.column_stack(
        [
            message.position_en_m + effects.v2v_offset_enu_m[:, :2],
            message.heading_rad,
            message.speed_mps,
            message.pl_at_m * effects.v2v_pl_scale,
            message.pl_ct_m * effects.v2v_pl_scale,
            np.full(message.heading_rad.shape, time_s),
        ]
    )


def _reaches(config: V2vConfig, antenna_en_m: Array, street: NDArray[np.int64], u: Array) -> NDArray[np.bool_]:
    """Whether a message gets through (receiver, sender): ``P = (1 - loss) (1 - (d / range)^4)`` within the range."""
    gap = antenna_en_m[:, None] - antenna_en_m[None]
    fade = np.clip(np.hypot(gap[..., 0], gap[..., 1]) / config.range_m, 0.0, 1.0) ** 4
    heard = u < (1.0 - config.loss) * (1.0 - fade)
    heard &= street[:, None] == street[None]
    np.fill_diagonal(heard, False)
    return heard


def _send(
    config: V2vConfig, state: V2vState, dt_s: float, antenna_en_m: Array, street: NDArray[np.int64], u: Array
) -> None:
    """Put this epoch's messages under way; a message of a later epoch replaces one that would arrive with it."""
    delay_s = config.latency_s - config.jitter_s * np.log1p(-u[..., 1])
    through = _reaches(config, antenna_en_m, street, u[..., 0]) & (delay_s <= config.latency_max_s)
    wait = np.ceil(delay_s / dt_s - ROUNDING).astype(np.int64)
    receiver, sender = np.nonzero(through)
    slot = (state.epoch + wait[receiver, sender]) % state.arriving.shape[0]
    state.arriving[slot, receiver, sender] = state.epoch


def _receive(state: V2vState) -> None:
    """Take what arrives now, unless something newer is held."""
    slot = state.epoch % state.arriving.shape[0]
    newer = state.arriving[slot] > state.origin
    receiver, sender = np.nonzero(newer)
    origin = state.arriving[slot, receiver, sender]
    state.origin[receiver, sender] = origin
    state.held[receiver, sender] = state.broadcasts[origin % state.broadcasts.shape[0], sender]
    state.arriving[slot] = -1


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
) -> V2vInbox:
    """One epoch of the channel: send, carry, receive; ``state`` advances in place.

    Parameters
    ----------
    time_s, dt_s : end and length of the epoch
    message : what each vehicle says of itself
    antenna_en_m : (B, 2) where the antennas really are, for the radio range only
    street : (B,) or scalar; vehicles on different streets do not hear each other

    Returns
    -------
    V2vInbox
        What everyone holds at ``time_s``. A message that takes longer than an epoch arrives in a later one.

    Raises
    ------
    InputError
        When shapes disagree or a position is not finite.
    """
    batch = state.origin.shape[0]
    antenna = require_finite("antenna_en_m", antenna_en_m)
    require_shape("antenna_en_m", antenna, (batch, 2))
    require_shape("message.position_en_m", require_finite("message.position_en_m", message.position_en_m), (batch, 2))
    if streams.batch != batch:
        raise InputError(f"streams must serve {batch} vehicles, got {streams.batch}: make both the same batch")
    u = streams.uniform("v2v", batch, 2)
    state.epoch += 1
    state.broadcasts[state.epoch % state.broadcasts.shape[0]] = _content(message, effects, time_s)
    slot = math.floor(state.epoch * dt_s * config.rate_hz + ROUNDING)
    if slot > state.sent:
        state.sent = slot
        _send(config, state, dt_s, antenna, np.broadcast_to(np.asarray(street, dtype=np.int64), (batch,)), u)
    _receive(state)
    return _inbox(state, time_s)


def _inbox(state: V2vState, time_s: float) -> V2vInbox:
    heard, held = state.origin >= 0, state.held
    return V2vInbox(
        heard=heard,
        age_s=np.where(heard, time_s - held[..., TIME], np.inf),
        position_en_m=held[..., EAST : NORTH + 1].copy(),
        heading_rad=held[..., HEADING].copy(),
        speed_mps=held[..., SPEED].copy(),
        pl_at_m=np.where(heard, held[..., PL_AT], np.inf),
        pl_ct_m=np.where(heard, held[..., PL_CT], np.inf),
    )
