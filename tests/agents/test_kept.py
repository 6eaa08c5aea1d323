"""Folders of long work: parts are kept, a run that breaks goes on, and other work in the same folder is refused."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from work import squared

from lanebound.agents import kept
from lanebound.agents.benchmark.store import Store
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.cli import app
from lanebound.agents.kept import (
    MARKS,
    claim,
    code_digest,
    one_thread,
    parts_kept,
    require_own,
    run_parts,
    write_whole,
)
from lanebound.agents.learning.experiment import ExperimentConfig
from lanebound.agents.learning.training import train
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError

PACKAGES = ("lanebound.agents.assess",)


class Small(Config):
    """Something to be studied."""

    size: int = Field(1, ge=1, description="of it")
    parts: dict[str, float] = Field({}, description="of its parts")


def test_a_run_that_breaks_goes_on_with_what_is_missing(tmp_path: Path) -> None:
    worked: list[str] = []

    def work(name: str) -> dict[str, Any]:
        if len(worked) == 2:
            raise KeyboardInterrupt
        worked.append(name)
        return squared(name)

    with pytest.raises(KeyboardInterrupt):
        run_parts(tmp_path, ["3", "1", "2"], work)
    assert worked == ["3", "1"]
    assert parts_kept(tmp_path) == 2
    told: list[tuple[int, int]] = []
    found = run_parts(tmp_path, ["3", "1", "2"], squared, progress=lambda done, of: told.append((done, of)), size=int)
    assert {name: one["squared"] for name, one in found.items()} == {"3": 9, "1": 1, "2": 4}
    assert [one["bad"] for one in found.values()] == [None] * 3
    assert told == [(4, 6), (6, 6)]


def test_several_processes_come_to_the_same_each_on_one_thread(tmp_path: Path) -> None:
    names = ["5", "4", "6"]
    found = run_parts(tmp_path, names, squared, jobs=2)
    assert list(found.items()) == [(name, {"squared": int(name) ** 2, "threads": "1", "bad": None}) for name in names]


@pytest.mark.parametrize("jobs", [1, 2])
def test_no_part_is_begun_once_it_may_not(tmp_path: Path, jobs: int) -> None:
    answers = iter([True, True, False, False, False, False])
    found = run_parts(tmp_path, ["1", "2", "3", "4"], squared, jobs, may_start=lambda: next(answers))
    assert list(found) == ["1", "2"]
    assert list(run_parts(tmp_path, ["1", "2", "3", "4"], squared)) == ["1", "2", "3", "4"]


def test_the_environment_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with one_thread():
        assert (os.environ["OMP_NUM_THREADS"], os.environ["MKL_NUM_THREADS"]) == ("1", "1")
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.parametrize(
    ("study", "config", "found"),
    [
        ("other", Small(size=2), "with the study 'same'"),
        ("same", Small(size=2), r"which differs in size \(1 there, now 2\)"),
        ("same", Small(parts={"a": 0.5}), r"which differs in parts\.a \(nothing there, now 0\.5\)"),
        (
            "same",
            Small(parts=dict.fromkeys("abcde", 0.5)),
            r"which differs in parts\.a .*, parts\.b .*, parts\.c .* and 2 more",
        ),
    ],
)
def test_other_work_in_the_same_folder_is_refused(tmp_path: Path, study: str, config: Config, found: str) -> None:
    claim(tmp_path, "same", Small(), PACKAGES)
    claim(tmp_path, "same", Small(), PACKAGES)
    with pytest.raises(InputError, match=f"hold the same study, got {tmp_path} {found}: choose a new folder$"):
        claim(tmp_path, study, config, PACKAGES)


def test_work_of_other_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    claim(tmp_path, "same", Small(), PACKAGES)
    monkeypatch.setattr(kept, "code_digest", lambda *packages: "other")
    with pytest.raises(InputError, match=r"hold the same study, got .* of another version of the code: choose"):
        claim(tmp_path, "same", Small(), PACKAGES)


def test_the_code_of_every_package_counts() -> None:
    assert code_digest(*PACKAGES) != code_digest(*PACKAGES, "lanebound.agents.learning")


@pytest.mark.parametrize("mark", ["", "[]", '{"digest": 3}'])
def test_a_mark_that_is_none_of_ours_is_refused(tmp_path: Path, mark: str) -> None:
    (tmp_path / "config.json").write_text(mark)
    with pytest.raises(InputError, match=r"hold the same study, got .* with a config\.json that is none of ours"):
        claim(tmp_path, "same", Small(), PACKAGES)
    assert (tmp_path / "config.json").read_text() == mark


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="out must be a folder that can be written, got"):
            claim(out, "same", Small(), PACKAGES)


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    write_whole(tmp_path / "deep" / "file.json", {"a": 1})
    with pytest.raises(TypeError):
        write_whole(tmp_path / "deep" / "other.json", {"a": object()})
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["file.json"]


def test_a_folder_of_drives_or_of_a_replay_takes_no_training(tmp_path: Path) -> None:
    for mark, kind in (("columns.md", "drives"), ("replay.json", "a replayed drive"), ("rtk.json", "an RTK solution")):
        (tmp_path / mark).write_text('{"dataset": "smartloc", "epochs": 3}', encoding="utf-8")
        with pytest.raises(InputError, match=f"with {kind}: choose"):
            require_own(tmp_path / "experiment.json")
        require_own(tmp_path / mark)
        (tmp_path / mark).unlink()


@pytest.mark.parametrize("mark", sorted(MARKS))
def test_kinds_of_work_share_no_folder(tmp_path: Path, mark: str) -> None:
    suite = SuiteConfig.load({"envs": ["LaneKeeping"], "skies": ["open"], "agents": ["nominal"]})
    claims: dict[str, Callable[[], object]] = {
        "config.json": lambda: claim(tmp_path, "of sizes", Small(), PACKAGES),
        "experiment.json": lambda: train(ExperimentConfig.load({"env": "LaneKeeping"}), tmp_path),
        "suite.json": lambda: Store(tmp_path).claim(suite, fresh=True),
    }
    key, kind = MARKS[mark]
    (tmp_path / mark).write_text(json.dumps({key: "something"}), encoding="utf-8")
    for other in claims.keys() - {mark}:
        with pytest.raises(
            InputError, match=f"out must be empty or hold work of its own kind, got .* with {kind}: choose a"
        ):
            claims[other]()
    assert [path.name for path in tmp_path.iterdir()] == [mark]


@pytest.fixture
def recorded(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder one is in holds what goes for a recorded pair."""
    folder = tmp_path_factory.mktemp("recorded")
    for name in ("rover.obs", "base.obs"):
        (folder / name).touch()
    monkeypatch.chdir(folder)


@pytest.mark.parametrize(
    "arguments",
    [
        ["drive", "LaneKeeping"],
        ["replay", "."],
        ["rtk", "--rover", "rover.obs", "--base", "base.obs", "--nav", "base.nav"],
    ],
)
def test_what_writes_in_one_go_takes_no_folder_of_long_work(
    tmp_path: Path, recorded: None, arguments: list[str]
) -> None:
    """A log of a drive goes by the name of a benchmark's results."""
    (tmp_path / "suite.json").write_text(json.dumps({"suite": {}}), encoding="utf-8")
    (tmp_path / "episodes.parquet").write_text("results", encoding="utf-8")
    told = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert told.exit_code == 2
    assert told.stderr.startswith("error: out must be empty or hold work of its own kind, got ")
    assert told.stderr.endswith("with a benchmark: choose a new folder\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["episodes.parquet", "suite.json"]
    assert (tmp_path / "episodes.parquet").read_text(encoding="utf-8") == "results"


@pytest.mark.parametrize("command", [["replay", "."], ["rtk", "--rover", "r", "--base", "b", "--nav", "n"]])
def test_recorded_drives_refuse_a_file_as_their_folder_first(
    tmp_path: Path, recorded: None, command: list[str]
) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        done = CliRunner().invoke(app, [*command, "--out", str(out)])
        assert done.exit_code == 2
        assert "out must be a folder that can be written, got" in done.output
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"
