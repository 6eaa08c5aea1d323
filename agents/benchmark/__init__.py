"""The benchmark: agents compared in suites of environments, skies and faults, seed by seed."""

from __future__ import annotations

from lanebound.agents.benchmark.metrics import MAIN, METRICS, Metric
from lanebound.agents.benchmark.outcome import Outcome, Place, Task
from lanebound.agents.benchmark.results import Cell, Estimate, Paired, Results
from lanebound.agents.benchmark.suite import AgentConfig, SeedsConfig, SuiteConfig, load_suite

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
]
