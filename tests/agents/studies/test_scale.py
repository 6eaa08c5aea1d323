"""Growth of time and memory: points are measured once, lines are fitted by relative deviation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import scale
from lanebound.agents.studies.scale import ScalePoint, fit, measured, plan, points, run_scale, tables

BARE: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 4.0}
FEW = [ScalePoint("environments", n, "LaneKeeping", "LaneKeeping", n, BARE) for n in (1, 2, 4)]


def test_each_table_has_its_points_under_names_of_their_own() -> None:
    every = points()
    assert len({point.name for point in every}) == len(every)
    assert {point.table for point in every} == set(scale.SECTIONS[:-1])
    assert max(point.envs for point in every) == 8192
    few = points(quick=True)
    assert {point.table for point in few} == set(scale.SECTIONS[:-1])
    assert max(point.envs for point in few) <= 4
    assert not any("surrogate" in str(point.config) for point in few)


def test_a_line_is_fitted_by_relative_deviation() -> None:
    x = [1.0, 10.0, 100.0, 1000.0]
    line = fit(x, [5.0 + 2.0 * n for n in x])
    assert (line.fixed, line.each, line.worst) == (pytest.approx(5.0), pytest.approx(2.0), pytest.approx(0.0, abs=1e-6))
    bent = fit(x, [7.0, 25.0, 205.0, 4010.0])
    assert bent.where in (100.0, 1000.0)
    assert abs(bent.worst) > 0.1


def test_points_are_measured_once_and_shown_in_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "points", lambda quick=False: FEW)
    monkeypatch.setattr(scale, "MOST_S", 0.0)
    asked: list[str] = []
    measure = scale._measure

    def counted(point: ScalePoint, advance: Any) -> dict[str, float]:
        asked.append(point.name)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return measure(point, advance)

    monkeypatch.setattr(scale, "_measure", counted)
    with pytest.raises(KeyboardInterrupt):
        run_scale(tmp_path)
    result = run_scale(tmp_path)
    assert asked == [FEW[0].name, FEW[1].name, FEW[1].name, FEW[2].name]
    assert json.loads((tmp_path / "results.json").read_text())["points"] == result["points"]
    for point in result["points"]:
        assert point["known"] < point["held"] <= point["peak"]
        assert min(point["step_s"], point["reset_s"], point["open_s"]) > 0.0
    shown = tables(result)
    heads, rows = shown["environments"]
    assert [row[:2] for row in rows] == [("LaneKeeping", "1 to 4")]
    assert {len(row) for row in rows} == {len(heads)}
    heads, rows = measured(result)
    assert [row[:3] for row in rows] == [("environments", "LaneKeeping", value) for value in ("1", "2", "4")]
    assert {len(row) for row in rows} == {len(heads)}
    assert shown["vehicles"][1] == []


def test_a_plan_multiplies_the_line_by_the_steps() -> None:
    counts = (1, 10, 100)
    measured = [{**FEW[0]._asdict(), "value": n, "envs": n, "step_s": 1e-4 * n, "reset_s": 1e-3 * n, "held": 1e6 * n}
                for n in counts]  # fmt: skip
    _, rows = plan({"points": measured})
    what, length, us, core_hours, hours, gigabytes = rows[0]
    assert (what, length, us) == ("LaneKeeping", "20", "150")
    assert float(core_hours.replace(",", "")) == pytest.approx(1e9 * 150e-6 / 3600.0, rel=1e-2)
    assert float(hours.replace(",", "")) == pytest.approx(1e9 * 150e-6 / 3600.0 / 16, rel=1e-2)
    assert float(gigabytes) == pytest.approx(16 * 64 * 1e-3, rel=1e-2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--quick"], "--quick needs --scale"),
        (["--page", "a.md"], "--page needs --scale"),
        (["--scale", "--only", "sky"], "--only and --scale must not be given together"),
        (["--scale", "--quick", "--page", "a.md"], "--quick and --page must not be given together"),
        (["--scale", "--page", "not/there.md"], "page must be a file that can be read"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["bench", *options])
    assert result.exit_code != 0
    assert message in result.stderr.replace("\n", " ")
