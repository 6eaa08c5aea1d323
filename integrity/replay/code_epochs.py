"""Recorded code-only drives as epochs of the monitor family, with the truth apart from what monitors see.

The displacements are those of wheel speed and yaw rate, turned by the heading that fits the code positions of the last
minute best. No truth enters the epochs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.positioning.code_solution import gauss_newton
from lanebound.integrity.recorded.smartloc import Odometry, SmartLoc
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay.reckoning import reckon
from lanebound.integrity.replay.sensor_checks import require_same_times
from lanebound.integrity.replay.window import LocalFrame
from lanebound.integrity.sky.orbit import ranges_and_sights

Array = NDArray[np.float64]


Bools = NDArray[np.bool_]

LEAST_DBHZ = 20.0  # as the code-only replay
FAR_M = np.array([0.0, 0.0, 2.6e7])  # a satellite in the place of none
WINDOW_S = 60.0  # code positions that the heading of displacements is fitted to
PATH_ERROR = 0.02  # of the reckoned path over its length, 1 sigma; as the code-only replay
LASTING_S = 10.0  # correlation time of code positions in the deviation of the heading
LARGEST_TURN_RAD = 2.0  # deviation of a heading that is not known


@dataclass(frozen=True)
class TrackedEpochs:
    """Epochs, and what only an assessment knows: true positions (E, 3) in their frame [m], and where known (E,);
    origin (3,) of the frame ECEF [m], where it is known."""

    epochs: CodeEpochs
    truth_enu_m: Array
    known: Bools
    origin_ecef_m: Array | None = None


def recorded_epochs(drive: SmartLoc, cn0_min_dbhz: float = LEAST_DBHZ) -> TrackedEpochs:
    """The epochs of a smartLoc drive; deviations are those that the receiver states.

    Raises
    ------
    InputError
        No epoch determines a position, or positions are those of other times of the truth.
    """
    r = drive.ranges
    time, epoch = np.unique(r.time_s, return_inverse=True)
    letters, system_of = np.unique(r.system, return_inverse=True)
    names, column = np.unique(system_of * 100_000 + r.satellite, return_inverse=True)
    good = (r.cn0_dbhz >= cn0_min_dbhz) & (r.variance_m2 > 0.0)
    if letters.size > 8:
        raise InputError(f"drive must have at most 8 systems, got {letters.size}: remove some")
    shape = time.size, names.size

    def table(value: Array, empty: float = 0.0) -> Array:
        out = np.full((*shape, *value.shape[1:]), empty)
        out[epoch[good], column[good]] = value[good]
        return out

    used = table(np.ones(r.time_s.size)) > 0.0
    place, range_m = table(r.satellite_ecef_m), table(r.range_m)
    frame = _frame(place, range_m, used, (names // 100_000).astype(np.int64))
    plain = CodeEpochs(
        time_s=time, y_m=np.zeros(shape), los_enu=np.zeros((*shape, 3)), sigma_m=np.sqrt(table(r.variance_m2, 1.0)),
        used=used, system=(names // 100_000).astype(np.int64), cn0_dbhz=table(r.cn0_dbhz),
        elevation_rad=table(r.elevation_rad), drive=np.zeros(time.size, np.int64),
    )  # fmt: skip
    epochs = _settled(plain, place, range_m, frame)
    fixes = solve_codes(epochs).x_m
    if drive.truth is not None:
        there = frame.local(drive.truth.position_ecef_m)[:, :2]  # heights from codes are off by the delays in the air
        require_same_times("pseudorange3", time, fixes[:, :2], drive.truth.time_s, there)
    step, sigma = reckoned_steps(drive.odometry, time, fixes[:, :2])
    truth, known = np.zeros((time.size, 3)), np.zeros(time.size, bool)
    if drive.truth is not None:
        ecef, known = drive.truth.at(time)
        known &= ~drive.bridged(time, WINDOW_S)  # the heading would be that of a path that was not measured
        truth = frame.local(ecef)
    return TrackedEpochs(
        CodeEpochs(**{**vars(epochs), "step_enu_m": step, "step_sigma_m": sigma}).checked(),
        truth,
        known,
        frame.origin_ecef_m,
    )


def _frame(place: Array, range_m: Array, used: Bools, system: NDArray[np.int64]) -> LocalFrame:
    """Local frame at the fix of the first epoch that has one; the iteration starts at the Earth's centre."""
    for k in range(len(used)):
        own = used[k : k + 1]
        x, fit = gauss_newton(partial(_about, place[k : k + 1], range_m[k : k + 1]), np.zeros((1, 3)), 1.0, own, system)
        if fit.df[0] < 1 or not fit.solved[0]:
            continue
        if abs(float(geodetic_from_ecef(x[0])[2])) < 1e4:
            return LocalFrame.at(x[0])
    raise InputError("drive must have an epoch with more codes than unknowns, has none: lower cn0_min_dbhz")


def _about(place: Array, range_m: Array, at_ecef_m: Array) -> tuple[Array, Array]:
    """Observed minus computed ranges (E, m) at positions (E, 3), and unit vectors; far up where there is no code."""
    far = np.where((range_m != 0.0)[..., None], place, FAR_M)
    distance, sight = ranges_and_sights(far, at_ecef_m[:, None, :])
    return range_m - distance, sight


def _settled(plain: CodeEpochs, place: Array, range_m: Array, frame: LocalFrame) -> CodeEpochs:
    """The epochs linearised at their own least-squares positions."""

    def about(at_enu_m: Array) -> tuple[Array, Array]:
        there = _linearised(plain, place, range_m, frame, at_enu_m)
        return there.y_m + (there.los_enu @ at_enu_m[..., None])[..., 0], there.los_enu

    start = np.zeros((plain.count, 3))
    at, _ = gauss_newton(about, start, np.square(plain.sigma_m), plain.used, plain.system)
    return _linearised(plain, place, range_m, frame, at)


def _linearised(plain: CodeEpochs, place: Array, range_m: Array, frame: LocalFrame, at_enu_m: Array) -> CodeEpochs:
    """Observed minus computed at the positions ``at_enu_m`` (E, 3), as values of the whole frame."""
    receiver = frame.origin_ecef_m + at_enu_m @ frame.axes.T
    far = np.where(plain.used[..., None], place, FAR_M)
    distance, sight = ranges_and_sights(far, receiver[:, None, :])
    los = sight @ frame.axes
    y = range_m - distance - (los @ at_enu_m[..., None])[..., 0]
    los = np.where(plain.used[..., None], los, np.array([0.0, 0.0, 1.0]))
    return CodeEpochs(**{**vars(plain), "y_m": np.where(plain.used, y, 0.0), "los_enu": los})


def reckoned_steps(odometry: Odometry, time_s: Array, fix_en_m: Array) -> tuple[Array, Array]:
    """Displacements (T, 3) between epochs and their deviations (T,), by wheels, gyro, and the heading of past fixes."""
    path = reckon(odometry.time_s, odometry.speed_mps, -odometry.yaw_rate_left_radps)
    at = interpolated(time_s, path.time_s, path.position_m)
    length = np.diff(np.interp(time_s, path.time_s, path.distance_m), prepend=0.0)
    turn, spread = path_headings(time_s, at, fix_en_m)
    own = np.diff(at, axis=0, prepend=at[:1])
    c, s = np.cos(turn), np.sin(turn)
    step = np.stack([c * own[:, 0] + s * own[:, 1], c * own[:, 1] - s * own[:, 0], np.zeros(time_s.size)], -1)
    sigma = np.abs(length) * np.hypot(PATH_ERROR, np.minimum(spread, LARGEST_TURN_RAD))
    sigma[0] = np.inf
    return step, sigma


def path_headings(time_s: Array, path: Array, fix: Array) -> tuple[Array, Array]:
    """Angle by which the path is turned clockwise to fit the fixes of the last ``WINDOW_S``, and its deviation."""
    count = time_s.size
    turn, spread = np.zeros(count), np.full(count, np.inf)
    first = np.searchsorted(time_s, time_s - WINDOW_S)
    for k in range(1, count):
        own = slice(int(first[k]), k)  # the epoch itself stays out, so that its error is not in its own step
        turn[k], spread[k] = fit_heading(time_s[own], path[own], fix[own])
    return turn, spread


def fit_heading(time_s: Array, path_m: Array, fix_en_m: Array) -> tuple[float, float]:
    """Angle by which a path (n, 2) is turned clockwise to fit positions (n, 2), and its deviation [rad], inf without
    motion."""
    p, x = path_m - path_m.mean(0), fix_en_m - np.median(fix_en_m, 0)
    along, across = float((x * p).sum()), float((x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]).sum())
    size = float(np.square(p).sum())
    if size <= 0.0:
        return 0.0, float("inf")
    turn = float(np.arctan2(across, along))
    c, s = np.cos(turn), np.sin(turn)
    off = x - np.stack([c * p[:, 0] + s * p[:, 1], c * p[:, 1] - s * p[:, 0]], -1)
    alike = max(1.0, LASTING_S / max(float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0, 1e-3))
    return turn, float(np.sqrt(float(np.square(off).sum()) / max(len(p), 1) * alike / size))
