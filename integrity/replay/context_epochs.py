"""Recorded drives as the context monitor takes them, once in an interval; what a recording lacks is skipped, and named.

smartLoc: codes and wheels; no range rates, so that the speed phase is skipped, and the direction is that of wheels and
gyro, turned to fit the code positions of the last minute. RINEX: codes, and range rates by Doppler or by carriers; no
wheels. comma2k19: positions and Doppler speeds of the receiver, and wheels; no geometry, so that the position phase is
skipped. The truth is apart, for an assessment.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, VehicleFix, code_position
from lanebound.integrity.monitoring.context.monitor import ContextConfig
from lanebound.integrity.monitoring.context.position_phase import PositionTest, check_position
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig
from lanebound.integrity.recorded.comma import Comma, read_comma
from lanebound.integrity.recorded.smartloc import Odometry
from lanebound.integrity.replay.code_epochs import reckoned_steps
from lanebound.integrity.replay.doppler_rates import carrier_rates
from lanebound.integrity.replay.recording_checks import aligned_comma
from lanebound.integrity.replay.service_drive import read_service_epochs
from lanebound.integrity.replay.service_epochs import ServiceEpochs
from lanebound.integrity.replay.window import LocalFrame
from lanebound.integrity.sky.systems import System

__all__ = ["ContextEpochs", "ContextReplayConfig", "read_context_epochs"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

KNOWN_RAD = np.deg2rad(10.0)  # deviation of a direction by wheels and gyro that counts as known
FRESH_S = 0.15  # age of a receiver's position that counts for an epoch
NO_DOPPLER = "the recording has no range rates; differences of positions are no Doppler speed"
NO_GEOMETRY = "positions of the receiver come without their geometry, so that there is no level and no test"
NO_WHEELS = "the recording has no wheels: MASE is compared with the printed standard error, which only asks for N >= 9"
BY_WHEELS = "the map phase compares with the speed by wheels; the direction is that of wheels and gyro"
MEAN_RATES = "range rates are changes of carriers between epochs, which are means over that time"


class ContextReplayConfig(ContextConfig):
    """The context monitor on a recorded drive."""

    interval_s: float = Field(1.0, gt=0, le=60, description="time between two verdicts [s]; S5: 1 Hz")
    within_m: float = Field(500.0, gt=0, description="roads of the file farther from the drive are left out [m]")
    map_errors: MapErrorsConfig = Field(MapErrorsConfig(), description="errors put into the map; default: none")
    map_seed: int = Field(1, ge=0, description="of the draws of these errors [-]")
    node_m: float = Field(10.0, ge=0, description="distance from a node within which both links count as right [m]")
    receiver_m: float = Field(
        2.1, gt=0, description="comma2k19: positions of the receiver, 1 sigma [m]; 2.5 m CEP, u-blox M8"
    )
    receiver_mps: float = Field(0.3, gt=0, description="comma2k19: its Doppler speed, 1 sigma [m/s]; chosen")


@dataclass(frozen=True)
class ContextEpochs:
    """E epochs of one vehicle in a local frame.

    Attributes
    ----------
    time_s : (E,) from the first epoch of the recording on
    fix, position : of E rows; result of the first phase, which passes where it is skipped
    wheel_mps : (E,) mean over the interval before; by Doppler where there are no wheels
    has_wheels : there are wheels
    distance_m : (E,) by wheels, where the speed phase is skipped; None where it is not
    skipped : phases that the recording does not allow, with the reason
    notes : what else differs from S5
    truth_en_m, known : (E, 2), (E,); only an assessment reads them
    """

    frame: LocalFrame
    time_s: Array
    fix: VehicleFix
    position: PositionTest
    wheel_mps: Array
    has_wheels: bool
    distance_m: Array | None
    skipped: dict[str, str]
    notes: tuple[str, ...]
    truth_en_m: Array
    known: Bools


def read_context_epochs(folder: Path, kind: str, config: ContextReplayConfig) -> tuple[ContextEpochs, dict[str, str]]:
    """The epochs of a recording, and which of its files end early.

    Raises
    ------
    InputError
        The recording cannot be read, or has no positions.
    """
    if kind == "comma2k19":
        segment, _ = aligned_comma(read_comma(folder))
        return _of_receiver(segment, config), segment.notes
    epochs, _, stopped = read_service_epochs(folder, kind, ["spp"])
    return _of_codes(epochs, config), stopped or {}


def picked(time_s: Array, interval_s: float) -> Ints:
    """Epochs of a recording (E,) nearest to every interval from the first on, at most a quarter of it away."""
    wanted = np.arange(time_s[0], time_s[-1] + 0.25 * interval_s, interval_s)
    after = np.clip(np.searchsorted(time_s, wanted), 1, max(time_s.size - 1, 1))
    near = np.where(wanted - time_s[after - 1] <= time_s[after] - wanted, after - 1, after)
    return np.unique(near[np.abs(time_s[near] - wanted) <= 0.25 * interval_s])


def _of_codes(e: ServiceEpochs, config: ContextReplayConfig) -> ContextEpochs:
    """A recording with codes."""
    if e.origin_ecef_m is None:
        raise InputError("origin_ecef_m must be known to place a map, is None: give the origin of the epochs' frame")
    latitude, longitude, _ = geodetic_from_ecef(e.origin_ecef_m)
    frame = LocalFrame(e.origin_ecef_m, ecef_from_enu_matrix(latitude, longitude))
    used, codes, hdop = _solved(e, config.codes)
    if e.time_s.size < 2:
        raise InputError(f"the recording must have two epochs, has {e.time_s.size}: give a whole one")
    at = picked(e.time_s, config.interval_s)
    found, time = codes.take(at), e.time_s[at]
    position = check_position(found, config.position, None if hdop is None else hdop[at])
    if e.odometry is not None:
        has, velocity, covariance = _course(e, e.odometry, at)
        distance, skipped = _distances(e.odometry, time), {"speed": NO_DOPPLER}
        wheels, notes = _means(time, distance), (BY_WHEELS,)
    else:
        rates, mean = _rates(e, config.codes, used, codes)
        rates, distance, skipped = rates.take(at), None, {}
        has, velocity, covariance = rates.solved, rates.x_m[:, :2], rates.cofactor[:, :2, :2]
        wheels, notes = np.hypot(velocity[:, 0], velocity[:, 1]), (NO_WHEELS, *((MEAN_RATES,) if mean else ()))
    fix = VehicleFix(found.solved, found.x_m[:, :2], found.cofactor[:, :2, :2], has, velocity, covariance)
    return ContextEpochs(
        frame, time, fix, position, wheels, e.odometry is not None, distance, skipped, notes, e.truth_enu_m[at, :2],
        e.known[at],
    )  # fmt: skip


def _solved(e: ServiceEpochs, config: CodeErrorsConfig) -> tuple[Bools, CodeFit, Array | None]:
    """Codes used, positions by them, and their HDOP without weights where the level takes it."""
    used = e.tracked & (e.los_enu[..., 2] >= np.sin(np.deg2rad(config.mask_deg)))
    used &= (e.cn0_dbhz >= config.least_cn0_dbhz) & np.isin(e.system, [System[name].value for name in config.systems])
    return used, *code_position(e.los_enu, e.code_m, e.cn0_dbhz, used, e.system, config)


def _rates(e: ServiceEpochs, config: CodeErrorsConfig, used: Bools, codes: CodeFit) -> tuple[CodeFit, bool]:
    """Velocities by range rates, and whether these are changes of carriers."""
    rate = e.rate_mps
    if rate is None:
        place = np.where(codes.solved[:, None], codes.x_m, 0.0)
        rate = carrier_rates(e.time_s, e.los_enu, e.phase_m, e.lost, used, place)
    factor = config.errors.errors(e.los_enu[..., 2], e.cn0_dbhz).factor
    found = solve_ranges(
        e.los_enu, rate, config.range_rate_mps**2 * factor, used & (rate != 0.0), np.zeros_like(e.system)
    )
    return found, e.rate_mps is None


def _distances(o: Odometry, time_s: Array) -> Array:
    """Distance driven at times (E,), by wheels [m]."""
    driven = np.concatenate([[0.0], np.cumsum(0.5 * (o.speed_mps[1:] + o.speed_mps[:-1]) * np.diff(o.time_s))])
    return np.asarray(np.interp(time_s, o.time_s, driven))


def _means(time_s: Array, distance_m: Array) -> Array:
    """Mean speed since the epoch before (E,)."""
    mean = np.diff(distance_m) / np.diff(time_s)
    return np.concatenate([mean[:1], mean]) if mean.size else np.zeros(time_s.size)


def _course(e: ServiceEpochs, o: Odometry, at: Ints) -> tuple[Bools, Array, Array]:
    """Whether the direction is known, the velocity since the last picked epoch, and a covariance of it."""
    assert e.rough_en_m is not None
    step, sigma = reckoned_steps(o, e.time_s, e.rough_en_m)
    length = np.hypot(step[:, 0], step[:, 1])
    sure = np.where(length > 0.0, sigma <= KNOWN_RAD * np.maximum(length, 1e-9), np.isfinite(sigma))
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(step[:, :2], 0)[1:]])
    moved, dt = np.diff(path[at], axis=0, prepend=path[at[:1]]), np.diff(e.time_s[at], prepend=-np.inf)
    return sure[at], moved / dt[:, None], np.zeros((at.size, 2, 2))


def _of_receiver(segment: Comma, config: ContextReplayConfig) -> ContextEpochs:
    """A recording with positions and speeds of a receiver."""
    if segment.fixes is None:
        raise InputError("segment must have GNSS/live_gnss_ublox, has none: the monitor needs positions")
    f, r, wheels = segment.fixes, segment.reference, segment.speed
    origin = r.position_ecef_m[0]
    latitude, longitude, height = geodetic_from_ecef(origin)
    frame = LocalFrame(origin, ecef_from_enu_matrix(latitude, longitude))
    start, end = max(f.time_s[0], wheels.time_s[0]), min(f.time_s[-1], wheels.time_s[-1])
    inside = np.flatnonzero((f.time_s >= start) & (f.time_s <= end))
    if inside.size < 2:
        raise InputError("segment must have positions while wheels are recorded, has fewer than two: give a whole one")
    at = inside[picked(f.time_s[inside], config.interval_s)]
    time = f.time_s[at]
    ecef = ecef_from_geodetic(np.deg2rad(f.latitude_deg[at]), np.deg2rad(f.longitude_deg[at]), np.full(at.size, height))
    course = np.deg2rad(f.course_deg[at])
    velocity = f.speed_mps[at, None] * np.stack([np.sin(course), np.cos(course)], -1)
    eye, there = np.broadcast_to(np.eye(2), (at.size, 2, 2)), np.ones(at.size, np.bool_)
    truth = frame.local(r.position_ecef_m)
    driven = _distances(Odometry(wheels.time_s, wheels.value, *[np.zeros(wheels.time_s.size)] * 3), time)
    none = np.full(at.size, np.inf)
    return ContextEpochs(
        frame=frame, time_s=time - time[0], wheel_mps=_means(time, driven), has_wheels=True, distance_m=None,
        fix=VehicleFix(
            there, frame.local(ecef)[:, :2], config.receiver_m**2 * eye, there, velocity, config.receiver_mps**2 * eye
        ),
        position=PositionTest(none, np.zeros(at.size), none, there, there),
        skipped={"position": NO_GEOMETRY}, notes=("SDOP is that of a declared error of the receiver's speed",),
        truth_en_m=np.stack([np.interp(time, r.time_s, truth[:, k]) for k in range(2)], -1),
        known=(time >= r.time_s[0] - FRESH_S) & (time <= r.time_s[-1] + FRESH_S) & ~segment.bridged(time),
    )  # fmt: skip
