"""The manual of the benchmark: the text of ``manual.md``, with tables made from the code.

``python -m lanebound.agents.benchmark.manual > docs/benchmark.md`` writes it.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields
from importlib.resources import files

from jinja2 import StrictUndefined, Template

from lanebound.agents.benchmark.metrics import HARM_OF_AN_END, METRICS
from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import CSV_COLUMNS, ESTIMATE_COLUMNS, PAIRED_COLUMNS
from lanebound.agents.benchmark.seeds import TEST, TRAIN
from lanebound.agents.benchmark.statistics import RESAMPLES, VERDICT_SEEDS, seeds_to_exclude
from lanebound.agents.benchmark.store import STORED
from lanebound.agents.benchmark.suite import SuiteConfig, load_suite
from lanebound.agents.benchmark.untuned import tuned_places
from lanebound.agents.benchmark.verdicts import MARGIN
from lanebound.agents.drivers import ABOUT
from lanebound.integrity.core.config import describe

__all__ = ["SUITES", "markdown"]

SUITES = ("quick", "standard", "claim", "faults", "look_ahead", "learnt")
ARROWS = {"higher": "↑", "lower": "↓", None: ""}


def markdown() -> str:
    """The manual in Markdown."""
    text = files("lanebound.agents.benchmark").joinpath("manual.md").read_text(encoding="utf-8")
    page: str = Template(text, undefined=StrictUndefined, keep_trailing_newline=True).render(
        TRAIN=TRAIN,
        TEST=TEST,
        RESAMPLES=RESAMPLES,
        VERDICT_SEEDS=VERDICT_SEEDS,
        MARGIN=MARGIN,
        HARM_OF_AN_END=HARM_OF_AN_END,
        least_seeds=seeds_to_exclude(MARGIN),
        suites=_suites(),
        keys=_keys(),
        tuned="\n".join(f"- `{base.removesuffix('World')}`, {sky} sky" for base, sky in tuned_places()),
        agents=_table(
            ("agent", "does", "reads", "on an alert", "actions"),
            ((f"`{name}`", *about) for name, about in ABOUT.items()),
        ),
        metrics=_table(
            ("key", "unit", "", "is"), ((f"`{m.key}`", m.unit, ARROWS[m.better], m.meaning) for m in METRICS)
        ),
        csv_columns=", ".join(f"`{c}`" for c in (*CSV_COLUMNS, *ESTIMATE_COLUMNS, *PAIRED_COLUMNS)),
        outcome=_outcome(),
        columns=_table(("column", "type", "unit", "is"), ((f"`{c.name}`", c.kind, c.unit, c.meaning) for c in STORED)),
    )
    return page


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = (head, ["---"] * len(head), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _suites() -> str:
    rows = []
    for name in SUITES:
        s = load_suite(name)
        seeds = f"{s.seeds.count} after {s.seeds.skip:,}" if s.seeds.skip else f"{s.seeds.count}"
        envs, agents = (env.removesuffix("-v0") for env in s.envs), (f"`{agent}`" for agent in s.agents)
        lists = (", ".join(names) for names in (envs, s.skies, (fault.value for fault in s.faults), agents))
        rows.append((f"`{name}`", s.title, *lists, seeds))
    return _table(("suite", "for", "environments", "skies", "faults", "agents", "seeds"), rows)


def _keys() -> str:
    suite = SuiteConfig.load({"envs": ["LaneKeeping"], "agents": ["nominal"]})
    entries = [(e.path, _value(e.value), e.description) for e in describe(suite) if not e.path.startswith("agents")]
    entries.insert(4, ("agents", "", str(SuiteConfig.model_fields["agents"].description)))
    needed = [name for name, field in SuiteConfig.model_fields.items() if field.is_required()]
    rows = ((f"`{key}`", "needed" if key in needed else default, text) for key, default, text in entries)
    return _table(("key", "default", "is"), rows)


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f"`[{', '.join(str(getattr(item, 'value', item)) for item in value)}]`"
    return "" if value in ("", {}) else f"`{value}`"


def _outcome() -> str:
    """The attributes of its docstring as a list."""
    text = (inspect.getdoc(Outcome) or "").partition("Attributes\n----------\n")[2].replace("``", "`")
    names = ", ".join(f"`{item.name}`" for item in fields(Outcome))
    items = "\n".join(f"- {line}" if line[:1] != " " else line for line in text.splitlines())
    return f"Its fields in their order: {names}.\n\n{items}"


if __name__ == "__main__":
    sys.stdout.write(markdown())
