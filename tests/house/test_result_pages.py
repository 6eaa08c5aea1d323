"""Pages of results say which defaults they were made with, and whether those are the present ones."""

from __future__ import annotations

import pytest
from result_pages import marked, pages, present_state, wrong_digests

from lanebound.agents.checkpointing.folder import defaults_digest


def test_the_last_row_of_the_table_has_the_digest_of_the_present_defaults() -> None:
    assert present_state()[1] == defaults_digest(), (
        "the defaults changed: add a row to the table of defaults in docs/results/index.md with this digest and what "
        "changed, then run make pages"
    )


@pytest.mark.parametrize("page", pages(), ids=lambda path: path.stem)
def test_a_page_of_earlier_defaults_says_so_in_its_first_line(page) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == marked(text), "run make pages"
    assert wrong_digests(text) == [], "the result files have other defaults than the page says: see their run.json"


def test_a_mark_is_written_once_and_removed_when_the_page_is_renewed() -> None:
    number, _ = present_state()
    old, new = (f"# A page\n\n**Defaults.** [Defaults {n}](index.md#defaults).\n" for n in (number - 1, number))
    assert marked(old).startswith(f"> Made with [defaults {number - 1}](index.md#defaults); the present ones are")
    assert marked(marked(old)) == marked(old)
    assert marked(new) == new
    assert marked(marked(old).replace(f"Defaults {number - 1}", f"Defaults {number}")) == new


def test_a_digest_on_a_page_is_compared_with_the_row_of_its_state() -> None:
    number, digest = present_state()
    line = "**Defaults.** [Defaults {}](index.md#defaults), digest `{}`."
    assert wrong_digests(line.format(number, digest)) == []
    assert wrong_digests(line.format(number, "0" * 8)) == [(str(number), "0" * 8)]
    assert wrong_digests(line.format(1, digest)) == [("1", digest)]  # that of defaults 1 is not recorded
    assert marked(line.format(number, digest)) == line.format(number, digest)
