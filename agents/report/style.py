"""Looks and names of agents in a report, and units of metrics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lanebound.agents.benchmark.metrics import SHARE as SHARE_BOUNDS
from lanebound.agents.benchmark.metrics import Metric
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.report.numbers import SHARE

__all__ = ["Actor", "actors_of", "clear_best", "slug_of", "title_of", "unit_of"]


@dataclass(frozen=True)
class Actor:
    """An agent as a report shows it.

    Attributes
    ----------
    name : in the results
    look : number of its colour and shape
    reference : other agents are compared with it
    bound : it observes the truth: a bound, no competitor
    chance : it acts at random
    """

    name: str
    look: int
    reference: bool
    bound: bool
    chance: bool

    @property
    def remark(self) -> str:
        """Remark next to its name."""
        return "sees the truth" if self.bound else "reference" if self.reference else ""


def actors_of(suite: SuiteConfig) -> dict[str, Actor]:
    """The agents of a suite by name, in its order."""
    found = {}
    for look, (name, chosen) in enumerate(suite.agents.items()):
        reference = name in suite.references
        found[name] = Actor(name, look, reference, chosen.sees_truth, chosen.agent == "random")
    return found


def unit_of(metric: Metric) -> str:
    """The unit of a metric, ``share`` for percentages."""
    return SHARE if metric.bounds == SHARE_BOUNDS else metric.unit.replace("m/s2", "m/s²").replace("m/s3", "m/s³")


def title_of(place: Place) -> str:
    """A place in words.

    >>> title_of(Place("Merge-v0", "urban", "none")), title_of(Place("Merge-v0", "open", "stress"))
    ('Merge, urban sky', 'Merge, open sky, stress faults')
    """
    faults = "" if place.faults == "none" else f", {place.faults} faults"
    return f"{place.env.removesuffix('-v0')}, {place.sky} sky{faults}"


def slug_of(place: Place) -> str:
    """A place as part of an address within the page."""
    return "".join(letter if letter.isalnum() else "-" for letter in str(place)).lower()


def clear_best(intervals: Iterable[tuple[str, float | None, float | None]], better: str | None) -> str | None:
    """The name whose interval lies wholly on the better side of all others; None without one.

    >>> clear_best([("a", 0.0, 0.2), ("b", 0.3, 0.5)], "lower"), clear_best([("a", 0.0, 0.3), ("b", 0.2, 0.5)], "lower")
    ('a', None)
    """
    known: Sequence[tuple[str, float, float]] = [
        (name, low, high) for name, low, high in intervals if low is not None and high is not None
    ]
    if better is None or len(known) < 2:
        return None
    if better == "lower":
        known = [(name, -high, -low) for name, low, high in known]
    best = max(known, key=lambda entry: entry[1])
    return best[0] if all(best[1] > high for name, _, high in known if name != best[0]) else None
