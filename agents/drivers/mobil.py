"""When to change lane: MOBIL (Kesting, Treiber and Helbing 2007), with accelerations of the intelligent driver model.

Signed gaps are middle to middle along the ego's route; lanes are -1 left, 0 own, 1 right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.plans import EGO_LENGTH_M, FREE_M, CruiseConfig, idm_acceleration, in_lane
from lanebound.integrity.core.config import Config, Field

__all__ = ["MobilConfig", "Neighbours", "changes", "neighbours"]

Array = NDArray[np.float64]


class MobilConfig(Config):
    """Figures of lane changes."""

    politeness: float = Field(0.2, ge=0, le=1, description="p, weight of the others' loss [-]; Kesting 2007, 0 to 0.5")
    threshold_mps2: float = Field(0.3, ge=0, description="gain that a change must exceed; Kesting 2007 has 0.1")
    brake_safe_mps2: float = Field(3.0, gt=0, description="hardest braking of any vehicle; Kesting 2007 has 4")
    room_m: float = Field(3.0, ge=0, description="gap to leader and follower of the new lane at least; chosen")
    speed_min_mps: float = Field(3.0, ge=0, description="below it no lane is changed; chosen")
    bend_per_m: float = Field(0.02, gt=0, description="nor before bends tighter than this [1/m]; 50 m radius, chosen")
    way_m: float = Field(40.0, gt=0, description="that a change takes, over which bends and junctions count; chosen")


class Neighbours(NamedTuple):
    """Nearest vehicles of a lane: gap bumper to bumper [m], FREE_M without one, and speed [m/s]."""

    lead_gap_m: Array
    lead_mps: Array
    follower_gap_m: Array
    follower_mps: Array


def neighbours(
    reader: Reader, observation: Observation, lane: int, along_m: Array | float = 0.0, within_s: float = 0.0
) -> Neighbours:
    """Vehicles ahead and behind that are on a lane or enter it within a time; every gap less ``along_m`` (..., K)."""
    v = reader.value(observation, "ego.speed")
    if not reader.config.vehicles:
        return Neighbours(np.full(v.shape, FREE_M), v, np.full(v.shape, FREE_M), v)
    gap = reader.rows(observation, "lane_gap")
    there = in_lane(reader, observation, lane, within_s)
    between = np.abs(gap) - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M) - along_m
    speed = np.maximum(v[..., None] + reader.rows(observation, "velocity_ahead"), 0.0)
    return Neighbours(
        *_nearest(between, there & (gap > 0.0), speed, v), *_nearest(between, there & (gap <= 0.0), speed, v)
    )


def _nearest(between: Array, there: NDArray[np.bool_], speed: Array, own_mps: Array) -> tuple[Array, Array]:
    free = np.where(there, between, FREE_M)
    best = np.argmin(free, axis=-1)[..., None]
    s = np.take_along_axis(free, best, axis=-1)[..., 0]
    return s, np.where(s < FREE_M, np.take_along_axis(speed, best, axis=-1)[..., 0], own_mps)


def changes(
    reader: Reader,
    observation: Observation,
    wanted_mps: Array,
    c: CruiseConfig,
    m: MobilConfig,
    along_m: Array | float = 0.0,
    bonus_mps2: tuple[Array | float, Array | float] = (0.0, 0.0),
) -> NDArray[np.int64]:
    """Lane to change to, -1 left, 0 none, 1 right.

    The better side whose gain ``a' - a + p (a_n' - a_n + a_o' - a_o)`` exceeds the threshold (equation 4), where the
    new follower n brakes no harder than is safe (equation 2), nor does the ego, unless it brakes as hard already. The
    end of the ego's lane is a standing car.

    Parameters
    ----------
    wanted_mps : speed on a free road
    along_m : subtracted from every gap
    bonus_mps2 : added to the gain of the left and of the right side
    """
    v = reader.value(observation, "ego.speed")
    own = neighbours(reader, observation, 0, along_m, c.cut_in_s)
    end = reader.value(observation, "road.lane_end")
    end = np.where(end < reader.scale("road.lane_end"), np.maximum(end, 0.0), FREE_M)
    here = np.minimum(_idm(v, wanted_mps, own.lead_gap_m, own.lead_mps, c), _idm(v, wanted_mps, end, 0.0 * v, c))
    joined = own.lead_gap_m + own.follower_gap_m + EGO_LENGTH_M  # for the old follower, after the change
    relief = _follower(own, joined, own.lead_mps, wanted_mps, c) - _follower(own, own.follower_gap_m, v, wanted_mps, c)
    gains = []
    sides = ((-1, "ego.left_exists", bonus_mps2[0]), (1, "ego.right_exists", bonus_mps2[1]))
    for lane, exists, bonus in sides:
        new = neighbours(reader, observation, lane, along_m, c.cut_in_s)
        there = _idm(v, wanted_mps, new.lead_gap_m, new.lead_mps, c)
        cut = _follower(new, new.follower_gap_m, v, wanted_mps, c)
        before = _follower(new, new.lead_gap_m + new.follower_gap_m + EGO_LENGTH_M, new.lead_mps, wanted_mps, c)
        safe = (cut >= -m.brake_safe_mps2) & ((there >= -m.brake_safe_mps2) | (there >= here))
        safe &= (new.lead_gap_m >= m.room_m) & (new.follower_gap_m >= m.room_m)
        safe &= reader.value(observation, exists) > 0.5
        gain = there - here + m.politeness * (cut - before + relief) + bonus
        gains.append(np.where(safe, gain, -np.inf))
    left, right = gains
    side = np.where(left >= right, -1, 1)
    worth = np.maximum(left, right) > m.threshold_mps2
    return np.asarray(np.where(worth & _may_change(reader, observation, v, m), side, 0), dtype=np.int64)


def _may_change(reader: Reader, observation: Observation, v: Array, m: MobilConfig) -> NDArray[np.bool_]:
    """No change is in progress, the car moves, and the road ahead is straight enough and does not end."""
    may = (reader.value(observation, "ego.target_left") < 0.5) & (reader.value(observation, "ego.target_right") < 0.5)
    may &= v >= m.speed_min_mps
    may &= reader.value(observation, "road.junction") >= m.way_m
    for d in reader.previews_m:
        if d <= m.way_m:
            may &= np.abs(reader.value(observation, f"road.preview_{d:g}m_curvature")) <= m.bend_per_m
    return may


def _idm(v: Array, wanted_mps: Array, s: Array, lead_mps: Array, c: CruiseConfig) -> Array:
    return np.clip(idm_acceleration(v, wanted_mps, s, lead_mps, c), -2.0 * c.brake_max_mps2, c.accelerate_mps2)


def _follower(lane: Neighbours, s: Array, lead_mps: Array, wanted_mps: Array, c: CruiseConfig) -> Array:
    """Acceleration of a lane's follower at a gap; 0 without a follower."""
    speed = lane.follower_mps
    return np.where(lane.follower_gap_m < FREE_M, _idm(speed, np.maximum(wanted_mps, speed), s, lead_mps, c), 0.0)
