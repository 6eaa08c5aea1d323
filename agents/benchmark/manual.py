"""The page of the benchmark: the text of ``manual.md``, with tables of suites, agents, metrics and columns.

``python -m lanebound.agents.benchmark.manual > docs/benchmark.md`` writes it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.resources import files
from itertools import groupby
from operator import itemgetter

from jinja2 import StrictUndefined, Template

from lanebound.agents.benchmark.metrics import METRICS
from lanebound.agents.benchmark.results import CSV_COLUMNS, ESTIMATE_COLUMNS, PAIRED_COLUMNS
from lanebound.agents.benchmark.statistics import RESAMPLES, VERDICT_SEEDS, seeds_to_exclude
from lanebound.agents.benchmark.store import stored_columns
from lanebound.agents.benchmark.suite import TEST, TRAIN, SuiteConfig, load_suite
from lanebound.agents.benchmark.untuned import tuned_places
from lanebound.agents.benchmark.verdicts import MARGIN
from lanebound.agents.drivers import ABOUT
from lanebound.envs.ids import CLASSES
from lanebound.integrity.core.config import describe

__all__ = ["SUITES", "markdown"]

SUITES = (
    "quick",
    "standard",
    "claim",
    "faults",
    "one_fault",
    "look_ahead",
    "learnt",
    "degenerate",
    "services",
    "monitors",
    "context",
    "filters",
    "detectors",
    "work_zone",
    "remote_braking",
    "occluded_crossing",
    "guidance",
    "tolling",
)

ARROWS = {"higher": "↑", "lower": "↓", None: ""}


def markdown() -> str:
    """The whole page in Markdown."""
    text = files("lanebound.agents.benchmark").joinpath("manual.md").read_text(encoding="utf-8")
    page: str = Template(text, undefined=StrictUndefined, keep_trailing_newline=True).render(
        TRAIN=TRAIN,
        TEST=TEST,
        RESAMPLES=RESAMPLES,
        VERDICT_SEEDS=VERDICT_SEEDS,
        MARGIN=MARGIN,
        least_seeds=seeds_to_exclude(MARGIN),
        suites=_suites(),
        keys=_keys(),
        tuned=_tuned(),
        agents=_drivers(),
        metrics=_metrics(),
        csv_columns=", ".join(f"`{c}`" for c in (*CSV_COLUMNS, *ESTIMATE_COLUMNS, *PAIRED_COLUMNS)),
        columns=_columns(),
    )
    return page


def _tuned() -> str:
    """The places where constant margins were tuned, by environment."""
    skies: dict[str, list[str]] = {}
    for base, sky in tuned_places():
        skies.setdefault(base.removesuffix("World"), []).append(f"`{sky}`")
    return " and ".join(f"`{name}` ({', '.join(found)})" for name, found in skies.items())


def _drivers() -> str:
    """The packaged agents, as ``lanebound agents`` lists them."""
    lines = ["| agent | does | reads | during an alert | actions |", "|---|---|---|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {' | '.join(about)} |" for name, about in ABOUT.items())])


def _suites() -> str:
    head = ("suite", "question", "environments", "skies", "faults", "agents", "seeds")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name in SUITES:
        s = load_suite(name)
        faults = ", ".join(fault.value for fault in s.faults)
        everything = len(s.envs) == len(CLASSES)
        envs = "all" if everything else ", ".join(env.removesuffix("-v0") for env in s.envs)
        packaged = [f"`{agent}`" for agent in s.agents if agent in ABOUT]
        more = len(s.agents) - len(packaged)
        agents = ", ".join([*packaged, *([f"{more} of its own"] if more else [])])
        seeds = f"{s.seeds.count} after {s.seeds.skip:,}" if s.seeds.skip else f"{s.seeds.count}"
        lines.append(f"| `{name}` | {s.title} | {envs} | {', '.join(s.skies)} | {faults} | {agents} | {seeds} |")
    return "\n".join(lines)


def _keys() -> str:
    suite = SuiteConfig.load({"envs": ["LaneKeeping"], "agents": ["nominal"]})
    entries = [(e.path, _value(e.value), e.description) for e in describe(suite) if not e.path.startswith("agents")]
    entries.insert(4, ("agents", "", str(SuiteConfig.model_fields["agents"].description)))
    needed = [name for name, field in SuiteConfig.model_fields.items() if field.is_required()]
    lines = [f"| `{key}` | {'needed' if key in needed else default} | {text} |" for key, default, text in entries]
    return "\n".join(["| key | default | meaning |", "|---|---|---|", *lines])


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f"`[{', '.join(str(getattr(item, 'value', item)) for item in value)}]`"
    return "" if value in ("", {}) else f"`{value}`"


def _metrics() -> str:
    rows = [
        (metric.key, (_united(f"{ARROWS[metric.better]} {metric.meaning}".strip(), metric.unit),)) for metric in METRICS
    ]
    return "\n".join(["| key | meaning |", "|---|---|", *_merged(rows)])


def _united(meaning: str, unit: str) -> str:
    return f"{meaning} [{unit}]" if unit else meaning


def _merged(rows: Sequence[tuple[str, tuple[str, ...]]]) -> list[str]:
    """Lines of a table; neighbours that differ in their names only share a line."""
    shared = [(rest, [name for name, _ in members]) for rest, members in groupby(rows, itemgetter(1))]
    return [f"| {', '.join(f'`{name}`' for name in names)} | {' | '.join(rest)} |" for rest, names in shared]


def _columns() -> str:
    rows = [(c.name, (_united(c.meaning, c.unit),)) for c in stored_columns()]
    return "\n".join(["| column | meaning |", "|---|---|", *_merged(rows)])


if __name__ == "__main__":
    sys.stdout.write(markdown())
