"""The vehicles behind which a safe driver must be able to stop: those ahead, and a leader that may still be ahead.

Where protection levels are longer than the gap, a leader may be believed level with the ego, or behind it. Its place at
the last decision distinguishes it from a follower.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.plans import EGO_LENGTH_M, LANES

__all__ = ["Leader", "counted", "expected_m", "in_way", "leader_of"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Leader(NamedTuple):
    """The vehicle with the least free gap, of a single observation.

    Attributes
    ----------
    gap_m : between bumpers, as believed; speed_mps : as broadcast; age_s : of the broadcast
    level_m : protection level along the track of both together; broadcast_m : its own level, as broadcast
    """

    gap_m: float
    speed_mps: float
    age_s: float
    level_m: float
    broadcast_m: float


def in_way(reader: Reader, observation: Observation, extra_m: float, side: int = 0) -> Bools:
    """Which vehicles may be in the ego's lane by their levels across the track, up to a bound, (..., K).

    ``side``: -1 and 1 for the lanes to the left and to the right, as wide as the ego's.
    """
    width = reader.value(observation, "ego.lane_width")[..., None]
    extra = np.minimum(reader.rows(observation, "pl_ct"), extra_m)
    near = np.abs(reader.rows(observation, "lane_offset") - side * width) <= 0.5 * width + extra
    there = reader.rows(observation, "present") > 0.5
    return there & (near | (reader.rows(observation, LANES[side]) > 0.5))


def counted(reader: Reader, observation: Observation, way: Bools, expected: Array | float) -> Bools:
    """Which vehicles count as ahead: those believed ahead, and a leader that may still be ahead, (..., K).

    The leader of the last decision has an expected gap. Where no vehicle ahead lies within its level of that gap, one
    that is believed level or behind counts too: the nearest to that gap, within its level of it, with a level that
    reaches over the ego.

    Parameters
    ----------
    way : (..., K), which vehicles may be in the ego's lane
    expected : (...), expected gap of the leader between middles; NaN without a leader
    """
    gap, level = reader.rows(observation, "lane_gap"), reader.rows(observation, "pl_at")
    ahead = way & (gap > 0.0)
    off = np.abs(gap - np.asarray(expected)[..., None])
    alike = off <= level  # never where NaN
    lost = ~(ahead & alike).any(axis=-1, keepdims=True)
    maybe = way & (gap <= 0.0) & (gap + level > 0.0) & alike & lost
    nearest = off <= np.where(maybe, off, np.inf).min(axis=-1, keepdims=True)
    return np.asarray(ahead | (maybe & nearest), dtype=np.bool_)


def expected_m(reader: Reader, observation: Observation, ahead: Bools, dt_s: float) -> Array:
    """Expected gap after a step to the nearest vehicle that counts; NaN without any.  (...)."""
    gap = np.where(ahead, reader.rows(observation, "lane_gap"), np.inf)
    best = np.argmin(gap, axis=-1)[..., None]
    closing = np.take_along_axis(reader.rows(observation, "velocity_ahead"), best, axis=-1)[..., 0]
    return np.where(ahead.any(axis=-1), np.take_along_axis(gap, best, axis=-1)[..., 0] + closing * dt_s, np.nan)


def leader_of(reader: Reader, observation: Observation, ahead: Bools) -> Leader | None:
    """The vehicle of a single observation with the least free gap, of those that count; None without any."""
    if not ahead.any():
        return None
    level = reader.rows(observation, "pl_at")
    gap = reader.rows(observation, "lane_gap") - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M)
    k = int(np.argmin(np.where(ahead, gap - level, np.inf)))
    v = float(reader.value(observation, "ego.speed")) + float(reader.rows(observation, "velocity_ahead")[k])
    relative = bool(reader.rows(observation, "sensor")[k] > 0.5)
    own = 0.0 if relative else float(reader.value(observation, "integrity.pl_at"))
    broadcast = max(float(level[k]) - own, 0.0)
    return Leader(float(gap[k]), max(v, 0.0), float(reader.rows(observation, "age")[k]), float(level[k]), broadcast)
