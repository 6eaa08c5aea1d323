"""The context monitor on a recorded drive with a map that the user gives: the roads near the drive, as matchers take
them, and statistics, verdicts, changes of the light and a map as files.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.bounding import doubt
from lanebound.integrity.assessment.plotting import INK, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import WarningCounts, sweep_thresholds
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.monitor import ContextMonitor, ContextReason, ContextVerdict, Light
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedTest
from lanebound.integrity.positioning.map_matching.hidden_markov import viterbi
from lanebound.integrity.positioning.map_matching.map_errors import with_errors
from lanebound.integrity.positioning.map_matching.matching import MatchingConfig
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap
from lanebound.integrity.recorded.road_file import RoadLine, RoadLines, read_roads
from lanebound.integrity.replay.context_epochs import ContextEpochs, ContextReplayConfig, read_context_epochs
from lanebound.integrity.replay.window import LocalFrame

__all__ = ["ReplayedContext", "RoadNetwork", "drive_context", "network_near", "summarise_context", "write_context"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


SAME_DEG = 1e-7  # 1 cm: vertices that are written alike are one


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
    place, length = (
        _plane(np.asarray(keys * SAME_DEG, np.float64), frame),
        [len(line.lon_lat_deg) for line in roads.lines],
    )
    paths = [path[np.diff(path, prepend=-1) != 0] for path in np.split(of.ravel(), np.cumsum(length)[:-1])]
    node = _is_node(paths, len(keys))
    ends: list[tuple[int, int]] = []
    lines: list[Array] = []
    limits: list[float] = []
    names: list[str] = []
    for line, path in zip(roads.lines, paths, strict=True):
        for piece in _pieces(path, node):
            if _is_near(place[piece], track_en_m, within_m):
                _add(line, piece, place, ends, lines, limits, names)
    if not ends:
        raise InputError(
            f"the map must have a road within {within_m:g} m of the drive, the nearest is "
            f"{_distance(place, track_en_m) / 1000.0:.1f} km away: give a map of its area"
        )
    used, renumbered = np.unique(np.array(ends), return_inverse=True)
    pairs = [(int(a), int(b)) for a, b in renumbered.reshape(-1, 2)]
    return RoadNetwork(RoadMap.of_lines(place[used], pairs, lines, limit_mps=limits), tuple(names))


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


def _pieces(path: Ints, node: NDArray[np.bool_]) -> list[Ints]:
    """A line of places cut at nodes."""
    return [path[a : b + 1] for a, b in pairwise(np.flatnonzero(node[path]))]


def _add(
    line: RoadLine, piece: Ints, place: Array, ends: list[tuple[int, int]], lines: list[Array], limits: list[float],
    names: list[str],
) -> None:  # fmt: skip
    """Add the links of a piece in the directions that exist."""
    for exists, way in ((line.along, piece), (line.against, piece[::-1])):
        if exists:
            ends.append((int(way[0]), int(way[-1])))
            lines.append(place[way])
            limits.append(line.limit_mps)
            names.append(line.name)


def _is_near(line: Array, track: Array, within_m: float) -> bool:
    """Whether a line (P, 2) comes within a distance of a track, to a tenth of it."""
    low, high = line.min(0) - within_m, line.max(0) + within_m
    some = track[((track >= low) & (track <= high)).all(-1)]
    if not len(some):
        return False
    step = np.hypot(*np.diff(line, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, arc[-1], 2 + int(arc[-1] / (0.2 * within_m)))
    points = np.stack([np.interp(at, arc, column) for column in line.T], -1)
    return any(bool((np.square(points - here).sum(-1) <= within_m**2).any()) for here in some)


def _distance(place: Array, track: Array) -> float:
    """Least distance between places and a track [m]."""
    return float(min(np.hypot(*(place - here).T).min() for here in track))


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


def write_context(
    folder: Path, kind: str, roads: Path, out: Path, changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Judge a recording on a map; writes ``context.json``, ``context.csv``, ``warnings.csv`` and ``context.png``.

    Parameters
    ----------
    kind : of the recording, as :func:`~.datasets.kind_of` finds it
    roads : the map, GeoJSON as :mod:`~lanebound.integrity.recorded.road_file` reads it
    changes : overrides of :class:`~.context_epochs.ContextReplayConfig`

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
    out.mkdir(parents=True, exist_ok=True)
    written = [out / name for name in ("context.json", "context.csv", "warnings.csv")]
    written[0].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
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
    return found | {"judged": int(drive.judged.sum()), "rates": _rates(drive), "caution": CAUTION}


def _rates(drive: ReplayedContext) -> dict[str, Any]:
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


Bools = NDArray[np.bool_]

TRUTH = MatchingConfig(radius_m=30.0, candidates=16, sigma_m=3.0)
"""The reference on the map: its error, the half width of a road and the error of a digitised map."""


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
