"""The command line refuses options that contradict each other, and its help shows commands that run."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.cli.options import film_rate
from lanebound.agents.cli.output import format_value
from lanebound.agents.studies.faults import FaultsConfig
from lanebound.envs import EnvConfig, FaultLevel
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import parse_assignments
from lanebound.integrity.navigators.navigator import NavigatorConfig


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize(
    ("arguments", "first", "second"),
    [
        (["drive", "Merge", "--sky", "dense", "--set", "sky=open"], "--sky", "--set sky="),
        (["drive", "Merge", "--set", "faults=none", "--faults", "stress"], "--faults", "--set faults="),
        (["benchmark", "quick", "--out", "x", "--seeds", "1", "--set", "seeds.count=2"], "--seeds", "--set seeds"),
        (["benchmark", "quick", "--out", "x", "--fresh", "--resume"], "--fresh", "--resume"),
        (["benchmark", "quick", "--out", "x", "--resume", "--fresh"], "--fresh", "--resume"),
        (["assess", "faults", "--out", "x", "--vehicles", "3", "--set", "vehicles=4"], "--vehicles", "--set vehicles="),
        (["assess", "bounding", "--out", "x", "--risk", "1e-3", "--set", "risks=[1e-4]"], "--risk", "--set risks="),
        (["evaluate", "x", "--out", "y", "--sky", "open", "--set", "sky=dense"], "--sky", "--set sky="),
    ],
)  # fmt: skip
def test_options_that_contradict_each_other_are_both_named(tmp_path, monkeypatch, arguments, first, second):
    monkeypatch.chdir(tmp_path)
    told = run(*arguments)
    assert told.exit_code == 2
    line = told.stderr.strip()
    assert line.startswith(f"error: {first} and {second}")
    assert "must not be given together" in line
    assert "\n" not in line
    assert list(tmp_path.iterdir()) == []


def test_a_seed_count_beside_another_key_of_the_seeds_is_no_contradiction(tmp_path):
    told = run("benchmark", "nope", "--out", str(tmp_path), "--seeds", "1", "--set", "seeds.skip=2")
    assert "suite 'nope' is unknown" in told.stderr


@pytest.mark.parametrize("command", [["drive", "Merge"], ["replay-episode", "nowhere", "a/b/c/1"]])
def test_a_rate_without_a_film_is_refused(command):
    told = run(*command, "--fps", "20")
    assert told.exit_code == 2
    assert told.stderr.startswith("error: --fps needs --video, got --fps 20 alone")


def test_a_film_has_ten_pictures_a_second_unless_told():
    assert film_rate(Path("a.mp4"), None) == film_rate(None, None) == 10
    assert film_rate(Path("a.mp4"), 20) == 20


def test_the_example_of_the_fault_study_can_be_run(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    told = re.sub(r"\x1b\[[0-9;]*m", "", run("assess", "faults", "--help").stdout)
    words = shlex.split(re.search(r"Example: (.*)", told)[1])
    given = parse_assignments([words[words.index("--set") + 1]])
    assert FaultsConfig.load(given).kinds == ("spoofing", "jamming")


def test_the_help_of_the_fault_study_has_its_number_of_vehicles():
    told = " ".join(run("assess", "faults", "--help").stdout.replace("│", " ").split())
    assert f"the study has {FaultsConfig().vehicles}." in told


def test_files_that_do_not_exist_are_named_with_their_option(tmp_path):
    (tmp_path / "a.obs").touch()
    told = run(
        "rtk", "--rover", str(tmp_path / "a.obs"), "--base", "no.obs", "--nav", "no.nav", "--out", str(tmp_path / "x")
    )
    assert told.exit_code == 2
    assert told.stderr == "error: --base must be a file that exists, got no.obs: correct the path\n"


@pytest.mark.parametrize("name", ["quick", "suites/quick"])
def test_a_preset_is_shown_with_and_without_its_folder(name):
    shown = json.loads(run("config", "show", name, "--json").stdout)
    assert shown["kind"] == "suite"


@pytest.mark.parametrize("command", [["train", "experiments/no"], ["benchmark", "suites/no"], ["study", "studies/no"]])
def test_an_unknown_preset_with_a_folder_is_refused_as_one_without(command, tmp_path):
    told = run(*command, "--out", str(tmp_path))
    assert told.exit_code == 2
    assert re.search(r"is unknown: (known are|did you mean) ", told.stderr)


def test_values_are_shown_as_a_user_writes_them():
    assert format_value((FaultLevel.NONE, FaultLevel.STRESS)) == "none, stress"


def test_presets_are_listed_with_what_they_are_for():
    rows = {row["preset"]: row["about"] for row in json.loads(run("config", "list", "--json").stdout)}
    assert all(rows.values())
    assert rows["suites/claim"] == "what integrity adds to caution"
    assert rows["sensors/gnss_consumer"].startswith("Single-band u-blox class")


@pytest.mark.parametrize("name", ["tactical", "navigators/tactical"])
def test_a_navigator_is_named_with_and_without_its_folder(name):
    config = EnvConfig.build({"base": "highway-v0"}, {"navigator": name})
    assert config.navigator["imu"]["grade"] == NavigatorConfig.preset("navigators/tactical").imu.grade
    for wrong in ("no_such_navigator", "dense"):
        with pytest.raises(ConfigError, match=f"^must be a kind .* or a preset .*, got '{wrong}'"):
            NavigatorConfig.data_of(wrong)


@pytest.mark.parametrize("name", ["dense", "skies/dense"])
def test_a_sky_is_named_with_and_without_its_folder(name):
    config = EnvConfig.build({"base": "highway-v0"}, {"sky": name})
    assert config.level == EnvConfig.build({"base": "highway-v0"}, {"sky": "dense"}).level
