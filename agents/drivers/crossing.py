"""Giving way to traffic that crosses the route: gap acceptance by predicted occupancy; leading axes are a batch.

Other vehicles go on at their speed; near the route they may also turn. The ego enters a crossing where on none of these
courses less than a time gap lies between it and another vehicle in the conflict area: a post-encroachment time, as
that of the cost of conflicts. With the 3 to 4.5 s in which the ego clears a lane from rest this is a critical gap of 4
to 5.5 s before a vehicle. It waits before the crossing, not inside. Inside a shorter time gap counts, and it goes on
unless it can still stop clear of all predicted courses.

Symbols: d station on the route [m], t time [s], v speed of the ego [m/s]; K vehicles, T times, D stations, C circles
that cover a vehicle on each of its courses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.integrity.core.config import Config, Field

__all__ = ["YieldConfig", "crosses", "yield_speed"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
STATION_STEP_M, TIME_STEP_S = 1.5, 0.25
INSIDE_RAD = 0.1  # a route that turns by more before the end of the section does so inside the crossing; chosen
CIRCLES = (-0.33, 0.0, 0.33)
"""Middles of circles that cover a vehicle, in its lengths; of a car of 5 m and 2 m they have 1.3 m radius."""


class YieldConfig(Config):
    """Figures of giving way."""

    horizon_s: float = Field(7.0, gt=0, description="prediction of other vehicles; critical gaps are 4-7 s, HCM 2010")
    reach_m: float = Field(45.0, gt=0, description="along the route; a comfortable stop from 50 km/h")
    width_m: float = Field(2.3, gt=0, description="of a circle to the route: its radius and half a car")
    length_m: float = Field(3.8, gt=0, description="half of the ego and the radius of a circle")
    gap_s: float = Field(
        1.0, ge=0, description="before and after the ego on entering; 1.5 s took fewer gaps and prevented no conflict"
    )
    inside_s: float = Field(0.5, ge=0, description="the same for an ego inside the crossing; chosen")
    turn_m: tuple[float, float] = Field((13.0, 9.0), description="radii of a turn left and right; lanes of 4 m")
    turning_rad: float = Field(
        0.14, ge=0, description="from the directions of the crossing, from which a vehicle turns; 8 deg"
    )
    enter_mps: float = Field(
        3.0, gt=0, description="at which the ego enters while others approach; it can still stop in a car's length"
    )
    line_m: float = Field(1.0, ge=0, description="from the crossing to where the ego waits; a stop line is 1 m before")
    creep_mps: float = Field(1.0, ge=0, description="from which the ego can always stop; chosen")
    angle_sin: float = Field(0.35, ge=0, le=1, description="sine of the angle from which a path crosses; 20 degrees")
    join_sin: float = Field(
        0.6, ge=0, le=1, description="sine of the angle to the route below which a vehicle follows the ego; within 3 m"
    )
    beside_m: float = Field(6.0, gt=0, description="from the route, up to which vehicles along it only drive beside it")
    response_s: float = Field(0.5, ge=0, description="until the ego has speed from rest; one decision")
    accelerate_mps2: float = Field(1.5, gt=0, description="of the ego at least; as the driver's")
    brisk_mps2: float = Field(3.0, gt=0, description="of the ego at most; meta-actions of highway-env")
    brake_mps2: float = Field(2.0, gt=0, description="of the ego giving way; comfortable")
    hard_mps2: float = Field(3.0, gt=0, description="with which a stop counts as possible; meta-actions of highway-env")


class _Courses(NamedTuple):
    """Predicted circles of other vehicles: x, y, direction (..., K, T, C) in the present axes of the ego."""

    x: Array
    y: Array
    direction: Array


def yield_speed(
    reader: Reader,
    observation: Observation,
    c: YieldConfig,
    free_mps: Array | float = np.inf,
    extra_m: Array | float = 0.0,
) -> Array:
    """Fastest speed from which the ego stops before crossing traffic; infinite where it may go.  (...).

    Parameters
    ----------
    free_mps : speed on a free road, (...) or a number
    extra_m : widening of each vehicle for uncertain positions, (..., K) or a number
    """
    v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
    if not reader.config.vehicles or not reader.previews_m:
        return np.full(v.shape, np.inf)
    station = _stations(reader, c)
    x, y, course = _route(reader, observation, station)
    across = _across(reader, observation, x, y, course, c)
    if not across.any():
        return np.full(v.shape, np.inf)
    there = across.any(axis=-1)
    free = np.maximum(np.broadcast_to(np.asarray(free_mps, dtype=np.float64), v.shape), 2.0)
    extra = np.broadcast_to(np.asarray(extra_m, dtype=np.float64), across.shape)
    if v.ndim == 0:
        return _cap(reader, observation, station, (x, y, course), across, free, extra, c)
    chosen = (
        {g: part[there] for g, part in observation.items()} if isinstance(observation, Mapping) else observation[there]
    )
    out = np.full(v.shape, np.inf)
    route = x[there], y[there], course[there]
    out[there] = _cap(reader, chosen, station, route, across[there], free[there], extra[there], c)
    return out


def crosses(reader: Reader, observation: Observation, c: YieldConfig) -> Bools:
    """Whether some vehicle in view may cross the route, (...)."""
    if not reader.config.vehicles or not reader.previews_m:
        return np.zeros(reader.value(observation, "ego.speed").shape, dtype=np.bool_)
    route = _route(reader, observation, _stations(reader, c))
    return np.asarray(_across(reader, observation, *route, c).any(axis=-1))


def _stations(reader: Reader, c: YieldConfig) -> Array:
    return np.arange(0.0, min(c.reach_m, reader.previews_m[-1]) + 1e-6, STATION_STEP_M)


def _cap(
    reader: Reader,
    observation: Observation,
    station: Array,
    route: tuple[Array, Array, Array],
    across: Bools,
    top: Array,
    extra: Array,
    c: YieldConfig,
) -> Array:
    """The speed where some vehicle may cross."""
    v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
    covered, straight = _covered(reader, observation, route, across, extra, v, c)
    when = _times(c)
    junction = reader.value(observation, "road.junction")
    inside = _inside(station, route[2], junction)
    gap = np.where(inside, c.inside_s, c.gap_s)
    met = _met(covered, when, station, v, top, gap, c)
    looks = np.sqrt(c.enter_mps**2 + 2.0 * c.brake_mps2 * np.maximum(junction, 0.0))
    approaches = (v > c.creep_mps) & (junction > 0.0) & ~inside
    look = np.where(covered.any(axis=(-2, -1)) & approaches, looks, np.inf)
    return np.minimum(_decision(station, when, met, straight, v, junction, c), look)


def _decision(
    station: Array, when: Array, met: Bools, straight: Bools, v: Array, junction_m: Array, c: YieldConfig
) -> Array:
    """Speed by where and when the ego meets a vehicle if it goes, and by where it would stand otherwise.

    It stops before the first conflict, and before the crossing if that is still ahead. It goes where it would be met
    sooner standing, where it then comes to stand, than going.
    """
    conflict = met.any(axis=-2)
    room = np.where(conflict, station, np.inf).min(axis=-1) - c.length_m
    place = np.where(room + c.length_m >= junction_m, np.minimum(room, junction_m - c.line_m), room)
    possible = (room >= 0.5 * v**2 / c.hard_mps2) | (v <= c.creep_mps)
    reached = np.maximum(place, 0.5 * v**2 / c.hard_mps2)
    stand = np.abs(station - reached[..., None]) < c.length_m
    soon = [
        np.where(blocks.any(axis=-1), when, np.inf).min(axis=-1) for blocks in (met, straight & stand[..., None, :])
    ]
    stops = conflict.any(axis=-1) & ((soon[1] > soon[0]) | (possible & (place >= c.length_m)))
    delay = c.brake_mps2 * c.response_s
    speed = np.sqrt(delay**2 + 2.0 * c.brake_mps2 * np.maximum(place, 0.0)) - delay
    return np.asarray(np.where(stops, speed, np.inf))


def _times(c: YieldConfig) -> Array:
    return np.arange(0.0, c.horizon_s + 1e-6, TIME_STEP_S)


def _inside(station: Array, course: Array, junction_m: Array) -> Bools:
    """Whether the route turns before this section of the road ends: the ego is inside the crossing."""
    turned = np.abs(course - course[..., :1]) > INSIDE_RAD
    return np.asarray((turned & (station < junction_m[..., None] - STATION_STEP_M)).any(axis=-1))


def _met(covered: Bools, when: Array, station: Array, v: Array, top: Array, gap_s: Array, c: YieldConfig) -> Bools:
    """Times and stations (..., T, D) that a vehicle covers while the ego is there, or within the time gap."""
    first = _arrival_s(station - c.length_m, v, top, c.brisk_mps2, 0.0)
    clear = _arrival_s(station + c.length_m, v, top, c.accelerate_mps2, c.response_s)
    t = when[:, None]
    gap = gap_s[..., None, None]
    return np.asarray(covered & (t + gap >= first[..., None, :]) & (t <= clear[..., None, :] + gap))


def _covered(
    reader: Reader,
    observation: Observation,
    route: tuple[Array, Array, Array],
    across: Bools,
    extra: Array,
    v: Array,
    c: YieldConfig,
) -> tuple[Bools, Bools]:
    """Which stations some vehicle that crosses covers at which time, on any course and straight on, (..., T, D)."""
    courses = _courses(reader, observation, route[2][..., -1], v, c)
    x, y = (axis[..., None, None, None, :] for axis in route[:2])
    square = (courses.x[..., None] - x) ** 2 + (courses.y[..., None] - y) ** 2  # (..., K, T, C, D)
    width = c.width_m + np.broadcast_to(extra, across.shape)
    near = (square <= (width**2)[..., None, None, None]) & across[..., None, None, None]
    turned = courses.direction[..., None] - route[2][..., None, None, None, :]
    joined = (np.abs(np.sin(turned)) <= c.join_sin) & (np.cos(turned) > 0.0)
    already = np.asarray(near & joined)[..., :1, :, :].any(axis=(-2, -1), keepdims=True)
    near &= ~(joined & already)  # one that has joined the route follows the ego, or leads
    ahead = near[..., : len(CIRCLES), :]
    return np.asarray(near.any(axis=(-4, -2))), np.asarray(ahead.any(axis=(-4, -2)))


def _courses(reader: Reader, observation: Observation, exit_rad: Array, v: Array, c: YieldConfig) -> _Courses:
    """Straight on or, in a turn, on along it to the left and right, at the speed of now.

    A vehicle turns where its heading is between the directions of the crossing, taken to be at right angles. The turn
    ends at the next of these.
    """
    x0, y0 = reader.rows(observation, "ahead"), reader.rows(observation, "right")
    vx = reader.rows(observation, "velocity_ahead") + v[..., None]
    speed = np.hypot(vx, reader.rows(observation, "velocity_right"))
    way = speed[..., None] * _times(c)  # (..., K, T)
    psi = np.arctan2(reader.rows(observation, "heading_sin"), reader.rows(observation, "heading_cos"))
    past = np.mod(psi - exit_rad[..., None], 0.5 * np.pi)
    turning = (past > c.turning_rad) & (past < 0.5 * np.pi - c.turning_rad)
    xs, ys, directions = [], [], []
    for radius, rest in ((np.inf, 0.0 * past), (c.turn_m[0], -past), (c.turn_m[1], 0.5 * np.pi - past)):
        turn = np.where(turning, rest, 0.0)[..., None]
        angle = np.sign(turn) * np.minimum(np.abs(turn), way / radius)
        arc = np.where(angle == 0.0, 0.0, np.abs(angle) * min(radius, 1e6))
        start, out = psi[..., None], way - arc
        chord = arc * np.sinc(0.5 * angle / np.pi)
        x = x0[..., None] + chord * np.cos(start + 0.5 * angle) + out * np.cos(start + angle)
        y = y0[..., None] + chord * np.sin(start + 0.5 * angle) + out * np.sin(start + angle)
        for share in CIRCLES:
            d = share * reader.rows(observation, "length")[..., None]
            xs.append(x + d * np.cos(start + angle))
            ys.append(y + d * np.sin(start + angle))
            directions.append(np.broadcast_to(start + angle, x.shape))
    return _Courses(*(np.stack(part, axis=-1) for part in (xs, ys, directions)))


def _route(reader: Reader, observation: Observation, station: Array) -> tuple[Array, Array, Array]:
    """Points (..., D) of the route ahead and to the right of the ego, and its direction.

    Between previews cubic Hermite curves have the directions of both.
    """
    knots = (0.0, *reader.previews_m)
    zero = np.zeros_like(reader.value(observation, "ego.speed"))
    columns = {
        name: np.stack([zero, *(reader.value(observation, f"road.preview_{d:g}m_{name}") for d in knots[1:])], axis=-1)
        for name in ("ahead", "right", "heading")
    }
    at = np.clip(np.searchsorted(knots, station, side="right") - 1, 0, len(knots) - 2)
    span = np.diff(knots)[at]
    u = (station - np.array(knots)[at]) / span
    weights = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2 * span, u**2 * (3 - 2 * u), u**2 * (u - 1) * span
    psi = columns["heading"]
    out = []
    for name, slope in (("ahead", np.cos(psi)), ("right", np.sin(psi))):
        p = columns[name]
        out.append(weights[0] * p[..., at] + weights[1] * slope[..., at] + weights[2] * p[..., at + 1]
                   + weights[3] * slope[..., at + 1])  # fmt: skip
    return out[0], out[1], (1 - u) * psi[..., at] + u * psi[..., at + 1]


def _across(reader: Reader, observation: Observation, x: Array, y: Array, course: Array, c: YieldConfig) -> Bools:
    """Which vehicles may cross or join the route: not along it at its point nearest to them, or far beside it.

    One that comes towards the ego along the road into which the route turns crosses the turn.  (..., K).
    """
    there = reader.rows(observation, "present") > 0.5
    dx = reader.rows(observation, "ahead")[..., None] - x[..., None, :]
    dy = reader.rows(observation, "right")[..., None] - y[..., None, :]
    nearest = np.argmin(dx**2 + dy**2, axis=-1)[..., None]
    along = np.take_along_axis(np.broadcast_to(course[..., None, :], dx.shape), nearest, -1)[..., 0]
    dx, dy = (np.take_along_axis(d, nearest, -1)[..., 0] for d in (dx, dy))
    sin, cos = reader.rows(observation, "heading_sin"), reader.rows(observation, "heading_cos")
    turned = np.abs(sin * np.cos(along) - cos * np.sin(along)) > c.angle_sin
    bends = np.any(np.abs(np.sin(course - course[..., :1])) > c.angle_sin, axis=-1, keepdims=True)
    turned |= bends & (sin * np.sin(along) + cos * np.cos(along) < 0.0)
    beside = np.abs(dy * np.cos(along) - dx * np.sin(along)) > c.beside_m
    return np.asarray(there & (turned | beside))


def _arrival_s(station: Array, v: Array, top: Array, a: float, response_s: float) -> Array:
    """When the ego reaches each station: ``v t + a t^2 / 2 = d`` up to a top speed, (..., D).

    The response counts in full from rest and not at the top speed.
    """
    v, top = v[..., None], top[..., None]
    d = np.maximum(station, 0.0)
    gain = np.maximum((top**2 - v**2) / (2.0 * a), 0.0)
    rising = (np.sqrt(v**2 + 2.0 * a * np.minimum(d, gain)) - v) / a
    late = response_s * np.clip(1.0 - v / top, 0.0, 1.0)
    return np.asarray(rising + np.maximum(d - gain, 0.0) / top + late)
