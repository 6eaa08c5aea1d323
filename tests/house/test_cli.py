"""The command line: what it prints, what it refuses, and that it starts without heavy imports."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import metadata, resources
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from lanebound.agents.bench import runner
from lanebound.agents.cli import app, listing
from lanebound.agents.cli.advice import explain
from lanebound.agents.cli.output import format_value
from lanebound.integrity.core import presets
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.presets import preset_names


class Toy(Config):
    age_s: float = Field(30.0, gt=0, description="oldest corrections [s]; source")
    bands: tuple[int, ...] = (1, 2)
    gyro_radps: float = 0.125


@pytest.fixture
def toy_presets(tmp_path, monkeypatch):
    """Two presets of a kind of our own, and one of no known kind."""
    package = tmp_path / "toy_cli_presets"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "calm.yaml").write_text("kind: toy\nage_s: 20\n", encoding="utf-8")
    (package / "rush.yaml").write_text("extends: calm\nbands: [3]\n", encoding="utf-8")
    (package / "stray.yaml").write_text("kind: tyo\n", encoding="utf-8")
    (package / "bare.yaml").write_text("age_s: 3\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "toy_cli_presets", raising=False)
    monkeypatch.setattr(presets, "PRESET_PACKAGE", "toy_cli_presets")
    monkeypatch.setitem(listing.KINDS, "toy", f"{__name__}:Toy")


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def test_version():
    result = run("--version")
    assert (result.exit_code, result.stdout) == (0, f"lanebound {metadata.version('lanebound')}\n")


@pytest.mark.parametrize("path", [(), ("config",), ("config", "list"), ("config", "show"), ("bench",), ("benchmark",)])
def test_help_teaches_with_examples(path):
    result = run(*path, "--help")
    assert result.exit_code == 0
    assert path == ("config",) or "lanebound " + " ".join(path) in " ".join(result.stdout.split())
    if path != ("config",):
        assert "Example" in result.stdout


@pytest.mark.usefixtures("toy_presets")
def test_config_list():
    table = run("config", "list").stdout
    assert all(word in table for word in ("calm", "rush", "bare"))
    rows = json.loads(run("config", "list", "--json").stdout)
    assert {"preset": "rush", "kind": "toy", "about": ""} in rows
    assert {"preset": "bare", "kind": None, "about": ""} in rows


@pytest.mark.usefixtures("toy_presets")
def test_config_show_prints_values_and_units():
    table = run("config", "show", "rush").stdout
    assert "rush (toy)" in table
    assert "rad/s" in table
    result = json.loads(run("config", "show", "rush", "--set", "gyro_radps=1e-3", "--json").stdout)
    assert (result["preset"], result["kind"]) == ("rush", "toy")
    assert result["values"] == [
        {"path": "age_s", "value": 20.0, "unit": "s", "description": "oldest corrections; source"},
        {"path": "bands", "value": [3], "unit": "", "description": ""},
        {"path": "gyro_radps", "value": 0.001, "unit": "rad/s", "description": ""},
    ]


@pytest.mark.usefixtures("toy_presets")
def test_config_show_takes_a_file_of_ones_own(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: rush\nage_s: 7\n", encoding="utf-8")
    found = json.loads(run("config", "show", str(path), "--set", "gyro_radps=2e-3", "--json").stdout)
    assert [row["value"] for row in found["values"]] == [7.0, [3], 0.002]
    path.unlink()
    assert "preset must be a file that can be read" in run("config", "show", str(path)).stderr


@pytest.mark.usefixtures("toy_presets")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["config", "show", "rsh"], "error: preset 'rsh' is unknown: did you mean 'rush'?"),
        (["config", "show", "stray"], "error: kind 'tyo' of preset 'stray' is unknown: did you mean 'toy'?"),
        (["config", "show", "bare"], "error: preset 'bare' names no kind: add a line"),
        (["config", "show", "rush", "--set", "agee_s=1"], "error: agee_s is not a known key: did you mean 'age_s'?"),
        (["config", "show", "rush", "--set", "age_s=-1"], "error: age_s must be > 0, got -1: "),
        (["config", "show", "rush", "--set", "age_s"], "error: an override must read key=value"),
        (["config", "show"], "error: PRESET is required, got nothing: add it, see 'lanebound config show --help'"),
        (["config", "shwo"], "error: command 'shwo' is unknown: did you mean 'show'?"),
        (["config", "list", "skies", "extra"], "error: got unexpected extra argument"),
        (["config", "list", "--jsno"], "error: option '--jsno' is unknown: did you mean '--json'?"),
        (["--vesrion"], "error: option '--vesrion' is unknown: did you mean '--version'?"),
        (["benhc"], "error: command 'benhc' is unknown: did you mean 'bench'?"),
        (["bench", "--rounds"], "error: option '--rounds' requires an argument: see 'lanebound --help'"),
        (["reproduce", "urban-drvie"], "error: command 'urban-drvie' is unknown: did you mean 'urban-drive'?"),
        (["reproduce", "urban-drive"], "error: --out is required, got nothing: add it, see 'lanebound reproduce urb"),
        (["bench", "--rounds", "0"], "error: --rounds must be >= 1, got 0: correct that value, see 'lanebound bench"),
        (["bench", "--rounds", "two"], "error: --rounds must be a valid integer, got two: correct that value, see"),
    ],
)
def test_mistakes_are_answered_in_one_line_with_the_nearest_and_exit_code_2(arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


@pytest.mark.parametrize("group", [(), ("config",), ("reproduce",)])
def test_a_group_alone_shows_its_help_and_no_error(group):
    result = run(*group)
    assert result.exit_code == 2
    assert "Usage: " in result.output
    assert "error:" not in result.output


@pytest.mark.usefixtures("toy_presets")
@pytest.mark.parametrize(("columns", "width"), [("80", 80), (None, 100)])
def test_a_pipe_is_as_wide_as_columns_says_and_never_breaks_a_key(monkeypatch, columns, width):
    monkeypatch.setattr(Toy.model_fields["age_s"], "description", "word " * 60 + "last")
    if columns is None:
        monkeypatch.delenv("COLUMNS")
    else:
        monkeypatch.setenv("COLUMNS", columns)
    lines = run("config", "show", "calm").stdout.splitlines()
    assert lines[0] == "calm (toy)"
    assert max(map(len, lines)) == width
    assert [line.split()[1] for line in lines if "_" in line] == ["age_s", "gyro_radps"]


@pytest.mark.parametrize(("name", "width"), [("skies/urban", 80), ("studies/urban_drive", 100)])
def test_keys_and_heads_stand_whole_in_eighty_characters_or_as_few_more_as_they_need(monkeypatch, name, width):
    monkeypatch.setenv("COLUMNS", "80")
    shown = run("config", "show", name).stdout
    keys = {row["path"] for row in json.loads(run("config", "show", name, "--json").stdout)["values"]}
    assert keys <= set(shown.split())
    assert {len(line) for line in shown.splitlines()[1:]} == {width}  # nothing is cut off, the frame is whole
    assert shown.rstrip().endswith("┘")


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("LaneKeeping", "it is an environment, see 'lanebound envs LaneKeeping'"),
        ("lanebound/Merge-v0", "it is an environment, see 'lanebound envs Merge'"),
        ("urbn", "did you mean 'skies/urban'?"),
        ("zzz", "'lanebound config list' lists all of them"),
    ],
)
def test_unknown_presets_are_answered_with_where_to_look(name, advice):
    assert run("config", "show", name).stderr == f"error: preset '{name}' is unknown: {advice}\n"


def test_typer_complaints_of_older_versions_keep_their_own_words():
    error = typer.BadParameter("0 is not in the range x>=1.", param_hint="'--rounds'")
    assert explain(error) == "invalid value for '--rounds': 0 is not in the range x>=1: see 'lanebound --help'"


def test_what_is_no_input_error_is_not_hidden(monkeypatch):
    def broken(*_):
        raise RuntimeError("a fault of our own")

    monkeypatch.setattr(presets, "preset_names", broken)
    result = run("config", "list")
    assert isinstance(result.exception, RuntimeError)


def test_every_packaged_preset_resolves():
    for name in preset_names():
        assert run("config", "show", name, "--json").exit_code == 0, name


NEEDED = {
    "suite": "envs: [Merge]\nagents: [cruise]\n",
    "experiment": "env: Merge\n",
    "learning_study": "arms: {one: {}}\nenvs: [Merge]\nskies: [open]\n",
    "context_rules": (resources.files("lanebound.configs") / "monitors/context_rules.yaml").read_text("utf-8"),
}  # all other kinds have a default for everything


@pytest.mark.parametrize("kind", sorted(listing.KINDS))
def test_every_kind_names_a_configuration(kind, tmp_path, monkeypatch):
    package = tmp_path / f"kind_presets_{kind}"
    package.mkdir()
    (package / "__init__.py").touch()
    text = NEEDED.get(kind, "")
    (package / "plain.yaml").write_text(text if "kind:" in text else f"kind: {kind}\n{text}", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(presets, "PRESET_PACKAGE", package.name)
    found, config = listing.resolve("plain")
    assert found == kind
    assert isinstance(config, Config)


@pytest.fixture
def toy_bench(tmp_path, monkeypatch):
    """Two benchmarks that work, and one that fails."""
    package = tmp_path / "toy_cli_bench"
    package.mkdir()
    (package / "__init__.py").touch()
    head = "from lanebound.agents.bench.runner import Row\n"
    row = head + "def measure_{}(rounds=5):\n    return [Row({}, {}, 'x', {})]\n"
    (package / "quick.py").write_text(row.format("quick", "'quick_ratio'", "12.0 * rounds", "10.0"), encoding="utf-8")
    (package / "bare.py").write_text(row.format("bare", "'bare_ratio'", "1.0", "None"), encoding="utf-8")
    (package / "bad.py").write_text("def measure_bad(rounds=5):\n    raise RuntimeError('no [b]luck[/b]')\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "toy_cli_bench", raising=False)
    monkeypatch.setattr(runner, "BENCH_PACKAGE", "toy_cli_bench")
    monkeypatch.setattr(runner, "BENCHES", {name: name for name in ("bad", "bare", "quick")})
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("toy_cli_bench")]:
        del sys.modules[name]


def test_bench_reports_a_failure_and_keeps_the_others(toy_bench):
    result = run("bench", "--rounds", "2", "--json")
    assert result.exit_code == 1
    assert "error: benchmark 'bad' failed: RuntimeError: no [b]luck[/b]" in result.stderr
    rows = json.loads(result.stdout)
    assert [(row["name"], row["value"], row["met"]) for row in rows] == [
        ("bare_ratio", 1.0, None),
        ("quick_ratio", 24.0, True),
    ]
    assert json.loads((toy_bench / "build" / "bench.json").read_text(encoding="utf-8")) == rows


def test_bench_of_one_name(toy_bench):
    result = run("bench", "--only", "quick", "--out", "figures/one.json")
    assert result.exit_code == 0
    assert "quick_ratio" in result.stdout
    assert "bare_ratio" not in result.stdout
    assert (toy_bench / "figures" / "one.json").exists()


@pytest.mark.usefixtures("toy_bench")
@pytest.mark.parametrize("arguments", [("--only", "quikc"), ("--out", ".")])
def test_bench_refuses_before_it_measures(arguments, monkeypatch):
    monkeypatch.setattr(runner, "run", None)
    result = run("bench", *arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")


@pytest.mark.usefixtures("toy_bench")
def test_bench_of_an_unknown_name():
    result = run("bench", "--only", "quikc")
    assert result.exit_code == 2
    assert "error: benchmark 'quikc' is unknown: did you mean 'quick'?" in result.stderr


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "-"), (True, "yes"), (False, "no"), (0.1 + 0.2, "0.3"), (1e-9, "1e-09"), ((1, 2.5), "1, 2.5"), ("a", "a")],
)
def test_format_value(value, text):
    assert format_value(value) == text


def test_the_installed_program_starts_and_refuses_without_a_traceback():
    program = Path(sys.executable).parent / "lanebound"
    done = subprocess.run([str(program), "config", "show", "nothing"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: preset 'nothing' is unknown: ")


def test_the_program_starts_light():
    code = "import sys, lanebound.agents.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "numba", "torch", "gymnasium", "matplotlib", "pydantic", "yaml", "rich.table"}
    assert not heavy & set(done.stdout.split())
