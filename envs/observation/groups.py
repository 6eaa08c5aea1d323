"""The numbers of each group in the order of the index, before scale and bounds; what is missing is infinite here."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from math import cos, inf, sin

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.index import LANES
from lanebound.envs.observation.path import Path, wrap
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["ego_values", "integrity_values", "road_values", "traffic_values"]


def _one_hot(codes: Sequence[int]) -> dict[int, tuple[float, ...]]:
    """For each code the numbers that show it."""
    return {code: tuple(float(code == other) for other in codes) for code in codes}


REASONS = _one_hot([reason.code for reason in AlertReason])
MODES = _one_hot([int(mode) for mode in Mode])
RTK_STATES = _one_hot([status.code for status in RtkStatus])
UNKNOWN = -inf  # a number of satellites that nobody predicts
ABSENT = [0.0, inf, *[0.0] * 5, inf, *[0.0] * 6, inf, 0.0]  # a row of traffic without a vehicle
ABSENT_LEVELS = [0.0, inf, inf]


def ego_values(belief: EgoBelief, path: Path) -> list[float]:
    """Group ``ego``."""
    half = 0.5 * belief.lane_width_m
    change = _commanded_change(belief, path)
    return [
        belief.speed_mps,
        belief.target_speed_mps,
        belief.acceleration_mps2,
        belief.yaw_rate_radps,
        belief.steering_rad,
        sin(belief.angle_rad),
        cos(belief.angle_rad),
        belief.lateral_m,
        belief.lateral_m / half,
        belief.lane_width_m,
        path.lane.share,
        path.lane.left_exists,
        path.lane.right_exists,
        float(change < 0),
        float(change > 0),
    ]


def _commanded_change(belief: EgoBelief, path: Path) -> int:
    """Lanes to the right of the ego's path that its target lane lies; 0 when the target is on no road of the path."""
    target = belief.target_lane_index
    if target == belief.lane_index:
        return 0
    for index in path.following:
        if index[:2] == target[:2]:
            return int(target[2]) - int(index[2])
    return 0


def integrity_values(belief: EgoBelief, trends_m: tuple[float, float], oracle: bool) -> list[float]:
    """Group ``integrity``; ``trends_m``: change of the clipped levels AT, CT; ``oracle``: perfect, without alert."""
    b = belief
    available, alert, age, reason = (1.0, 0.0, 0.0, 0) if oracle else _alert_of(b)
    return [
        *_axis(0.0 if oracle else b.pl_at_m, b.al_at_m, trends_m[0]),
        *_axis(0.0 if oracle else b.pl_ct_m, b.al_ct_m, trends_m[1]),
        available,
        alert,
        age,
        *REASONS[reason],
        *MODES[b.mode],
        *RTK_STATES[b.rtk],
        b.since_rtk_s,
        b.since_calibration_s,
        b.corrections_age_s,
        b.satellites,
        b.satellites_doppler,
        b.excluded,
        b.hdop,
    ]


def _alert_of(belief: EgoBelief) -> tuple[float, float, float, int]:
    return float(belief.available), float(belief.alert), belief.alert_age_s, belief.reason


def _axis(pl_m: float, al_m: float, trend_m: float) -> tuple[float, ...]:
    """Level, whether it exists, limit, ratio, margin and trend of one axis."""
    exists = pl_m < inf
    if not exists:
        return inf, 0.0, al_m, inf, -inf, trend_m
    return pl_m, 1.0, al_m, pl_m / al_m if al_m > 0.0 else inf, al_m - pl_m, trend_m


def road_values(
    config: ObservationConfig, belief: EgoBelief, path: Path, street_ahead: NDArray[np.generic] | None
) -> list[float]:
    """Group ``road``; ``street_ahead`` (D, 3): line-of-sight satellites predicted for the lanes left, own, right."""
    here, heading = belief.longitudinal_m, belief.heading_rad
    x0, y0 = belief.position_m.tolist()
    c, s = cos(heading), sin(heading)
    out = [path.lane.speed_limit_mps, path.junction_m - here, path.lane_end_m - here]
    for distance in config.preview_m:
        station = here + distance
        x, y, direction, curvature = path.at(station)
        dx, dy = x - x0, y - y0
        exists = 1.0 if station <= path.end_m else 0.0
        out += (exists, dx * c + dy * s, dy * c - dx * s, wrap(direction - heading), curvature)
    out += _sky(config, path, street_ahead)
    return out


def _sky(config: ObservationConfig, path: Path, street_ahead: NDArray[np.generic] | None) -> list[float]:
    shape = (len(config.satellites_m), len(LANES))
    if street_ahead is None:
        return [UNKNOWN] * (shape[0] * shape[1])
    if street_ahead.shape != shape:
        raise InputError(
            f"street_ahead must have shape {shape}, got {street_ahead.shape}: one row for each of satellites_m, "
            f"columns {', '.join(LANES)}"
        )
    out: list[float] = street_ahead.ravel().tolist()
    if not path.lane.left_exists:
        out[0::3] = [UNKNOWN] * shape[0]
    if not path.lane.right_exists:
        out[2::3] = [UNKNOWN] * shape[0]
    return [value if value >= 0 else UNKNOWN for value in out]


def traffic_values(config: ObservationConfig, belief: EgoBelief, traffic: Traffic, path: Path) -> list[float]:
    """Group ``traffic``: the nearest vehicles, one row after the other, then rows without."""
    rows = min(traffic.count, config.vehicles)
    out: list[float] = []
    if rows:
        _present(out, config, belief, traffic, path, rows)
    absent = ABSENT + ABSENT_LEVELS if config.shows_levels else ABSENT
    out += absent * (config.vehicles - rows)
    return out


def _present(
    out: list[float], config: ObservationConfig, belief: EgoBelief, traffic: Traffic, path: Path, rows: int
) -> None:
    """Append the rows of the vehicles that are there."""
    heading, speed, half = belief.heading_rad, belief.speed_mps, 0.5 * belief.lane_width_m
    x0, y0 = belief.position_m.tolist()
    c, s = cos(heading), sin(heading)
    levels = _levels_of(config, belief)
    columns = zip(
        traffic.position_m.tolist(),
        traffic.heading_rad.tolist(),
        traffic.speed_mps.tolist(),
        traffic.length_m.tolist(),
        traffic.width_m.tolist(),
        traffic.age_s.tolist(),
        traffic.relative.tolist(),
        traffic.pl_at_m.tolist(),
        traffic.pl_ct_m.tolist(),
        strict=True,
    )
    for (x, y), direction, v, length, width, age, relative, at, ct in islice(columns, rows):
        dx, dy = x - x0, y - y0
        ahead, right = dx * c + dy * s, dy * c - dx * s
        turn = direction - heading
        tc, ts = cos(turn), sin(turn)
        beside = path.project(x, y, belief.longitudinal_m + ahead)
        gap, offset = _nowhere(ahead, right) if beside is None else (beside[0] - belief.longitudinal_m, beside[1])
        out += (1.0, ahead, right, v * tc - speed, v * ts, ts, tc, gap, offset)
        out += (-half <= offset <= half, -3 * half <= offset < -half, half < offset <= 3 * half)
        out += (length, width, age, relative)
        if levels:
            out += _combined(tc, ts, at, ct, (0.0, 0.0) if relative else levels, config.integrity == "oracle")


def _nowhere(ahead_m: float, right_m: float) -> tuple[float, float]:
    """Gap and offset of a vehicle that is not beside the ego's route."""
    return inf if ahead_m >= 0.0 else -inf, inf if right_m >= 0.0 else -inf


def _levels_of(config: ObservationConfig, belief: EgoBelief) -> tuple[float, float] | None:
    """The ego's share of combined levels; None when levels are not shown."""
    return (belief.pl_at_m, belief.pl_ct_m) if config.shows_levels else None


def _combined(
    tc: float, ts: float, at: float, ct: float, own: Sequence[float], oracle: bool
) -> tuple[float, float, float]:
    """Whether levels exist, and own plus half the extent of the box (at, ct), turned, on the ego's axes."""
    if oracle:
        return 1.0, 0.0, 0.0
    if not (at < inf and ct < inf and own[0] < inf and own[1] < inf):
        return 0.0, inf, inf
    tc, ts = abs(tc), abs(ts)
    return 1.0, own[0] + tc * at + ts * ct, own[1] + ts * at + tc * ct
