"""Speed, acceleration and steering from an observation; leading axes are a batch.

Symbols: v speed [m/s], s gap bumper to bumper [m], kappa curvature [1/m], L length of the car [m], beta the angle of
its velocity to its heading, delta the steering angle, (x, y) a point ahead and to the right of its middle [m].
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.integrity.core.config import Config, Field

__all__ = [
    "EGO_LENGTH_M",
    "FREE_M",
    "LANES",
    "CruiseConfig",
    "closure_gap",
    "following_acceleration",
    "idm_acceleration",
    "in_lane",
    "nearest_ahead",
    "pursuit_steering",
    "route_speed",
    "safe_speed",
]

Array = NDArray[np.float64]
EGO_LENGTH_M = 5.0  # of highway-env's cars
FREE_M = 1e6  # gap without a vehicle ahead
LANES = {-1: "left_lane", 0: "own_lane", 1: "right_lane"}
MERGES = 0.5  # speed across the lane over that along it, below which a vehicle merges; 27 degrees


class CruiseConfig(Config):
    """Parameters of a calm driver."""

    speed_mps: float = Field(14.0, gt=0, description="where the map gives no limit [m/s]; 50 km/h")
    lateral_mps2: float = Field(2.0, gt=0, description="acceleration across the track in bends; comfort, ISO 2631-1")
    accelerate_mps2: float = Field(1.5, gt=0, description="acceleration on a free road; IDM, Treiber 2000, city")
    brake_mps2: float = Field(2.0, gt=0, description="comfortable braking; IDM, Treiber 2000")
    brake_max_mps2: float = Field(5.0, gt=0, description="hardest braking; dry road, chosen")
    lead_brake_mps2: float = Field(6.0, gt=0, description="hardest braking expected of a leader; RSS, dry road")
    time_gap_s: float = Field(1.2, gt=0, description="time gap to the leader; IDM, 1 to 1.5 s")
    response_s: float = Field(0.6, ge=0, description="until braking begins: a decision and the age of a broadcast")
    merge_m: float = Field(
        80.0, ge=0, description="before a closure of the own lane, where its limit holds: gaps come up; chosen"
    )
    leaders: int = Field(1, ge=1, le=8, description="vehicles ahead on the lane behind which it can stop; chosen")
    standstill_m: float = Field(2.0, gt=0, description="gap at rest; IDM, Treiber 2000")
    cut_in_s: float = Field(
        1.0, ge=0, description="a vehicle that enters a lane within this time counts there; half of a change, chosen"
    )
    lookahead_s: float = Field(0.8, gt=0, description="of the target point; longer is calmer, chosen")
    lookahead_min_m: float = Field(5.0, gt=0, description="and at least this far; a car's length")


def route_speed(reader: Reader, observation: Observation, c: CruiseConfig) -> Array:
    """Speed that limits and bends ahead allow: ``v^2 <= a_lat / |kappa(d)| + 2 b d`` at every preview, and the end."""
    limit = reader.value(observation, "road.speed_limit")
    squared = np.where(limit < reader.scale("road.speed_limit"), limit, c.speed_mps) ** 2
    for d in reader.previews_m:
        kappa = np.abs(reader.value(observation, f"road.preview_{d:g}m_curvature"))
        squared = np.minimum(squared, c.lateral_mps2 / np.maximum(kappa, 1e-6) + 2.0 * c.brake_mps2 * d)
    if reader.config.closure:
        early = c.merge_m * (reader.value(observation, "road.closure_own") > 0.5)
        beside = reader.value(observation, "road.closure_limit") ** 2
        beside += 2.0 * c.brake_mps2 * np.maximum(reader.value(observation, "road.closure_start") - early, 0.0)
        ahead = (reader.value(observation, "road.closure_known") > 0.5) & (
            reader.value(observation, "road.closure_end") > 0.0
        )
        squared = np.where(ahead, np.minimum(squared, beside), squared)
    return np.asarray(np.sqrt(squared))


def in_lane(reader: Reader, observation: Observation, side: int, within_s: float) -> NDArray[np.bool_]:
    """Which vehicles have their middles in a lane, or enter it within a time along the lane's direction, (..., K).

    Parameters
    ----------
    side : -1 for the lane left of the ego's, 0 for its own, 1 right
    """
    rows = partial(reader.rows, observation)
    there = rows(LANES[side]) > 0.5
    if within_s > 0.0:
        sine, cosine = (reader.value(observation, f"ego.heading_{name}")[..., None] for name in ("sin", "cos"))
        ahead = reader.value(observation, "ego.speed")[..., None] + rows("velocity_ahead")
        right = rows("velocity_right")
        along, across = cosine * ahead - sine * right, sine * ahead + cosine * right
        width = reader.value(observation, "ego.lane_width")[..., None]
        off = rows("lane_offset") + within_s * across - side * width
        # A vehicle that crosses at an angle is no cut-in: giving way counts it.
        there |= (np.abs(off) <= 0.5 * width) & (np.abs(across) <= MERGES * along)
    return np.asarray(there & (rows("present") > 0.5))


def closure_gap(reader: Reader, observation: Observation, lane: int = 0, along_m: Array | float = 0.0) -> Array:
    """Road from the bumper to a closure known on the own lane, on the left (-1) or on the right one (1) [m].

    0 beside it and within ``along_m`` of it; far off without one.
    """
    free = np.full(reader.value(observation, "ego.speed").shape, FREE_M)
    if not reader.config.closure:
        return free
    there = reader.value(observation, f"road.closure_{LANES[lane].removesuffix('_lane')}") > 0.5
    there &= reader.value(observation, "road.closure_end") > -0.5 * EGO_LENGTH_M - along_m
    gap = reader.value(observation, "road.closure_start") - 0.5 * EGO_LENGTH_M - along_m
    return np.where(there, np.maximum(gap, 0.0), free)


def nearest_ahead(
    reader: Reader,
    observation: Observation,
    along_m: Array | float = 0.0,
    across_m: Array | float = 0.0,
    c: CruiseConfig | None = None,
) -> tuple[Array, Array]:
    """Gap bumper to bumper [m] to the next vehicle on the ego's route, and its speed [m/s]; far off without one.

    With a configuration vehicles that enter the lane within ``cut_in_s`` count. Of the ``leaders`` next vehicles that
    one counts whose braking leaves the least safe speed; from the gap to one that is not the next the vehicles in
    between, and their gaps at rest, are subtracted.

    Parameters
    ----------
    along_m : (..., K) or number, subtracted from the gap to each vehicle
    across_m : (..., K) or number, by which the ego's lane is widened on each side for each vehicle
    """
    speed = reader.value(observation, "ego.speed")
    if not reader.config.vehicles:
        return np.full(speed.shape, FREE_M), speed
    gap = reader.rows(observation, "lane_gap")
    half = 0.5 * reader.value(observation, "ego.lane_width")[..., None]
    near = np.abs(reader.rows(observation, "lane_offset")) <= half + across_m
    wide = near & (np.asarray(across_m) > 0.0) & (reader.rows(observation, "present") > 0.5)
    there = (in_lane(reader, observation, 0, 0.0 if c is None else c.cut_in_s) | wide) & (gap > 0.0)
    free = np.where(there, gap - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M) - along_m, FREE_M)
    best = np.argmin(free, axis=-1)[..., None]
    if c is not None and c.leaders > 1:
        place = np.argsort(np.argsort(free, axis=-1, kind="stable"), axis=-1)
        free = np.where(there, free - place * (EGO_LENGTH_M + c.standstill_m), FREE_M)
        ahead = np.maximum(speed[..., None] + reader.rows(observation, "velocity_ahead"), 0.0)
        safe = safe_speed(np.maximum(free, 0.0), ahead, c)
        best = np.argmin(np.where(there & (place < c.leaders), safe, FREE_M), axis=-1)[..., None]
    closing = np.take_along_axis(reader.rows(observation, "velocity_ahead"), best, axis=-1)[..., 0]
    s = np.take_along_axis(free, best, axis=-1)[..., 0]
    return np.maximum(s, 0.0), np.where(s < FREE_M, np.maximum(speed + closing, 0.0), speed)


def safe_speed(s: Array, lead_mps: Array, c: CruiseConfig) -> Array:
    """Fastest speed from which a leader's hardest braking is answered in time (Krauss 1998, with two decelerations).

    ``v tau + v^2 / 2b = s - s0 + v_lead^2 / 2b_lead``, solved for v.
    """
    room = np.maximum(s - c.standstill_m + 0.5 * lead_mps**2 / c.lead_brake_mps2, 0.0)
    delay = c.brake_max_mps2 * c.response_s
    return np.asarray(np.sqrt(delay * delay + 2.0 * c.brake_max_mps2 * room) - delay)


def idm_acceleration(v: Array, wanted_mps: Array, s: Array, lead_mps: Array, c: CruiseConfig) -> Array:
    """The intelligent driver model (Treiber et al. 2000, equations 2 and 3), unbounded.

    ``a (1 - (v / v0)^4 - (s* / s)^2)``, ``s* = s0 + v T + v (v - v_lead) / (2 sqrt(a b))``; above the wanted speed it
    brakes in proportion, as that model does not.
    """
    a, b = c.accelerate_mps2, c.brake_mps2
    needed = c.standstill_m + np.maximum(v * c.time_gap_s + 0.5 * v * (v - lead_mps) / np.sqrt(a * b), 0.0)
    free = np.where(v <= wanted_mps, a * (1.0 - (v / np.maximum(wanted_mps, 0.1)) ** 4), 2.0 * (wanted_mps - v))
    return np.asarray(free - a * (needed / np.maximum(s, 0.1)) ** 2)


def following_acceleration(v: Array, wanted_mps: Array, s: Array, lead_mps: Array, c: CruiseConfig) -> Array:
    """The intelligent driver model, braking harder where the gap is no longer safe; bounded."""
    follow = idm_acceleration(v, wanted_mps, s, lead_mps, c)
    urgent = (safe_speed(s, lead_mps, c) - v) / max(c.response_s, 0.1)
    bounded = np.where(urgent < 0.0, np.minimum(follow, urgent), follow)
    return np.asarray(np.clip(bounded, -c.brake_max_mps2, c.accelerate_mps2))


def pursuit_steering(reader: Reader, observation: Observation, c: CruiseConfig) -> Array:
    """Steering angle [rad] of a circle through the route's centreline ahead (pure pursuit, Coulter 1992).

    The car's middle, half way between the axles, moves at beta to its heading on a circle of ``sin(beta) = kappa L/2``,
    ``tan(beta) = tan(delta) / 2``: for a point at distance d and bearing alpha ``tan(beta) = sin(alpha) / (d / L +
    cos(alpha))``. Between two previews the angle is interpolated.
    """
    v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
    reach = np.maximum(c.lookahead_s * v, c.lookahead_min_m)
    distances = reader.previews_m
    tangents = np.stack([_tan_beta(reader, observation, d) for d in distances], axis=-1)
    if len(distances) == 1:
        return np.asarray(np.arctan(2.0 * tangents[..., 0]))
    beyond = np.clip(np.searchsorted(distances, reach), 1, len(distances) - 1)
    low, high = np.array(distances)[beyond - 1], np.array(distances)[beyond]
    share = np.clip((reach - low) / (high - low), 0.0, 1.0)
    near = np.take_along_axis(tangents, np.asarray(beyond - 1)[..., None], axis=-1)[..., 0]
    far = np.take_along_axis(tangents, np.asarray(beyond)[..., None], axis=-1)[..., 0]
    return np.asarray(np.arctan(2.0 * ((1.0 - share) * near + share * far)))


def _tan_beta(reader: Reader, observation: Observation, preview_m: float) -> Array:
    x = reader.value(observation, f"road.preview_{preview_m:g}m_ahead")
    y = reader.value(observation, f"road.preview_{preview_m:g}m_right")
    d = np.maximum(np.hypot(x, y), 0.1)
    return np.asarray((y / d) / (d / EGO_LENGTH_M + np.maximum(x / d, 0.0)))
