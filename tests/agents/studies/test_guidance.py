"""Services and drivers in Guidance: figures of drives under a constant error, and their tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from lanebound.agents.studies.guidance import SECTIONS, GuidanceConfig, assess_guidance, tables
from lanebound.integrity.core.errors import ConfigError

AWAY: dict[str, Any] = {
    "navigation": {"source": "offset", "offset_ct_m": 21.5},
    "perception": {"source": "none"},
    "world": {"vehicles_count": 0},
    "duration_s": 6.0,
}


def test_a_position_on_the_other_road_shows_in_the_figures(tmp_path: Path) -> None:
    """To the right by the distance of the roads: from the motorway it is the collector road, from there no road."""
    config = GuidanceConfig.load({"navigators": {"one": "navigators/consumer"}, "seeds": 4, "overrides": AWAY})
    found = assess_guidance(config, tmp_path)
    assert set(found["cases"]) == {"one-nominal", "one-integrity_aware"}
    for part in found["cases"].values():
        assert part["time_s"] == [6.0] * 4
        assert part["available"] == [0.0] * 4
        assert {round(share) for share in part["wrong_road"]} == {0, 1}
        assert part["error_m"] == pytest.approx([21.5] * 3, abs=0.1)
        assert part["beyond"] == 0
        assert not any(part["success"])
    blocked = {name: sum(part["causes"]["blocking"]) for name, part in found["cases"].items()}
    assert max(blocked.values()) < 0.05, "at the limit of the slower possible road a car does not block"
    shown = tables(found)
    assert tuple(shown) == SECTIONS
    (heads, rows), (_, positions) = shown["outcome"], shown["position"]
    assert [row[:3] for row in rows] == [("one", "`nominal`", "0 of 4"), ("one", "`integrity_aware`", "0 of 4")]
    assert all(len(row) == len(heads) for row in rows)
    assert len(positions) == 1
    assert assess_guidance(config, tmp_path)["cases"] == found["cases"]  # as kept


def test_a_navigator_that_does_not_exist_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="navigator"):
        assess_guidance(GuidanceConfig.load({"navigators": {"one": "services/none"}}), tmp_path)
    assert not list(tmp_path.iterdir())
