"""Drives of many vehicles along one path: open sky, then a tunnel without satellites, with turns in either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

Array = NDArray[np.float64]
DT_S, MPS = 0.1, 12.0


@dataclass(frozen=True)
class Drive:
    """Epochs (T,) of B vehicles: time [s], abs(error) (T, B, 2) along and across the estimated heading [m], all levels
    (T, B, R, 2) [m], heading error (T, B) [rad], mode (T, B)."""

    time_s: Array
    error_m: Array
    levels_m: Array
    heading_error_rad: Array
    mode: NDArray[np.int64]

    def exceeding(self, case: int, time_s: float) -> int:
        """Vehicles beyond a level on either axis at one time."""
        k = int(np.argmin(np.abs(self.time_s - time_s)))
        return int((self.error_m[k] > self.levels_m[k, :, case]).any(-1).sum())


def drive(
    config: NavigatorConfig, rate_radps: Array, open_s: float, vehicles: int, axle_m: float = 0.0, from_s: float = 0.0,
    faults: FaultSchedule | None = None, seed: int = 0, speed_mps: Array | None = None, heading_rad: float = 0.0,
) -> Drive:  # fmt: skip
    """Drive at 12 m/s with this yaw rate of every epoch (T,), the first ``open_s`` seconds under the open sky.

    The reference point is ``axle_m`` ahead of the rear axle, which moves along the heading. Epochs from ``from_s`` on.
    ``speed_mps`` (T,) is the speed in every epoch instead, ``heading_rad`` the heading at the beginning.
    """
    speeds = np.full(len(rate_radps), MPS) if speed_mps is None else speed_mps
    arcs = np.cumsum(speeds) * DT_S
    cell_m, length_m = 10.0, arcs[-1] + 100.0
    path = np.zeros((int(length_m / cell_m) + 1, 1, 1), dtype=np.uint8)
    if round(open_s / DT_S) <= len(arcs):
        path[int((arcs[round(open_s / DT_S) - 1] + 1e-9) / cell_m) :] = SignalPath.BLOCKED
    mask = SkyMask(path, np.zeros(path.shape, dtype=np.float32), 1, 1, cell_m, length_m, False)
    track = SkyTrack.from_config(config.sky, DT_S * len(rate_radps) + 1.0)
    navigator = Navigator(config, track, mask, list(range(seed, seed + vehicles)), faults=faults)
    rear, heading, out = np.zeros(2), heading_rad, []
    before = _pose(rear, heading, rate_radps[0], axle_m, vehicles, speeds[0])
    for k, (rate, speed) in enumerate(zip(rate_radps, speeds, strict=True)):
        turn = rate * DT_S
        rear = rear + speed * DT_S * np.sinc(turn / (2.0 * np.pi)) * _forward(heading + 0.5 * turn)
        heading += turn
        after = _pose(rear, heading, rate, axle_m, vehicles, speed)
        time_s, arc = (k + 1) * DT_S, np.full(vehicles, arcs[k])
        poses, velocities, headings = zip(before, after, strict=True)
        solution = navigator.step(truth_between(time_s, DT_S, poses, velocities, headings, arc_m=arc))
        if time_s > from_s:
            east, north = (solution.position_en_m - after[0]).T
            sine, cosine = np.sin(solution.heading_rad), np.cos(solution.heading_rad)
            error = np.stack([east * sine + north * cosine, east * cosine - north * sine], -1)
            off = np.angle(np.exp(1j * (solution.heading_rad - heading)))
            out.append((time_s, np.abs(error), solution.pl_cases_m, off, solution.mode))
        before = after
    return Drive(*(np.array(column) for column in zip(*out, strict=True)))


def _forward(heading: float) -> Array:
    return np.array([np.sin(heading), np.cos(heading)])


def _pose(
    rear: Array, heading: float, rate: float, axle_m: float, vehicles: int, speed: float
) -> tuple[Array, Array, Array]:
    """Position, velocity (B, 2) and heading (B,) of the reference point."""
    along, right = _forward(heading), np.array([np.cos(heading), -np.sin(heading)])
    position, velocity = rear + axle_m * along, speed * along + axle_m * rate * right
    return np.tile(position, (vehicles, 1)), np.tile(velocity, (vehicles, 1)), np.full(vehicles, heading)


def yaw_rates(*pieces: tuple[float, float]) -> Array:
    """Yaw rate of every epoch from pieces (rate [rad/s], length [s])."""
    return np.concatenate([np.full(round(length / DT_S), rate) for rate, length in pieces])


def turning(rate_radps: float, angle_rad: float) -> tuple[float, float]:
    """A piece that turns by an angle, positive to the right."""
    return np.copysign(rate_radps, angle_rad), abs(angle_rad) / rate_radps


def allowed(vehicles: int, risk: float, false_alarm: float = 1e-3, times: int = 1) -> int:
    """Most vehicles beyond a level that holds at ``risk``: exceeded by chance with ``false_alarm`` over all times."""
    return int(binom.isf(false_alarm / times, vehicles, risk))


def with_risk(config: NavigatorConfig, risk: float) -> NavigatorConfig:
    """The configuration with a further level at this risk, case 1."""
    return config.replace(more_levels=[{"integrity_risk": risk}])


def pieces(*parts: tuple[float, float] | Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Pieces and lists of pieces in one list."""
    out: list[tuple[float, float]] = []
    for part in parts:
        out += [part] if isinstance(part, tuple) else list(part)
    return out
