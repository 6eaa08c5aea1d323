"""Limits of costs by one rule: closed forms of the rule, and the study on two drives of LaneKeeping."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies.limits import (
    COST_SECTIONS,
    CostLimitsConfig,
    cost_tables,
    first_episodes,
    interval_of_quantile,
    limit_by_rule,
    tune_cost_limits,
)
from lanebound.envs.costs import GROUPS
from lanebound.integrity.core.errors import ConfigError, InputError


@pytest.mark.parametrize(
    ("highest", "limit"), [(4.9, 5.0), (1.8, 2.0), (0.3, 0.3), (0.301, 0.4), (14.0, 20.0), (9.01, 10.0), (7e-4, 7e-4)]
)
def test_the_limit_is_kept_by_seven_of_ten_and_rounded_up(highest: float, limit: float) -> None:
    sums = [*np.linspace(0.0, highest, 7), *[1e3] * 3]
    assert limit_by_rule(sums, 0.7) == limit
    assert np.mean(np.array(sums) <= limit) >= 0.7


def test_a_cost_that_is_mostly_nothing_has_no_limit() -> None:
    assert limit_by_rule([0.0] * 7 + [5.0] * 3, 0.7) is None
    assert limit_by_rule([0.0] * 6 + [5.0] * 4, 0.7) == 5.0


def test_the_interval_of_a_quantile_holds_it_as_often_as_it_says() -> None:
    """Of 2000 samples of 24 uniform numbers 95 % at least, by binomial ranks; fails by chance once in 1000 runs."""
    rng = np.random.default_rng(5)
    held = [low <= 0.7 <= high for low, high in (interval_of_quantile(rng.random(24), 0.7) for _ in range(2000))]
    assert np.mean(held) > 0.95 - 3.3 * np.sqrt(0.95 * 0.05 / 2000)
    assert interval_of_quantile([1.0, 2.0], 0.7) == (0.0, np.inf)


def test_two_drives_give_limits_that_are_resumed_and_written_into_a_page(tmp_path: Path) -> None:
    config = CostLimitsConfig(envs=("LaneKeeping",), seeds=2, overrides={"duration_s": 8.0})
    assert config.places == {"LaneKeeping-urban": ("LaneKeeping", "urban")}, "its own sky is urban"
    told: list[float] = []
    found = tune_cost_limits(config, tmp_path / "out", on_progress=lambda progress: told.append(progress.done))
    part = found["places"]["LaneKeeping-urban"]
    assert list(part["sums"]) == list(part["limits"]) == ["cost", *GROUPS]
    parts = np.array([part["sums"][group] for group in GROUPS])
    assert (parts.sum(axis=0) <= np.array(part["sums"]["cost"]) + 1e-9).all()
    assert max(part["sums"]["cost"]) > 0.0
    assert part["cost_limit"] == 15.0
    assert part["mean"] == pytest.approx(np.mean(part["sums"]["cost"]))
    assert part["ended"] == 0
    assert part["mean"] + 2.0 <= part["limit_in_mean"] < 2.0 * (part["mean"] + 2.0), "rounded up to a digit"
    assert part["limits"]["headway"] is None, "there is nobody ahead"
    assert any(0.0 < share < 1.0 for share in told), "a part is seen to go on"
    assert [row[:2] for row in cost_tables(found)["limits"][1]] == [("LaneKeeping", "urban")]
    assert tune_cost_limits(config, tmp_path / "out") == found
    page = tmp_path / "page.md"
    page.write_text("".join(f"<!-- {name} -->\n<!-- end of {name} -->\n" for name in COST_SECTIONS))
    command = ["tune", "limits", "--out", str(tmp_path / "out"), "--env", "LaneKeeping", "--seeds", "2"]
    command += ["--set", "overrides.duration_s=8.0", "--page", str(page), "--json"]
    shown = CliRunner().invoke(app, command)
    assert shown.exit_code == 0, shown.output
    assert json.loads(shown.stdout)["places"].keys() == found["places"].keys()
    assert "| LaneKeeping | urban | 15 |" in page.read_text()


def test_what_cannot_be_driven_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="sky must be one of"):
        tune_cost_limits(CostLimitsConfig(envs=("LaneKeeping",), skies=("urbane",)), tmp_path)
    assert not (tmp_path / "run.json").exists()
    with pytest.raises(InputError, match="envs must be ids with an engine, got 'parking-v0'"):
        next(first_episodes("parking-v0", {}, "nominal", 2))
