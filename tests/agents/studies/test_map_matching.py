"""The study of map matching: true links, thresholds of hand-made sweeps, a short run, the command."""

import json
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import map_matching as made
from lanebound.agents.studies import matched_drives as drives
from lanebound.integrity.assessment.warning_rates import WarningSweep, sweep_thresholds
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import Leg, RouteMotion

BERLIN = "berlin_kreuzberg"
SHORT = {
    "maps": [BERLIN, "generated:1"], "drives": 2, "length_m": 500.0, "skies": ["open"], "warm_up_s": 2.0,
}  # fmt: skip


def test_links_of_a_street_map_are_its_edges() -> None:
    streets = drives.streets_of(BERLIN)
    assert streets.links.links == len(streets.graph.edges)
    both = np.flatnonzero(streets.links.twin >= 0)
    assert both.size
    for k in both[:20]:
        assert streets.graph.edges[k].turns_back(streets.graph.edges[streets.links.twin[k]])
    np.testing.assert_allclose(streets.links.length_m, [edge.length_m for edge in streets.graph.edges])


def test_the_true_link_is_the_one_beside_the_car() -> None:
    streets = drives.streets_of(BERLIN)
    route = drives.wandering(streets, 3000.0, np.random.default_rng(1))
    assert all((a, b) in set(streets.graph.turns) for a, b in pairwise(route))
    at = {k: streets.stations.of(i) for i, k in enumerate(streets.known)}
    rows = np.concatenate([np.arange(at[k].start, at[k].stop) for k in route])
    edges = [streets.graph.edges[k] for k in route]
    way = RouteMotion.of(edges, Leg(tuple(route), 0.0, 1.0), streets.stations, rows, DriveConfig(), 1.0)
    assert way.starts_m.size == len(route) + 1
    assert (np.diff(way.starts_m) > 0.0).all()
    lengths = np.array([edge.length_m for edge in edges])
    assert np.abs(np.diff(way.starts_m) - lengths).max() < 25.0  # lanes and chords cut corners
    near = streets.links.near(way.place_en_m, 12.0, 16)
    for k in range(len(way.place_en_m)):
        here = [link for link in near.link[k] if drives._on_route(route, way.starts_m, int(link), way.arc_m[k], 0.0)]
        assert here, f"no link of the route beside epoch {k}"


def test_links_of_the_route_near_a_node_count() -> None:
    starts = np.array([0.0, 50.0, 55.0, 120.0])
    right = [
        drives._on_route([7, 8, 9], starts, link, arc, 10.0)
        for link, arc in ((7, 20.0), (8, 20.0), (8, 45.0), (9, 46.0), (9, 44.0), (7, 61.0), (8, 70.0), (-1, 50.0))
    ]
    assert right == [True, False, True, True, False, False, False, False]


def test_thresholds_of_a_hand_made_sweep() -> None:
    grid = drives.THRESHOLDS
    false_alarms, missed = np.zeros(grid.size, int), np.full(grid.size, 20)
    false_alarms[grid > 30.0], missed[grid > 30.0] = 5, 8
    false_alarms[grid > 60.0], missed[grid > 60.0] = 15, 4
    false_alarms[grid > 80.0] = 300
    found = made.fitted(WarningSweep(grid, false_alarms, missed, 400), "quddus", 0.05)
    assert found == {"crossing": 60.25, "best": 30.25, "equal": 80.0, "never": 0.0, "published": 70.0}
    assert "published" not in made.fitted(WarningSweep(grid, false_alarms, missed, 400), "yu", 0.05)


def test_a_threshold_is_fitted_on_the_points_that_reach_the_score() -> None:
    """First phases that warn of many points leave the threshold of the others as it is."""
    rng = np.random.default_rng(2)
    wrong = rng.random(4000) < 0.1
    score = np.clip(rng.normal(np.where(wrong, 40.0, 70.0), 15.0), 0.0, 100.0)
    early = rng.random(4000) < 0.7
    chain = sweep_thresholds(np.where(early, -1.0, score), wrong, drives.THRESHOLDS)
    assert chain.crossing() == 0.0  # more early warnings than wrong points: the score would be off
    rest = sweep_thresholds(score[~early], wrong[~early], drives.THRESHOLDS)
    reached = made.reaching(chain, int(wrong.sum()))
    assert reached.points == rest.points == (~early).sum()
    assert made.fitted(reached, "yu", 0.05) == made.fitted(rest, "yu", 0.05)
    assert 30.0 < made.fitted(reached, "yu", 0.05)["crossing"] < 70.0
    whole = sweep_thresholds(score, wrong, drives.THRESHOLDS)
    same = made.reaching(whole, int(wrong.sum()))
    np.testing.assert_array_equal(same.false_alarms, whole.false_alarms)
    assert same.points == whole.points


def test_rates_are_those_of_s5_and_intervals_are_by_drive() -> None:
    def drive(points, wrong, false_alarms, missed):
        return {"points": points, "wrong": wrong, "sweeps": {"yu": {"alone": [[false_alarms], [missed]]}}}

    same = made.rates([drive(100, 10, 5, 2)] * 3, "yu", "alone", 0)
    for key, value in (("far", 0.05), ("mdr", 0.02), ("ocdr", 0.93), ("per_right", 5 / 90), ("per_wrong", 0.2)):
        assert same[key] == pytest.approx([value] * 3)
    two = made.rates([drive(100, 0, 0, 0), drive(100, 0, 100, 0)], "yu", "alone", 0)
    assert two["far"] == pytest.approx([0.5, 0.0, 1.0])
    assert two["per_wrong"] == [None, None, None]


def test_a_short_study_counts_all_points_fits_on_the_other_map_and_resumes(tmp_path) -> None:
    config = drives.MapMatchingConfig.load(SHORT)
    found = made.run_map_matching(config, tmp_path)
    parts = [json.loads((tmp_path / "parts" / f"{m}-0-{k}.json").read_text()) for m in (0, 1) for k in (0, 1)]
    assert [d["faulty"] for d in found["drives"]] == [1, 1]
    assert (tmp_path / "roc.svg").exists()
    for m, name in enumerate(config.maps):
        own, others = parts[2 * m : 2 * m + 2], parts[2 * (1 - m) : 2 * (1 - m) + 2]
        total = made._total(others, "quddus", "alone")
        thresholds = made.fitted(total, "quddus", config.equal_far)
        rows = [r for r in found["rates"] if (r["map"], r["score"], r["chain"], r["group"]) == (
            name, "quddus", "alone", "all")]  # fmt: skip
        assert {r["rule"]: r["threshold"] for r in rows} == thresholds
        at = {rule: int(np.searchsorted(drives.THRESHOLDS, value)) for rule, value in thresholds.items()}
        points = sum(d["points"] for d in own)
        for r in rows:
            alarms, missed = (
                made._total(own, "quddus", "alone").false_alarms,
                made._total(own, "quddus", "alone").missed,
            )
            assert r["ocdr"][0] == pytest.approx(1.0 - (alarms[at[r["rule"]]] + missed[at[r["rule"]]]) / points)
    for part in parts:
        for sweeps in part["sweeps"].values():
            for false_alarms, missed in sweeps.values():
                assert (np.diff(false_alarms) >= 0).all()  # a higher threshold warns of more
                assert (np.diff(missed) <= 0).all()
                assert missed[0] <= part["wrong"]
        assert part["sweeps"]["quddus"]["alone"] == part["sweeps"]["quddus"]["published"]
        assert part["sweeps"]["context"]["published"][0][0] >= part["sweeps"]["context"]["alone"][0][0] == 0
    before = (tmp_path / "parts" / "0-0-0.json").stat().st_mtime_ns
    words = [word for key in ("length_m=500", "skies=[open]", "warm_up_s=2") for word in ("--set", key)]
    told = CliRunner().invoke(app, [
        "reproduce", "map-matching", "--out", str(tmp_path), "--map", BERLIN, "--map", "generated:1", "--drives", "2",
        *words,
    ])  # fmt: skip
    assert told.exit_code == 0, told.output
    assert (tmp_path / "parts" / "0-0-0.json").stat().st_mtime_ns == before
    for title in ("Points in motion", "threshold rule", "before the score", "Table 6", "equal false", "Largest OCDR"):
        assert title in told.output
    for rows in (made.crossing_rows, made.first_phases_rows, made.published_rows, made.equal_rows, made.best_rows):
        head, cells = rows(found)
        assert cells
        assert all(len(row) == len(head) for row in cells)


def test_under_an_open_sky_with_a_true_map_nearly_all_matches_are_right() -> None:
    config = drives.MapMatchingConfig.load({**SHORT, "length_m": 2500.0, "map_errors": {
        "shift_m": 0.0, "missing": 0.0, "wrong_topology": 0.0}})  # fmt: skip
    found = drives.judged_drive(config, BERLIN, "open", [1, 2], False)
    assert found.wrong.size > 150
    assert found.wrong.mean() < 0.02
    again = drives.judged_drive(config, BERLIN, "open", [1, 2], False)
    for name, scores in found.scores.items():
        np.testing.assert_array_equal(scores, again.scores[name])


def test_a_map_whose_streets_lead_nowhere_is_refused(tmp_path) -> None:
    file = tmp_path / "one.osm"
    file.write_text(
        '<osm version="0.6"><node id="1" version="1" lat="52.5" lon="13.4"/><node id="2" version="1" lat="52.501" '
        'lon="13.4"/><way id="3" version="1"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/>'
        '<tag k="oneway" v="yes"/></way></osm>'
    )
    with pytest.raises(InputError, match="lead back"):
        drives.streets_of(str(file))


@pytest.mark.parametrize("twice", [BERLIN, "generated:1", "a/town.osm"])
def test_a_map_that_is_named_twice_is_refused(twice) -> None:
    with pytest.raises(ConfigError, match="maps must differ"):
        drives.MapMatchingConfig(maps=(twice, "generated:2", twice))
    with pytest.raises(ConfigError, match="maps must differ"):
        drives.MapMatchingConfig(maps=(twice, f"./{twice}"))


def test_the_command_refuses_a_map_that_is_named_twice_before_any_drive(tmp_path) -> None:
    out = tmp_path / "out"
    told = CliRunner().invoke(
        app, ["reproduce", "map-matching", "--out", str(out), "--map", BERLIN, "--map", BERLIN, "--drives", "2"]
    )
    assert told.exit_code != 0
    assert "maps must differ" in told.output
    assert not out.exists()


def test_the_study_scores_all_methods_and_refuses_another_score_of_the_monitor() -> None:
    with pytest.raises(ConfigError, match="score must be context"):
        drives.MapMatchingConfig.load({**SHORT, "monitor": {"map": {"score": "yu", "threshold": 50.0}}})


def test_maps_of_one_stem_stay_distinct_in_tables() -> None:
    assert made.labels(["a/town.osm.pbf", "b/town.osm", BERLIN]) == {
        "a/town.osm.pbf": "a/town.osm.pbf", "b/town.osm": "b/town.osm", BERLIN: BERLIN,
    }  # fmt: skip
    assert made.labels(["a/town.osm.pbf", "b/village.osm"]) == {"a/town.osm.pbf": "town", "b/village.osm": "village"}
