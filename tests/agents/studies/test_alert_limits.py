"""The study of alert limits on two drives of LaneKeeping."""

from __future__ import annotations

from pathlib import Path

import pytest

from lanebound.agents.studies.limits import DIRECTIONS, AlertLimitsConfig, alert_tables, assess_alert_limits
from lanebound.integrity.core.errors import InputError


def test_errors_below_and_above_the_limits_are_told_apart(tmp_path: Path) -> None:
    config = AlertLimitsConfig(envs=("LaneKeeping",), seeds=2)
    found = assess_alert_limits(config, tmp_path)
    part = found["ids"]["LaneKeeping"]
    fixed, budget = (part["kinds"][kind] for kind in ("fixed", "budget"))
    assert fixed["lowest_m"] == fixed["median_m"] == pytest.approx([1.5, 0.625])
    assert 0.29 <= budget["lowest_m"][1] <= budget["median_m"][1] < 0.625
    assert all(errors.keys() == DIRECTIONS.keys() for errors in (*fixed["errors"].values(), *budget["errors"].values()))
    assert fixed["errors"]["above"]["ahead"]["alerts"] == 1.0, "150 % of a fixed limit is alerted all the time"
    assert fixed["errors"]["below"]["ahead"]["alerts"] == 0.0
    worst = {kind: max(e["cost"] for e in part["kinds"][kind]["errors"]["below"].values()) for kind in part["kinds"]}
    assert worst["budget"] < part["cost_limit"] < worst["fixed"]
    rows = alert_tables(found)["costs"][1]
    assert [row[:3] for row in rows] == [["LaneKeeping", "fixed", "15"], ["LaneKeeping", "budget", "15"]]
    assert [row[4].startswith("**") for row in rows] == [True, False], "harm on the wrong side is bold"
    assert assess_alert_limits(config, tmp_path) == found, "a run is resumed"
    with pytest.raises(InputError, match="seeds"):
        assess_alert_limits(AlertLimitsConfig(envs=("LaneKeeping",), seeds=3), tmp_path)
