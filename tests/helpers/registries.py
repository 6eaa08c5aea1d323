"""All tables that users extend, so that each test finds them as the package has them and leaves them so."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium

from lanebound.agents import plugins
from lanebound.agents.episodes import columns
from lanebound.envs import info
from lanebound.envs.ids import registry
from lanebound.envs.observation import index
from lanebound.envs.worlds import kinds as worlds
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.family.kinds import FAMILY
from lanebound.integrity.navigators.navigator import KINDS, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.extra_stages import EXTRA_STAGES
from lanebound.integrity.navigators.rtk_reckoning.modes import MODES
from lanebound.integrity.navigators.services.table import SERVICES
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors import fault_registry

__all__ = ["PLUGINS", "TABLES", "as_in_the_package", "restore"]

NavigatorConfig.all_kinds()  # imports those of the package, which enter the tables once
TABLES: tuple[dict[Any, Any] | list[Any], ...] = (
    AlertReason.members,
    FAMILY,
    KINDS,
    MODES,
    EXTRA_STAGES,
    Mode.members,
    NavigatorConfig.kinds,
    SERVICES,
    columns._registered,
    fault_registry._kinds,
    index._registered,
    info._registered,
    plugins._loaded,
    registry.IDS,
    registry._registered,
    worlds._kinds,
    sys.path,
)
FIRST = [table.copy() for table in TABLES]
"""What the tables hold before any module of tests is imported."""
GYMNASIUM = dict(gymnasium.registry)
PLUGINS = Path(__file__).parents[1] / "plugins"
ON_IMPORT = "lanebound.integrity.navigators.services.velocity_switch"
"""Module of the package that registers stages when a configuration names it."""
_others: set[str] = set()
"""Modules that are no plug-ins."""


@contextmanager
def as_in_the_package(temporary: Path) -> Iterator[None]:
    """All tables as in the package before and after, see :func:`restore`."""
    restore(temporary)
    yield
    restore(temporary)


def restore(temporary: Path = PLUGINS) -> None:
    """Put all tables back as they were; modules of plug-ins and of a temporary folder are forgotten."""
    added = AlertReason.members.keys() - FIRST[0]
    for name in added:
        delattr(AlertReason, name)
    for name in registry.IDS:
        gymnasium.registry.pop(name, None)
    gymnasium.registry.update(GYMNASIUM)
    for table, first in zip(TABLES, FIRST, strict=True):
        table.clear()
        table.update(first) if isinstance(table, dict) else table.extend(first)
    for name, reason in AlertReason.members.items():  # they are attributes of the class as well
        setattr(AlertReason, name, reason)
    sys.modules.pop(ON_IMPORT, None)
    for name in sys.modules.keys() - _others:
        file = str(getattr(sys.modules[name], "__file__", ""))
        if str(PLUGINS) in file or str(temporary) in file:
            del sys.modules[name]
        else:
            _others.add(name)
