"""What a project offers those who join it: its targets, workflows, hooks and templates are there and agree."""

from __future__ import annotations

import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
TARGETS = re.findall(r"^([a-z-]+):.*## ", MAKEFILE, re.MULTILINE)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
every_workflow = pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def steps(path: Path) -> list[dict[str, Any]]:
    return [step for job in load(path)["jobs"].values() for step in job["steps"]]


def test_every_target_is_explained_in_the_docs_and_exists_for_make() -> None:
    development = (ROOT / "docs" / "development.md").read_text(encoding="utf-8")
    assert [name for name in TARGETS if name != "help" and f"`make {name}`" not in development] == []
    phony = re.search(r"^\.PHONY: (.*)$", MAKEFILE, re.MULTILINE)
    assert phony is not None
    assert set(phony[1].split()) == set(TARGETS)


def test_pages_name_only_targets_that_exist() -> None:
    pages = [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / ".github").glob("*.md"),
    ]
    named = {
        name for page in pages for name in re.findall(r"(?:`|\$ )make ([a-z-]+)", page.read_text(encoding="utf-8"))
    }
    assert {"dev", "test", "check", "format", "release"} <= named <= set(TARGETS)


@every_workflow
def test_a_workflow_may_only_read_and_replaces_its_older_run(path: Path) -> None:
    workflow = load(path)
    assert workflow["permissions"] == {"contents": "read"}
    assert workflow["concurrency"]["cancel-in-progress"] is True
    assert all("permissions" not in job and job["timeout-minutes"] for job in workflow["jobs"].values())


@every_workflow
def test_actions_have_a_version_and_commands_are_targets(path: Path) -> None:
    for step in steps(path):
        if "uses" in step:
            assert re.fullmatch(r"actions/[a-z-]+@v\d+", step["uses"]), step
        else:
            command, target, *settings = shlex.split(re.sub(r"\$\{\{.*?\}\}", "x", step["run"]))
            assert command == "make"
            assert target in TARGETS
            assert all(re.search(rf"^{item.partition('=')[0]} \?=", MAKEFILE, re.MULTILINE) for item in settings)


def test_the_tests_run_on_each_python_that_the_project_names() -> None:
    rows = load(ROOT / ".github" / "workflows" / "tests.yml")["jobs"]["test"]["strategy"]["matrix"]["include"]
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert [row["python"] for row in rows if row["versions"] == "pinned"] == named
    assert PROJECT["requires-python"] == f">={named[0]}"
    assert {row["versions"]: row["constraints"] for row in rows} == {
        "pinned": "constraints.txt",
        "lowest": "build/lowest.txt",
        "newest": "",
    }


def test_lowest_versions_are_those_of_the_project() -> None:
    """The rule of the Makefile, asked what it would run."""
    plan = subprocess.run(
        ["make", "-sn", "--always-make", "build/lowest.txt"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    command = next(line for line in plan.stdout.splitlines() if line.startswith("sed"))
    made = subprocess.run(
        ["sh", "-c", command.partition(" > ")[0]], cwd=ROOT, capture_output=True, text=True, check=True
    )
    allowed = [line for line in PROJECT["dependencies"] if re.match("numba|numpy", line)]
    assert len(allowed) == 2
    assert made.stdout.split() == [line.replace(">=", "==") for line in allowed]


def test_hooks_use_the_tools_of_the_project() -> None:
    tools = {re.split("[>=[]", line)[0] for line in PROJECT["optional-dependencies"]["dev"]}
    hooks = [hook for repo in load(ROOT / ".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]]
    used = {hook["entry"].split()[0] for hook in hooks if hook["language"] == "system"}
    assert used == {".venv/bin/ruff", ".venv/bin/mypy"}
    assert {Path(tool).name for tool in used} <= tools
    assert {"end-of-file", "large-files"} <= {hook["id"] for hook in hooks}


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.name)
def test_forms_of_issues_have_what_github_needs(path: Path) -> None:
    form = load(path)
    assert form["name"]
    assert form["description"]
    fields = [item["id"] for item in form["body"]]
    assert len(set(fields)) == len(fields) > 0
    assert all(item["type"] == "textarea" and item["attributes"]["label"] for item in form["body"])


def test_a_bug_report_asks_for_version_command_and_file() -> None:
    text = (ROOT / ".github" / "ISSUE_TEMPLATE" / "bug.yml").read_text(encoding="utf-8")
    assert "lanebound --version" in text
    assert {"versions", "command", "file"} <= {item["id"] for item in yaml.safe_load(text)["body"]}


def test_files_are_written_as_editorconfig_says() -> None:
    """Text files of the repository end with one newline and have no trailing blanks."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False).stdout
    if not names:
        pytest.skip("not a git checkout")
    wrong = []
    for name in filter(None, names.split("\0")):
        data = (ROOT / name).read_bytes() if (ROOT / name).is_file() else b""
        if b"\0" in data or not data:
            continue
        if not data.endswith(b"\n") or data.endswith(b"\n\n") or re.search(rb"[ \t\r]\n", data):
            wrong.append(name)
    assert wrong == []
