"""README and pages of the documentation: snippets run, commands parse, links lead somewhere, lines stay short."""

from __future__ import annotations

import doctest
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from lanebound.agents.benchmark import SuiteConfig
from lanebound.agents.cli import app
from lanebound.agents.learning.experiment import load_experiment

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = (README, ROOT / "CONTRIBUTING.md", *DOCS)
SNIPPETS = tuple(page for page in PAGES if ">>>" in page.read_text(encoding="utf-8"))
LINE, WORDS = 140, 1500
every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


@pytest.mark.parametrize("page", SNIPPETS, ids=lambda page: page.name)
def test_snippets_run_and_print_what_they_show(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, where snippets may write files and modules."""
    if page.stem == "multiagent":
        pytest.importorskip("pettingzoo")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    result = doctest.testfile(str(page), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 0
    assert result.failed == 0


def test_the_pages_with_code_have_snippets_that_run() -> None:
    names = {page.stem for page in SNIPPETS}
    assert {"README", "benchmark", "development", "environments", "navigation", "training"} <= names


@every_page
def test_code_in_python_is_a_snippet_that_runs(page: Path) -> None:
    """Blocks are of kinds that tests read: ``pycon`` here, ``console`` and ``yaml`` below, ``python`` from files."""
    kinds = set(re.findall(r"^```(\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE))
    assert kinds <= {"pycon", "console", "yaml"} | ({"python"} if page.name == "extending.md" else set())


def test_the_code_of_extensions_is_that_of_the_files_it_names() -> None:
    """Short files are shown, longer ones linked."""
    text = (ROOT / "docs/extending.md").read_text(encoding="utf-8")
    shown = re.findall(r"^`(\S+\.py)`:\n\n```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    linked = re.findall(r"\]\(\.\./(tests/plugins/\S+\.py)\)", text)
    assert len(shown) == text.count("```python")
    assert sorted([name for name, _ in shown] + linked) == sorted(
        str(path.relative_to(ROOT)) for path in (ROOT / "tests/plugins").glob("*.py")
    )
    for name, code in shown:
        assert (ROOT / name).read_text(encoding="utf-8") == code, name


@every_page
def test_no_figure_is_left_to_be_filled_in(page: Path) -> None:
    assert re.findall(r"@[A-Z_]+@", page.read_text(encoding="utf-8")) == []


# Links and form


@every_page
def test_tables_have_heads(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    rules = [n for n, line in enumerate(lines) if re.match(r"\|\s*:?-{3}", line)]
    assert [n + 1 for n in rules if not lines[n - 1].startswith("|")] == []


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and MkDocs make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@every_page
def test_links_lead_to_files_and_headings_that_exist(page: Path) -> None:
    lost = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.is_file() or (anchor and anchor not in anchors(target)):
            lost.append(link)
    assert lost == []


def test_every_page_is_listed_in_the_index() -> None:
    """A folder's pages in the index of that folder, the index of the results in that of the docs."""
    lost = [
        page
        for page in DOCS
        if page.name != "index.md" and f"]({page.name})" not in (page.parent / "index.md").read_text(encoding="utf-8")
    ]
    assert lost == []
    assert "](results/index.md)" in (ROOT / "docs/index.md").read_text(encoding="utf-8")


@every_page
def test_lines_outside_of_tables_are_short(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if len(line) > LINE and not line.startswith(("|", "!["))] == []


def test_the_readme_is_a_map() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= WORDS


# Commands and presets


def quoted_commands(page: Path) -> tuple[list[str], list[str]]:
    """Commands of console blocks, and those quoted in text, without the program's name."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    whole = [line for block in blocks for line in re.findall(r"^\$ lanebound (.+)$", block, re.MULTILINE)]
    inline = re.findall(r"`lanebound ([a-z][^`]*)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))
    return whole, [" ".join(command.split()) for command in inline]


def parse(command: str) -> None:
    """Parse a command line as the program does, without running it; typer's classes have no public names."""
    words = shlex.split(command, comments=True)
    here: Any = typer.main.get_command(app)
    context = None
    while True:
        context = here.make_context(here.name, list(words), parent=context)
        if not hasattr(here, "resolve_command"):
            return
        _, here, words = here.resolve_command(context, [*context._protected_args, *context.args])


@every_page
def test_commands_parse(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those in text may leave out arguments; commands and options must exist. Plug-ins are not loaded."""
    monkeypatch.setattr("lanebound.agents.plugins.load_plugins", list)
    whole, inline = quoted_commands(page)
    for command in whole:
        parse(command)
    for command in inline:
        try:
            parse(command)
        except Exception as error:
            if type(error).__name__ not in ("MissingParameter", "Exit"):  # Exit: --help
                raise


@pytest.mark.parametrize("wrong", ["benchmark quick --outt out/quick", "benchmrk quick", "assess boundng --out o"])
def test_what_does_not_exist_does_not_parse(wrong: str) -> None:
    parse("assess bounding --out out/bounding")
    with pytest.raises(Exception, match=r"outt|benchmrk|boundng"):
        parse(wrong)


def yaml_block(page: str) -> str:
    (block,) = re.findall(r"^```yaml\n(.*?)^```", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return str(block)


def test_the_experiment_in_the_docs_can_be_trained(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml_block("docs/training.md"), encoding="utf-8")
    found, base = (load_experiment(name) for name in (str(path), "car_following_ppo_lagrangian"))
    assert (found.env, found.sky, found.steps, found.count) == (base.env, "dense", 100_000, 32)


def test_the_suite_in_the_docs_is_valid() -> None:
    suite = SuiteConfig.load(yaml.safe_load(yaml_block("docs/benchmark.md")))
    assert suite.agents["mine"].config == {"observation": {"vehicles": 3}}
