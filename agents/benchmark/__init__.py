"""The benchmark: agents compared in suites of environments, skies and faults, seed by seed.

Names are loaded at their first use, because the modules import heavy packages.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lanebound.agents.benchmark.metrics import MAIN, METRICS, Metric
    from lanebound.agents.benchmark.outcome import Outcome, Place, Task
    from lanebound.agents.benchmark.results import Cell, Estimate, Paired, Results
    from lanebound.agents.benchmark.suite import AgentConfig, SeedsConfig, SuiteConfig, load_suite
    from lanebound.agents.benchmark.work import run

__all__ = [
    "MAIN",
    "METRICS",
    "AgentConfig",
    "Cell",
    "Estimate",
    "Metric",
    "Outcome",
    "Paired",
    "Place",
    "Results",
    "SeedsConfig",
    "SuiteConfig",
    "Task",
    "load_suite",
    "run",
]

HOMES = {
    "metrics": ("MAIN", "METRICS", "Metric"),
    "outcome": ("Outcome", "Place", "Task"),
    "results": ("Cell", "Estimate", "Paired", "Results"),
    "work": ("run",),
    "suite": ("AgentConfig", "SeedsConfig", "SuiteConfig", "load_suite"),
}


def __getattr__(name: str) -> Any:
    for home, names in HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
