"""``lanebound envs``: the list is what the environments are, and is there at once."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.cli.static import static_table
from lanebound.agents.episodes import full_id, open_env
from lanebound.envs import IDS
from lanebound.envs.info import INFO

QUICK = """
import sys
from lanebound.agents.cli import app
app(["envs"], standalone_mode=False)
heavy = {"gymnasium", "highway_env", "numba", "numpy", "torch"} & set(sys.modules)
assert not heavy, heavy
"""


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["envs", *arguments])


def test_info_is_described_key_by_key():
    _, info = open_env("LaneKeeping", {"navigation": {"source": "perfect"}, "sky": "open"}).reset(seed=0)
    assert len(INFO) == len(info)
    assert set(INFO) == set(info)


def test_listing_needs_none_of_the_heavy_imports():
    done = subprocess.run([sys.executable, "-c", QUICK], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "lanebound/UrbanCanyon-v0" in done.stdout


def test_list_as_table_and_as_json():
    assert all(env_id in run().stdout for env_id in IDS)
    assert json.loads(run("--json").stdout) == static_table()["environments"]


def test_the_list_fits_into_a_narrow_terminal():
    shown = run().stdout
    assert max(map(len, shown.splitlines())) <= 80
    assert "Box(2,)" in shown


def test_one_environment_as_tables():
    shown = run("LaneKeeping", "--set", "sky=dense").stdout
    for word in ("lanebound/LaneKeeping-v0", "dense", "ego.lateral_offset", "cost_lane_integrity", "is_success"):
        assert word in shown


def test_one_environment_as_json():
    shown = json.loads(run("UrbanCanyon", "--set", "observation.integrity=blind", "--json").stdout)
    assert list(shown["observation"]) == ["ego", "road", "traffic"]
    assert len(shown["index"]) == shown["flat_size"]
    assert shown["config"]["base"] == "UrbanCanyonWorld"
    assert shown["cost_weights"]["cost_collision"] == 200.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["LaneKeepign"], "error: environment 'LaneKeepign' is unknown: did you mean 'LaneKeeping-v0'?"),
        (["LaneKeeping-v7"], "error: environment 'LaneKeeping-v7' is unknown: did you mean 'LaneKeeping-v0'?"),
        (["LaneKeeping", "--set", "sky=dens"], "error: sky must be one of"),
        (["--set", "sky=dense"], "error: --set needs an environment, got none"),
    ],
)
def test_mistakes_are_answered_in_one_line(arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "env_id"),
    [
        ("lanekeeping", "lanebound/LaneKeeping-v0"),
        ("Merge-v0", "lanebound/Merge-v0"),
        ("lanebound/Highway-v0", "lanebound/Highway-v0"),
        ("highway-v0", "lanebound/Highway-v0"),
        ("two-way-v0", "two-way-v0"),
    ],
)
def test_names_are_ids_or_short_for_them(name, env_id):
    assert full_id(name) == env_id
