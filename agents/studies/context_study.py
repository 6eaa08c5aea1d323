"""``lanebound reproduce context``: the drives of S5 on generated roads, and its Tables 3 and 4, figure 8 and more.

Every drive is measured once. All matchers, both maps (true, and with errors), all forms of the speed phase and all
combinations of phases judge the same measurements. Tables have medians over drives, pooled counts, the crossing of the
sweep, and charges.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import model_validator

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.context_drive import DRIVES, DriveTable, MonitorSeries, drive_figures, drive_of, wrong_map
from lanebound.agents.studies.study import Shown, claim, parts_of, seed_batches, spread, stored
from lanebound.integrity.assessment.plotting import INK, LIMIT_COLOUR, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.assessment.warning_rates import (
    PUBLISHED_COUNTS,
    ChargingConfig,
    SpeedPowerConfig,
    WarningCounts,
    WarningSweep,
    rest_power,
    speed_power,
)
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextReason
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig
from lanebound.integrity.positioning.map_matching.matching import MatcherKind
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.constellation import SkyConfig

PUBLISHED_PASSED = {"urban": 913, "rural": 2994, "mixed": 809}  # points, S5 table after section 4.4
PHASE_COUNT = 3
PRINTED_PERCENT = {"urban": 98.24, "rural": 99.23, "mixed": 97.29}  # S5 Table 4
MAIN = "with errors, topological"  # S5's matcher, with the map that a vehicle may have
OWN = "all systems, declared errors"
COUNTED = "phase 3, over all points (S5's counting)"
STAGES = ("phase 1", "phase 2, of what reaches it", "phase 3, of what reaches it")
RULES = (
    "as printed", "all phases", "without position", "without speed", "without map", "position alone", "speed alone",
    "map alone", "level alone", "never", "always",
)  # fmt: skip


def summarise(config: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All tables from the figures of the drives."""
    by_environment: dict[str, list[Mapping[str, Any]]] = {}
    roads = {part["environment"]: part["roads"] for part in parts}
    for part in parts:
        by_environment.setdefault(part["environment"], []).extend(part["seeds"])
    return {
        "config": dict(config),
        "environments": {name: _environment(drives, roads[name]) for name, drives in by_environment.items()},
    }


def _environment(drives: list[Mapping[str, Any]], roads: str) -> dict[str, Any]:
    return {
        "roads": roads,
        "drives": len(drives),
        "points": int(sum(d["points"] for d in drives)),
        "moving": spread(d["moving"] for d in drives),
        "error_m": [spread(d["error_m"][k] for d in drives) for k in range(2)],
        "speed": {form: spread(d["speed"][form] for d in drives) for form in drives[0]["speed"]},
        "of": {key: _monitor([d["of"][key] for d in drives]) for key in drives[0]["of"]},
        "assumptions": {name: _monitor([d["assumptions"][name] for d in drives]) for name in drives[0]["assumptions"]},
    }


def _monitor(found: list[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "right": spread(f["right"] for f in found),
        "available": spread(f["available"] for f in found),
        "level_m": spread(f["level_m"] for f in found),
        "beyond": [int(n) for n in np.sum([f["beyond"] for f in found], 0)],
        "passed": spread(f["passed"] / max(f["counts"]["never"][0], 1) for f in found),
        "reasons": [int(n) for n in np.sum([f["reasons"] for f in found], 0)],
        "rules": {rule: _counts([f["counts"][rule] for f in found]) for rule in RULES},
        "stages": [_counts([f["stages"][k] for f in found]) for k in range(PHASE_COUNT)],
        "over_all": _counts([[f["counts"]["never"][0], *f["stages"][-1][1:]] for f in found]),
        "sweep": _sweep([f["sweep"] for f in found]),
        "belief": _sweep([f["belief"] for f in found]),
        "charging": {
            kind: {what: _charges([f["charging"][kind][what] for f in found]) for what in ("toll", "speed")}
            for kind in ("plain", "guarded")
        },
    }


def _counts(rows: Sequence[Sequence[int]]) -> dict[str, Any]:
    """Rates of the drives that have points, and of all their points together."""
    each = [WarningCounts(*row) for row in rows]
    total, some = sum(each[1:], each[0]), [c for c in each if c.points]
    return {
        **{key: spread(getattr(c, key) for c in some) if some else None for key in ("ocdr", "far", "mdr")},
        "pooled": {
            "points": total.points, "wrong": total.wrong, "false_alarms": total.false_alarms, "missed": total.missed,
            "ocdr": total.ocdr, "per_right": total.per_right, "per_wrong": total.per_wrong,
            "far_95": total.interval(total.false_alarms), "mdr_95": total.interval(total.missed),
        },
    }  # fmt: skip


def _sweep(rows: Sequence[Sequence[Any]]) -> dict[str, Any]:
    each = [WarningSweep(np.arange(float(len(a))), np.array(a), np.array(m), int(n)) for a, m, n in rows]
    total = sum(each[1:], each[0])
    threshold, ocdr = total.best()
    return {
        "false_alarms": total.false_alarms.tolist(), "missed": total.missed.tolist(), "points": total.points,
        "crossing": total.crossing(), "best_threshold": threshold, "best_ocdr": ocdr,
    }  # fmt: skip


def _charges(rows: Sequence[Mapping[str, int]]) -> dict[str, Any]:
    total = {key: sum(row[key] for row in rows) for key in ("due", "charged", "wrong", "missed")}
    return {
        **total,
        "wrong_rate": total["wrong"] / total["charged"] if total["charged"] else None,
        "missed_rate": total["missed"] / total["due"] if total["due"] else None,
    }


def _percent(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{100.0 * value:.{digits}f} %"


def _withspread(values: Sequence[float] | None) -> str:
    return "-" if values is None else f"{100 * values[0]:.1f} ({100 * values[1]:.1f} to {100 * values[2]:.1f}) %"


def ocdr_rows(tables: Mapping[str, Any]) -> Table:
    """OCDR of S5 next to ours: by S5's counting, with warnings at rest, of all phases, and of each phase alone.

    S5's counting divides the false alarms and missed detections of the third phase by all points.
    """
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        found, published = env["of"][MAIN], PUBLISHED_COUNTS[env["roads"]]
        paper = WarningCounts(published[2], 0, *published[:2])
        rows.append((
            name, _percent(paper.ocdr, 2), _withspread(found["over_all"]["ocdr"]),
            *(_withspread(found["rules"][rule]["ocdr"]) for rule in ("as printed", "all phases", "never")),
            *(_withspread(stage["ocdr"]) for stage in found["stages"]), _withspread(found["available"]),
        ))  # fmt: skip
    return (
        "drive", "S5", COUNTED, "warned at rest", "all phases", "never warn", *STAGES, "HPL within limit",
    ), rows  # fmt: skip


def stage_rows(tables: Mapping[str, Any]) -> Table:
    """Each phase over the points that reach it, all drives together, next to never warning of the same points."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            for stage, counted in zip(STAGES, found["stages"], strict=True):
                p = counted["pooled"]
                never = 1.0 - p["wrong"] / p["points"] if p["points"] else None
                shares = (p["ocdr"], never, p["per_right"], p["per_wrong"])
                rows.append((name, assumed, stage, f"{p['points']:,}", f"{p['wrong']:,}", *map(_percent, shares)))
    return (
        "drive", "receiver", "phase", "points", "wrong", "OCDR", "never warn", "warned of right points",
        "wrong points not warned of",
    ), rows  # fmt: skip


def _by_receiver(env: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The monitor's own receiver first, then those of the assumptions."""
    return [(OWN, env["of"][MAIN]), *env["assumptions"].items()]


def assumption_rows(tables: Mapping[str, Any]) -> Table:
    """Availability and rates by what the receiver uses and declares; the first row of a drive is the monitor's own."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            rows.append((
                name, assumed, f"{found['level_m'][0]:.1f} m", _withspread(found["available"]),
                _beyond(*found["beyond"]), _withspread(found["passed"]),
                _withspread(found["rules"]["as printed"]["ocdr"]), _withspread(found["rules"]["all phases"]["ocdr"]),
                _withspread(found["over_all"]["ocdr"]), _withspread(found["stages"][-1]["ocdr"]),
            ))  # fmt: skip
        passed = 100 * PUBLISHED_PASSED[env["roads"]] / PUBLISHED_COUNTS[env["roads"]][2]
        paper = f"{PRINTED_PERCENT[env['roads']]:.2f} %"
        rows.append((name, "S5, published", "-", "-", "-", f"{passed:.1f} %", "-", "-", paper, "-"))
    return (
        "drive", "assumption", "HPL", "HPL within limit", "errors beyond it", "three levels passed",
        "OCDR, warned at rest", "OCDR, all phases", COUNTED, STAGES[-1],
    ), rows  # fmt: skip


def _beyond(errors: int, accepted: int) -> str:
    return f"{errors:,} of {accepted:,}"


def reason_rows(tables: Mapping[str, Any]) -> Table:
    """Why the driver is warned: shares of all points, at rest as of their own, by what the receiver uses."""
    names = [reason.name.lower() for reason in ContextReason]
    rows: list[tuple[str, ...]] = []
    for drive, env in tables["environments"].items():
        for assumed, found in _by_receiver(env):
            total = max(sum(found["reasons"]), 1)
            rows.append((drive, assumed, *(_percent(n / total) for n in found["reasons"])))
    return ("drive", "receiver", *names), rows


def rule_rows(tables: Mapping[str, Any]) -> Table:
    """What each phase adds, and what naive rules reach; all drives of an environment together."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for rule in RULES:
            p = env["of"][MAIN]["rules"][rule]["pooled"]
            rows.append(
                (name, rule, _percent(p["ocdr"]), _percent(p["per_right"]), _percent(p["per_wrong"]), f"{p['wrong']:,}")
            )
    return ("drive", "rule", "OCDR", "warned of right points", "wrong points not warned of", "wrong points"), rows


def matcher_rows(tables: Mapping[str, Any]) -> Table:
    """Share of right links of each matcher and map; the crossing of its sweep; the same of its probability."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for key, found in env["of"].items():
            which, kind = key.split(", ")
            cells = [
                "-" if found[of]["crossing"] is None else f"{found[of]['crossing']:.0f}" for of in ("sweep", "belief")
            ]
            rows.append((
                name, which, kind, _withspread(found["right"]), *cells, _percent(found["sweep"]["best_ocdr"]),
                _percent(found["belief"]["best_ocdr"]),
            ))  # fmt: skip
    return (
        "drive", "map", "matcher", "right link", "crossing of the score", "crossing of the probability",
        "best OCDR of the score", "best OCDR of the probability",
    ), rows  # fmt: skip


def speed_rows(tables: Mapping[str, Any]) -> Table:
    """Share of windows in which each form of the speed phase warns, by fault; and of the drives' points in motion."""
    cases = tables["speed_power"]
    forms = list(next(iter(cases.values())))
    rows: list[tuple[str, ...]] = [(name, *(_percent(found[form]) for form in forms)) for name, found in cases.items()]
    for name, env in tables["environments"].items():
        rows.append((f"{name} drives, no fault", *(_withspread(env["speed"][form]) for form in forms)))
    return ("case", *forms), rows


def application_rows(tables: Mapping[str, Any]) -> Table:
    """Charges of both applications, plain and guarded by the warnings."""
    rows: list[tuple[str, ...]] = []
    for name, env in tables["environments"].items():
        for what in ("toll", "speed"):
            for kind in ("plain", "guarded"):
                c = env["of"][MAIN]["charging"][kind][what]
                rows.append((name, what, kind, f"{c['due']:,}", f"{c['charged']:,}", _percent(c["wrong_rate"]),
                             _percent(c["missed_rate"])))  # fmt: skip
    return ("drive", "charge", "", "due", "charged", "wrong of charged", "missed of due"), rows


def shown(tables: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    yield "Overall correct detection rate; medians over drives, 5 to 95 %", ocdr_rows(tables)
    yield "By what the receiver uses and declares", assumption_rows(tables)
    yield "Each phase over the points that reach it, drives together", stage_rows(tables)
    yield "Why the driver is warned, shares of all points", reason_rows(tables)
    yield "What each phase adds, and naive rules", rule_rows(tables)
    yield "Matchers, with the true map and with one that has errors", matcher_rows(tables)
    yield "Speed phase: windows warned of", speed_rows(tables)
    yield "Charges by the matched link", application_rows(tables)


S5_THRESHOLD = 71.0
COLOURS = ("#009E73", "#E69F00", "#CC79A7")


def write_figures(tables: Mapping[str, Any], out: Path) -> None:
    """Write ``threshold.png``, ``rules.png`` and ``matchers.png``."""
    _threshold(tables, out / "threshold.png")
    _rules(tables, out / "rules.png")
    _matchers(tables, out / "matchers.png")


def _threshold(tables: Mapping[str, Any], path: Path) -> None:
    """False alarms and missed detections against the threshold; S5 figure 8."""
    environments = tables["environments"]
    figure = new_figure(4.2 * len(environments), 3.4)
    for axes, (name, env) in zip(
        np.atleast_1d(figure.subplots(1, len(environments))), environments.items(), strict=True
    ):
        sweep = env["of"][MAIN]["sweep"]
        points = max(sweep["points"], 1)
        for key, colour, label in (("false_alarms", PL_COLOUR, "FAR"), ("missed", LIMIT_COLOUR, "MDR")):
            axes.plot(np.arange(len(sweep[key])), 100.0 * np.array(sweep[key]) / points, color=colour, label=label)
        axes.axvline(S5_THRESHOLD, color=INK, linewidth=0.8, linestyle=":", label="71 (S5)")
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_ylim(0.0, 100.0)
        tidy(axes, title=name, xlabel="threshold of the score", ylabel="share of points [%]")
        legend(axes)
    save(figure, path)


def _rules(tables: Mapping[str, Any], path: Path) -> None:
    """Warned of right points against wrong points not warned of."""
    figure = new_figure(6.0, 4.6)
    axes = figure.subplots()
    for colour, (name, env) in zip(COLOURS, tables["environments"].items(), strict=False):
        axes.plot([], [], "o", color=colour, label=name)
        names: dict[tuple[int, int], list[str]] = {}
        for rule in RULES:
            p = env["of"][MAIN]["rules"][rule]["pooled"]
            if p["per_right"] is not None and p["per_wrong"] is not None:
                at = round(50.0 * p["per_right"]), round(50.0 * p["per_wrong"])  # rules within 2 % share a label
                names.setdefault(at, []).append(rule)
                axes.plot(100.0 * p["per_right"], 100.0 * p["per_wrong"], "o", color=colour, markersize=5)
        for (x, y), rules in names.items():
            axes.annotate(
                "\n".join(rules), (2.0 * x, 2.0 * y), fontsize=5.5, xytext=(5, -4), textcoords="offset points",
                color=colour, va="top",
            )  # fmt: skip
    tidy(axes, title="Rules of warning", xlabel="right points warned of [%]", ylabel="wrong points not warned of [%]")
    legend(axes)
    save(figure, path)


def _matchers(tables: Mapping[str, Any], path: Path) -> None:
    """Share of right links of each matcher with both maps."""
    environments = tables["environments"]
    figure = new_figure(3.2 * len(environments), 3.4)
    for axes, (name, env) in zip(
        np.atleast_1d(figure.subplots(1, len(environments))), environments.items(), strict=True
    ):
        keys = list(env["of"])
        middle, low, high = 100.0 * np.array([env["of"][key]["right"] for key in keys]).T
        at = np.arange(len(keys))
        axes.bar(at, middle, color=[COLOURS[k % 3] for k in at])
        axes.errorbar(at, middle, yerr=[middle - low, high - middle], fmt="none", ecolor=INK, linewidth=0.8)
        axes.set_xticks(at, [key.replace(", ", "\n").replace("_", "\n") for key in keys], fontsize=6)
        tidy(axes, title=name, ylabel="right link [%]")
        axes.set_ylim(max(0.0, float(low.min()) - 5.0), 100.0)
    save(figure, path)


PACKAGES = ("lanebound.integrity", "lanebound.agents.studies", "lanebound.envs.sky")
S5_SKY = {"lat_deg": 52.95, "lon_deg": -1.15, "qzss": 0}


PRINTED = {"position": {"printed_slope": True}, "codes": {"plain_hdop": True, "covariance": "diagonal"}}
GPS, DUAL = {"systems": ["GPS"]}, {"systems": ["GPS", "GALILEO"]}
SALOS = {"position": {"alert_limit_m": 50.0, "false_alarm": 5e-3, "missed_detection": 5e-5}}
ASSUMPTIONS: dict[str, dict[str, Any]] = {
    "diagonal covariance": {"codes": {"covariance": "diagonal"}},
    "crisp terms": {"map": {"rules": "monitors/context_rules_crisp"}},
    "GPS alone": {"codes": GPS},
    "GPS and Galileo, limit 50 m, P_FA 5e-3, P_MD 5e-5": {**SALOS, "codes": DUAL},
    "GPS alone, limit 50 m, P_FA 5e-3, P_MD 5e-5": {**SALOS, "codes": GPS},
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
    environments: tuple[str, ...] = Field(tuple(DRIVES), min_length=1, description="of the drives")
    drives: dict[str, DriveTable] = Field(DRIVES, description="S5 Table 2, and urban streets under a lower sky")
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

    @model_validator(mode="after")
    def _environments_have_drives(self) -> ContextStudyConfig:
        for name in self.environments:
            if name not in self.drives:
                raise ConfigError(f"environments must be among {', '.join(self.drives)}, got {name!r}: correct it")
        return self

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
    claim(out, "context study", config, PACKAGES)
    parts = _parts(config)
    found = parts_of(
        config, work_part, list(parts), out, 1, on_progress,
        size=lambda name: len(parts[name]) * config.drives[name.rpartition("-")[0]].points, infinite=True,
    )  # fmt: skip
    tables = summarise(config.to_dict(), list(found.values()))
    tables["speed_power"] = speed_power(config.speed_power, config.monitor.speed) | rest_power(
        config.speed_power, config.monitor
    )
    tables = finite_or_none(tables)
    write_figures(tables, out)
    return stored(tables, out, "tables.json")


def _parts(config: ContextStudyConfig) -> dict[str, list[int]]:
    """Seeds of each part: an environment and a map."""
    return {
        f"{environment}-{number}": seeds
        for environment in config.environments
        for number, seeds in enumerate(seed_batches(config.first_seed, config.seeds, config.batch))
    }


def work_part(config: ContextStudyConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """The drives of one map; they depend on no other part."""
    environment, _, number = name.rpartition("-")
    seeds, table = _parts(config)[name], config.drives[environment]
    codes = {"": config.monitor.codes, **{key: assumed.codes for key, assumed in config.assumed.items()}}
    drive = drive_of(table, int(number), seeds, (config.gnss, config.sky), codes, config.node_m)
    maps = {"true": drive.road_map, "with errors": wrong_map(drive.road_map, config.map_errors, table, int(number))}
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
        "environment": environment, "roads": str(table.roads),
        "seeds": [drive_figures(config, series, maps, b) for b in range(len(seeds))],
    }  # fmt: skip


def _with_matcher(config: ContextConfig, kind: MatcherKind) -> ContextConfig:
    return config.replace(matching={"kind": kind})
