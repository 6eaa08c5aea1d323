"""The study of levels relative to the ego: a small run, and what it counts."""

from __future__ import annotations

from pathlib import Path

from lanebound.agents.studies.relative_levels import RelativeLevelsConfig, run_relative_levels, shown


def test_a_small_study(tmp_path: Path) -> None:
    config = RelativeLevelsConfig.load({"ids": ["CarFollowing"], "environments": 4, "decisions": 40, "sky": "open"})
    result = run_relative_levels(config, tmp_path / "out")
    assert [*result["parts"]] == ["CarFollowing-honest", "CarFollowing-lying", "CarFollowing-vans"]
    honest, lying = (result["parts"][f"CarFollowing-{group}"] for group in ("honest", "lying"))
    assert 100 < honest["tracked"] <= 4 * 39  # one leader, less the first decisions
    assert honest["along"] == honest["across"] == honest["excluded"] == 0
    assert lying["honest excluded"] == 0
    assert 0.0 < honest["pl_at_m"][0] < 1.0
    heads, rows = next(iter(shown(result)))[1]
    assert len(rows) == 3
    assert len(heads) == len(rows[0])
