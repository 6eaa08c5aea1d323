"""``lanebound reproduce context``: the drives of S5 on generated roads, and its Tables 3 and 4, figure 8 and more.

Every drive is measured once. All matchers, both maps (true, and with errors), all forms of the speed phase and all
combinations of phases judge the same measurements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.reproduce.context_drive import DRIVES, ContextDrive, ContextPoint, DriveTable, drive_of
from lanebound.agents.reproduce.context_tables import summarise
from lanebound.agents.serialization import finite_or_none
from lanebound.integrity.assessment.charging_rates import ChargingConfig, charging_counts
from lanebound.integrity.assessment.speed_power import SpeedPowerConfig, speed_power
from lanebound.integrity.assessment.warning_rates import WarningCounts, sweep_thresholds
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextReason, ContextVerdict
from lanebound.integrity.monitoring.context.position_phase import check_position
from lanebound.integrity.monitoring.context.speed_phase import SpeedForm, SpeedPhase, SpeedTest
from lanebound.integrity.positioning.map_matching.generators import DriveEnvironment
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.matching import MatcherKind
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.constellation import SkyConfig

__all__ = ["ContextStudyConfig", "run_context"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

PACKAGES = ("lanebound.integrity", "lanebound.agents.reproduce", "lanebound.envs.sky")
THRESHOLDS = np.arange(0.0, 101.0)
ASSUMED = "assumed"
Judge = tuple[str, str]
"""A map and a matcher; or ASSUMED and the name of an assumption."""
S5_SKY = {"lat_deg": 52.95, "lon_deg": -1.15, "qzss": 0}


PRINTED = {"position": {"printed_slope": True}, "codes": {"plain_hdop": True}}
GPS, DUAL = {"systems": ["GPS"]}, {"systems": ["GPS", "GALILEO"]}
SALOS = {"position": {"alert_limit_m": 50.0, "false_alarm": 5e-3, "missed_detection": 5e-5}}
ASSUMPTIONS: dict[str, dict[str, Any]] = {
    "GPS alone": {"codes": GPS},
    "GPS and Galileo, limit 50 m, P_FA 5e-3, P_MD 5e-5": {**SALOS, "codes": DUAL},
    "GPS alone, limit 50 m, P_FA 5e-3, P_MD 5e-5": {**SALOS, "codes": GPS},
    "all systems, weak signals": {"codes": {"least_cn0_dbhz": 20.0}},
    "level as printed": PRINTED,
    "S5: as printed, GPS alone, weak signals": deep_merge(
        PRINTED, {"codes": {**GPS, "least_cn0_dbhz": 20.0}, "speed": {"form": "printed"}}
    ),
}
"""The rows of 50 m are those of Salos et al., whose availability S3 quotes (section IV-A).

S5's receiver has GPS alone and tracks to -160 dBm (section 4.1). Its slope has no deviation of a code and its HDOP
no weights (equations 1 and 2), so that HPL is in metres if each code has an error of 1 m; the WSSE test has weights."""


class ContextStudyConfig(Config):
    """Everything the study depends on."""

    seeds: int = Field(100, ge=1, description="drives in each environment [-]")
    first_seed: int = Field(1, ge=0, description="seed of the first drive [-]")
    batch: int = Field(20, ge=1, description="drives that share a map, a city and satellites [-]")
    environments: tuple[DriveEnvironment, ...] = Field(tuple(DriveEnvironment), min_length=1)
    drives: dict[DriveEnvironment, DriveTable] = Field(DRIVES, description="S5 Table 2")
    sky: SkyConfig = Field(
        SkyConfig.load(S5_SKY),
        description="all systems over Nottingham; S5 had GPS alone, whose level here never is below 15 m",
    )
    gnss: GnssConfig = Field(
        default_factory=lambda: GnssConfig.preset("sensors/gnss_automotive"), description="receiver; its first band"
    )
    map_errors: MapErrorsConfig = Field(
        MapErrorsConfig(shift_m=3.0, missing=0.02, wrong_topology=0.02), description="errors of the second map; chosen"
    )
    assumptions: dict[str, dict[str, Any]] = Field(
        ASSUMPTIONS, description="changes of the monitor; each judges the same drives with the second map"
    )
    node_m: float = Field(10.0, ge=0, description="distance from a node within which both links count as true [m]")
    monitor: ContextConfig = Field(default_factory=ContextConfig)
    charging: ChargingConfig = ChargingConfig()
    speed_power: SpeedPowerConfig = SpeedPowerConfig()

    @property
    def assumed(self) -> dict[str, ContextConfig]:
        """The monitor under each of the assumptions."""
        return {name: self.monitor.replace(**changes) for name, changes in self.assumptions.items()}


def run_context(config: ContextStudyConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Drive the missing parts, and write ``tables.json`` and figures into ``out``; returns the tables.

    Raises
    ------
    InputError
        ``out`` cannot be claimed.
    """
    from lanebound.agents.reproduce.context_figures import write_figures

    ResultFolder(out, "context study", config.to_dict(), code_digest(*PACKAGES)).claim()
    parts = _parts(config)
    found = run_parts(
        out, list(parts), partial(work_part, config), 1, on_progress,
        size=lambda name: len(parts[name]) * config.drives[DriveEnvironment(name.split("-")[0])].points, infinite=True,
    )  # fmt: skip
    tables = summarise(config.to_dict(), list(found.values()))
    tables["speed_power"] = speed_power(config.speed_power, config.monitor.speed)
    tables = finite_or_none(tables)
    write_json(out / "tables.json", tables)
    write_figures(tables, out)
    return dict(tables)


def _parts(config: ContextStudyConfig) -> dict[str, list[int]]:
    """Seeds of each part: an environment and a map."""
    last = config.first_seed + config.seeds
    starts = range(config.first_seed, last, config.batch)
    return {
        f"{environment}-{number}": list(range(first, min(first + config.batch, last)))
        for environment in config.environments
        for number, first in enumerate(starts)
    }


def work_part(config: ContextStudyConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """The drives of one map; they depend on no other part."""
    environment, number = DriveEnvironment(name.split("-")[0]), int(name.split("-")[1])
    seeds, table = _parts(config)[name], config.drives[environment]
    drive = drive_of(
        environment, table, number, seeds, (config.gnss, config.sky),
        {"": config.monitor.codes, **{name: assumed.codes for name, assumed in config.assumed.items()}}, config.node_m,
    )  # fmt: skip
    key = [list(DriveEnvironment).index(environment), number]
    maps = {
        "true": drive.road_map,
        "with errors": with_errors(drive.road_map, config.map_errors, named_generator(key, "map")),
    }
    monitors = {
        (which, str(kind)): ContextMonitor(_with_matcher(config.monitor, kind), road_map, len(seeds), 1.0)
        for which, road_map in maps.items()
        for kind in MatcherKind
    }
    others = {
        name: ContextMonitor(assumed, maps["with errors"], len(seeds), 1.0) for name, assumed in config.assumed.items()
    }
    series = MonitorSeries.of(drive, table.points, monitors, others, config.monitor, advance)
    return {
        "environment": str(environment),
        "seeds": [_drive_figures(config, series, maps, b) for b in range(len(seeds))],
    }


def _with_matcher(config: ContextConfig, kind: MatcherKind) -> ContextConfig:
    return config.replace(matching={"kind": kind})


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
                _add(out.found.setdefault(key, {}), _of_verdict(verdict, p))
            for name, monitor in others.items():
                verdict = monitor.step(p.others[name], p.wheel_mps)
                _add(out.found.setdefault((ASSUMED, name), {}), _of_verdict(verdict, p))
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
    return phase.step(p.fix.velocity_en_mps, p.fix.rates.cofactor[:, :2, :2], p.wheel_mps, p.fix.rates.solved)


def _of_point(p: ContextPoint, tests: Mapping[SpeedForm, SpeedTest]) -> dict[str, NDArray[Any]]:
    first = tests[SpeedForm.WHEEL]
    return {
        "error": p.error_m, "driving": p.driving, "speed": p.speed_mps, "moving": first.moving, "known": first.known,
        "average": first.average_mps, "true": p.true_link[:, 0], "position": p.fix.position_en_m,
        **{f"speed {form}": test.consistent for form, test in tests.items()},
    }  # fmt: skip


def _of_verdict(v: ContextVerdict, p: ContextPoint) -> dict[str, NDArray[Any]]:
    return {
        "warn": v.warn, "reason": v.reason, "score": v.score, "phases": v.phases, "link": v.link,
        "right": (v.link[:, None] == p.true_link).any(-1), "probability": v.match.probability,
        "level": v.position.level_m, "available": v.position.available, "consistent": v.position.consistent,
        "speed": v.speed.consistent,
        "matched": v.map.matched, "map": v.map.passed, "own score": v.map.score,
    }  # fmt: skip


def _drive_figures(config: ContextStudyConfig, s: MonitorSeries, maps: Mapping[str, RoadMap], b: int) -> dict[str, Any]:
    """Counts of one drive, of every matcher and map."""
    driving, moving = s.of_points("driving", b), s.of_points("moving", b)
    out: dict[str, Any] = {
        "points": int(driving.sum()),
        "moving": float(moving[driving].mean()),
        "error_m": np.quantile(s.of_points("error", b)[driving], [0.5, 0.95], method="lower").tolist(),
        "speed": {
            str(form): float((~s.of_points(f"speed {form}", b))[driving & moving & s.of_points("known", b)].mean())
            for form in SpeedForm
        },
        "of": {},
        "assumptions": {},
    }
    for which, kind in s.found:
        found = _judged(config, s, maps["true"], (which, kind), b, driving, moving)
        if which == ASSUMED:
            out["assumptions"][kind] = found
        else:
            out["of"][f"{which}, {kind}"] = found
    return out


def _judged(
    config: ContextStudyConfig,
    s: MonitorSeries,
    road_map: RoadMap,
    key: Judge,
    b: int,
    driving: Bools,
    moving: Bools,
) -> dict[str, Any]:
    """Counts of warnings of each rule of warning, the sweep, and what charging makes of the verdicts."""
    get = partial(s.of_found, key, b=b)
    wrong = ~get(name="right")
    counts = {name: _counted(WarningCounts.of(warn, wrong, driving)) for name, warn in _rules(config, get, moving)}
    stages = _stages(get, driving, moving)
    warned = dict(_rules(config, get, moving))["all phases"]
    sweep = sweep_thresholds(get(name="own score"), wrong, THRESHOLDS, stages[-1][0])
    belief = sweep_thresholds(100.0 * get(name="probability"), wrong, THRESHOLDS, driving)
    charges = charging_counts(
        config.charging, road_map, link=get(name="link"), warn=warned, speed_mps=s.of_points("average", b),
        true_link=s.of_points("true", b), driving=driving,
        true_speed_mps=_averaged(s.of_points("speed", b), config.monitor.speed.intervals),
    )  # fmt: skip
    return {
        "right": float((~wrong)[driving].mean()),
        "passed": int((get(name="phases") == 3)[driving].sum()),
        "available": float(get(name="available")[driving].mean()),
        "reasons": np.bincount(get(name="reason")[driving], minlength=len(ContextReason)).tolist(),
        "counts": counts,
        "stages": [_counted(WarningCounts.of(warn, wrong, reached)) for reached, warn in stages],
        "sweep": [sweep.false_alarms.tolist(), sweep.missed.tolist(), sweep.points],
        "belief": [belief.false_alarms.tolist(), belief.missed.tolist(), belief.points],
        "charging": charges,
    }


def _stages(get: Any, driving: Bools, moving: Bools) -> list[tuple[Bools, Bools]]:
    """Of each phase, the points (T,) that reach it and those that it warns of; at rest none reaches the second."""
    first = get(name="available") & get(name="consistent")
    second = driving & first & moving
    return [(driving, ~first), (second, ~get(name="speed")), (second & get(name="speed"), ~get(name="map"))]


def _rules(config: ContextStudyConfig, get: Any, moving: Bools) -> Iterator[tuple[str, Bools]]:
    """Rules of warning (T,): the whole monitor, without each phase, each phase alone, and naive ones."""
    position = ~(get(name="available") & get(name="consistent"))
    speed = moving & ~get(name="speed")
    road = ~get(name="matched") | ~get(name="map")
    rest = ~moving
    yield "as printed", position | rest | speed | road
    yield "all phases", _held(position | speed | road, moving)
    yield "without position", _held(speed | road, moving)
    yield "without speed", _held(position | road, moving)
    yield "without map", _held(position | speed, moving)
    yield "position alone", _held(position, moving)
    yield "speed alone", _held(speed, moving)
    yield "map alone", _held(road, moving)
    yield "level alone", np.asarray(get(name="level") > config.monitor.position.alert_limit_m)
    yield "never", np.zeros(rest.size, np.bool_)
    yield "always", np.ones(rest.size, np.bool_)


def _held(warn: Bools, moving: Bools) -> Bools:
    """Warnings in motion; at rest the last one holds, a warning before the first motion."""
    last = np.maximum.accumulate(np.where(moving, np.arange(warn.size), -1))
    return np.where(last >= 0, warn[np.maximum(last, 0)], True)


def _averaged(speed_mps: Array, intervals: int) -> Array:
    """Mean over the last intervals, as the monitor averages; over fewer at the start."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (speed_mps[1:] + speed_mps[:-1]))])
    k = np.arange(speed_mps.size)
    begin = np.maximum(k - intervals, 0)
    return np.where(k > 0, (total - total[begin]) / np.maximum(k - begin, 1), speed_mps)


def _counted(c: WarningCounts) -> list[int]:
    return [c.points, c.wrong, c.false_alarms, c.missed]
