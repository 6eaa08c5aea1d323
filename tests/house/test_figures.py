"""A figure that stands on several pages is the same on all of them: the page of the result has it, others repeat it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from result_pages import STATE, present_state

from lanebound.envs.ids import IDS
from lanebound.envs.registration import make_config

ROOT = Path(__file__).parents[2]
PAGES = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]
LIMITS = {
    found[1]: make_config(name).cost_limit for name in IDS if (found := re.fullmatch(r"lanebound/(\w+)-v0", name))
}
CLAIM = r"\|\s*{name}, urban[^|]*\|[^|]*\|[^|]*\|\s*([\d.]+) at"

FIGURES = {
    "figures of S1 within their bands": {
        "docs/results/urban-drive.md": r"\*\*Answer\.\*\* (\d+) of 39 figures",
        "docs/results/index.md": r"(\d+) of 39 figures",
        "README.md": r"reproduces (\d+) of the 39 figures",
    },
    "million epochs in the loop": {
        "docs/results/levels-in-the-loop.md": r"\*\*Answer\.\*\* In (\w+) million epochs",
        "README.md": r"In (\w+) million epochs",
    },
    "harm of CarFollowing under urban": {
        "docs/results/claim.md": r"its mean harm is ([\d.]+)",
        "docs/results/index.md": r"harm ([\d.]+), against",
        "README.md": CLAIM.format(name="CarFollowing"),
    },
    "how often the alert is on without carrier phases": {
        "docs/limits.md": r"too large for a lane, so the alert is ([\w ]+) on \(",
        "README.md": r"too large for a lane: the alert is ([\w ]+) on\.",
        "docs/results/services.md": r"With code services the alert is ([\w ]+) on,",
    },
    "epochs of SPP beyond their level in Berlin": {
        "docs/results/services.md": r"1e-3 \| 393 of 393 \|[^|]*\|[^|]*\| (\d+) along",
        "README.md": r"(\d+) of 393 epochs exceed",
    },
}


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_the_same_on_all_pages(figure: str) -> None:
    found = {}
    for page, pattern in FIGURES[figure].items():
        match = re.search(pattern, (ROOT / page).read_text())
        assert match, f"{page} has no figure {figure!r}: correct the pattern or the page"
        found[page] = match[1]
    assert len(set(found.values())) == 1, f"{figure} differs: {found}; the first page has it from its command"


# The table of the claim


def tables(page: str) -> list[list[list[str]]]:
    """The tables of a page: of each the rows, the head first, as their cells."""
    found: list[list[list[str]]] = [[]]
    for line in (ROOT / page).read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            found.append([])
        elif not line.startswith(("|---", "| ---")):
            found[-1].append([cell.strip() for cell in line[1:-1].split("|")])
    return [table for table in found if table]


def claimed() -> dict[tuple[str, str, str], dict[str, str]]:
    """Harm and throughput on the page of the claim, of each agent: by environment, sky and quantity."""
    found = {}
    for (env, *agents), *body in tables("docs/results/claim.md"):
        sky = ""
        for first, *cells in body:
            if begins := re.match(r"\*\*(\w+)\*\*: ", first):
                sky = begins[1]
            quantity = first.rpartition(": ")[2].partition(" [")[0]
            if quantity in ("harm", "throughput"):
                found[env, sky, quantity] = dict(zip(agents, cells, strict=True))
    return found


def test_the_harm_table_of_the_readme_is_that_of_the_claim() -> None:
    ((head, *body),) = [table for table in tables("README.md") if "`integrity_aware`" in table[0]]
    shown = {}
    for place, *cells in body:
        env, _, sky = place.partition(", ")
        for agent, cell in zip(head[1:], cells, strict=True):
            name = agent.strip("`")
            shown[env, sky, "harm", name], _, shown[env, sky, "throughput", name] = cell.partition(" at ")
    names = ("nominal", "cautious", "integrity_aware")
    assert shown == {(*place, name): of[name] for place, of in claimed().items() for name in names}


def test_the_readme_names_the_defaults_of_the_claim() -> None:
    """By their number, or as the present ones."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = re.search(r"\[(?:defaults (\d+)|present defaults)\]\(docs/results/index\.md#defaults\)", text)
    state = STATE.search((ROOT / "docs/results/claim.md").read_text(encoding="utf-8"))
    assert named
    assert state
    assert int(named[1] or present_state()[0]) == int(state[1])


# Cost limits

LIMIT = r"`cost_limit`\s(?:is|of)\s([\d.]+\d|\d)"
STATED = {  # in text, with the ids of the figures
    "docs/training.md": (
        r"as in Merge and Roundabout \(limits of\s([\d.]+)\sand\s([\d.]+)",
        ["Merge", "Roundabout"],
    ),
    "docs/results/degenerate-policies.md": (r"- The limit is (\d+), the 0.7 quantile", ["Intersection"]),
    "docs/results/learning-study.md": (
        r"keep the limit \((\d+); Highway (\d+), UrbanCanyon (\d+)\)",
        ["LaneKeeping", "Highway", "UrbanCanyon"],
    ),
}


@pytest.mark.parametrize("page", PAGES)
def test_cost_limits_in_tables_are_those_of_the_code(page: str) -> None:
    """A limit of an earlier state has the present one behind it: ``6 (now 2)``."""
    for head, *body in tables(page):
        column = next((k for k, cell in enumerate(head) if cell in ("limit", "cost limit")), 0)
        for cells in body:
            name = next((name for name in LIMITS if re.match(rf"(\[lanebound/)?{name}\b", cells[0])), None)
            if name and column and "topic" not in head:  # docs/limits.md has limits of another kind
                assert cells[column].rpartition("now ")[2].rstrip(")") == f"{LIMITS[name]:g}", cells


@pytest.mark.parametrize("page", STATED)
def test_cost_limits_in_text_are_those_of_the_code(page: str) -> None:
    pattern, names = STATED[page]
    match = re.search(pattern, (ROOT / page).read_text(encoding="utf-8"))
    assert match, f"{page} states no cost limit: correct the pattern or the page"
    assert [float(figure) for figure in match.groups()] == [LIMITS[name] for name in names]


def test_each_id_describes_its_cost_limit() -> None:
    text = (ROOT / "docs/environments.md").read_text(encoding="utf-8")
    sections = {part.partition("\n")[0]: part for part in text.split("\n## ")}
    for name, limit in LIMITS.items():
        assert [float(figure) for figure in re.findall(LIMIT, sections[name])] == [limit], name


def test_the_cost_limit_of_the_claim_is_that_of_its_ids() -> None:
    text = (ROOT / "docs/results/claim.md").read_text(encoding="utf-8")
    limits = {LIMITS[table[0][0]] for table in tables("docs/results/claim.md") if table[0][0] in LIMITS}
    assert {float(figure) for figure in re.findall(LIMIT, text)} <= limits
