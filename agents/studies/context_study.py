"""``lanebound reproduce context``: the drives of S5 on generated roads, and its Tables 3 and 4, figure 8 and more.

Every drive is measured once. All matchers, both maps (true, and with errors), all forms of the speed phase and all
combinations of phases judge the same measurements.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import model_validator

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.context_drive import DRIVES, DriveTable, MonitorSeries, drive_figures, drive_of, wrong_map
from lanebound.agents.studies.context_tables import MAIN, RULES, summarise
from lanebound.integrity.assessment.plotting import INK, LIMIT_COLOUR, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.assessment.speed_power import SpeedPowerConfig, rest_power, speed_power
from lanebound.integrity.assessment.warning_rates import ChargingConfig
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig
from lanebound.integrity.positioning.map_matching.matching import MatcherKind
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.constellation import SkyConfig

__all__ = ["ContextStudyConfig", "run_context", "write_figures"]


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
    ResultFolder(out, "context study", config.to_dict(), code_digest(*PACKAGES)).claim()
    parts = _parts(config)
    found = run_parts(
        out, list(parts), partial(work_part, config), 1, on_progress,
        size=lambda name: len(parts[name]) * config.drives[name.rpartition("-")[0]].points, infinite=True,
    )  # fmt: skip
    tables = summarise(config.to_dict(), list(found.values()))
    tables["speed_power"] = speed_power(config.speed_power, config.monitor.speed) | rest_power(
        config.speed_power, config.monitor
    )

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
