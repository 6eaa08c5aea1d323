"""Journeys in unseen cities: motion along routes, sums over cities, and what runs of the commands leave."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.studies import journeys as study
from lanebound.agents.studies.availability import AvailabilityConfig, fitted
from lanebound.agents.studies.availability import work_city as work_training_city
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import Leg, RouteMotion, speed_profile
from lanebound.integrity.sky.journeys.streets import EdgeStations
from lanebound.integrity.sky.maps.generated import generated_map, map_seed
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.road import Road

DT_S = 0.1


@pytest.mark.parametrize("seed", [0, 4])
def test_a_vehicle_drives_from_standing_to_standing_within_limits(seed: int) -> None:
    graph, drive = StreetGraph.of(generated_map(seed)), DriveConfig()
    first, last = sorted(graph.connected)[3], sorted(graph.connected)[-20]
    edges = graph.way(first, last)
    assert edges is not None
    stations = EdgeStations.along([graph.edges[k] for k in edges], 8.0)
    rows = np.arange(len(stations.part_m))
    way = RouteMotion.of([graph.edges[k] for k in edges], Leg(tuple(edges), 0.5, 0.5), stations, rows, drive, DT_S)
    assert way.speed_mps[0] == pytest.approx(0.0, abs=0.1)
    assert way.speed_mps[-1] == pytest.approx(0.0, abs=0.1)
    assert np.all(way.speed_mps <= stations.speed_mps.max() + 1e-9)
    change = np.diff(way.speed_mps) / DT_S
    assert change.max() < drive.acceleration_mps2 + 0.1
    assert change[:-1].min() > -drive.braking_mps2 - 0.1
    step = np.linalg.norm(np.diff(way.place_en_m, axis=0), axis=1)
    np.testing.assert_allclose(step[:-1], DT_S * 0.5 * (way.speed_mps[1:-1] + way.speed_mps[:-2]), atol=0.05)
    away = np.linalg.norm(way.place_en_m - stations.place_en_m[way.row], axis=1)
    assert away.max() < 16.0  # in a turn the nearest station is that of a street
    expected = sum(graph.edges[k].length_m for k in edges) - 0.5 * sum(graph.edges[k].length_m for k in (first, last))
    assert way.length_m == pytest.approx(expected, rel=0.15)


def city(seed: int, pairs: int = 4) -> list[dict[str, Any]]:
    """A city in which the shortest way loses 30 s, the others 10 s to 20 s, and the oracle 10 s."""
    rng = np.random.default_rng(seed)
    lost = dict(zip(study.CHOICES, (30.0, 20.0, 20.0, 15.0, 10.0), strict=True))
    return [
        {
            "hour": 1.0,
            "routes": {
                choice: {
                    "edges": [k], "planned_s": 90.0, "predicted_s": value, "time_s": 100.0 + shift, "length_m": 900.0,
                    "unusable_s": value + shift,
                }
                for k, (choice, value) in enumerate(lost.items())
            },
        }
        for shift in rng.normal(size=pairs)
    ]  # fmt: skip


def test_differences_and_shares_are_those_of_the_same_journeys() -> None:
    found = study.summary(study.JourneysConfig(weight=2.0), [city(seed) for seed in range(5)])
    rows = {row["choice"]: row for row in found["choices"]}
    assert found["journeys"] == 20
    np.testing.assert_allclose(rows["integrity-aware"]["less"]["unusable_s"], -10.0)  # shifts are those of the pair
    np.testing.assert_allclose(rows["integrity-aware"]["less"]["time_s"], 0.0, atol=1e-9)
    np.testing.assert_allclose(rows["chance-constrained"]["gain_unusable"], 0.75)
    np.testing.assert_allclose(rows["oracle"]["gain_cost"], 1.0)
    assert rows["fastest"]["same"] == 0.0
    assert rows["shortest"]["same"] == 1.0
    assert found["correlation"] > 0.95
    assert sum(group["routes"] for group in found["calibration"]) == 5 * 4 * 5


def test_a_training_city_gives_the_same_samples_again_and_a_model() -> None:
    config = AvailabilityConfig(cities=1, vehicles=3, warm_up_s=2.0)
    ways = work_training_city(config, "0")
    assert work_training_city(config, "0") == ways
    assert len(ways) == 3
    for way in ways:
        assert max(way["station"]) < len(way["satellites"]) == len(way["part_s"]) == len(way["pdop"])
        assert len(way["station"]) == len(way["usable"]) == len(way["pl_ct_m"])
    assert fitted(ways).probability([30.0], [0.0])[0] > 0.0


def test_training_cities_are_no_test_cities() -> None:
    assert AvailabilityConfig().cities <= map_seed("test", 0)


def test_a_short_run_of_journeys(tmp_path: Path) -> None:
    arguments = ["--cities", "1", "--pairs", "1", "--set", "warm_up_s=2", "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, ["reproduce", "journeys", *arguments])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    rows = {row["choice"]: row for row in found["choices"]}
    assert set(rows) == set(study.CHOICES)
    assert rows["shortest"]["length_m"] <= rows["integrity-aware"]["length_m"] + 40.0  # corners are cut
    assert all(0.0 <= row["unusable_s"] <= row["time_s"] for row in rows.values())
    for name in ("results.json", "calibration.svg"):
        assert (tmp_path / "out" / name).is_file()


def test_vehicles_are_slow_enough_at_both_ends_of_every_bend() -> None:
    drive, road = DriveConfig(), Road.through([(0, 0), (100, 0), (100, 80), (180, 100)], corner_radius_m=12.0)
    speed = speed_profile(road, np.full(road.arc_at_m.size, 14.0), drive)
    step, turn = np.diff(road.arc_at_m), np.abs(np.diff(road.tangent_rad))
    bend = turn > 1e-6
    most = np.maximum(np.sqrt(drive.lateral_mps2 * step[bend] / turn[bend]), 3.0) + 1e-9
    assert bend.any()
    assert (speed[:-1][bend] <= most).all()
    assert (speed[1:][bend] <= most).all()
    assert (np.diff(speed**2) <= 2.0 * drive.acceleration_mps2 * step + 1e-9).all()
    assert (-np.diff(speed**2) <= 2.0 * drive.braking_mps2 * step + 1e-9).all()
    assert speed[0] == speed[-1] == 0.0
