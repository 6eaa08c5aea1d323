"""The context monitor on a recorded drive, with a map that the user gives: statistics, verdicts, changes of the light.

A drive is judged once in an interval; what a recording lacks is skipped, and named. smartLoc: codes and wheels; no
range rates, so that the speed phase is skipped, and the direction is that of wheels and gyro, turned to fit the code
positions of the last minute. RINEX: codes, and range rates by Doppler or by carriers; no wheels. comma2k19: positions
and Doppler speeds of the receiver, and wheels; no geometry, so that the position phase is skipped. The truth is apart,
for an assessment.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import doubt
from lanebound.integrity.assessment.plotting import INK, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import WarningCounts, sweep_thresholds
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, VehicleFix, code_position
from lanebound.integrity.monitoring.context.monitor import (
    ContextConfig,
    ContextMonitor,
    ContextReason,
    ContextVerdict,
    Light,
)
from lanebound.integrity.monitoring.context.position_phase import PositionTest, check_position
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedTest
from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges
from lanebound.integrity.positioning.map_matching.hidden_markov import viterbi
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.matching import MatchingConfig
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap
from lanebound.integrity.recorded.comma import Comma, read_comma
from lanebound.integrity.recorded.road_file import RoadLines, read_roads
from lanebound.integrity.recorded.smartloc import Odometry
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.code_epochs import reckoned_steps
from lanebound.integrity.replay.differences import carrier_rates
from lanebound.integrity.replay.reckoning import integral
from lanebound.integrity.replay.sensor_checks import aligned_comma
from lanebound.integrity.replay.service_drive import read_service_epochs
from lanebound.integrity.replay.service_epochs import ServiceEpochs
from lanebound.integrity.replay.window import LocalFrame
from lanebound.integrity.sky.systems import System

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
SAME_DEG = 1e-7  # 1 cm: vertices that are written alike are one
TRUTH = MatchingConfig(radius_m=30.0, candidates=16, sigma_m=3.0)
"""The reference on the map: its error, the half width of a road and the error of a digitised map."""
PHASES = ("position", "speed", "map")
HEAD = (
    "time_s", "light", "reason", "phases", "score", "link", "road", "link_probability", "hpl_m", "east_m", "north_m",
    "speed_mps", "error_m", "true_road", "right",
)  # fmt: skip
CHANGES = ("time_s", "light", "reason", "phases", "score", "link_probability", "road")
COLOURS = {Light.GREEN: "#1a9850", Light.AMBER: "#f59f00", Light.RED: "#d73027"}
CAUTION = (
    "right: on the road of the map on which the reference drives (its likeliest sequence of roads). A map drawn from "
    "the reference itself says nothing of how often a matched road is wrong. One drive is one drive"
)


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
    frame = LocalFrame.at(e.origin_ecef_m)
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
    return np.asarray(np.interp(time_s, o.time_s, integral(o.time_s, o.speed_mps)))


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
    frame, height = LocalFrame.at(origin), geodetic_from_ecef(origin)[2]
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
        truth_en_m=interpolated(time, r.time_s, truth[:, :2]),
        known=(time >= r.time_s[0] - FRESH_S) & (time <= r.time_s[-1] + FRESH_S) & ~segment.bridged(time),
    )  # fmt: skip


@dataclass(frozen=True)
class RoadNetwork:
    """A map, and the name of the road of each link."""

    road_map: RoadMap
    names: tuple[str, ...]


def network_near(roads: RoadLines, frame: LocalFrame, track_en_m: Array, within_m: float) -> RoadNetwork:
    """The links of roads that come within ``within_m`` of a track (T, 2) in E, N of the frame [m].

    Lines are cut where they share a vertex. The frame is a plane through the origin at its height.

    Raises
    ------
    InputError
        No road is near the track, or too many are.
    """
    vertices = np.concatenate([line.lon_lat_deg for line in roads.lines])
    keys, of = np.unique(np.rint(vertices / SAME_DEG).astype(np.int64), axis=0, return_inverse=True)
    place = _plane(np.asarray(keys * SAME_DEG, np.float64), frame)
    cuts = np.cumsum([len(line.lon_lat_deg) for line in roads.lines])[:-1]
    paths = [path[np.diff(path, prepend=-1) != 0] for path in np.split(of.ravel(), cuts)]
    node = _is_node(paths, len(keys))
    links = [
        (line, way)
        for line, path in zip(roads.lines, paths, strict=True)
        for first, last in pairwise(np.flatnonzero(node[path]))
        if _is_near(place[piece := path[first : last + 1]], track_en_m, within_m)
        for exists, way in ((line.along, piece), (line.against, piece[::-1]))
        if exists
    ]
    if not links:
        raise InputError(
            f"the map must have a road within {within_m:g} m of the drive, the nearest is "
            f"{_distance(place, track_en_m) / 1000.0:.1f} km away: give a map of its area"
        )
    used, renumbered = np.unique([(way[0], way[-1]) for _, way in links], return_inverse=True)
    pairs = [(int(a), int(b)) for a, b in renumbered.reshape(-1, 2)]
    limits = [line.limit_mps for line, _ in links]
    road_map = RoadMap.of_lines(place[used], pairs, [place[way] for _, way in links], limit_mps=limits)
    return RoadNetwork(road_map, tuple(line.name for line, _ in links))


def _plane(lon_lat_deg: Array, frame: LocalFrame) -> Array:
    """East and North (V, 2) of longitudes and latitudes."""
    _, _, height = geodetic_from_ecef(frame.origin_ecef_m)
    longitude, latitude = np.radians(lon_lat_deg).T
    ecef = ecef_from_geodetic(latitude, longitude, np.full(len(latitude), float(height)))
    return np.asarray(frame.local(ecef)[:, :2])


def _is_node(paths: list[Ints], count: int) -> NDArray[np.bool_]:
    """Whether a place is the end of a line, or a vertex of several lines, or of one line twice."""
    node = np.bincount(np.concatenate(paths), minlength=count) > 1
    node[[path[k] for path in paths for k in (0, -1)]] = True
    return np.asarray(node)


def _is_near(line: Array, track: Array, within_m: float) -> bool:
    """Whether a line (P, 2) comes within a distance of a track, to a tenth of it."""
    low, high = line.min(0) - within_m, line.max(0) + within_m
    some = track[((track >= low) & (track <= high)).all(-1)]
    if not len(some):
        return False
    step = np.hypot(*np.diff(line, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, arc[-1], 2 + int(arc[-1] / (0.2 * within_m)))
    points = interpolated(at, arc, line)
    return any(bool((np.square(points - here).sum(-1) <= within_m**2).any()) for here in some)


def _distance(place: Array, track: Array) -> float:
    """Least distance between places and a track [m]."""
    return float(min(np.hypot(*(place - here).T).min() for here in track))


@dataclass(frozen=True)
class ReplayedContext:
    """Verdicts of E epochs.

    network : the map of the file; the monitor has it with the configured errors
    warn, light, reason, phases, link (E,); score, probability, level_m (E,)
    true_link : (E,) link of the file's map on which the reference drives, NO_LINK where it is on none
    right : (E,) the matched road is that one, in either direction, or the neighbour at a node
    """

    config: ContextReplayConfig
    epochs: ContextEpochs
    network: RoadNetwork
    warn: Bools
    light: Ints
    reason: Ints
    phases: Ints
    link: Ints
    score: Array
    probability: Array
    level_m: Array
    true_link: Ints
    right: Bools

    @property
    def judged(self) -> Bools:
        """Epochs (E,) with a position and a reference that is on a road of the map."""
        return np.asarray(self.epochs.known & (self.true_link != NO_LINK) & self.epochs.fix.located)

    def counts(self, warn: Bools) -> WarningCounts:
        """Counts of warnings (E,) of the judged epochs."""
        return WarningCounts.of(warn, ~self.right, self.judged)

    def errors_m(self) -> Array:
        """Horizontal errors (N,) of the positions at epochs with a reference."""
        keep = self.epochs.known & self.epochs.fix.located
        return np.asarray(np.hypot(*(self.epochs.fix.position_en_m - self.epochs.truth_en_m)[keep].T))


def drive_context(
    epochs: ContextEpochs, roads: RoadLines, config: ContextReplayConfig, progress: Progress = silent
) -> ReplayedContext:
    """Judge all epochs; ``progress`` is called with the number of epochs done and the total number.

    Raises
    ------
    InputError
        No road of the map is near the positions.
    """
    track = epochs.fix.position_en_m[epochs.fix.located]
    network = network_near(roads, epochs.frame, track, config.within_m)
    road_map = with_errors(network.road_map, config.map_errors, named_generator(config.map_seed, "map"))
    own = config if epochs.has_wheels else config.replace(speed={"form": SpeedForm.PRINTED.value})
    monitor = ContextMonitor(own, road_map, 1, config.interval_s)
    verdicts = list[ContextVerdict]()
    for k in range(epochs.time_s.size):
        row, monitor.dt_s = slice(k, k + 1), _interval(epochs, k, config)
        speed = None if epochs.distance_m is None else _speed_by_wheels(epochs, epochs.distance_m, k, config)
        verdicts.append(monitor.step(epochs.fix.rows(row), epochs.wheel_mps[row], epochs.position.rows(row), speed))
        progress(k + 1, epochs.time_s.size)
    return _gathered(config, epochs, network, verdicts)


def _interval(epochs: ContextEpochs, k: int, config: ContextReplayConfig) -> float:
    """Time since the epoch before [s]."""
    return float(epochs.time_s[k] - epochs.time_s[k - 1]) if k else config.interval_s


def _speed_by_wheels(epochs: ContextEpochs, distance_m: Array, k: int, config: ContextReplayConfig) -> SpeedTest:
    """In place of the second phase: the mean speed by wheels over its time, known with a direction of motion."""
    first = max(k - config.speed.intervals, 0)
    time = epochs.time_s[k] - epochs.time_s[first]
    mean = abs(float(distance_m[k] - distance_m[first])) / time if time > 0.0 else abs(float(epochs.wheel_mps[k]))
    known = epochs.fix.has_velocity[k : k + 1] & (k >= config.speed.intervals)
    wheels = np.abs(epochs.wheel_mps[k : k + 1])
    return SpeedTest(wheels > config.speed.least_mps, known, known, np.array([mean]), np.zeros(1, np.bool_), wheels)


def _gathered(
    config: ContextReplayConfig, epochs: ContextEpochs, network: RoadNetwork, verdicts: list[ContextVerdict]
) -> ReplayedContext:
    def all_of(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(verdict, name) for verdict in verdicts])

    link = all_of("link")
    true = _true_links(epochs, network.road_map)
    return ReplayedContext(
        config, epochs, network, warn=all_of("warn"), light=all_of("light"), reason=all_of("reason"),
        phases=all_of("phases"), link=link, score=all_of("score"),
        probability=np.concatenate([v.match.probability for v in verdicts]), level_m=epochs.position.level_m,
        true_link=true, right=_right(network.road_map, link, true, epochs.truth_en_m, config.node_m),
    )  # fmt: skip


def _true_links(epochs: ContextEpochs, road_map: RoadMap) -> Ints:
    """Links (E,) of the reference: its likeliest sequence on the map, all epochs at once."""
    out, keep = np.full(epochs.time_s.size, NO_LINK), np.flatnonzero(epochs.known)
    if keep.size:
        out[keep] = viterbi(road_map, epochs.truth_en_m[keep], TRUTH).link
    return out


def _right(road_map: RoadMap, link: Ints, true: Ints, truth_en_m: Array, node_m: float) -> Bools:
    """Whether links (E,) are on the road of the true ones, or on one that meets it within ``node_m``."""
    a, b = np.maximum(link, 0), np.maximum(true, 0)
    same = (a == b) | (road_map.twin[a] == b)
    for node in (road_map.link_from[b], road_map.link_to[b]):
        close = np.hypot(*(road_map.node_en_m[node] - truth_en_m).T) <= node_m
        same |= close & ((road_map.link_from[a] == node) | (road_map.link_to[a] == node))
    return np.asarray(same & (link != NO_LINK) & (true != NO_LINK))


def write_context(
    folder: Path, kind: str, roads: Path, out: Path, changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Judge a recording on a map; writes ``context.json``, ``context.csv``, ``warnings.csv`` and ``context.png``.

    Parameters
    ----------
    kind : of the recording, as :func:`~.datasets.kind_of` finds it
    roads : the map, GeoJSON as :mod:`~lanebound.integrity.recorded.road_file` reads it
    changes : overrides of :class:`ContextReplayConfig`

    Raises
    ------
    InputError
        The map or the recording cannot be used, or a change is invalid.
    """
    config, lines = ContextReplayConfig.build(None, changes), read_roads(roads)
    epochs, stopped = read_context_epochs(folder, kind, config)
    stopped |= {roads.name: lines.note} if lines.note else {}
    drive = drive_context(epochs, lines, config, progress)
    summary = {
        "dataset": "context", "recording": kind, "stopped": stopped or None, **summarise_context(drive),
        "left_out": {"features that are no lines": lines.others, "ways without cars": lines.without_cars,
                     "malformed ways": lines.malformed, "speed limits, taken as 50 km/h": lines.limits},
    }  # fmt: skip
    written = [out / name for name in ("context.json", "context.csv", "warnings.csv")]
    write_summary(written[0], summary)
    rows = _rows(drive)
    _write(written[1], HEAD, rows)
    _write(written[2], CHANGES, [row for k, row in enumerate(rows) if k == 0 or _differ(row, rows[k - 1])])
    return summary, [*written, _draw(drive, out / "context.png")]


def summarise_context(drive: ReplayedContext) -> dict[str, Any]:
    """Statistics of a drive as JSON data."""
    e, interval = drive.epochs, drive.config.interval_s
    found: dict[str, Any] = {
        "epochs": int(e.time_s.size),
        "located": int(e.fix.located.sum()),
        "roads": {"links": drive.network.road_map.links, "nodes": len(drive.network.road_map.node_en_m)},
        "skipped": e.skipped, "notes": list(e.notes),
        "light_s": {light.name.lower(): interval * int((drive.light == light).sum()) for light in Light},
        "reasons": {name: n for name, n in ContextReason.count(drive.reason).items() if n},
        "matched": float((drive.link != NO_LINK).mean()),
    }  # fmt: skip
    if "position" not in e.skipped:
        level = np.where(np.isfinite(drive.level_m), drive.level_m, np.inf)
        found["level"] = {
            "median_m": _finite(float(np.quantile(level, 0.5, method="lower"))),
            "within_limit": float((level <= drive.config.position.alert_limit_m).mean()),
        }
    if not drive.judged.any():
        return found
    errors = drive.errors_m()
    found["error"] = {"median_m": float(np.median(errors)), "p95_m": float(np.quantile(errors, 0.95))}
    if "position" not in e.skipped:
        known = e.known & e.fix.located
        over, level = errors > drive.level_m[known], drive.level_m[known]
        found["error"] |= {"beyond_level": int(over.sum()), "with_level": int(np.isfinite(level).sum())}
        found["doubt"] = doubt(drive.config.position.missed_detection, errors, level, "epochs")
    return found | {"judged": int(drive.judged.sum()), "rates": _warning_rates(drive), "caution": CAUTION}


def _warning_rates(drive: ReplayedContext) -> dict[str, Any]:
    """Counts of the monitor, of rules that need none, and where its sweep of the threshold crosses."""
    never, reached = np.zeros_like(drive.warn), _reached(drive)
    rules = {"all phases": drive.warn, "never warn": never, "always warn": ~never}
    sweep = sweep_thresholds(drive.score, ~drive.right, np.arange(101.0), drive.judged & reached)
    third = WarningCounts.of(drive.phases < len(PHASES), ~drive.right, drive.judged & reached)
    return {
        **{name: _counts(drive.counts(warn)) for name, warn in rules.items()},
        "third phase, of points that reach it": _counts(third), "threshold_crossing": sweep.crossing(),
    }  # fmt: skip


def _reached(drive: ReplayedContext) -> NDArray[np.bool_]:
    """Points (E,) that pass the first two phases."""
    return np.asarray(drive.phases >= len(PHASES) - 1)


def _counts(c: WarningCounts) -> dict[str, Any]:
    return {
        "points": c.points, "wrong": c.wrong, "false_alarms": c.false_alarms, "missed": c.missed, "far": c.far,
        "mdr": c.mdr, "ocdr": c.ocdr,
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _rows(drive: ReplayedContext) -> list[dict[str, Any]]:
    """A row for each epoch; empty cells for what is not known."""
    e, names = drive.epochs, (*drive.network.names, "")
    out = []
    for k in range(e.time_s.size):
        there, known = bool(e.fix.located[k]), bool(e.known[k])
        east, north = e.fix.position_en_m[k]
        error = float(np.hypot(*(e.fix.position_en_m[k] - e.truth_en_m[k])))
        out.append({
            "time_s": f"{e.time_s[k]:.2f}", "light": Light(int(drive.light[k])).name.lower(),
            "reason": ContextReason.from_code(int(drive.reason[k])).name, "phases": int(drive.phases[k]),
            "score": f"{drive.score[k]:.1f}", "link": int(drive.link[k]), "road": names[drive.link[k]],
            "link_probability": f"{drive.probability[k]:.3f}",
            "hpl_m": f"{drive.level_m[k]:.2f}" if np.isfinite(drive.level_m[k]) else "",
            "east_m": f"{east:.2f}" if there else "", "north_m": f"{north:.2f}" if there else "",
            "speed_mps": f"{e.wheel_mps[k]:.2f}", "error_m": f"{error:.2f}" if there and known else "",
            "true_road": names[drive.true_link[k]], "right": int(drive.right[k]) if drive.judged[k] else "",
        })  # fmt: skip
    return out


def _differ(row: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    return bool((row["light"], row["reason"]) != (before["light"], before["reason"]))


def _write(path: Path, head: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, head, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def _draw(drive: ReplayedContext, path: Path) -> Path:
    """The roads, the positions in the colours of the light, and the reference."""
    figure, e = new_figure(7.0, 6.0), drive.epochs
    axes = figure.subplots()
    for link in range(drive.network.road_map.links):
        axes.plot(*drive.network.road_map.line(link).T, color="#bbbbbb", linewidth=1.0, zorder=1)
    if e.known.any():
        axes.plot(*e.truth_en_m[e.known].T, color=INK, linewidth=0.8, zorder=2, label="reference")
    for light in Light:
        at = (drive.light == light) & e.fix.located
        if at.any():
            name = light.name.lower()
            east, north = e.fix.position_en_m[at].T
            axes.scatter(east, north, s=9, color=COLOURS[light], zorder=3, label=name)
    places = e.fix.position_en_m[e.fix.located] if e.fix.located.any() else np.zeros((1, 2))
    low, high = places.min(0) - 60.0, places.max(0) + 60.0
    tidy(axes, title="Context monitor on a recorded drive", xlabel="East [m]", ylabel="North [m]")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    legend(axes)
    return save(figure, path)
