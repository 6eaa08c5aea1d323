"""Scores of map matching on roads that exist: S5's monitor next to the methods of its Table 5 (Quddus, Velaga, ...).

Drives follow random routes through street maps of OpenStreetMap, under the buildings of the map or under an open sky.
A receiver has code positions of its first band, some drives have faults, and the map of the vehicle has errors. One
topological matcher matches all points; every method scores the same matches. A point is wrong if the matched link is
not that of the drive, or the matched point farther away than the alert limit. Points in motion with a position count.

A threshold is fitted on the drives of all other maps, by one of three rules, and judged on the drives of a map:
``crossing`` (S5's: false alarms and missed detections are equally many), ``best`` (the largest OCDR), ``equal`` (the
same share of right points is warned of by all methods). Intervals are by drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.context_drive import navigator_config
from lanebound.agents.studies.route_drives import PACKAGES, truths_of
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.assessment.plotting import INK, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import WarningSweep, sweep_thresholds
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import code_fix
from lanebound.integrity.monitoring.context.link_scores import ScoreKind, make_score
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextVerdict, match_inputs
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import STATION_M, Leg, RouteMotion
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.journeys.streets import AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG, EdgeStations, at_hour
from lanebound.integrity.sky.maps.city import city_of
from lanebound.integrity.sky.maps.generated import named_map
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.records import MapFrame
from lanebound.integrity.sky.scene import City, clad
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

THRESHOLDS = np.arange(0.0, 100.5, 0.25)
RULES = "crossing", "best", "equal"
ALONE, PUBLISHED = "alone", "published"  # the score by itself, and after the phases that its authors have before it
PROBABILITY = "probability"  # of the link, by the emissions of the matcher: what a score has to add to
SCORES = (*(str(kind) for kind in ScoreKind), PROBABILITY)
BEFORE: dict[str, tuple[str, ...]] = {"context": ("position", "speed"), "velaga": ("position",)}
S5_TABLE_5 = {  # OCDR, but of Yu the missed detection rate alone; S5 Table 5
    "context": "98.6 %", "quddus": "91.1 %", "velaga": "98.2 %", "jabbour": "88.8 %", "yu": "MDR 1.41 %",
}  # fmt: skip
OPEN = "open"
GROUPS: dict[str, Callable[[Mapping[str, Any]], bool]] = {"all": lambda _: True, "with faults": lambda d: d["faulty"]}
RESAMPLES, CONFIDENCE = 2000, 0.95
COLOURS = dict(zip(SCORES, ("#000000", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#999999"), strict=True))


class MapMatchingConfig(Config):
    """Maps, drives, and what vehicles have."""

    maps: tuple[str, ...] = Field(min_length=2, description="packaged maps, files, or generated:SEED")
    skies: tuple[str, ...] = Field(
        (OPEN, "urban"), min_length=1, description="levels that give instruments; all but open with the map's buildings"
    )
    drives: int = Field(40, ge=2, description="on each map under each sky [-]")
    length_m: float = Field(4000.0, ge=500, le=50_000, description="of a route at least [m]")
    seed: int = Field(401, ge=0, description="of routes, hours, instruments, maps and faults")
    faults: str = Field("sensors/fault_priors_stress", description="preset of fault rates")
    fault_share: float = Field(0.5, ge=0, le=1, description="of the drives have faults [-]")
    equal_far: float = Field(0.05, gt=0, lt=1, description="share of right points warned of, of the rule equal [-]")
    warm_up_s: float = Field(20.0, ge=0, description="standing before a drive [s]")
    node_m: float = Field(10.0, ge=0, description="from a node, within which both links of the route are right [m]")
    map_errors: MapErrorsConfig = Field(
        MapErrorsConfig(shift_m=3.0, missing=0.02, wrong_topology=0.02),
        description="errors of the map of each vehicle; chosen, as of the study of S5's monitor",
    )
    monitor: ContextConfig = Field(default_factory=ContextConfig, description="S5's; its matcher is that of all")
    gnss: GnssConfig = Field(
        default_factory=lambda: GnssConfig.preset("sensors/gnss_automotive"), description="receiver; its first band"
    )
    drive: DriveConfig = Field(DriveConfig(), description="accelerations; the speed limits are those of the streets")


def run_map_matching(
    config: MapMatchingConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing drives; writes ``results.json`` and a figure, returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or a map has no streets that lead back to themselves.
    """
    claim(out, "map matching", config, PACKAGES)
    names = [
        f"{m}-{s}-{k}" for m in range(len(config.maps)) for s in range(len(config.skies)) for k in range(config.drives)
    ]
    parts = parts_of(config, work_drive, names, out, jobs, on_progress)
    result = {"config": config.to_dict(), **summary(config, list(parts.values()))}
    save(roc_figure(result), out / "roc.svg")
    return stored(result, out)


# Drives


class DrivenStreets(NamedTuple):
    """A map as it is: streets, their links for matching, and stations of the sky along the streets that can be driven.

    known : edges from each of which each can be reached, without those below a roof
    """

    frame: MapFrame
    graph: StreetGraph
    links: RoadMap
    known: tuple[int, ...]
    stations: EdgeStations


@lru_cache(maxsize=8)
def streets_of(name: str) -> DrivenStreets:
    """The streets of a map.

    Raises
    ------
    InputError
        No street leads back to itself.
    """
    streets = named_map(name)
    graph = StreetGraph.of(streets)
    known = tuple(sorted(k for k in graph.connected if not graph.edges[k].way.covered))
    if len(known) < 2:
        raise InputError(f"map {name} must have streets that lead back to themselves, got none: cut a larger part")
    stations = EdgeStations.along([graph.edges[k] for k in known], STATION_M)
    return DrivenStreets(streets.frame, graph, links_of(graph), known, stations)


def links_of(graph: StreetGraph) -> RoadMap:
    """All edges of a street graph as links, named by their numbers."""
    number = {node: k for k, node in enumerate(graph.junctions)}
    place: dict[int, Array] = {}
    for edge in graph.edges:
        place[edge.start], place[edge.end] = edge.points_en_m[0], edge.points_en_m[-1]
    return RoadMap.of_lines(
        np.array([place[node] for node in graph.junctions]),
        [(number[edge.start], number[edge.end]) for edge in graph.edges],
        [edge.points_en_m for edge in graph.edges],
        limit_mps=[edge.way.speed_limit_mps for edge in graph.edges],
    )


@lru_cache(maxsize=8)
def _mask(name: str, sky: str) -> SkyMask:
    """What the buildings of a map leave of the sky at its stations; an open sky has none."""
    city = City.empty()
    if sky != OPEN:
        city = city_of(named_map(name))
        shares = SkyLevel.named(sky).material_shares
        city = replace(city, material=clad(city.building, shares, named_generator(0, "facades")))
    return SkyMask.of_stations(
        streets_of(name).stations.antenna_enu_m, city, STATION_M, AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG
    )


def wandering(streets: DrivenStreets, length_m: float, rng: np.random.Generator) -> list[int]:
    """A route: from edge to edge by allowed turns, to those that were driven least, until it is long enough."""
    edges, onward = streets.graph.edges, dict[int, list[int]]()
    known = set(streets.known)
    for before, after in streets.graph.turns:
        if after in known:
            onward.setdefault(before, []).append(after)
    out, driven = [int(rng.choice(streets.known))], dict[int, int]()
    total = edges[out[0]].length_m
    while total < length_m and out[-1] in onward:
        choices = onward[out[-1]]
        cost = np.array([driven.get(k, 0) for k in choices]) + 0.5 * rng.random(len(choices))
        out.append(choices[int(np.argmin(cost))])
        driven[out[-1]] = driven.get(out[-1], 0) + 1
        total += edges[out[-1]].length_m
    return out


class ScoredPoints(NamedTuple):
    """Points of one drive (T,): which are wrong, what the first two phases passed, and all scores by name."""

    wrong_link: Bools
    beyond: Bools
    passed: dict[str, Bools]
    scores: dict[str, Array]

    @property
    def wrong(self) -> Bools:
        """A wrong link, or a matched point beyond the alert limit."""
        return self.wrong_link | self.beyond


def work_drive(config: MapMatchingConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Drive once and sweep the thresholds of all scores; a drive depends on no other."""
    which, sky, number = (int(text) for text in name.split("-"))
    faulty = int((number + 1) * config.fault_share) > int(number * config.fault_share)
    found = judged_drive(
        config, config.maps[which], config.skies[sky], [config.seed, which, sky, number], faulty, advance
    )
    return {
        "map": config.maps[which], "sky": config.skies[sky], "faulty": faulty,
        "points": found.wrong.size, "wrong": int(found.wrong.sum()), "wrong_link": int(found.wrong_link.sum()),
        "beyond": int(found.beyond.sum()),
        "sweeps": {
            score: {
                chain: _swept(np.where(_all_passed(found, before), values, -1.0), found.wrong)
                for chain, before in ((ALONE, ()), (PUBLISHED, BEFORE.get(score, ())))
            }
            for score, values in found.scores.items()
        },
    }  # fmt: skip


def _all_passed(found: ScoredPoints, phases: Sequence[str]) -> Bools:
    return np.all([found.passed[phase] for phase in phases], 0) if phases else np.ones(found.wrong.size, np.bool_)


def _swept(score: Array, wrong: Bools) -> list[list[int]]:
    sweep = sweep_thresholds(score, wrong, THRESHOLDS)
    return [sweep.false_alarms.tolist(), sweep.missed.tolist()]


def judged_drive(
    config: MapMatchingConfig, name: str, sky: str, seeds: list[int], faulty: bool, advance: Advance = ignore
) -> ScoredPoints:
    """One drive through a map under a sky: its points in motion with a position."""
    streets, monitor, rng = streets_of(name), config.monitor, named_generator(seeds, "journeys")
    route = wandering(streets, config.length_m, rng)
    hour, own, campaign = 24.0 * float(rng.random()), int(rng.integers(2**32)), int(rng.integers(2**32))
    at = {k: streets.stations.of(i) for i, k in enumerate(streets.known)}
    rows = np.concatenate([np.arange(at[k].start, at[k].stop) for k in route])
    edges = [streets.graph.edges[k] for k in route]
    way = RouteMotion.of(edges, Leg(tuple(route), 0.0, 1.0), streets.stations, rows, config.drive, 1.0)
    place = SkyConfig().replace(lat_deg=streets.frame.lat_deg, lon_deg=streets.frame.lon_deg)
    base = SkyLevel.named(sky).navigator(navigator_config(config.gnss, at_hour(place, hour)))
    wait = round(config.warm_up_s)
    epochs = wait + way.speed_mps.size - 1
    track = SkyTrack.from_config(base.sky, epochs + 60.0)
    faults = FaultSchedule(
        random_campaign(
            FaultPriors.preset(config.faults), float(epochs), named_generator(campaign, "faults"),
            track.at(track.start_s, np.zeros(1, np.int64)),
        ) if faulty else ()
    )  # fmt: skip
    navigator = Navigator(base, track, _mask(name, sky), [own], faults=faults)
    matched = with_errors(streets.links, config.map_errors, named_generator(seeds, "map"))
    watch, points = ContextMonitor(monitor, matched, 1, 1.0), _Points()
    scores = {
        str(kind): score
        for kind in ScoreKind
        if (score := make_score(kind, matched, monitor.matching, monitor.map.map_sigma_m, monitor.map.intervals, 1))
    }
    for k, truth in enumerate(truths_of([way], wait, epochs, 1.0)):
        m = navigator.measure(truth)
        fix = code_fix(m, monitor.codes)
        verdict = watch.step(fix, m.odometer.speed_mps)
        inputs = match_inputs(fix, verdict.speed, 1.0)
        said = {score: float(of.step(verdict.match, inputs)[0]) for score, of in scores.items()}
        if k >= wait and fix.located[0] and not verdict.speed.at_rest[0]:
            arc = float(way.arc_m[k - wait + 1])
            right = _on_route(route, way.starts_m, int(verdict.link[0]), arc, config.node_m)
            off = float(np.linalg.norm(verdict.match.foot_en_m[0] - truth.position_enu_m[0, :2]))
            points.add(not right, off > monitor.position.alert_limit_m, verdict, said)
        advance((k + 1) / epochs)
    return points.done()


def _on_route(route: Sequence[int], starts_m: Array, link: int, arc_m: float, node_m: float) -> bool:
    """Whether a link is one of the route within ``node_m`` of a place along it."""
    here = (starts_m[:-1] - node_m <= arc_m) & (arc_m <= starts_m[1:] + node_m)
    return bool((here & (np.array(route) == link)).any())


class _Points:
    """Rows of :class:`ScoredPoints` as they come."""

    def __init__(self) -> None:
        self._rows: list[tuple[bool, bool, bool, bool]] = []
        self._scores: list[dict[str, float]] = []

    def add(self, wrong_link: bool, beyond: bool, v: ContextVerdict, said: Mapping[str, float]) -> None:
        """One point and what all methods say of it."""
        self._rows.append((wrong_link, beyond, bool(v.position.passed[0]), bool(v.speed.passed[0])))
        own = {"context": float(v.score[0]), PROBABILITY: 100.0 * float(v.match.probability[0])}
        self._scores.append({**own, **said})

    def done(self) -> ScoredPoints:
        """All points."""
        wrong, beyond, position, speed = np.array(self._rows, np.bool_).reshape(-1, 4).T
        scores = {name: np.array([row[name] for row in self._scores]) for name in SCORES}
        return ScoredPoints(wrong, beyond, {"position": position, "speed": speed}, scores)


# Results


def summary(config: MapMatchingConfig, drives: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates of every map, group of drives, score, chain and rule; thresholds are those of the other maps."""
    rows, curves = [], []
    for name in config.maps:
        others = [d for d in drives if d["map"] != name]
        own = [d for d in drives if d["map"] == name]
        groups = {sky: [d for d in own if d["sky"] == sky] for sky in config.skies}
        groups |= {group: [d for d in own if of(d)] for group, of in GROUPS.items()}
        for score in SCORES:
            for chain in (ALONE, PUBLISHED):
                at = fitted(_total(others, score, chain), sum(d["wrong"] for d in others), config.equal_far)
                key = {"map": name, "score": score, "chain": chain}
                curves.append(key | _curve(own, score, chain, config.equal_far))
                rows += [
                    key | {"group": group, "rule": rule, "threshold": float(THRESHOLDS[at[rule]])}
                    | rates(some, score, chain, at[rule])
                    for group, some in groups.items() if some
                    for rule in RULES
                ]  # fmt: skip
    counts = [
        {"map": name, "sky": sky} | {
            key: sum(d[key] for d in drives if (d["map"], d["sky"]) == (name, sky))
            for key in ("points", "wrong", "wrong_link", "beyond", "faulty")
        }
        for name in config.maps for sky in config.skies
    ]  # fmt: skip
    return {"drives": counts, "rates": rows, "curves": curves}


def _total(drives: Sequence[Mapping[str, Any]], score: str, chain: str) -> WarningSweep:
    false_alarms, missed = np.sum([d["sweeps"][score][chain] for d in drives], 0)
    return WarningSweep(THRESHOLDS, false_alarms, missed, sum(d["points"] for d in drives))


def fitted(sweep: WarningSweep, wrong: int, equal_far: float) -> dict[str, int]:
    """Place in ``THRESHOLDS`` of the threshold of each rule.

    ``equal`` is the largest threshold by which at most ``equal_far`` of the right points are warned of, the least one
    where even that warns of more.
    """
    right = max(sweep.points - wrong, 1)
    few = np.flatnonzero(sweep.false_alarms <= equal_far * right)
    crossed = np.flatnonzero(sweep.false_alarms >= sweep.missed)
    return {
        "crossing": int(crossed[0]) if crossed.size else THRESHOLDS.size - 1,
        "best": int(np.argmin(sweep.false_alarms + sweep.missed)),
        "equal": int(few[-1]) if few.size else 0,
    }


def rates(drives: Sequence[Mapping[str, Any]], score: str, chain: str, at: int) -> dict[str, list[float | None]]:
    """OCDR, FAR and MDR over all points (S5 equations 15 to 17), and shares of right and of wrong points, by drive.

    Each is a value and its interval; None where no drive has such points.
    """
    rows = np.array(
        [[d["points"], d["wrong"], *np.array(d["sweeps"][score][chain])[:, at]] for d in drives], np.float64
    )  # fmt: skip
    drawn = named_generator(0, "resamples").integers(len(rows), size=(RESAMPLES, len(rows)))
    sums = np.concatenate([rows.sum(0)[None], rows[drawn].sum(1)])
    points, wrong, false_alarms, missed = sums.T
    return {
        "ocdr": _interval(points - false_alarms - missed, points), "far": _interval(false_alarms, points),
        "mdr": _interval(missed, points), "per_right": _interval(false_alarms, points - wrong),
        "per_wrong": _interval(missed, wrong),
    }  # fmt: skip


def _interval(events: Array, of: Array) -> list[float | None]:
    """The first ratio, and the interval of the others that have points."""
    if not of[0] > 0.0:
        return [None, None, None]
    tail, some = 0.5 * (1.0 - CONFIDENCE), of > 0.0
    ratio = events[some] / of[some]
    return [float(ratio[0]), *(float(q) for q in np.quantile(ratio[1:], (tail, 1.0 - tail)))]


def _curve(drives: Sequence[Mapping[str, Any]], score: str, chain: str, equal_far: float) -> dict[str, Any]:
    """Warned shares of right and wrong points by threshold; the area below the second over the first one, by drive;
    and the second where the first is ``equal_far``, on the line between neighbouring thresholds."""
    sweeps = np.array([d["sweeps"][score][chain] for d in drives], np.float64)
    wrong = np.array([d["wrong"] for d in drives], np.float64)
    right = np.array([d["points"] for d in drives]) - wrong
    drawn = named_generator(0, "resamples").integers(len(drives), size=(RESAMPLES, len(drives)))
    times = np.stack([np.bincount(one, minlength=len(drives)) for one in drawn])
    times = np.concatenate([np.ones((1, len(drives)), np.int64), times])  # as they are, and drawn again
    x = times @ sweeps[:, 0] / np.maximum(times @ right, 1.0)[:, None]
    y = 1.0 - times @ sweeps[:, 1] / np.maximum(times @ wrong, 1.0)[:, None]
    edge = np.ones((len(times), 1))
    across, up = np.concatenate([0.0 * edge, x, edge], 1), np.concatenate([0.0 * edge, y, edge], 1)
    area = np.sum(0.5 * (up[:, 1:] + up[:, :-1]) * np.diff(across), 1)
    return {
        "right": np.round(x[0], 5).tolist(), "wrong": np.round(y[0], 5).tolist(),
        "area": _interval(np.where(times @ wrong > 0.0, area, 0.0), np.asarray(times @ wrong > 0.0, np.float64)),
        "detected": float(np.interp(equal_far, across[0], up[0])) if wrong.any() else None,
    }  # fmt: skip


def roc_figure(result: Mapping[str, Any]) -> Figure:
    """Wrong points warned of over right points warned of, by score, a panel a map."""
    maps = result["config"]["maps"]
    figure = new_figure(3.8 * len(maps), 3.6)
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(maps))), maps, strict=True):
        for curve in result["curves"]:
            if (curve["map"], curve["chain"]) == (name, ALONE):
                right, wrong = ([100.0 * v for v in curve[key]] for key in ("right", "wrong"))
                axes.plot(right, wrong, color=COLOURS[curve["score"]], label=curve["score"], lw=1.2)
        axes.plot([0, 100], [0, 100], ":", color=INK, lw=0.8)
        tidy(axes, title=short(name), xlabel="right points warned of [%]", ylabel="wrong points warned of [%]")
        legend(axes)
    return figure


def short(name: str) -> str:
    """The name of a map without its folder and endings."""
    return Path(name).name.partition(".")[0]


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    rows = [
        (short(d["map"]), d["sky"], f"{d['points']:,}", f"{d['wrong']:,}", f"{d['wrong_link']:,}", f"{d['beyond']:,}",
         str(d["faulty"]))
        for d in result["drives"]
    ]  # fmt: skip
    heads = ("map", "sky", "points", "wrong", "wrong link", "beyond the limit", "drives with faults")
    yield "Points in motion with a position", (heads, rows)
    yield "By S5's threshold rule, fitted on the other maps; intervals of 95 % by drive", crossing_rows(result)
    yield "At equal false alarms of right points, fitted on the other maps; scores alone", equal_rows(result)
    yield "Largest OCDR on the other maps; scores alone", best_rows(result)


def _of(result: Mapping[str, Any], rule: str, chain: str, group: str | None = None) -> list[Mapping[str, Any]]:
    return [
        r for r in result["rates"] if (r["rule"], r["chain"]) == (rule, chain) and r["group"] == (group or r["group"])
    ]  # fmt: skip


def crossing_rows(result: Mapping[str, Any]) -> Table:
    """Each score alone and after the phases that its authors have before it, next to S5's Table 5."""
    heads = ("score", "S5", "map", "drives", "threshold", "false alarms", "missed", "OCDR", "with its first phases")
    whole = {(r["map"], r["group"], r["score"]): r for r in _of(result, "crossing", PUBLISHED)}
    rows = _of(result, "crossing", ALONE)
    return heads, [
        (score, S5_TABLE_5.get(score, "-"), short(r["map"]), r["group"], f"{r['threshold']:g}", _text(r["far"]),
         _text(r["mdr"]), _text(r["ocdr"]),
         _text(whole[r["map"], r["group"], score]["ocdr"]) if score in BEFORE else "-")
        for score in SCORES for r in rows if r["score"] == score
    ]  # fmt: skip


def equal_rows(result: Mapping[str, Any]) -> Table:
    """Scores alone at the threshold of equal false alarms, and the curve of the judged map itself."""
    curve = {(c["map"], c["score"]): c for c in result["curves"] if c["chain"] == ALONE}
    share = result["config"]["equal_far"]
    heads = ("score", "map", "threshold", "warned of right", "wrong not warned of", "OCDR",
             f"not warned of where {100.0 * share:g} % of right are", "area")  # fmt: skip
    rows = _of(result, "equal", ALONE, "all")
    return heads, [
        (score, short(r["map"]), f"{r['threshold']:g}", _text(r["per_right"]), _text(r["per_wrong"]), _text(r["ocdr"]),
         *(("-", "-") if (own := curve[r["map"], score])["detected"] is None
           else (f"{100.0 * (1.0 - own['detected']):.0f} %", "{:.2f} ({:.2f} .. {:.2f})".format(*own["area"]))))
        for score in SCORES for r in rows if r["score"] == score
    ]  # fmt: skip


def best_rows(result: Mapping[str, Any]) -> Table:
    """Scores alone at the threshold of the largest OCDR, next to never warning."""
    rows = _of(result, "best", ALONE, "all")
    never = {d["map"]: 0.0 for d in result["drives"]}
    for name in never:
        own = [d for d in result["drives"] if d["map"] == name]
        never[name] = 1.0 - sum(d["wrong"] for d in own) / sum(d["points"] for d in own)
    heads = ("score", "map", "threshold", "warned of right", "wrong not warned of", "OCDR", "OCDR of never warning")
    return heads, [
        (r["score"], short(r["map"]), f"{r['threshold']:g}", _text(r["per_right"]), _text(r["per_wrong"]),
         _text(r["ocdr"]), f"{100.0 * never[r['map']]:.1f} %")
        for score in SCORES for r in rows if r["score"] == score
    ]  # fmt: skip


def _text(found: Sequence[float | None]) -> str:
    value, low, high = found
    if value is None or low is None or high is None:
        return "-"
    return f"{100.0 * value:.1f} ({100.0 * low:.1f} .. {100.0 * high:.1f}) %"
