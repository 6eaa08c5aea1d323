"""Vehicle-to-vehicle broadcasts: every vehicle tells where it believes it is; some messages come late, some never."""

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
    """The newest message that each of R receivers (row) holds of each of B senders (column).

    Attributes
    ----------
    heard : (R, B) bool; entries never heard hold zeros, and age and protection levels inf
    age_s : (R, B) time since the sender's state was valid
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
    """Messages under way to R receivers, and held by them.

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
    """A silent channel from ``batch`` vehicles to ``receivers`` of them (None: to all), for epochs of ``dt_s``.

    Raises
    ------
    InputError
        When ``batch`` or ``dt_s`` is not positive, or there are no receivers or more than vehicles.
    """
    if batch < 1 or not dt_s > 0.0:
        raise InputError(f"batch and dt_s must be positive, got {batch} and {dt_s}: pass vehicles and seconds")
    rows = batch if receivers is None else receivers
    if not 1 <= rows <= batch:
        raise InputError(f"receivers must lie in [1, {batch}], got {rows}: pass how many of the vehicles listen")
    slots = math.ceil(config.latency_max_s / dt_s) + 2
    return V2vState(
        epoch=0,
        sent=-1,
        broadcasts=np.zeros((slots, batch), MESSAGE),
        arriving=np.full((slots, rows, batch), -1, dtype=np.int64),
        origin=np.full((rows, batch), -1, dtype=np.int64),
        held=_unheard(rows, batch),
    )


def _unheard(*shape: int) -> Records:
    held = np.zeros(shape, MESSAGE)
    held["pl_at"] = held["pl_ct"] = np.inf
    held["time"] = -np.inf
    return held


def forget(state: V2vState, senders: NDArray[np.int64]) -> None:
    """Drop what is held of ``senders`` (rows) and what they have under way: other vehicles take their rows over."""
    state.arriving[:, :, senders] = -1
    state.origin[:, senders] = -1
    state.held[:, senders] = _unheard(state.origin.shape[0], senders.size)


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
    """Whether a message gets through (receiver, sender): ``P = (1 - loss) (1 - (d / range)^4)`` within the range."""
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
    """Put this epoch's messages under way; a message of a later epoch replaces one that would arrive with it."""
    delay_s = config.latency_s - config.jitter_s * np.log1p(-u)
    through &= delay_s <= config.latency_max_s
    receiver, sender = np.nonzero(through)
    wait = np.ceil(delay_s[through] / dt_s - ROUNDING).astype(np.int64)
    state.arriving[(state.epoch + wait) % state.arriving.shape[0], receiver, sender] = state.epoch


def _receive(state: V2vState) -> None:
    """Take what arrives now, unless something newer is held."""
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
    """One epoch of the channel: send, carry, receive; ``state`` advances in place.

    Parameters
    ----------
    time_s, dt_s : end and length of the epoch
    message : what each vehicle says of itself
    antenna_en_m : (B, 2) where the antennas really are, for the radio range only
    streams : one row for each receiver
    street : (B,) or scalar; vehicles on different streets do not hear each other
    receivers : (R,) rows of the vehicles that listen; None for all
    sending : (B,) bool or scalar; the others keep silent, and their rows of ``message`` need only be finite

    Returns
    -------
    V2vInbox
        What every receiver holds at ``time_s``. A message that takes longer than an epoch arrives in a later one.

    Raises
    ------
    InputError
        When shapes disagree or a position is not finite.
    """
    listening, batch = state.origin.shape
    rows = np.arange(batch) if receivers is None else np.asarray(receivers, dtype=np.int64)
    if rows.size != listening:
        raise InputError(f"receivers must be {listening} rows, got {rows.size}: name as many as the state was made for")
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
