"""Result folders: the same work is resumed; other work, other versions, foreign files, two processes are refused."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from processes import started
from typer.testing import CliRunner
from work import HELD

from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.checkpointing import folder as folders
from lanebound.agents.checkpointing.files import make_folder, read_json, replace_file, write_json
from lanebound.agents.checkpointing.folder import MANIFEST, ResultFolder, code_digest, defaults_digest, locked
from lanebound.agents.cli import app
from lanebound.agents.learning.experiment import ExperimentConfig
from lanebound.agents.learning.training import train
from lanebound.integrity.core.errors import InputError

SOURCES = ("lanebound.agents.studies",)


def study(path: Path, config: dict[str, Any] | None = None, **changes: Any) -> ResultFolder:
    return ResultFolder(path, "study of sizes", config or {"size": 1, "parts": {}}, code_digest(*SOURCES), **changes)


@pytest.mark.parametrize(
    ("config", "found"),
    [
        ({"size": 2, "parts": {}}, r"which differs in size \(1 there, now 2\)"),
        ({"size": 1, "parts": {"a": (0.5, 1)}}, r"which differs in parts\.a \(nothing there, now \[0\.5, 1\]\)"),
        ({"size": 1, "parts": dict.fromkeys("abcde", 0.5)}, r"which differs in parts\.a .*, parts\.c .* and 2 more"),
    ],
)
def test_another_configuration_is_refused(tmp_path: Path, config: dict[str, Any], found: str) -> None:
    study(tmp_path).claim()
    study(tmp_path).claim()
    with pytest.raises(InputError, match=f"hold the same study of sizes, got {tmp_path} {found}: choose a new folder$"):
        study(tmp_path, config).claim()


def test_another_kind_of_work_is_refused(tmp_path: Path) -> None:
    study(tmp_path).claim()
    for method in (ResultFolder(tmp_path, "drive").claim, ResultFolder(tmp_path, "drive").manifest):
        with pytest.raises(InputError, match=r"the same drive, got .* with the results of a study of sizes: choose"):
            method()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"source": "0"}, r"another version of the code \(.*, 0\)"),
        ({"plugins": {"mine.py": "0"}}, r"another version of the plug-in mine\.py \(not loaded now\)"),
        ({"packages": {"Python": "3"}}, r"another version of Python \(3\)"),
        ({"packages": {}}, r"another version of Python \(not recorded\)"),
        ({"format": 0}, r"whose run\.json is of another version of lanebound"),
    ],
)
def test_results_of_another_version_are_refused(tmp_path: Path, change: dict[str, Any], what: str) -> None:
    study(tmp_path).claim()
    manifest = read_json(tmp_path / MANIFEST, dict)
    write_json(tmp_path / MANIFEST, manifest | change)
    with pytest.raises(InputError, match=what):
        study(tmp_path).claim()


def test_without_a_digest_versions_do_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ResultFolder(tmp_path, "training", {"steps": 1}).claim()
    monkeypatch.setattr(folders, "package_versions", lambda: {"Python": "4"})
    ResultFolder(tmp_path, "training", {"steps": 1}).claim()


@pytest.mark.parametrize("name", ["suite.json", "config.json", "experiment.json", "notes.txt"])
def test_foreign_files_are_named(tmp_path: Path, name: str) -> None:
    """Files of older versions among them."""
    (tmp_path / name).write_text("mine", encoding="utf-8")
    (tmp_path / ".hidden").touch()
    with pytest.raises(InputError, match=f"got {tmp_path} with files of other origin .{name}.: choose a new folder"):
        study(tmp_path).claim()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".hidden", name]


def test_hidden_files_are_no_foreign_ones(tmp_path: Path) -> None:
    (tmp_path / ".gitignore").touch()
    study(tmp_path).claim()


def test_entries_may_be_added_where_that_is_declared(tmp_path: Path) -> None:
    def of(agents: dict[str, str]) -> ResultFolder:
        return ResultFolder(tmp_path, "benchmark", {}, fixed={"agents": agents}, growing=("agents",))

    of({"a": "1"}).claim()
    of({"b": "2"}).claim()
    assert of({}).manifest()["fixed"] == {"agents": {"a": "1", "b": "2"}}
    with pytest.raises(InputError, match=r"which differs in agents\.a \(1 there, now 3\)"):
        of({"a": "3"}).claim()


def test_the_code_of_every_package_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert code_digest(*SOURCES) != code_digest(*SOURCES, "lanebound.agents.learning")
    before = {name: code_digest.__wrapped__(name) for name in ("lanebound.configs", "lanebound.agents:vec_env.py")}
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + (b"#" if "suites" not in path.parts else b""))
    for name, digest in before.items():
        assert code_digest.__wrapped__(name) != digest


@pytest.mark.parametrize(("text", "found"), [("", "is not JSON"), ("[]", "must hold a JSON object, got list")])
def test_a_damaged_manifest_is_refused_and_left_alone(tmp_path: Path, text: str, found: str) -> None:
    (tmp_path / MANIFEST).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"run\.json {found}"):
        study(tmp_path).claim()
    assert (tmp_path / MANIFEST).read_text(encoding="utf-8") == text


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        for make in (study(out).claim, lambda out=out: make_folder(out)):
            with pytest.raises(InputError, match="out must be a folder that can be written, got"):
                make()


def test_a_manifest_that_is_missing_is_named(tmp_path: Path) -> None:
    for path, found in ((tmp_path, r"without run\.json"), (tmp_path / "none", "none, which does not exist")):
        with pytest.raises(
            InputError, match=f"must hold a study of sizes, got .*{found}: give the folder of its --out"
        ):
            study(path).manifest()


def test_a_folder_is_written_by_one_process_at_a_time(tmp_path: Path) -> None:
    with locked(tmp_path), locked(tmp_path):
        pass
    with started([sys.executable, "-c", HELD, str(tmp_path)]) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=r"out must not be in use by another process, got .*: wait for that"):
            locked(tmp_path).__enter__()
    with locked(tmp_path):  # a process that ends in any way leaves no lock
        pass


def test_a_file_is_complete_or_absent(tmp_path: Path) -> None:
    write_json(tmp_path / "deep" / "file.json", {"a": float("inf")})
    assert read_json(tmp_path / "deep" / "file.json", dict) == {"a": None}
    with pytest.raises(TypeError):
        write_json(tmp_path / "deep" / "other.json", {"a": object()})
    with suppress(KeyboardInterrupt), replace_file(tmp_path / "deep" / "third") as draft:
        draft.touch()
        raise KeyboardInterrupt
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["file.json"]


def test_kinds_of_work_share_no_folder(tmp_path: Path) -> None:
    suite = SuiteConfig.load({"envs": ["LaneKeeping"], "skies": ["open"], "agents": ["nominal"]})
    claims: dict[str, Callable[[Path], object]] = {
        "study of sizes": lambda path: study(path).claim(),
        "training": lambda path: train(ExperimentConfig.load({"env": "LaneKeeping"}), path),
        "benchmark": lambda path: EpisodeStore(path).claim(suite, fresh=True),
    }
    for kind in claims:
        path = tmp_path / kind
        ResultFolder(path, kind).claim()
        for other in claims.keys() - {kind}:
            with pytest.raises(InputError, match=f"got .* with the results of a {kind}: choose"):
                claims[other](path)
        assert [file.name for file in path.iterdir()] == [MANIFEST]


@pytest.fixture
def recorded(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The present folder holds files with the names and first lines of a recorded pair."""
    folder = tmp_path_factory.mktemp("recorded")
    for name, kind in (
        ("rover.obs", "OBSERVATION DATA"),
        ("base.obs", "OBSERVATION DATA"),
        ("base.nav", "N: GNSS NAV"),
    ):
        line = f"{'     3.04':20}{kind:20}{'M':20}RINEX VERSION / TYPE\n"
        (folder / name).write_text(line, encoding="utf-8")
    monkeypatch.chdir(folder)


COMMANDS = [
    ["drive", "LaneKeeping"],
    ["replay", "."],
    ["rtk", "--rover", "rover.obs", "--base", "base.obs", "--nav", "base.nav"],
    ["benchmark", "quick"],
    ["evaluate", "nowhere"],
    ["assess", "bounding"],
    ["reproduce", "urban-drive"],
]


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda words: words[0])
def test_commands_write_into_no_folder_with_foreign_files_and_show_no_bar_before(
    tmp_path: Path, recorded: None, arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if arguments[0] == "evaluate":
        (tmp_path / "model").mkdir()
        ResultFolder(tmp_path / "model", "training", {"env": "LaneKeeping"}).claim()
        (tmp_path / "model" / "best.zip").touch()
        arguments = ["evaluate", str(tmp_path / "model"), "--agents", "nominal"]
    out = tmp_path / "out"
    out.mkdir()
    (out / "episodes.parquet").write_text("mine", encoding="utf-8")
    told = CliRunner().invoke(app, [*arguments, "--out", str(out)])
    assert told.exit_code == 2
    assert told.stderr.splitlines()[-1].startswith("error: ")
    if arguments[0] != "evaluate":  # whose checkpoint is no checkpoint
        assert "with files of other origin (episodes.parquet): choose a new folder" in told.stderr
        assert len(told.stderr.splitlines()) == 1
    assert [path.name for path in out.iterdir()] == ["episodes.parquet"]
    assert (out / "episodes.parquet").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("command", [["replay", "."], COMMANDS[2]])
def test_recorded_drives_refuse_a_file_as_their_folder_first(
    tmp_path: Path, recorded: None, command: list[str]
) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        done = CliRunner().invoke(app, [*command, "--out", str(out)])
        assert done.exit_code == 2
        assert "out must be a folder that can be written, got" in done.output
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


def test_a_manifest_is_plain_json(tmp_path: Path) -> None:
    study(tmp_path, extra={"left_out": []}).claim()
    found = json.loads((tmp_path / MANIFEST).read_text(encoding="utf-8"))
    head, made_with = ["format", "kind", "version", "source"], ["defaults", "plugins", "packages"]
    assert list(found) == [*head, *made_with, "config", "fixed", "left_out"]
    assert found["defaults"] == defaults_digest()
    assert {"Python", "numpy", "numba", "highway-env"} <= set(found["packages"])


def test_a_refused_command_leaves_no_manifest(tmp_path: Path) -> None:
    """The sky is refused after the folder was claimed; then other work may have the folder."""
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["assess", "bounding", "--in-the-loop", "--set", "skies=[nope]", "--out", str(out)])
    assert (done.exit_code, "'nope' is unknown" in done.stderr) == (2, True)
    assert not (out / MANIFEST).exists()
    ResultFolder(out, "other work").claim()


def test_results_survive_a_refusal(tmp_path: Path) -> None:
    ResultFolder(tmp_path, "work").claim()
    (tmp_path / "part.json").touch()
    ResultFolder.release_begun()
    assert (tmp_path / MANIFEST).exists()
