"""``lanebound plan``: its tables, files and refusals."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.cli.plan import plan
from lanebound.integrity.sky.journeys.planner import MOST_UNUSABLE, WEIGHT
from lanebound.integrity.sky.maps.generated import generated_map

SEED = 0


def place(east_m: float, north_m: float) -> str:
    lat, lon = generated_map(SEED).frame.lat_lon_of([east_m, north_m])
    return f"{lat:.6f},{lon:.6f}"


def test_a_plan_has_routes_hours_and_a_picture(tmp_path: Path) -> None:
    ends = ["--from", place(-200.0, -150.0), "--to", place(250.0, 200.0)]
    result = CliRunner().invoke(app, ["plan", f"generated:{SEED}", *ends, "--out", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    routes = found["routes"]
    assert set(routes) == {"shortest", "fastest", "integrity-aware", "chance-constrained"}
    assert routes["shortest"]["length_m"] <= min(route["length_m"] for route in routes.values()) + 1e-6
    assert routes["fastest"]["time_s"] <= min(route["time_s"] for route in routes.values()) + 1e-6
    assert routes["integrity-aware"]["unusable_s"] <= routes["fastest"]["unusable_s"] + 1.0
    assert all(0.0 <= route["unusable_share"] <= 1.0 for route in routes.values())
    assert [one["hour"] for one in found["by_hour"]] == list(range(24))
    assert len({round(one["unusable_s"], 6) for one in found["by_hour"]}) > 1
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "plan.json").read_text()) == found


@pytest.mark.parametrize(
    ("name", "origin", "destination", "more", "said"),
    [
        ("generated:0", "here", "35.666,139.792", (), "--from must be LAT,LON"),
        ("generated:0", "52.5,13.4", "35.666,139.792", (), "--from must lie in the map's connected streets"),
        ("generated:0", "35.666,139.792", "139.792,35.666", (), "--to must be LAT,LON"),
        ("generated:0", "35.666,139.792", "35.666,139.792", (), "--from and --to must differ"),
        ("generated:-3", "35.666,139.792", "35.667,139.793", (), "generated:SEED"),
        ("nowhere.osm", "35.666,139.792", "35.667,139.793", (), "map must be"),
        ("generated:0", "35.666,139.792", "35.667,139.793", ("--depart", "25"), "hour must lie in"),
    ],
)
def test_refusals(name: str, origin: str, destination: str, more: tuple[str, ...], said: str) -> None:
    result = CliRunner().invoke(app, ["plan", name, "--from", origin, "--to", destination, *more])
    assert result.exit_code != 0
    assert said in str(result.exception) + result.output


def test_the_options_have_the_defaults_of_the_planner() -> None:
    given = inspect.signature(plan).parameters
    assert given["weight"].default == WEIGHT
    assert given["most_unusable"].default == MOST_UNUSABLE
