"""Read-outs of an episode: the belief of the ego, and the perceived traffic.

Frame ``xy``: highway-env's plane, x ahead along the first road, y to its right, headings clockwise from x seen from
above. It is East-South: ``E = x``, ``N = -y``, azimuth = heading + pi / 2. Lateral offsets are positive to the right.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.closure_kernel import NOT_BESIDE
from lanebound.envs.batch.records_kernel import PERCEIVED
from lanebound.integrity.core.records import Records

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable

__all__ = ["EgoBelief", "LaneIndex", "Traffic", "azimuth_of", "enu_of", "xy_of"]

Array = NDArray[np.float64]
LaneIndex = tuple[str, str, int]
FLIP = np.array([1.0, -1.0])
FLAGS = ("alert", "available", "context_warning", "roads_agree", "lane_seen", "closure")
"""Fields of BELIEF that are true or false."""
Angle = TypeVar("Angle", float, NDArray[np.float64])


def enu_of(xy: Array) -> Array:
    """East, North of a point or vector in the plane.  (..., 2) -> (..., 2)."""
    return np.asarray(np.asarray(xy, dtype=np.float64) * FLIP)


def xy_of(en: Array) -> Array:
    """The inverse of :func:`enu_of`, which is its own.  (..., 2) -> (..., 2)."""
    return np.asarray(np.asarray(en, dtype=np.float64) * FLIP)


def azimuth_of(heading_rad: Angle) -> Angle:
    """Azimuth clockwise from North of a heading in the plane [rad]."""
    return heading_rad + 0.5 * np.pi


@dataclass(frozen=True)
class EgoBelief:
    """The belief of the ego about itself at one instant: the estimate, its place on the map, and its integrity.

    Attributes
    ----------
    position_m : (2,) x, y of the vehicle's middle, smoothed after a jump of the solution
    heading_rad, speed_mps, yaw_rate_radps, acceleration_mps2 : of the estimate; speed is the odometer's
    steering_rad : the steering angle commanded last
    lane_index, longitudinal_m, lateral_m, angle_rad, lane_width_m : the estimate on the ego's own map
    target_lane_index, target_speed_mps : what meta-actions have set; the lane itself and the speed otherwise
    pl_at_m, pl_ct_m : protection levels of ``position_m``, what smoothing has yet to take back included; inf if missing
    al_at_m, al_ct_m : alert limits
    mode, rtk, reason : codes of Mode, RtkStatus and AlertReason
    alert, available : bool; alert_age_s : how long the alert has been on, 0 without
    hdop, satellites, satellites_doppler, excluded : as in Solution
    since_rtk_s, since_calibration_s, corrections_age_s : inf for never
    context_warning, context_phases, context_score, link_probability : of the context monitor; 0 without one
    model_curved, nis_position, nis_wheels, nis_gyro, nis_steering, nis_slip, nis_compass, trust_m, sdop : as in
        Solution
    permitted_mps : speed permitted by ``cost.alert_speed: level``; of no meaning without it
    fix_position_m : (2,) of the navigator on the map; a lane sensor puts it on a lane as ``position_m``
    road_offset_m, other_road_m, other_limit_mps, possible_mps, roads_agree, lane_seen, route_shift : as in BELIEF, with
        a lane sensor; of no meaning without one
    closure, closure_side, closure_start_m, closure_end_m, closure_limit_mps : as in BELIEF, of a lane that closes
    """

    time_s: float
    position_m: Array
    heading_rad: float
    speed_mps: float
    yaw_rate_radps: float
    acceleration_mps2: float
    steering_rad: float
    lane_index: LaneIndex
    longitudinal_m: float
    lateral_m: float
    angle_rad: float
    lane_width_m: float
    target_lane_index: LaneIndex
    target_speed_mps: float
    pl_at_m: float
    pl_ct_m: float
    al_at_m: float
    al_ct_m: float
    mode: int
    rtk: int
    reason: int
    alert: bool
    alert_age_s: float
    available: bool
    hdop: float
    satellites: int
    satellites_doppler: int
    excluded: int
    since_rtk_s: float
    since_calibration_s: float
    corrections_age_s: float
    model_curved: float
    nis_position: float
    nis_wheels: float
    nis_gyro: float
    nis_steering: float
    nis_slip: float
    nis_compass: float
    trust_m: float
    sdop: float
    context_warning: bool = False
    context_phases: int = 0
    context_score: float = 0.0
    link_probability: float = 0.0
    permitted_mps: float = np.inf
    fix_position_m: Array = field(default_factory=lambda: np.zeros(2))
    road_offset_m: float = 0.0
    other_road_m: float = np.inf
    other_limit_mps: float = np.inf
    possible_mps: float = np.inf
    roads_agree: bool = True
    lane_seen: bool = True
    route_shift: int = 0
    closure: bool = False
    closure_side: int = NOT_BESIDE
    closure_start_m: float = np.inf
    closure_end_m: float = np.inf
    closure_limit_mps: float = np.inf

    @classmethod
    def of(cls, beliefs: Records, row: int, table: LaneTable) -> EgoBelief:
        """The belief in a row of BELIEF, on the lanes of a table."""
        values: dict[str, Any] = dict(zip(beliefs.dtype.names or (), beliefs[row].item(), strict=True))
        position = np.array([values.pop("x_m"), values.pop("y_m")])
        fix = np.array([values.pop("fix_x_m"), values.pop("fix_y_m")])
        lane, target = table.index[values.pop("lane")], table.index[values.pop("target_lane")]
        flags = {name: bool(values.pop(name)) for name in FLAGS}
        del values["path"]
        return cls(
            position_m=position, fix_position_m=fix, lane_index=lane, target_lane_index=target, **flags, **values
        )


@dataclass(frozen=True)
class Traffic:
    """The N perceived vehicles, nearest first, each extrapolated to now with its last known velocity.

    Attributes
    ----------
    key : (N,) int64, identifies a vehicle while it is perceived
    position_m : (N, 2) x, y; heading_rad, speed_mps : (N,)
    pl_at_m, pl_ct_m : (N,) bounds of the position's error along and across *its* heading, age included; inf if missing
    age_s : (N,) since the measurement behind it
    length_m, width_m : (N,)
    relative : (N,) bool, seen by the ego's own sensor: the levels bound the position *relative* to the ego, whose own
        levels are not added
    """

    key: NDArray[np.int64]
    position_m: Array
    heading_rad: Array
    speed_mps: Array
    pl_at_m: Array
    pl_ct_m: Array
    age_s: Array
    length_m: Array
    width_m: Array
    relative: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of vehicles perceived."""
        return int(self.key.shape[0])

    @classmethod
    def of(cls, perceived: Records) -> Traffic:
        """The vehicles in rows (N,) of PERCEIVED."""
        p = perceived.copy()
        position = np.stack([p["x_m"], p["y_m"]], axis=-1)
        names = ("heading_rad", "speed_mps", "pl_at_m", "pl_ct_m", "age_s", "length_m", "width_m")
        numbers = [p[name] for name in names]
        return cls(p["key"], position, *[*numbers, p["relative"] != 0])

    @classmethod
    def none(cls) -> Traffic:
        """No vehicle."""
        return cls.of(np.zeros(0, PERCEIVED))
