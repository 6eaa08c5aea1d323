"""The manual says what is there."""

from __future__ import annotations

from pathlib import Path

from lanebound.agents.benchmark.manual import SUITES, markdown
from lanebound.agents.benchmark.metrics import METRICS
from lanebound.integrity.core.presets import preset_names

ROOT = Path(__file__).parents[3]


def test_the_manual_is_up_to_date():
    """``python -m lanebound.agents.benchmark.manual > docs/benchmark.md`` brings it up to date."""
    assert (ROOT / "docs/benchmark.md").read_text(encoding="utf-8") == markdown()


def test_it_tells_of_every_suite_and_metric():
    assert {f"suites/{name}" for name in SUITES} == {name for name in preset_names() if name.startswith("suites/")}
    page = markdown()
    assert [metric.key for metric in METRICS if f"`{metric.key}`" not in page] == []
