"""Drives of S5: a generated road map, a street along the route, receivers with undifferenced codes, one point a second.

The truth is the link of the route on which the vehicle is; within ``node_m`` of a node both links of the route count
as true. Nothing that the monitor reads contains it.

``python -m lanebound.agents.studies.context_drive`` fits the weights of the topological matcher on drives that no
result uses: three maps of each kind of roads (maps and seeds from 1000 on; results have maps 0 to 4). It prints the
share of right links for each scale of distance and weight of connection. The chosen pair has the largest mean share,
over kinds of roads, true maps and maps with errors alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.assessment.warning_rates import WarningCounts, charging_counts, sweep_thresholds
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, CodeFix, code_fix
from lanebound.integrity.monitoring.context.monitor import (
    ContextConfig,
    ContextMonitor,
    ContextReason,
    ContextVerdict,
    match_inputs,
)
from lanebound.integrity.monitoring.context.position_phase import check_position
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedPhase, SpeedTest
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.map_matching.generators import DriveEnvironment, MapWithRoute, generate_map
from lanebound.integrity.positioning.map_matching.hidden_markov import make_matcher
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.matching import MatchingConfig, MatchInputs
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.city import build_city
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

if TYPE_CHECKING:
    from lanebound.agents.studies.context_study import ContextStudyConfig

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

THRESHOLDS = np.arange(0.0, 101.0)
ASSUMED = "assumed"
Judge = tuple[str, str]
"""A map and a matcher; or ASSUMED and the name of an assumption."""
PHASES = ("position", "speed", "map")


class MonitorSeries:
    """What all monitors found at all points: arrays (T, B)."""

    def __init__(self) -> None:
        self.point: dict[str, list[NDArray[Any]]] = {}
        self.found: dict[Judge, dict[str, list[NDArray[Any]]]] = {}

    @classmethod
    def of(
        cls,
        drive: ContextDrive,
        points: int,
        monitors: Mapping[Judge, ContextMonitor],
        others: Mapping[str, ContextMonitor],
        config: ContextConfig,
        advance: Advance,
    ) -> MonitorSeries:
        """Drive, and let every monitor judge every point."""
        out, batch = cls(), next(iter(monitors.values())).speed.memory["count"].size
        phases = {form: SpeedPhase(config.speed.replace(form=form), batch) for form in SpeedForm}
        for k, p in enumerate(drive.points):
            position = check_position(p.fix.codes, config.position, p.fix.hdop)
            tests = {form: _speed_test(phase, p) for form, phase in phases.items()}
            speed = tests[config.speed.form]
            _add(out.point, _of_point(p, tests))
            for key, monitor in monitors.items():
                verdict = monitor.step(p.fix, p.wheel_mps, position, speed)
                _add(out.found.setdefault(key, {}), _of_verdict(verdict, p.fix, p))
            for name, monitor in others.items():
                verdict = monitor.step(p.others[name], p.wheel_mps)
                _add(out.found.setdefault((ASSUMED, name), {}), _of_verdict(verdict, p.others[name], p))
            advance((k + 1) / points)
        return out

    def of_points(self, name: str, b: int) -> NDArray[Any]:
        """A quantity of the points of drive ``b``, (T,)."""
        return np.array([row[b] for row in self.point[name]])

    def of_found(self, key: Judge, name: str, b: int) -> NDArray[Any]:
        """What a monitor found, of drive ``b``, (T,)."""
        return np.array([row[b] for row in self.found[key][name]])


def _add(to: dict[str, list[NDArray[Any]]], values: Mapping[str, NDArray[Any]]) -> None:
    for name, value in values.items():
        to.setdefault(name, []).append(value)


def _speed_test(phase: SpeedPhase, p: ContextPoint) -> SpeedTest:
    return phase.step(p.fix.velocity_en_mps, p.fix.velocity_covariance, p.wheel_mps, p.fix.has_velocity)


def _of_point(p: ContextPoint, tests: Mapping[SpeedForm, SpeedTest]) -> dict[str, NDArray[Any]]:
    first = tests[SpeedForm.WHEEL]
    return {
        "driving": p.driving, "speed": p.speed_mps, "known": first.known, "average": first.average_mps,
        "true": p.true_link[:, 0], **{f"speed {form}": test.consistent for form, test in tests.items()},
    }  # fmt: skip


def _of_verdict(v: ContextVerdict, fix: CodeFix, p: ContextPoint) -> dict[str, NDArray[Any]]:
    error = np.linalg.norm(fix.position_en_m - p.position_en_m, axis=-1)
    return {
        "warn": v.warn, "reason": v.reason, "phases": v.phases, "link": v.link,
        "right": (v.link[:, None] == p.true_link).any(-1), "probability": v.match.probability,
        "error": np.where(fix.located, error, np.inf), "level": v.position.level_m,
        "available": v.position.available, "consistent": v.position.consistent,
        "in motion": ~v.speed.at_rest, "has velocity": fix.has_velocity, "speed": v.speed.consistent,
        "map": v.map.matched & v.map.passed, "own score": v.map.score,
    }  # fmt: skip


def drive_figures(config: ContextStudyConfig, s: MonitorSeries, maps: Mapping[str, RoadMap], b: int) -> dict[str, Any]:
    """Counts of one drive, of every matcher and map."""
    driving, own = s.of_points("driving", b), next(iter(s.found))
    moving, error = s.of_found(own, "in motion", b), s.of_found(own, "error", b)
    out: dict[str, Any] = {
        "points": int(driving.sum()),
        "moving": float(moving[driving].mean()),
        "error_m": np.quantile(error[driving], [0.5, 0.95], method="lower").tolist(),
        "speed": {
            str(form): float((~s.of_points(f"speed {form}", b))[driving & moving & s.of_points("known", b)].mean())
            for form in SpeedForm
        },
        "of": {},
        "assumptions": {},
    }
    for which, kind in s.found:
        found = _judged(config, s, maps["true"], (which, kind), b)
        if which == ASSUMED:
            out["assumptions"][kind] = found
        else:
            out["of"][f"{which}, {kind}"] = found
    return out


def _judged(config: ContextStudyConfig, s: MonitorSeries, road_map: RoadMap, key: Judge, b: int) -> dict[str, Any]:
    """Counts of warnings of each rule of warning, the sweep, and what charging makes of the verdicts."""
    get, driving = partial(s.of_found, key, b=b), s.of_points("driving", b)
    wrong, level = ~get(name="right"), get(name="level")
    stages = _stages(get, driving)
    sweep = sweep_thresholds(get(name="own score"), wrong, THRESHOLDS, stages[-1][0])
    belief = sweep_thresholds(100.0 * get(name="probability"), wrong, THRESHOLDS, driving)
    charges = charging_counts(
        config.charging, road_map, link=get(name="link"), warn=get(name="warn"), speed_mps=s.of_points("average", b),
        true_link=s.of_points("true", b), driving=driving,
        true_speed_mps=_averaged(s.of_points("speed", b), config.monitor.speed.intervals),
    )  # fmt: skip
    accepted = driving & get(name="consistent") & np.isfinite(level)
    return {
        "right": float((~wrong)[driving].mean()),
        "passed": int((get(name="phases") == len(PHASES))[driving].sum()),
        "available": float(get(name="available")[driving].mean()),
        "level_m": float(np.quantile(level[driving], 0.5, method="lower")),
        "beyond": [int((get(name="error") > level)[accepted].sum()), int(accepted.sum())],
        "reasons": np.bincount(get(name="reason")[driving], minlength=len(ContextReason)).tolist(),
        "counts": {name: _counted(WarningCounts.of(warn, wrong, driving)) for name, warn in _rules(config, get)},
        "stages": [_counted(WarningCounts.of(warn, wrong, reached)) for reached, warn in stages],
        "sweep": [sweep.false_alarms.tolist(), sweep.missed.tolist(), sweep.points],
        "belief": [belief.false_alarms.tolist(), belief.missed.tolist(), belief.points],
        "charging": charges,
    }


def _stages(get: Any, driving: Bools) -> list[tuple[Bools, Bools]]:
    """Of each phase, the points (T,) that reach it and those that it warns of; at rest none reaches the second."""
    first = get(name="available") & get(name="consistent")
    second, speed = driving & first & get(name="in motion"), get(name="speed")
    return [(driving, ~first), (second, ~speed), (second & speed, ~get(name="map"))]


def _rules(config: ContextStudyConfig, get: Any) -> Iterator[tuple[str, Bools]]:
    """Rules of warning (T,): the monitor's own verdicts, those without each phase, of each alone, and naive ones."""
    rest = ~get(name="in motion")
    yield "as printed", warned_by(get, PHASES) | rest
    yield "all phases", get(name="warn")
    for left in PHASES:
        yield f"without {left}", warned_by(get, [phase for phase in PHASES if phase != left])
    for phase in PHASES:
        yield f"{phase} alone", warned_by(get, [phase])
    yield "level alone", np.asarray(get(name="level") > config.monitor.position.alert_limit_m)
    yield "never", np.zeros(rest.size, np.bool_)
    yield "always", np.ones(rest.size, np.bool_)


def warned_by(get: Any, phases: list[str] | tuple[str, ...]) -> Bools:
    """Warnings (T,) of some phases by their results: of the position at every point, of speed and map as in the last
    motion while at rest, before the first motion always, and at rest without a Doppler velocity."""
    moving, failed = get(name="in motion"), np.zeros_like(get(name="warn"))
    if "speed" in phases:
        failed = failed | ~get(name="speed")
    if "map" in phases:
        failed = failed | ~get(name="map")
    if phases != ["position"]:
        last = np.maximum.accumulate(np.where(moving, np.arange(moving.size), -1))
        failed = np.where(last >= 0, failed[np.maximum(last, 0)], True)
    if "speed" in phases:
        failed = failed | (~moving & ~get(name="has velocity"))
    if "position" in phases:
        failed = failed | ~(get(name="available") & get(name="consistent"))
    return np.asarray(failed)


def _averaged(speed_mps: Array, intervals: int) -> Array:
    """Mean over the last intervals, as the monitor averages; over fewer at the start."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (speed_mps[1:] + speed_mps[:-1]))])
    k = np.arange(speed_mps.size)
    begin = np.maximum(k - intervals, 0)
    return np.where(k > 0, (total - total[begin]) / np.maximum(k - begin, 1), speed_mps)


def _counted(c: WarningCounts) -> list[int]:
    return [c.points, c.wrong, c.false_alarms, c.missed]


HOUR_S, WEEK_S = 3600, 604_800
LANE_M = 3.5
SIDE_M, APART_M = 20.0, 6.0  # longest and shortest side of a driven line
END_M = 5.0  # vehicles nearer to the end of their route have arrived
SUBSTEPS = 5  # of the motion in a second


class DriveTable(Config):
    """A drive of S5 Table 2 and its surroundings."""

    roads: DriveEnvironment = Field(description="kind of the generated roads")
    length_m: float = Field(gt=1000, description="length of the route [m]; S5 Table 2")
    points: int = Field(gt=20, description="points at one a second [-]; S5 Table 2")
    sky: str = Field(description="level of sky along the route")
    drive: DriveConfig = DriveConfig()


DRIVES: dict[str, DriveTable] = {
    "urban": DriveTable(
        roads=DriveEnvironment.URBAN, length_m=6400.0, points=1245, sky="urban",
        drive=DriveConfig(speed_limit_mps=11.5, light_spacing_m=240.0, red_share=0.5),
    ),
    "rural": DriveTable(
        roads=DriveEnvironment.RURAL, length_m=6500.0, points=3335, sky="suburban",
        drive=DriveConfig(speed_limit_mps=22.0, light_spacing_m=3000.0, red_share=0.3),
    ),
    "mixed": DriveTable(
        roads=DriveEnvironment.MIXED, length_m=8600.0, points=1105, sky="suburban",
        drive=DriveConfig(speed_limit_mps=14.5, light_spacing_m=500.0, red_share=0.4),
    ),
}  # fmt: skip
DRIVES["suburban"] = DRIVES["urban"].replace(sky="suburban")
"""Length and points of S5. Speeds are chosen so that the points cover the length. In S5's rural drive they do not:
3,335 points at one a second over 6.5 km are 2 m/s, while 82.7 km in all leave it 67.7 km. It is driven as laps of a
closed route. ``suburban`` is the urban drive under the sky of suburbs: the streets of S5's city are lower than ours."""


@dataclass(frozen=True)
class TrueLinks:
    """Where the links of a route begin along a road: start_m (R + 1,), identity (R,); ``closed``: lap after lap."""

    start_m: Array
    identity: Ints
    closed: bool

    @classmethod
    def of(cls, road: Road, found: MapWithRoute) -> TrueLinks:
        """Arcs of the nodes of the route: the vertex nearest to each node, one after another."""
        arcs, at = [0.0], 0.0
        for link in found.route[:-1]:
            length = float(found.road_map.length_m[link])
            node = found.road_map.node_en_m[found.road_map.link_to[link]]
            inside = np.flatnonzero((road.arc_at_m > at) & (road.arc_at_m <= at + 1.05 * length + 2.0))
            near = np.linalg.norm(road.vertices_en_m[inside] - node, axis=-1)
            at = float(road.arc_at_m[inside[np.argmin(near)]])
            arcs.append(at)
        return cls(np.array([*arcs, road.length_m]), found.road_map.identity[found.route], found.closed)

    def at(self, arc_m: Array, node_m: float) -> Ints:
        """Identities (B, 2) of the link at arcs (B,), and of the neighbour within ``node_m`` of a node or the same."""
        length = self.start_m[-1]
        arc = np.remainder(arc_m, length) if self.closed else np.clip(arc_m, 0.0, length)
        k = np.clip(np.searchsorted(self.start_m, arc, side="right") - 1, 0, self.identity.size - 1)
        step = np.where(arc - self.start_m[k] < node_m, -1, np.where(self.start_m[k + 1] - arc < node_m, 1, 0))
        other = k + step
        count = self.identity.size
        other = np.remainder(other, count) if self.closed else np.clip(other, 0, count - 1)
        return np.stack([self.identity[k], self.identity[other]], -1)


@dataclass(frozen=True)
class ContextPoint:
    """One second of B vehicles: what the monitor gets (fix, wheels), and the truth for scoring.

    others: fixes of the same epoch under other assumptions, by name; true_link (B, 2) identities that count as true;
    driving (B,) the end of the route is not reached.
    """

    time_s: float
    fix: CodeFix
    others: dict[str, CodeFix]
    wheel_mps: Array
    true_link: Ints
    driving: Bools
    speed_mps: Array
    position_en_m: Array


@dataclass(frozen=True)
class ContextDrive:
    """A map, and the points of B vehicles on its route."""

    road_map: RoadMap
    route: Ints
    points: Iterator[ContextPoint]


def navigator_config(gnss: GnssConfig, sky: SkyConfig) -> NavigatorConfig:
    """A receiver read once a second, without a reference link."""
    return NavigatorConfig(dt_s=1.0).replace(gnss=gnss.replace(undifferenced=True).to_dict(), sky=sky.to_dict())


def drive_of(
    table: DriveTable,
    number: int,
    seeds: list[int],
    receiver: tuple[GnssConfig, SkyConfig],
    codes: Mapping[str, CodeErrorsConfig],
    node_m: float,
    faults: tuple[Fault, ...] = (),
) -> ContextDrive:
    """The drive of vehicles with these seeds on map ``number`` of a kind of roads; ``codes`` by name, the first is that
    of the monitor, the others are further assumptions."""
    key = _map_key(table, number)
    found = generate_map(table.roads, table.length_m, named_generator(key, "road"))
    road = route_road(found)
    level = SkyLevel.named(table.sky)
    city = build_city(road, level.streets_along(2.0 * road.edge_m), named_generator(key, "city"))
    mask = SkyMask.build(road, city, az_step_deg=4.0, el_step_deg=3.0)
    base = navigator_config(*receiver)
    hour = int(named_generator(key, "sky").integers(24))
    base = base.replace(sky={"week_second_s": (base.sky.week_second_s + HOUR_S * hour) % WEEK_S})
    track = SkyTrack.from_config(base.sky, table.points + 60.0)
    navigator = Navigator(base, track, mask, seeds, faults=FaultSchedule(faults))
    points = _points(navigator, CityDrive(road, table.drive, 1.0 / SUBSTEPS), TrueLinks.of(road, found), table, codes,
                     node_m)  # fmt: skip
    return ContextDrive(found.road_map, found.route, points)


def wrong_map(road_map: RoadMap, errors: MapErrorsConfig, table: DriveTable, number: int) -> RoadMap:
    """Map ``number`` of a kind of roads as a vehicle may have it."""
    return with_errors(road_map, errors, named_generator(_map_key(table, number), "map"))


def _map_key(table: DriveTable, number: int) -> list[int]:
    return [list(DriveEnvironment).index(table.roads), number]


def route_road(found: MapWithRoute) -> Road:
    """The road along a route, with the lane to the right of the lines of the map."""
    lines = [found.road_map.line(int(link)) for link in found.route]
    points = np.concatenate([lines[0], *(line[1:] for line in lines[1:])])
    if found.closed:
        points = points[:-1]
    points = _densified(_thinned(points), found.closed)
    return Road.through(points, corner_radius_m=np.inf, closed=found.closed, lane_width_m=LANE_M, shift_m=0.3 * LANE_M)


def _thinned(points: Array) -> Array:
    """A polyline without the vertices nearer than APART_M to the one before: no kinks that a car cannot drive."""
    kept = [points[0]]
    for point in points[1:]:
        if np.linalg.norm(point - kept[-1]) >= APART_M:
            kept.append(point)
    return np.array(kept)


def _densified(points: Array, closed: bool) -> Array:
    """A polyline with sides of at most SIDE_M: wide arcs in bends, and arcs of half of that at corners."""
    ends = np.concatenate([points[1:], points[:1]]) if closed else points[1:]
    parts = []
    for a, b in zip(points, ends, strict=False):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / SIDE_M)))
        parts.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate(parts if closed else [*parts, points[-1:]])


def _points(
    navigator: Navigator,
    car: CityDrive,
    links: TrueLinks,
    table: DriveTable,
    codes: Mapping[str, CodeErrorsConfig],
    node_m: float,
) -> Iterator[ContextPoint]:
    traffic = Streams(list(navigator.state.streams.seeds or ()))
    state = car.start(traffic, spread_m=car.road.length_m if car.road.closed else 150.0)
    last: Truth | None = None
    for k in range(table.points + 1):
        for _ in range(SUBSTEPS):
            now = car.step(state, traffic)
        if last is not None:
            truth = _second(last, now, float(k))
            m = navigator.measure(truth)
            fixes = {declared: code_fix(m, declared) for declared in set(codes.values())}
            fix, *others = (fixes[declared] for declared in codes.values())
            driving = np.full(now.batch, True) if car.road.closed else now.arc_m < car.road.length_m - END_M
            yield ContextPoint(
                float(k), fix, dict(zip(list(codes)[1:], others, strict=True)),
                m.odometer.speed_mps, links.at(now.arc_m, node_m), driving,
                np.linalg.norm(now.velocity_enu_mps, axis=-1), truth.position_enu_m[:, :2],
            )  # fmt: skip
        last = now


def _second(before: Truth, now: Truth, time_s: float) -> Truth:
    """The motion over the second between two truths."""
    return truth_between(
        time_s, 1.0,
        (before.position_enu_m[:, :2], now.position_enu_m[:, :2]),
        (before.velocity_enu_mps[:, :2], now.velocity_enu_mps[:, :2]),
        (before.heading_rad, now.heading_rad), arc_m=now.arc_m, lane=now.lane,
    )  # fmt: skip


TRAINING = 1000  # first map and first seed
MAPS, DRIVES_EACH, POINTS = 3, 5, 1000
SCALES_M = (6.0, 8.0, 10.0, 12.0, 15.0, 20.0)
CONNECTIONS = (0.0, 0.05, 0.1, 0.15, 0.25)


class MatchedDrives(NamedTuple):
    """Drives on a map: its true and wrong form, and of each point what matchers take, true links and driving."""

    roads: str
    maps: tuple[RoadMap, RoadMap]
    inputs: list[MatchInputs]
    true_link: NDArray[np.int64]
    driving: NDArray[np.bool_]

    def share(self, config: MatchingConfig) -> float:
        """Share of right links of a matcher, the mean of both maps."""
        shares = []
        for road_map in self.maps:
            matcher = make_matcher(road_map, config, self.driving.shape[1])
            names = np.append(road_map.identity, NO_LINK)
            link = np.array([names[matcher.step(inputs).link] for inputs in self.inputs])
            right = (link[..., None] == self.true_link).any(-1)
            shares.append(float(right[self.driving].mean()))
        return float(np.mean(shares))


def record(roads: str, number: int, seeds: list[int], points: int, study: ContextStudyConfig) -> MatchedDrives:
    """Drive map ``number`` once, for all matchers."""
    table, monitor = DRIVES[roads].replace(points=points), study.monitor
    drive = drive_of(table, number, seeds, (study.gnss, study.sky), {"": monitor.codes}, study.node_m)
    speed, inputs, true_link, driving = SpeedPhase(monitor.speed, len(seeds)), [], [], []
    for p in drive.points:
        fix = p.fix
        tested = speed.step(fix.velocity_en_mps, fix.velocity_covariance, p.wheel_mps, fix.has_velocity)
        inputs.append(match_inputs(fix, tested, 1.0))
        true_link.append(p.true_link)
        driving.append(p.driving)
    maps = drive.road_map, wrong_map(drive.road_map, study.map_errors, table, number)
    return MatchedDrives(roads, maps, inputs, np.array(true_link), np.array(driving))


def fit(drives: Sequence[MatchedDrives], base: MatchingConfig) -> dict[tuple[float, float], dict[str, float]]:
    """Mean share of right links by roads, for each scale [m] and weight of connection."""
    out: dict[tuple[float, float], dict[str, float]] = {}
    for scale, connection in product(SCALES_M, CONNECTIONS):
        config = base.replace(topological={"scale_m": scale, "connection": connection})
        shares: dict[str, list[float]] = {}
        for drive in drives:
            shares.setdefault(drive.roads, []).append(drive.share(config))
        out[scale, connection] = {roads: float(np.mean(each)) for roads, each in shares.items()}
    return out


def _mean(by_roads: Mapping[str, float]) -> float:
    return float(np.mean([*by_roads.values()]))


def main() -> None:
    """Print the table; see the module."""
    from lanebound.agents.studies.context_study import ContextStudyConfig

    study = ContextStudyConfig()
    seeds = list(range(TRAINING, TRAINING + DRIVES_EACH))
    drives = [
        record(roads, TRAINING + number, seeds, POINTS, study)
        for roads in ("urban", "rural", "mixed")
        for number in range(MAPS)
    ]
    found = fit(drives, study.monitor.matching)
    print("scale_m connection    mean  urban  rural  mixed   [% right links]")
    for (scale, connection), by_roads in sorted(found.items(), key=lambda item: -_mean(item[1])):
        cells = " ".join(f"{100.0 * share:6.2f}" for share in (_mean(by_roads), *by_roads.values()))
        print(f"{scale:7g} {connection:10g}  {cells}")


if __name__ == "__main__":
    main()
