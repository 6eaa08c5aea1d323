"""Giving way to traffic that crosses the route: gap acceptance by times of arrival; leading axes are a batch.

Predictions assume that other vehicles drive straight on at their speed. A vehicle that comes within a car's width of
the route, and not along it, crosses it there.

Symbols: d station on the route [m], t time [s], v speed of the ego [m/s].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.integrity.core.config import Config, Field

__all__ = ["YieldConfig", "yield_speed"]

Array = NDArray[np.float64]
STATION_STEP_M, TIME_STEP_S = 2.0, 0.5


class YieldConfig(Config):
    """Figures of giving way."""

    horizon_s: float = Field(5.0, gt=0, description="prediction of other vehicles; critical gaps are 4-7 s, HCM 2010")
    reach_m: float = Field(50.0, gt=0, description="along the route; a comfortable stop from 50 km/h")
    width_m: float = Field(2.5, gt=0, description="distance between middles at which paths cross; a car and a margin")
    gap_s: float = Field(
        2.0,
        ge=0,
        description="between one vehicle leaving the point and the other arriving; 1 s had half as many crashes more",
    )
    length_m: float = Field(7.0, gt=0, description="distance before and behind the point; a car and a margin")
    angle_sin: float = Field(0.35, ge=0, le=1, description="sine of the angle from which a path crosses; 20 degrees")
    moving_mps: float = Field(1.0, ge=0, description="slower vehicles count as standing; chosen")
    accelerate_mps2: float = Field(1.5, gt=0, description="of the ego from rest; as the driver's")
    brake_mps2: float = Field(2.0, gt=0, description="of the ego giving way; comfortable")


def yield_speed(reader: Reader, observation: Observation, c: YieldConfig) -> Array:
    """Fastest speed from which the ego stops before crossing traffic; infinite without any.  (...)."""
    v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
    if not reader.config.vehicles or not reader.previews_m:
        return np.full(v.shape, np.inf)
    station = np.arange(0.0, min(c.reach_m, reader.previews_m[-1]) + 1e-6, STATION_STEP_M)
    x, y, course = _route(reader, observation, station)
    when = np.arange(0.0, c.horizon_s + 1e-6, TIME_STEP_S)
    there = _at(reader, observation, v, when)  # (..., K, T, 2)
    apart = np.hypot(there[..., None, 0] - x[..., None, None, :], there[..., None, 1] - y[..., None, None, :])
    crosses = (apart <= c.width_m) & _across(reader, observation, course, apart, c)[..., None, None]
    reach = _arrival_s(station, v, c), _arrival_s(station + c.length_m, v, c)
    first, clear = (t[..., None, None, :] for t in reach)
    t = when[:, None]
    waits = _speed(reader, observation, v)[..., None, None] <= c.moving_mps
    conflict = crosses & (waits | (t + c.gap_s >= first) & (t <= clear + c.gap_s))
    stop = station - c.length_m
    place = np.where(conflict & (stop >= 0.0), stop, np.inf).min(axis=(-3, -2, -1))
    return np.asarray(np.sqrt(2.0 * c.brake_mps2 * place))


def _route(reader: Reader, observation: Observation, station: Array) -> tuple[Array, Array, Array]:
    """Points (..., D) of the route ahead and to the right of the ego, between the previews, and its direction."""
    known = (0.0, *reader.previews_m)
    share = np.array([np.interp(station, known, row) for row in np.eye(len(known))])  # (P, D)
    zero = np.zeros_like(reader.value(observation, "ego.speed"))
    columns = {}
    for name in ("ahead", "right", "heading"):
        seen = [reader.value(observation, f"road.preview_{d:g}m_{name}") for d in reader.previews_m]
        columns[name] = np.stack([seen[0] if name == "heading" else zero, *seen], axis=-1) @ share
    return columns["ahead"], columns["right"], columns["heading"]


def _at(reader: Reader, observation: Observation, v: Array, when: Array) -> Array:
    """Predicted places of other vehicles, (..., K, T, 2) in the present axes of the ego."""
    ahead = reader.rows(observation, "velocity_ahead") + v[..., None]
    x = reader.rows(observation, "ahead")[..., None] + ahead[..., None] * when
    y = reader.rows(observation, "right")[..., None] + reader.rows(observation, "velocity_right")[..., None] * when
    return np.stack([x, y], axis=-1)


def _across(reader: Reader, observation: Observation, course: Array, apart: Array, c: YieldConfig) -> NDArray[np.bool_]:
    """Which vehicles head across the route at its point nearest to them now, (..., K)."""
    nearest = np.argmin(apart[..., 0, :], axis=-1)
    along = np.take_along_axis(np.broadcast_to(course[..., None, :], apart[..., 0, :].shape), nearest[..., None], -1)
    sin, cos = reader.rows(observation, "heading_sin"), reader.rows(observation, "heading_cos")
    turned = np.abs(sin * np.cos(along[..., 0]) - cos * np.sin(along[..., 0]))
    return (reader.rows(observation, "present") > 0.5) & (turned > c.angle_sin)


def _speed(reader: Reader, observation: Observation, v: Array) -> Array:
    """Speeds of the other vehicles, (..., K)."""
    ahead = reader.rows(observation, "velocity_ahead") + v[..., None]
    return np.asarray(np.hypot(ahead, reader.rows(observation, "velocity_right")))


def _arrival_s(station: Array, v: Array, c: YieldConfig) -> Array:
    """When the ego reaches each station at its acceleration: ``v t + a t^2 / 2 = d``.  (..., D)."""
    a, speed = c.accelerate_mps2, v[..., None]
    return (np.sqrt(speed**2 + 2.0 * a * station) - speed) / a
