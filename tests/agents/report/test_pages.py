"""Commands write tables into their places in a page, and nothing else of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from lanebound.agents.report.pages import fill, require_page
from lanebound.integrity.core.errors import InputError

PAGE = """# A page

<!-- times -->
old
<!-- end of times -->

Text with <angles>.
"""


def test_a_table_is_written_between_its_marks_and_again(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    fill(page, {"times": (("n", "s"), [("1", "2")])})
    wanted = PAGE.replace("old\n", "\n| n | s |\n| --- | --- |\n| 1 | 2 |\n\n")
    assert page.read_text() == wanted
    fill(page, {"times": (("n", "s"), [("1", "2")])})
    assert page.read_text() == wanted


def test_a_page_without_the_marks_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    with pytest.raises(InputError, match=r"page must be a file that can be read, got .*page\.md"):
        require_page(page, ["times"])
    page.write_text(PAGE)
    require_page(page, ["times"])
    with pytest.raises(InputError, match="page must have the lines <!-- bytes --> and <!-- end of bytes -->"):
        fill(page, {"bytes": (("n",), [])})
