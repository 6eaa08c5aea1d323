"""Every snippet of the README runs and says what it says."""

from __future__ import annotations

import doctest
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"


def test_readme_snippets() -> None:
    result = doctest.testfile(str(README), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 10
    assert result.failed == 0


def test_readme_names_no_unfilled_figure() -> None:
    assert "@" not in README.read_text(encoding="utf-8")
