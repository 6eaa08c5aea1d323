"""The report of a benchmark: one page with tables and pictures, that needs no network."""

from __future__ import annotations

from lanebound.agents.report.write import write_report

__all__ = ["write_report"]
