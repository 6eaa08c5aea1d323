"""Configuration classes by the ``kind`` of a preset, loaded at their first use."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lanebound.integrity.core.errors import ConfigError

if TYPE_CHECKING:
    from lanebound.integrity.core.config import Config

__all__ = ["KINDS", "resolve"]

KINDS = {
    "context_rules": "lanebound.integrity.monitoring.context.fuzzy:RuleBase",
    "experiment": "lanebound.agents.learning.experiment:ExperimentConfig",
    "learning_study": "lanebound.agents.studies.learning:LearningStudyConfig",
    "suite": "lanebound.agents.benchmark.suite:SuiteConfig",
    "tuned_caution": "lanebound.agents.drivers.margins:TunedCaution",
    "urban_drive": "lanebound.agents.studies.urban_drive:UrbanDriveConfig",
    "navigator": "lanebound.integrity.navigators.navigator:NavigatorConfig",
    "corrections": "lanebound.integrity.sensors.corrections:CorrectionsConfig",
    "fitted_errors": "lanebound.integrity.monitoring.family.error_classes:FittedErrors",
    "fault_priors": "lanebound.integrity.sensors.campaign:FaultPriors",
    "gnss": "lanebound.integrity.sensors.gnss:GnssConfig",
    "imu": "lanebound.integrity.sensors.imu:ImuConfig",
    "odometer": "lanebound.integrity.sensors.odometer:OdometerConfig",
    "positioning": "lanebound.integrity.positioning.config:PositioningConfig",
    "sky_level": "lanebound.envs.sky.level:SkyLevel",
    "v2v": "lanebound.integrity.sensors.v2v:V2vConfig",
}


def resolve(name: str, overrides: Mapping[str, Any] | None = None) -> tuple[str, Config]:
    """The kind of a preset or a YAML file, and its configuration with ``overrides``.

    Raises
    ------
    ConfigError
        The preset or its kind is unknown, or a value is refused.
    """
    from lanebound.integrity.core.presets import FILES, deep_merge, load_file, load_preset, nearest

    if name.endswith(FILES):
        data = deep_merge(load_file(Path(name), "preset"), overrides or {})
    else:
        _require_no_environment(name)
        data = load_preset(name, overrides)
    kind = data.pop("kind", None)
    if kind is None:
        raise ConfigError(f"preset '{name}' names no kind: add a line such as 'kind: {min(KINDS)}'")
    kind, _, inner = str(kind).partition("/")  # "navigator/filter": a navigator of the kind filter
    if inner:
        data["kind"] = inner
    if kind not in KINDS:
        raise ConfigError(f"kind '{kind}' of preset '{name}' is unknown: {nearest(str(kind), KINDS)}")
    module, _, attribute = KINDS[kind].partition(":")
    model: type[Config] = getattr(import_module(module), attribute)
    return kind, model.load(data)


def _require_no_environment(name: str) -> None:
    """Refuse the name of an environment with a hint to ``lanebound envs``."""
    from lanebound.agents.cli.static import static_table

    short = name.removeprefix("lanebound/").removesuffix("-v0").lower()
    for row in static_table()["environments"]:
        there = row["id"].removeprefix("lanebound/").removesuffix("-v0")
        if short == there.lower():
            raise ConfigError(f"preset '{name}' is unknown: it is an environment, see 'lanebound envs {there}'")
