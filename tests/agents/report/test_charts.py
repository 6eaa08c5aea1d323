"""Pictures hold what they are given, and say it in words too."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from importlib import resources

import numpy as np
import pytest

from lanebound.agents.benchmark.results import Paired
from lanebound.agents.report.charts import (
    CostBar,
    EpisodeTrace,
    ParetoAxis,
    ParetoPoint,
    forest,
    front,
    pareto,
    stacked,
    stanford,
    trace,
)
from lanebound.envs.costs import CAUSES
from lanebound.integrity.assessment.plotting import MODE_COLOURS
from lanebound.integrity.assessment.record import Record, Zone
from lanebound.integrity.positioning.modes import Mode

COST, RETURN = ParetoAxis("cost", "", "lower"), ParetoAxis("return", "", "higher")


def paired(
    difference: float, low: float | None, high: float | None, n: int = 50, better: float | None = None, failed: int = 0
) -> Paired:
    place = ("LaneKeeping-v0", "urban", "none")
    return Paired(*place, "a", "nominal", "return", difference, low, high, n, better, failed=failed)


def spot(agent: str, x: float, y: float, look: int = 0, bound: bool = False) -> ParetoPoint:
    return ParetoPoint(agent, look, (x, x - 1.0, x + 1.0), (y, y - 1.0, y + 1.0), bound)


def record(error_m: list[float], pl_m: list[float], alert: list[bool] | None = None) -> Record:
    error, pl = np.array(error_m), np.array(pl_m)
    on = np.zeros(error.size, dtype=bool) if alert is None else np.array(alert)
    mode = np.where(np.arange(error.size) % 2, int(Mode.RTK), int(Mode.DOPPLER))
    return Record(np.arange(1.0, error.size + 1.0), mode, error, 0.5 * error, pl, pl, on, ~on)


def drawn_with(picture: str, *styles: str) -> list[ET.Element]:
    """Elements whose style has all of these."""
    return [e for e in ET.fromstring(picture).iter() if all(style in e.attrib.get("style", "") for style in styles)]


def notes(picture: str) -> list[str]:
    return [str(e.text) for e in ET.fromstring(picture).iter("title")]


def test_verdicts_follow_the_interval_and_the_better_side():
    up, down, unclear = (paired(*d) for d in ((1, 0.5, 2), (-1, -2, -0.5), (1, -0.5, 2)))
    assert [d.verdict("higher") for d in (up, down, unclear)] == ["better", "worse", "unclear"]
    assert [d.verdict("lower") for d in (up, down, unclear)] == ["worse", "better", "unclear"]
    assert [d.verdict(None) for d in (up, unclear)] == ["differs", "unclear"]


def test_few_seeds_or_none_that_differ_give_no_verdict():
    few, alike = paired(1, 0.5, 2, 7), paired(0.5, None, None)
    assert [d.verdict("higher") for d in (few, alike)] == ["too few seeds", "unclear"]
    drawn = forest("return", "", "higher", "nominal", {"a": few, "b": alike})
    assert len(drawn_with(drawn, "stroke:var(--soft)", "stroke-width:1.8")) == 1  # one has no interval
    assert not drawn_with(drawn, "var(--better)")
    assert notes(drawn)[0] == "a: +1.00 [+0.500, +2.00], 7 seeds"
    assert "b +0.500, no interval, unclear" in ET.fromstring(drawn).attrib["aria-label"]


def test_a_forest_has_no_verdict_on_who_failed():
    sound, failed = (paired(-1, -2, -0.5, failed=count) for count in (0, 3))
    assert (sound.verdict("lower"), failed.verdict("lower")) == ("better", "no verdict, 3 failed")
    drawn = forest("return", "", "lower", "nominal", {"a": failed})
    assert not drawn_with(drawn, "var(--better)")
    assert drawn_with(drawn, "fill:var(--card)", "stroke:var(--soft)")
    assert notes(drawn)[-1] == "a: −1.00 [−2.00, −0.500], 50 seeds, no verdict, 3 failed"


def test_a_forest_tells_clear_differences_by_shape_not_by_colour_alone():
    rows = {"mine": paired(-0.2, -0.3, -0.1, better=0.9), "other": paired(0.1, -0.1, 0.3, better=0.2)}
    drawn = forest("collision", "share", "lower", "nominal", rows)
    parsed = ET.fromstring(drawn)
    marks = [e.attrib["style"] for e in parsed.iter("use")]
    assert ["fill:var(--better)" in style for style in marks] == [True, False]
    assert "fill:var(--card)" in marks[1]
    shapes = {e.attrib["id"]: e.attrib["d"] for e in parsed.iter("path") if "id" in e.attrib}
    straight, round_ = (shapes[e.attrib["href"][1:]] for e in parsed.iter("use"))
    assert ("C" in straight, "C" in round_) == (False, True)
    assert "mine −20.0 % [−30.0 %, −10.0 %], better; other +10.0 %" in parsed.attrib["aria-label"]
    assert "better on 90 % of the seeds" in drawn
    assert "← better" in drawn


def test_the_front_is_whom_nobody_beats():
    places = [spot("a", 1, 1), spot("b", 2, 3), spot("c", 3, 2), spot("d", 4, 4)]
    assert [p.agent for p in front(places, COST, RETURN)] == ["a", "b", "d"]
    assert [p.agent for p in front([spot("a", 1, 1), spot("b", 1, 1)], COST, RETURN)] == ["a", "b"]


def test_who_sees_the_truth_is_not_on_the_front():
    drawn = pareto([spot("a", 2, 1), spot("b", 3, 2, 1), spot("oracle", 0, 9, 2, bound=True)], COST, RETURN)
    label = ET.fromstring(drawn).attrib["aria-label"]
    assert label.startswith("return against cost. On the Pareto front: a, b. Means: ")
    assert "oracle 0.000, 9.00" in label
    hollow = [e for e in ET.fromstring(drawn).iter("use") if "fill:var(--card)" in e.attrib["style"]]
    assert len(hollow) == 1


def test_labels_of_agents_at_one_spot_stay_apart():
    drawn = ET.fromstring(pareto([spot(f"agent{i}", 1, 1, i) for i in range(12)], COST, RETURN))
    rows = sorted(float(e.attrib["y"]) for e in drawn.iter("text") if (e.text or "").startswith("agent"))
    assert len(rows) == 12
    assert min(np.diff(rows)) > 14.0
    assert 0.0 < rows[0] < rows[-1] < 300.0


def test_bars_end_at_their_totals():
    drawn = stacked("Costs", [CostBar("a", {"lane": 3.0, "alert": 1.0}), CostBar("b", {"lane": 2.0})])
    bars = [e.attrib["d"] for e in drawn_with(drawn, "stroke:var(--ground)")]
    widths = [np.ptp([float(x) for x in re.findall(r"[ML](\S+) ", d)]) for d in bars]
    assert widths[0] == pytest.approx(3 * widths[1], abs=0.3)
    assert widths[0] + widths[1] == pytest.approx(2 * widths[2], abs=0.3)
    assert "a 4.00 (lane 3.00, alert 1.00)" in ET.fromstring(drawn).attrib["aria-label"]
    assert notes(drawn) == ["a, lane: 3.00", "a, alert: 1.00", "b, lane: 2.00"]
    assert stacked("Costs", [CostBar("a", {"lane": 0.0})])


def test_every_cause_of_costs_has_a_colour() -> None:
    drawn = stacked("Costs", [CostBar("a", dict.fromkeys(CAUSES, 1.0))])
    style = resources.files("lanebound.agents.report").joinpath("page.css").read_text(encoding="utf-8")
    for k in range(len(CAUSES)):
        assert f"var(--c{k})" in drawn
        assert style.count(f"--c{k}:") == 2  # light and dark


def test_a_stanford_diagram_counts_its_zones():
    drawn, zones = stanford("mine", record([0.1, 0.5, 2.0, 0.1, 2.0], [0.3, 0.3, 0.9, np.inf, 1.5]), "at", 1.0)
    assert zones.counts == dict.fromkeys(Zone, 1)
    assert "alert limit 1 m: nominal operation 20.0 %" in drawn
    assert [len(drawn_with(drawn, f"fill:var(--z{int(zone)})")) for zone in Zone] == [1] * len(Zone)
    dots = sum(e.attrib["d"].count("M") for e in drawn_with(drawn, "var(--dense)"))
    assert dots == 5


def test_neighbours_share_a_stroke():
    drawn, _ = stanford("mine", record([0.1, 0.13, 0.9], [0.3, 0.3, 0.9]), "at", 1.0)
    ends = [e.attrib["d"] for e in drawn_with(drawn, "var(--dense)")]
    lengths = [float(b) - float(a) for d in ends for a, b in re.findall(r"M(\S+) \S+L(\S+) ", d)]
    assert max(lengths) == pytest.approx(2 * min(lengths), abs=0.2)


def test_a_trace_shows_alerts_modes_and_levels_that_are_infinite():
    driven = record([0.1, 0.2, 0.9, 0.1], [0.3, 0.4, np.inf, 0.3], [False, False, True, False])
    drawn = trace(EpisodeTrace(driven, 0.6, 0.6), "mine, seed 3")
    parsed = ET.fromstring(drawn)
    assert len(drawn_with(drawn, "stroke:var(--level)")) == 2
    assert len(drawn_with(drawn, "fill:var(--alert)")) == 2
    tones = [MODE_COLOURS[mode].lower() for mode in (Mode.RTK, Mode.DOPPLER)]
    assert [len(drawn_with(drawn, f"fill:{tone}")) for tone in tones] == [4, 4]
    label = parsed.attrib["aria-label"]
    assert "AT: error up to 0.90 m, beyond the alert limit of 0.6 m 25 % of the time" in label
    assert "alert on 25 % of the time" in label
    assert "inf" not in drawn
    assert "nan" not in drawn
