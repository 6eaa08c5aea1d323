"""Mark the result pages that were not made with the present defaults: ``python tests/helpers/result_pages.py``.

``docs/results/index.md`` numbers the states of the defaults; its last row is the present one, with its digest
(:func:`lanebound.agents.checkpointing.folder.defaults_digest`). Every page names its state in a line
``**Defaults.**``. A page of an earlier state says so in its first line, which this writes and removes. A page may add
the digest that ``run.json`` of its result files has: ``[Defaults 6](index.md#defaults), digest `abcdef12` ``.
"""

from __future__ import annotations

import re
from pathlib import Path

RESULTS = Path(__file__).parents[2] / "docs" / "results"
ROW = re.compile(r"^\| (\d+) \|.*\| (`[0-9a-f]{8}`|not recorded) \|$", re.MULTILINE)
STATE = re.compile(r"^\*\*Defaults\.\*\*.*?[Dd]efaults (\d+)", re.MULTILINE | re.DOTALL)
DIGEST = re.compile(r"\[[Dd]efaults (\d+)\]\(index\.md#defaults\),\sdigest\s`([0-9a-f]{8})`")
MARK = "> Made with [defaults {}](index.md#defaults); the present ones are {}.\n\n"
MARKED = re.compile(r"\A> Made with \[defaults .*\n\n")


def states() -> dict[int, str]:
    """The digests of the table of defaults by number, or ``not recorded``."""
    rows = ROW.findall((RESULTS / "index.md").read_text(encoding="utf-8"))
    return {int(number): digest.strip("`") for number, digest in rows}


def present_state() -> tuple[int, str]:
    """Number and digest of the last row of the table of defaults."""
    return list(states().items())[-1]


def wrong_digests(page: str) -> list[tuple[str, str]]:
    """Number and digest where the text of a page has another digest than the table."""
    return [(number, digest) for number, digest in DIGEST.findall(page) if states().get(int(number)) != digest]


def marked(page: str) -> str:
    """The text of a page with the first line that its state asks for."""
    text, present = MARKED.sub("", page), present_state()[0]
    state = STATE.search(text)
    if state is None:
        raise ValueError("the page has no line **Defaults.** with [Defaults N](index.md#defaults)")
    return text if int(state[1]) == present else MARK.format(state[1], present) + text


def pages() -> list[Path]:
    """The pages of results that depend on defaults."""
    return [path for path in sorted(RESULTS.glob("*.md")) if path.name not in ("index.md", "speed.md")]


if __name__ == "__main__":
    for path in pages():
        path.write_text(marked(path.read_text(encoding="utf-8")), encoding="utf-8")
