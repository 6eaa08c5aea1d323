"""The context study: true links, counts of a short run, resumption, the command."""

import csv
import json
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import context_study as made
from lanebound.agents.studies.context_drive import (
    DRIVES,
    PHASES,
    MonitorSeries,
    TrueLinks,
    drive_of,
    route_road,
    warned_by,
)
from lanebound.agents.studies.context_study import ContextStudyConfig, run_context
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.monitor import ContextMonitor, ContextReason
from lanebound.integrity.motion.drive import CityDrive
from lanebound.integrity.positioning.map_matching.generators import generate_map

SHORT = {
    "environments": ["mixed"], "seeds": 3, "batch": 3,
    "drives": {"mixed": {"roads": "mixed", "length_m": 1500.0, "points": 40, "sky": "open"}},
}  # fmt: skip
SETTINGS = (
    "environments=[mixed]", "batch=3", "drives.mixed.length_m=1500", "drives.mixed.points=40", "drives.mixed.sky=open",
)  # fmt: skip


@pytest.mark.parametrize("environment", ["urban", "rural", "mixed"])
def test_routes_can_be_driven_and_the_true_link_is_beside_the_car(environment) -> None:
    table = DRIVES[environment]
    found = generate_map(table.roads, table.length_m, named_generator([1, 1], "road"))
    road = route_road(found)
    CityDrive(road, table.drive, 0.2)  # refuses kinks
    links = TrueLinks.of(road, found)
    assert (np.diff(links.start_m) > 0.0).all()
    arc = np.linspace(0.0, road.length_m, 400)[:-1]
    true = links.at(arc, 10.0)
    place, _ = road.pose_at(arc)
    near = found.road_map.near(place, 15.0, 64)
    names = np.append(found.road_map.identity, -1)[near.link]
    beside = (names[:, :, None] == true[:, None, :]).any((1, 2))
    assert beside.mean() > 0.995  # rounded corners leave the lines by some metres
    distance = np.where(names == true[:, :1], near.distance_m, np.inf).min(-1)
    assert np.median(distance[np.isfinite(distance)]) < 1.0


def test_true_links_of_a_closed_route_wrap_and_of_an_open_one_end() -> None:
    open_, closed = (TrueLinks(np.array([0.0, 50.0, 120.0]), np.array([7, 8]), closed) for closed in (False, True))
    arc = np.array([20.0, 47.0, 53.0, 118.0, 130.0])
    assert open_.at(arc, 5.0).tolist() == [[7, 7], [7, 8], [8, 7], [8, 8], [8, 8]]
    assert closed.at(arc, 5.0).tolist() == [[7, 7], [7, 8], [8, 7], [8, 7], [7, 7]]


def test_a_short_study_counts_all_points_and_resumes(tmp_path) -> None:
    config = ContextStudyConfig().replace(**SHORT)
    tables = run_context(config, tmp_path)
    found = tables["environments"]["mixed"]
    assert (found["drives"], found["points"]) == (3, 120)
    assert set(found["assumptions"]) == set(config.assumptions)
    for monitor in (*found["of"].values(), *found["assumptions"].values()):
        for counts in monitor["rules"].values():
            assert counts["pooled"]["points"] == 120
        rules = monitor["rules"]
        assert sum(monitor["reasons"]) == 120
        assert rules["never"]["pooled"]["false_alarms"] == rules["always"]["pooled"]["missed"] == 0
        assert rules["never"]["pooled"]["missed"] == rules["never"]["pooled"]["wrong"]
        assert rules["all phases"]["pooled"]["false_alarms"] >= rules["without map"]["pooled"]["false_alarms"]
        assert rules["all phases"]["pooled"]["missed"] <= rules["without map"]["pooled"]["missed"]
        reached = [stage["pooled"] for stage in monitor["stages"]]
        assert 120 == reached[0]["points"] >= reached[1]["points"] >= reached[2]["points"]
        unwarned = reached[2]["points"] - reached[2]["false_alarms"] - (reached[2]["wrong"] - reached[2]["missed"])
        assert unwarned == monitor["reasons"][0]  # what no phase warns of is trusted
        over_all = monitor["over_all"]["pooled"]
        assert over_all["points"] == 120
        assert over_all["false_alarms"] == reached[2]["false_alarms"]
        assert monitor["beyond"][0] <= monitor["beyond"][1] <= 120
    far = found["assumptions"]["GPS alone, limit 50 m, P_FA 5e-3, P_MD 5e-5"]["available"]
    assert far[0] > found["assumptions"]["GPS alone"]["available"][0]  # the limit is that of the assumption
    assert found["assumptions"]["GPS alone"]["stages"][2]["ocdr"] is None  # no point reaches the third phase
    printed = found["assumptions"]["S5: as printed, GPS alone, weak signals"]["available"]
    assert printed[0] > found["assumptions"]["GPS alone"]["available"][0]
    assert {path.name for path in tmp_path.glob("*.png")} == {"threshold.png", "rules.png", "matchers.png"}
    before = (tmp_path / "parts" / "mixed-0.json").stat().st_mtime_ns
    assert run_context(config, tmp_path) == tables
    assert (tmp_path / "parts" / "mixed-0.json").stat().st_mtime_ns == before
    told = CliRunner().invoke(app, [
        "reproduce", "context", "--out", str(tmp_path), "--seeds", "3",
        *(word for setting in SETTINGS for word in ("--set", setting)),
    ])  # fmt: skip
    assert told.exit_code == 0, told.output
    for words in (
        "Overall correct detection rate",
        "What each phase adds",
        "Matchers",
        "Speed phase",
        "Charges",
        "receiver uses",
        "Why the driver is warned",
    ):
        assert words in told.output
    for rows in (made.ocdr_rows, made.rule_rows, made.matcher_rows, made.speed_rows, made.application_rows,
                 made.assumption_rows, made.stage_rows, made.reason_rows):  # fmt: skip
        head, cells = rows(tables)
        assert cells
        assert all(len(row) == len(head) for row in cells)


def test_the_scored_warnings_are_those_of_the_monitor_at_every_point() -> None:
    """A town with stops, under a sky in which levels exceed the limit: warnings of the monitor, and by its results."""
    table = DRIVES["urban"].replace(length_m=1500.0, points=150)
    study, seeds = ContextStudyConfig(), [1, 2, 3]
    for limit in (15.0, 40.0):
        config = study.monitor.replace(position={"alert_limit_m": limit})
        drive = drive_of(table, 0, seeds, (study.gnss, study.sky), {"": config.codes}, study.node_m)
        key = ("true", "topological")
        series = MonitorSeries.of(
            drive, table.points, {key: ContextMonitor(config, drive.road_map, 3, 1.0)}, {}, config, lambda done: None
        )
        for b in range(3):
            get = partial(series.of_found, key, b=b)
            warned = get(name="warn")
            assert (warned == warned_by(get, PHASES)).all()
            rest = ~get(name="in motion")
            assert rest.sum() > 10
            assert warned.any()
            assert limit == 15.0 or not warned.all()
            assert np.isin(get(name="reason")[rest & ~warned], [ContextReason.SLOW.code]).all()


def test_environments_without_drives_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"environments must be among urban, rural, mixed, suburban, got 'desert'"):
        ContextStudyConfig(environments=("desert",))


def test_drive_shows_the_light_and_logs_it(tmp_path) -> None:
    out = tmp_path / "drive"
    told = CliRunner().invoke(app, [
        "drive", "LaneKeeping", "--sky", "open", "--set", "duration_s=14", "--display", "--out", str(out), "--json",
    ])  # fmt: skip
    assert told.exit_code == 0, told.output
    rows = (out / "warnings.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("episode,time_s,light,reason")
    assert rows[1].startswith("0,0.0,amber,COLLECTING,")
    assert any(row.startswith("0,8.0,green,TRUSTED,3,") for row in rows)
    assert "light: green 6 s, amber 8 s, red 0 s; it changed 1 time\n" in told.stderr
    assert json.loads(told.stdout)["files"]["warnings"] == str(out / "warnings.csv")


def test_the_log_of_warnings_needs_no_display_and_counts_each_episode_from_its_start(tmp_path) -> None:
    out, rounds = tmp_path / "drive", ["drive", "LaneKeeping", "--sky", "open", "--set", "duration_s=10", "--json"]
    watched = ["--set", "navigator.context.warns_at=red", "--episodes", "2", "--out", str(out)]
    told = CliRunner().invoke(app, [*rounds, *watched])
    assert told.exit_code == 0, told.output
    with (out / "warnings.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["episode"], row["time_s"], row["light"]) for row in rows] == [
        (episode, time, light) for episode in "01" for time, light in (("0.0", "amber"), ("8.0", "green"))
    ]  # the approach before an episode is not in its clock
    assert "light: green 4 s, amber 16 s, red 0 s; it changed 2 times\n" in told.stderr
    plain = CliRunner().invoke(app, [*rounds, "--out", str(out)])
    assert plain.exit_code == 0, plain.output
    assert "warnings" not in json.loads(plain.stdout)["files"]
    assert not (out / "warnings.csv").exists()
