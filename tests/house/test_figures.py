"""A figure that stands on several pages is the same on all of them: the page of the result has it, others repeat it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
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
