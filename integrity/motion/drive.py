"""Scripted drives: true motion of vehicles on a road with speed limits, curves and traffic lights.

They are inputs for the navigation without a driving environment. The motion is longitudinal only: each vehicle stays in
the middle of its lane, accelerates and brakes within comfortable limits, and stops at red lights. Its heading is that
of the lane, or that of a body whose rear axle follows.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sky.road import Road

__all__ = ["CityDrive", "DriveConfig", "DriveState", "curve_limits"]

Array = NDArray[np.float64]
SUBSTEPS = 8  # of an epoch, for the heading of a body


class DriveConfig(Config):
    """Parameters of scripted drives."""

    speed_limit_mps: float = Field(13.9, gt=0, description="speed limit [m/s]; 50 km/h, Tokyo city streets")
    acceleration_mps2: float = Field(
        1.5, gt=0, description="comfortable acceleration [m/s^2]; ISO 15622 allows up to 2"
    )
    braking_mps2: float = Field(2.0, gt=0, description="comfortable braking [m/s^2]; ISO 15622 allows up to 3.5")
    lateral_mps2: float = Field(2.0, gt=0, description="lateral acceleration that limits the speed in curves [m/s^2]")
    light_spacing_m: float = Field(250.0, gt=20, description="distance between traffic lights [m]; city blocks")
    red_share: float = Field(0.45, ge=0, le=1, description="share of traffic lights that are red [-]")
    red_min_s: float = Field(5.0, ge=0, description="shortest wait at a red light [s]")
    red_max_s: float = Field(50.0, ge=0, description="longest wait at a red light [s]")
    lane: int = Field(0, ge=0, description="lane of the vehicles, 0 is the rightmost")


@dataclass
class DriveState:
    """State of B vehicles along the road, arrays (B,); ``position_m`` is (B, 2)."""

    time_s: float
    arc_m: Array
    speed_mps: Array
    light: NDArray[np.int64]
    red: NDArray[np.bool_]
    wait_s: Array
    position_m: Array
    heading_rad: Array
    course_rad: Array

    def copy(self) -> DriveState:
        """An independent copy."""
        return copy.deepcopy(self)


def curve_limits(road: Road, legal_mps: Array, config: DriveConfig, lane_at_m: Array | None = None) -> Array:
    """Speeds at the M vertices of a road: the legal ones (M,) or those of curves, ahead too with comfortable braking.

    lane_at_m : (M,) length along the lane; None for the line of the road
    """
    step, limit = np.diff(road.arc_at_m), np.array(legal_mps, dtype=np.float64)
    bend = np.maximum(np.abs(np.diff(road.tangent_rad)), 1e-9)
    along = step if lane_at_m is None else np.diff(lane_at_m)
    in_curve = np.maximum(np.sqrt(config.lateral_mps2 * along / bend), 3.0)
    limit[:-1] = np.minimum(limit[:-1], in_curve)
    limit[1:] = np.minimum(limit[1:], in_curve)
    for _ in range(2):  # twice, so that on a closed road the limits at the start act on the end
        if road.closed:
            limit[-1] = min(limit[-1], limit[0])
        for i in range(step.size - 1, -1, -1):
            limit[i] = min(limit[i], np.sqrt(limit[i + 1] ** 2 + 2.0 * config.braking_mps2 * step[i]))
    return limit


class CityDrive:
    """A batch of vehicles on ``road``.

    Parameters
    ----------
    road : Road
        On a closed road the vehicles drive lap after lap, on an open one they stop at its end.
    config : DriveConfig
    dt_s : float
        Length of a navigation epoch.
    axle_m : float
        The point that follows the lane lies so far ahead of the rear axle, which does not slip sideways. In bends the
        course then differs from the heading h by the slip: ``h' = v sin(course - h) / axle_m``. 0: heading and course
        are one.

    Raises
    ------
    InputError
        ``dt_s`` is not positive, ``axle_m`` is negative, or the lane lies beyond the centre of a curve.
    """

    def __init__(self, road: Road, config: DriveConfig, dt_s: float = 0.1, axle_m: float = 0.0) -> None:
        if not float(require_finite("dt_s", dt_s)) > 0.0:
            raise InputError(f"dt_s must be positive, got {dt_s}: pass the length of an epoch in seconds")
        require_in_range("axle_m", axle_m, 0.0, 20.0)
        self.road, self.config, self.dt_s, self.axle_m = road, config, dt_s, axle_m
        tangent = road.tangent_rad - road.tangent_rad[0]
        lateral = float(road.lane_lateral_m(config.lane))
        self._lane_at_m = road.arc_at_m - lateral * tangent  # exact, because the tangent is linear between vertices
        if not (np.diff(self._lane_at_m) > 0.0).all():
            raise InputError(
                f"road must bend less than lane {config.lane}, got a radius below {lateral} m: widen its curves"
            )
        self._limit_mps = self._curve_limits()

    def _curve_limits(self) -> Array:
        """Speed limit at each vertex: the legal limit or the limit of the curves ahead with comfortable braking."""
        legal = np.full(self.road.arc_at_m.size, self.config.speed_limit_mps)
        return curve_limits(self.road, legal, self.config, self._lane_at_m)

    def _along_lane(self, arc_m: Array) -> Array:
        """Length of the lane from the start of the road: ``s - lateral (heading(s) - heading(0))``."""
        lap = np.floor(arc_m / self.road.length_m) if self.road.closed else np.zeros_like(arc_m)
        within = self.road.wrap_arc(arc_m) if self.road.closed else np.minimum(arc_m, self.road.length_m)
        lane = np.interp(within, self.road.arc_at_m, self._lane_at_m)
        return np.asarray(lane + lap * self._lane_at_m[-1] + (arc_m - within - lap * self.road.length_m))

    def _advance_arc(self, arc_m: Array, distance_m: Array) -> Array:
        """The arc after ``distance_m`` along the lane; exactly the same arc for a vehicle at rest."""
        lane = self._along_lane(arc_m) + distance_m
        lap = np.floor(lane / self._lane_at_m[-1]) if self.road.closed else np.zeros_like(lane)
        arc = lap * self.road.length_m
        arc += np.interp(lane - lap * self._lane_at_m[-1], self._lane_at_m, self.road.arc_at_m)
        return np.asarray(np.where(distance_m > 0.0, arc, arc_m))

    def start(self, streams: Streams, spread_m: float = 0.0) -> DriveState:
        """Create vehicles at rest, uniformly distributed over the first ``spread_m`` of the road.

        Raises
        ------
        InputError
            ``streams`` is not of class :class:`Streams`, or ``spread_m`` is negative or beyond the end of an open road.
        """
        _require_streams(streams)
        require_in_range("spread_m", spread_m, 0.0, np.inf if self.road.closed else self.road.length_m)
        u = streams.uniform("traffic", 2)
        arc = u[:, 0] * spread_m
        position, heading = self._pose(arc)
        return DriveState(
            time_s=0.0,
            arc_m=arc,
            speed_mps=np.zeros(streams.batch),
            light=np.floor(arc / self.config.light_spacing_m).astype(np.int64) + 1,
            red=u[:, 1] < self.config.red_share,
            wait_s=np.zeros(streams.batch),
            position_m=position,
            heading_rad=heading,
            course_rad=heading,
        )

    def _pose(self, arc_m: Array) -> tuple[Array, Array]:
        lane = np.full(arc_m.shape, self.config.lane)
        return self.road.pose_at(arc_m, self.road.lane_lateral_m(lane))

    def step(self, state: DriveState, streams: Streams) -> Truth:
        """Advance ``state`` in place by one epoch and return its truth.

        Raises
        ------
        InputError
            ``streams`` and ``state`` have different numbers of vehicles.
        """
        _require_streams(streams, state.arc_m.size)
        c, dt = self.config, self.dt_s
        u = streams.uniform("traffic", 2)
        to_light = state.light * c.light_spacing_m - state.arc_m
        allowed = self._allowed_speed(state, to_light)
        speed = np.clip(
            allowed, state.speed_mps - 2.0 * c.braking_mps2 * dt, state.speed_mps + c.acceleration_mps2 * dt
        )
        speed = np.where(speed < 0.05, np.where(allowed < 0.05, 0.0, speed), speed)
        arc = self._advance_arc(state.arc_m, 0.5 * (speed + state.speed_mps) * dt)
        self._lights(state, to_light, speed, u)
        position, course = self._pose(arc)
        heading = self._body_heading(state, course, 0.5 * (speed + state.speed_mps) * dt)
        v0 = state.speed_mps[:, None] * np.column_stack([np.sin(state.course_rad), np.cos(state.course_rad)])
        v1 = speed[:, None] * np.column_stack([np.sin(course), np.cos(course)])
        truth = truth_between(
            state.time_s + dt,
            dt,
            (state.position_m, position),
            (v0, v1),
            (state.heading_rad, heading),
            arc_m=arc,
            lane=c.lane,
        )
        state.time_s += dt
        state.arc_m, state.speed_mps, state.position_m, state.heading_rad = arc, speed, position, heading
        state.course_rad = course
        return truth

    def _body_heading(self, state: DriveState, course: Array, distance_m: Array) -> Array:
        """Heading at the end of an epoch, by the midpoint rule; the course changes evenly along it."""
        if self.axle_m == 0.0:
            return course
        heading, turned = state.heading_rad, wrap_angle(course - state.course_rad)
        step = distance_m / (SUBSTEPS * self.axle_m)
        for k in range(SUBSTEPS):
            middle = heading + 0.5 * step * np.sin(state.course_rad + k / SUBSTEPS * turned - heading)
            heading = heading + step * np.sin(state.course_rad + (k + 0.5) / SUBSTEPS * turned - middle)
        return np.asarray(wrap_angle(heading))

    def _allowed_speed(self, state: DriveState, to_light: Array) -> Array:
        """Largest speed that allows a comfortable stop at a red light or at the end of an open road."""
        gap = np.where(state.red, to_light - 1.0, np.inf)
        if not self.road.closed:
            gap = np.minimum(gap, self.road.length_m - 1.0 - state.arc_m)
        stopping = np.sqrt(2.0 * self.config.braking_mps2 * np.maximum(gap, 0.0))
        limit = np.interp(self.road.wrap_arc(state.arc_m), self.road.arc_at_m, self._limit_mps)
        return np.minimum(limit, np.where(gap < 0.3, 0.0, stopping))

    def _lights(self, state: DriveState, to_light: Array, speed: Array, u: Array) -> None:
        """Count down the wait at a red light; after a light is passed, draw the colour of the next one."""
        c = self.config
        waiting = state.red & (speed == 0.0) & (to_light < 3.0)
        begins = waiting & (state.wait_s <= 0.0)
        state.wait_s = np.where(begins, c.red_min_s + (c.red_max_s - c.red_min_s) * u[:, 0], state.wait_s)
        state.wait_s = np.where(waiting, state.wait_s - self.dt_s, state.wait_s)
        state.red &= ~(waiting & (state.wait_s <= 0.0))
        passed = to_light <= 0.0
        state.light = state.light + passed
        state.red = np.where(passed, u[:, 1] < c.red_share, state.red)


def _require_streams(streams: Streams, batch: int | None = None) -> None:
    """Raise InputError unless ``streams`` are random streams, and for ``batch`` vehicles if it is not None."""
    if not isinstance(streams, Streams):
        raise InputError(f"streams must be of class Streams, got {type(streams).__name__}: pass Streams(seeds)")
    if batch not in (None, streams.batch):
        raise InputError(
            f"streams must be for the {batch} vehicles of state, got streams for {streams.batch}: "
            "pass the streams of start()"
        )
