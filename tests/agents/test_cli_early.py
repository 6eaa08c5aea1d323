"""Refusals before slow imports: static lists are those of the environments, and nothing heavy is imported."""

import json
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import get_args

import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app, options, static
from lanebound.agents.cli.static import TABLE, refuse_early, refuse_film, refuse_preset
from lanebound.agents.cli.static_write import made, text_of
from lanebound.agents.episodes import open_env
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import parse_assignments


def test_the_static_table_is_that_of_the_environments_and_configurations() -> None:
    """It is stored with one key a line."""
    stored = resources.files("lanebound.agents.cli").joinpath(TABLE).read_text(encoding="utf-8")
    assert stored == text_of(made()), "write it anew: python -m lanebound.agents.cli.static_write"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"env": "LaneKeepin"}, "environment 'LaneKeepin' is unknown: did you mean 'LaneKeeping-v0'"),
        ({"env": "lanebound/Nowhere-v0"}, "environment 'lanebound/Nowhere-v0' is unknown"),
        ({"agent": "nominl"}, "agent 'nominl' is unknown: did you mean 'nominal'"),
        (
            {"sky": "urbn"},
            "sky must be one of open, suburban, urban, dense, plaza, or a file, got 'urbn': did you",
        ),
        ({"faults": "stres"}, "faults must be one of none, nominal, stress, one, got 'stres': did you mean 'stress'"),
    ],
)
def test_names_that_cannot_exist_are_refused(names: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match="^" + message):
        refuse_early(**names)


@pytest.mark.parametrize("env", ["lanekeeping", "LaneKeeping-v0", "lanebound/Merge-v0", "two-way-v0", "mine:Own-v0"])
def test_names_that_may_exist_pass(env: str) -> None:
    refuse_early(env, "package.module:make", "skies/plaza", "stress")


def test_skies_are_known_by_the_names_that_are_listed() -> None:
    listed = json.loads(CliRunner().invoke(app, ["config", "list", "skies", "--json"]).stdout)
    for row in listed:
        short = row["preset"].removeprefix("skies/")
        refuse_early(sky=short)
        refuse_early(sky=row["preset"])
        assert f" {short}," in get_args(options.Sky)[1].help


def test_files_that_do_not_exist_are_refused(tmp_path: Path) -> None:
    (tmp_path / "best.zip").touch()
    (tmp_path / "berlin.csv").touch()
    refuse_early("Merge", str(tmp_path / "best.zip"), str(tmp_path / "berlin.csv"))
    with pytest.raises(InputError, match=r"^agent must be a file that exists, got out/best\.zip: correct the path$"):
        refuse_early("Merge", "out/best.zip")
    with pytest.raises(
        InputError, match=r"^sky must be a file that exists, got berlin\.csv: make it by 'lanebound rec"
    ):
        refuse_early("Merge", None, "berlin.csv")
    with pytest.raises(InputError, match=r"^video must end in \.mp4, got a\.gif: rename it$"):
        refuse_film(tmp_path / "a.gif")


def test_presets_that_do_not_exist_are_refused() -> None:
    for what, folder, name in (("suite", "suites/", "quick"), ("experiment", "experiments/", "lane_keeping_ppo")):
        refuse_preset(what, folder, name)
        refuse_preset(what, folder, folder + name)
        refuse_preset(what, folder, "mine.yaml")
        with pytest.raises(ConfigError, match=f"^{what} '{name}s' is unknown: did you mean '{name}'"):
            refuse_preset(what, folder, name + "s")
    with pytest.raises(ConfigError, match=r"^study 'urban_drive' is unknown"):  # another kind of study
        refuse_preset("study", "studies/", "urban_drive", "learning_study")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("foo=1", "foo is not a known key: known are action, "),
        ("duraton_s=1", r"duraton_s is not a known key: did you mean 'duration_s'\?$"),
        (
            "navigator.gnss.bnds=[0]",
            r"navigator.gnss.bnds is not a known key: did you mean '(navigator.)?gnss.bands'\?$",
        ),
        ("duration_s=-1", r"duration_s must lie in \(0, 3600\], got -1: correct that value$"),
        ("navigator.gnss.half_share=2", r"navigator.gnss.half_share must lie in \[0, 1\], got 2: correct that value"),
        ("cost.hmi=-1", r"cost.hmi must be >= 0, got -1: correct that value"),
    ],
)
def test_keys_and_bounds_are_refused_early_as_later(change: str, message: str) -> None:
    given = parse_assignments([change])
    for refuse in (lambda: static.refuse_keys("environment", given), lambda: open_env("LaneKeeping", given)):
        with pytest.raises(ConfigError, match="^" + message.removesuffix("$")):
            refuse()
    with pytest.raises(ConfigError, match=rf"^overrides\.{message.split()[0]}"):
        static.refuse_keys("suite", {"overrides": given})


@pytest.mark.parametrize("root", ["suite", "experiment"])
def test_a_key_of_an_environment_is_offered_below_overrides(root: str) -> None:
    with pytest.raises(ConfigError, match=f"^duration_s is a key of an environment, not of the {root}: write override"):
        static.refuse_keys(root, {"duration_s": 5})
    static.refuse_keys(root, {"overrides": {"duration_s": 5}})


def test_what_only_the_configuration_can_judge_passes() -> None:
    for change in ("navigator=services/spp", "navigator.kind=mine:own", "world.lanes=9", "sky=urban", "duration_s=x"):
        static.refuse_keys("environment", parse_assignments([change]))
    static.refuse_keys("environment", {"navigator": {"kind": "mine:own", "unheard_of": 1}})
    static.refuse_keys("experiment", {"settings": {"n_steps": 8}, "imitation": None})


@pytest.mark.parametrize(
    "command",
    [
        ["drive", "LaneKeeping"],
        ["envs", "Merge"],
        ["benchmark", "quick", "--out", "nowhere"],
        ["train", "lane_keeping_ppo", "--out", "nowhere"],
    ],
)
def test_an_unknown_key_is_refused_before_the_slow_imports(command: list[str]) -> None:
    code = (
        "import sys\n"
        "from lanebound.agents.cli import app\n"
        f"try:\n    app({[*command, '--set', 'foo=1']})\nexcept SystemExit as end:\n    assert end.code == 2\n"
        "assert not {'numba', 'torch', 'highway_env', 'scipy'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (done.returncode, "foo is not a known key" in done.stderr) == (0, True), done.stderr


def test_a_refusal_imports_neither_numba_nor_torch_nor_highway_env() -> None:
    code = (
        "import sys\n"
        "from lanebound.agents.cli import app\n"
        "try:\n    app(['drive', 'LaneKeepin'])\nexcept SystemExit as end:\n    assert end.code == 2\n"
        "assert not {'numba', 'torch', 'highway_env', 'scipy'} & set(sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0
