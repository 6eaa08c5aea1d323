"""Two vehicles and two roadside units that cooperate: S2 Table 5, and levels while a node lies.

Each drive has two vehicles in a street, each with codes, Doppler, gyro and odometer, and two units that stand in it.
All share their codes at 1 Hz, measure UWB ranges, or both. ``local`` is each vehicle alone: the INS/GNSS solution that
S2 compares with. Signals, instruments and streets are those of all other studies; nothing is fitted to S2.

A lying vehicle shares codes of another place from some second on; a wrong unit has wrong coordinates from the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator
from scipy.stats import chi2

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.street_drives import StreetDrivesConfig, city_of, mask_of, navigator_of, road_of
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.motion.drive import CityDrive
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.fleet import Fleet, FleetConfig, Placed
from lanebound.integrity.navigators.navigator import Measurements
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.cooperative.joint_filter import JointFilterConfig
from lanebound.integrity.positioning.cooperative.particles import Ranges
from lanebound.integrity.sensors.uwb import RangingConfig
from lanebound.integrity.sky.raytrace import first_hits
from lanebound.integrity.sky.scene import City

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

UNITS_AT_M = (150.0, 450.0)  # places of the roadside units along the street
BESIDE_M = 5.0  # they stand to the right of the lane, under the sky of the lane
TOGETHER_M = 60.0  # vehicles start within so much of the street
MODULE_M = 1.5  # height of antennas and modules: the lines between them
NO_SATELLITES = 3  # of each vehicle in the case ``few``
PUBLISHED = {
    "local": (2.59, 4.77, 4.46, 10.92),
    "ekf": (1.21, 2.22, 2.45, 4.24),
    "mdpc": (1.69, 3.19, 3.20, 5.63),
    "spawn": (1.67, 3.24, 3.19, 4.98),
    "md_spawn": (1.63, 3.09, 3.08, 4.71),
}
"""S2 Table 5: mean RMSE 2D and 3D, largest error 2D and 3D [m]."""
REFLECTIONS_M = {"open": (0.0, 0.0), "suburban": (0.2, 0.4), "urban": (0.7, 1.6), "dense": (1.4, 2.7)}
"""Declared multipath: RMS of codes from 36 dB-Hz on, and of all codes, in simulated streets of seed 101
(``CodeErrorBudget``). Estimators use codes of the first kind and weigh them so; levels and tests count on the second.
"""


class CooperativeStudyConfig(Config):
    """Which drives, cases and estimators."""

    seeds: int = Field(100, ge=1, le=10_000, description="drives under each sky")
    skies: tuple[str, ...] = Field(
        ("open", "suburban", "urban", "dense"), min_length=1, description="presets of the sky"
    )
    cases: tuple[Literal["codes", "uwb", "both", "few", "levels", "vehicle", "unit"], ...] = Field(
        ("codes", "uwb", "both", "few", "levels", "vehicle", "unit"),
        min_length=1,
        description="what is shared: codes, ranges or both; few: both, with three satellites of each vehicle for a "
        "while; levels: of the EKF with both and a search for faults; vehicle, unit: one of them lies there",
    )
    estimators: tuple[str, ...] = Field(
        ("ekf", "mdpc", "spawn", "md_spawn", "gaussian", "split"), min_length=1, description="of the fleet"
    )
    vehicles: int = Field(2, ge=2, le=16, description="vehicles in a drive; S2 Table 4")
    particles: int = Field(500, ge=10, description="of a node; of MDPC, of the fleet")
    warm_up_s: float = Field(20.0, ge=0, description="time before the first epoch that counts [s]")
    duration_s: float = Field(60.0, gt=0, description="length of a drive after it [s]")
    few_s: float = Field(20.0, gt=0, description="end of the drive with few satellites [s]")
    link_m: float = Field(300.0, gt=0, description="radio range within which codes are shared [m]")
    lie_m: tuple[float, float] = Field((2.0, 20.0), description="range of a lie, in any horizontal direction [m]")
    street_m: float = Field(1200.0, ge=500, le=20_000, description="length of a street [m]")
    ranging: RangingConfig = Field(
        RangingConfig(range_m=91.4, late_mean_m=0.3), description="ranges between nodes, each with one module"
    )
    range_sigma_m: float = Field(0.1, gt=0, description="declared 1 sigma of a range [m]; noise, offset and excess")
    first_seed: int = Field(1901, ge=0, description="of the drives; nothing was fitted there")

    @model_validator(mode="after")
    def _skies_are_known(self) -> CooperativeStudyConfig:
        for sky in self.skies:
            SkyLevel.named(sky)
            if sky not in REFLECTIONS_M:
                raise ConfigError(f"skies must be among {', '.join(REFLECTIONS_M)}, got {sky!r}: correct the name")
        return self

    def drives(self) -> StreetDrivesConfig:
        """The streets and the nodes in them."""
        return StreetDrivesConfig(
            skies=self.skies, faults=None, vehicles=self.vehicles + len(UNITS_AT_M), duration_s=self.duration_s,
            warm_up_s=self.warm_up_s, length_m=self.street_m, seed=self.first_seed,
            navigator={"gnss": {"undifferenced": True}},
        )  # fmt: skip

    def fleet(self, sky: str, case: str) -> FleetConfig:
        """What the fleet is told of the errors under a sky."""
        own = self.drives().navigator_in(sky)
        searching = case in ("levels", "vehicle", "unit")
        return FleetConfig(
            estimators=("ekf",) if searching else self.estimators,
            local=JointFilterConfig(
                codes=CodeErrorBudget(reflections_m=REFLECTIONS_M[sky][searching]),
                odometer_scale=own.odometer.scale_sigma,
                doppler_mps=own.positioning.doppler.sigma_mps,
            ),
            network={"particles": self.particles},
            exclusion={} if searching else None,
            share_codes=case != "uwb",
        )  # fmt: skip


class FleetMoment(NamedTuple):
    """An epoch of the network: truth of the nodes, their measurements, pairs that hear each other, and ranges."""

    truth: Truth
    measured: Measurements
    pairs: Ints
    ranges: Ranges


def moments(config: CooperativeStudyConfig, sky: str, number: int, uwb: bool) -> Iterator[FleetMoment]:
    """The epochs of the instruments of drive ``number``; pairs and ranges as they are then."""
    drives, rng = config.drives(), named_generator([config.first_seed, number], "uwb")
    city, road = city_of(drives, sky, number), road_of(drives, number)
    navigator = navigator_of(drives, sky, number, mask_of(drives, sky, number))
    arcs, lanes = np.array(UNITS_AT_M), np.zeros(len(UNITS_AT_M), np.int64)
    places, headings = road.pose_at(arcs, road.lane_lateral_m(lanes) + BESIDE_M)
    nodes, still = config.vehicles + len(arcs), np.zeros((len(arcs), 2))
    pairs = np.array([(i, j) for i in range(nodes) for j in range(i) if j < config.vehicles], np.int64)
    links = _Links(config, city, pairs, rng)
    seeds = named_generator([config.first_seed, number], "fleet").integers(2**32, size=config.vehicles)
    traffic = Streams([int(seed) for seed in seeds])
    car = CityDrive(road, drives.drive, navigator.config.dt_s)
    state = car.start(traffic, spread_m=TOGETHER_M)
    while True:
        truth = car.step(state, traffic)
        units = Truth.between(
            truth.time_s, truth.dt_s, (places, places), (still, still), (headings, headings), arcs, lanes
        )
        both = Truth.of(truth.time_s, truth.dt_s, np.concatenate([truth.records, units.records]))
        measured, place = navigator.measure(both), both.position_enu_m
        near = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=-1) < config.link_m
        yield FleetMoment(both, measured, pairs[near], links.measure(place) if uwb else links.none)


class _Links:
    """Links of the modules of pairs of nodes: a line that a building crosses gives no range."""

    def __init__(self, config: CooperativeStudyConfig, city: City, pairs: Ints, rng: np.random.Generator) -> None:
        self.law, self.declared_m = config.ranging.figures(FleetConfig().epoch_s)[0], config.range_sigma_m
        self.city, self.pairs, self.rng = city, pairs, rng
        self.offset = np.sqrt(2.0) * self.law["module_sigma_m"] * rng.standard_normal(len(pairs))  # of two modules
        nothing = np.empty(0)
        self.none = Ranges(np.empty((0, 2), np.int64), nothing, nothing)

    def measure(self, place_m: Array) -> Ranges:
        """Ranges at positions (N, 3): of pairs near each other without a building between them."""
        law, rng, count = self.law, self.rng, len(self.pairs)
        lifted = place_m + np.array([0.0, 0.0, MODULE_M])
        start, way = lifted[self.pairs[:, 1]], place_m[self.pairs[:, 0]] - place_m[self.pairs[:, 1]]
        distance, kept = np.linalg.norm(way, axis=-1), rng.random(count) >= law["loss"]
        late = np.where(rng.random(count) < law["late_share"], rng.exponential(law["late_mean_m"], count), 0.0)
        measured = np.maximum(distance + self.offset + late + law["sigma_m"] * rng.standard_normal(count), 0.0)
        kept &= (distance < law["range_m"]) & (distance > MODULE_M)
        if kept.any() and len(self.city):
            kept[kept] = first_hits(self.city.grid, start[kept], way[kept]).t >= 1.0
        sigma_m = np.full(int(kept.sum()), self.declared_m)
        return Ranges(self.pairs[kept], measured[kept], sigma_m, float(law["late_share"]), float(law["late_mean_m"]))


def work_drive(config: CooperativeStudyConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """One drive under one sky in each case: figures by case and estimator."""
    sky, number = config.skies[int(name.split("-")[0])], int(name.split("-")[1])
    found: dict[str, Any] = {}
    for k, case in enumerate(config.cases):
        found[case] = _drive(config, sky, number, case)
        advance((k + 1) / len(config.cases))
    return found


def _drive(config: CooperativeStudyConfig, sky: str, number: int, case: str) -> dict[str, Any]:
    rng = named_generator([config.first_seed, number], f"case-{case}")
    vehicles, span = config.vehicles, config.warm_up_s + config.duration_s
    angle, size = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*config.lie_m)
    lie, liar = size * np.array([np.sin(angle), np.cos(angle), 0.0]), int(rng.integers(vehicles))
    lie_from = config.warm_up_s + rng.uniform(0.0, 0.5) * config.duration_s if case == "vehicle" else np.inf
    fleet: Fleet | None = None
    rows, wrong = [], int(rng.integers(len(UNITS_AT_M)))
    every = round(FleetConfig().epoch_s / FleetConfig().dt_s)
    for k, moment in enumerate(moments(config, sky, number, case != "codes")):
        truth, time_s = moment.truth, moment.truth.time_s
        if time_s > span:
            break
        if fleet is None:
            places = truth.position_enu_m[vehicles:].copy()
            if case == "unit":
                places[wrong] += lie
            fleet = Fleet(config.fleet(sky, case), vehicles, moment.measured.sky.system, places, number)
            start = fleet.config.local
            fleet.start(
                truth.position_enu_m[:vehicles] + 0.5 * start.start_m * rng.standard_normal((vehicles, 3)),
                truth.heading_rad[:vehicles] + np.deg2rad(start.start_heading_deg) * rng.standard_normal(vehicles),
            )
        fleet.move(moment.measured)
        if (k + 1) % every:
            continue
        measured = moment.measured
        if case == "few" and time_s > span - config.few_s:
            measured = _few(measured, vehicles)
        if time_s >= lie_from:
            measured = _lying(measured, liar, lie)
        placed = fleet.share(measured, moment.pairs, moment.ranges)
        if time_s > config.warm_up_s:
            rows.append((time_s, truth.position_enu_m[:vehicles], placed))
    assert fleet is not None
    if fleet.bank is None:
        late = span - config.few_s if case == "few" else 0.0
        names = list(rows[0][2])
        return {name: _figures([(place, placed[name]) for t, place, placed in rows if t > late]) for name in names}
    guilty = {"vehicle": liar, "unit": vehicles + wrong}.get(case, -1)
    since = lie_from if case == "vehicle" else 0.0
    return _judged(rows, fleet, guilty, since) | {"lie_m": size if guilty >= 0 else 0.0}


def _few(m: Measurements, vehicles: int) -> Measurements:
    """With the highest ``NO_SATELLITES`` of each vehicle's satellites alone."""
    height = m.sky.los_enu[m.sky.index[0]][:, 2]
    tracked = m.gnss.tracked.copy()
    for v in range(vehicles):
        seen = np.flatnonzero(tracked[v])
        tracked[v] = False
        tracked[v, seen[np.argsort(-height[seen])][:NO_SATELLITES]] = True
    return replace(m, gnss=replace(m.gnss, tracked=tracked))


def _lying(m: Measurements, node: int, lie_m: Array) -> Measurements:
    """With codes of a node as they would be ``lie_m`` away."""
    assert m.gnss.raw_code_m is not None
    codes = m.gnss.raw_code_m.copy()
    codes[node] -= (m.sky.los_enu[m.sky.index[0]] @ lie_m)[:, None]
    return replace(m, gnss=replace(m.gnss, raw_code_m=codes))


def _figures(epochs: list[tuple[Array, Placed]]) -> dict[str, float]:
    """Errors of a drive: RMS and largest, in the plane and in space, and NEES in the plane."""
    error = np.array([placed.position_m - truth for truth, placed in epochs])
    covariance = np.array([placed.covariance_m2[:, :2, :2] for _, placed in epochs])
    plane, space = np.linalg.norm(error[..., :2], axis=-1), np.linalg.norm(error, axis=-1)
    nees = np.einsum("evi,evi->ev", error[..., :2], np.linalg.solve(covariance, error[..., :2, None])[..., 0])
    return {
        "rms2d_m": float(np.sqrt(np.square(plane).mean())), "rms3d_m": float(np.sqrt(np.square(space).mean())),
        "max2d_m": float(plane.max()), "max3d_m": float(space.max()), "nees": float(nees.mean()),
        "surprised": float((nees > chi2.isf(1e-3, 2)).mean()),
    }  # fmt: skip


def _judged(rows: list[Any], fleet: Fleet, guilty: int, since_s: float) -> dict[str, float]:
    """Levels of the honest vehicles against their errors, and whether the guilty node was found, and when."""
    honest = np.array([v for v in range(fleet.vehicles) if v != guilty])
    error = np.array([np.abs(placed["ekf"].position_m - truth)[honest, :2] for _, truth, placed in rows])
    level = np.array([placed["ekf"].level_m[honest] for _, _, placed in rows])
    local = np.array(
        [np.linalg.norm((placed["local"].position_m - truth)[honest, :2], axis=-1) for _, truth, placed in rows]
    )
    assert fleet.bank is not None
    times = {found.node: found.time_s for found in reversed(fleet.bank.excluded) if found.what == "node"}
    others = sum(found.node != guilty for found in fleet.bank.excluded)
    before = times.get(guilty, since_s) < since_s
    return {
        "epochs": float(error[..., 0].size), "beyond": float((error > level).any(-1).sum()),
        "level_m": float(np.median(level.max(-1))), "error_m": float(np.linalg.norm(error, axis=-1).max()),
        "local_m": float(local.max()),
        "found": float(guilty in times and not before), "delay_s": float(times.get(guilty, np.nan) - since_s),
        "innocent": float(others + before),
    }  # fmt: skip


def run_cooperative(
    config: CooperativeStudyConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing drives, and write ``cooperative.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "cooperative study", config, PACKAGES)
    names = [f"{k}-{number}" for number in range(config.seeds) for k in range(len(config.skies))]
    parts = parts_of(config, work_drive, names, out, jobs, on_progress)
    result: dict[str, Any] = {"config": config.to_dict(), "skies": {}}
    for k, sky in enumerate(config.skies):
        of = [part for name, part in parts.items() if name.startswith(f"{k}-")]
        result["skies"][sky] = {case: _summary(case, [part[case] for part in of]) for case in config.cases}
    return stored(result, out, "cooperative.json")


def _summary(case: str, parts: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Medians over drives of each estimator, or counts of what levels and the search did."""
    if case in ("levels", "vehicle", "unit"):
        counted = {
            key: float(np.sum([part[key] for part in parts])) for key in ("epochs", "beyond", "found", "innocent")
        }
        counted["drives"] = float(len(parts))
        counted["level_m"] = float(np.median([part["level_m"] for part in parts]))
        counted["error_m"] = float(np.max([part["error_m"] for part in parts]))
        delays = [part["delay_s"] for part in parts if part["found"]]
        counted["delay_s"] = float(np.median(delays)) if delays else float("nan")
        return counted
    return {
        name: {
            key: float((np.mean if key == "surprised" else np.median)([part[name][key] for part in parts]))
            for key in parts[0][name]
        }
        for name in parts[0]
    }


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """The tables, as far as their cases were run."""
    yield "Errors, medians over drives, and those of S2 Table 5 (of no stated environment)", error_rows(result)
    yield "Levels of the EKF, and the search for a faulty node", level_rows(result)


def error_rows(result: Mapping[str, Any]) -> Table:
    """RMS and largest errors, and the ratio of the RMS to that of the vehicles alone."""
    rows = []
    for name, of in PUBLISHED.items():
        rows.append(("S2", "", name, *(f"{v:.2f}" for v in (of[0], of[0] / PUBLISHED["local"][0], *of[1:])), "", ""))
    for sky, cases in result["skies"].items():
        for case, found in cases.items():
            if "local" not in found:
                continue
            for name, of in found.items():
                values = (of["rms2d_m"], of["rms2d_m"] / found["local"]["rms2d_m"], of["rms3d_m"], of["max2d_m"],
                          of["max3d_m"], of["nees"])  # fmt: skip
                rows.append((sky, case, name, *(f"{v:.2f}" for v in values), f"{100.0 * of['surprised']:.1f}"))
    heads = ("sky", "shared", "estimator", "RMS 2D [m]", "of alone", "RMS 3D [m]", "max 2D [m]", "max 3D [m]", "NEES",
             "beyond 1e-3 [%]")  # fmt: skip
    return heads, rows


def level_rows(result: Mapping[str, Any]) -> Table:
    """Epochs beyond a level, nodes found and accused."""
    rows = []
    for sky, cases in result["skies"].items():
        for case, of in cases.items():
            if "beyond" not in of:
                continue
            found = "-" if case == "levels" else f"{of['found']:.0f} of {of['drives']:.0f}"
            delay = "-" if not of["found"] else f"{of['delay_s']:.1f}"
            rows.append((
                sky, {"levels": "none"}.get(case, case), f"{of['beyond']:.0f} of {of['epochs']:.0f}",
                f"{of['level_m']:.2f}", f"{of['error_m']:.2f}", found, delay, f"{of['innocent']:.0f}",
            ))  # fmt: skip
    heads = ("sky", "faulty", "epochs beyond", "level [m]", "max error [m]", "found", "after [s]", "others excluded")
    return heads, rows


PACKAGES = ("lanebound.integrity", "lanebound.agents.studies", "lanebound.envs.sky")
