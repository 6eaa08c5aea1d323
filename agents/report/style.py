"""Numbers as text, colours of agents and names of quantities, and the commands that a page shows."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lanebound.agents.benchmark.metrics import SHARE as SHARE_BOUNDS
from lanebound.agents.benchmark.metrics import Metric
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.suite import SuiteConfig

SHARE = "share"  # unit of what is between 0 and 1 and shown as a percentage


def plain(value: float | None, unit: str = "", short: bool = False) -> str:
    """A number without its unit, but for the percent sign; a dash for none.

    >>> plain(0.4537), plain(1234.5), plain(0.125, "share"), plain(None), plain(0.00012)
    ('0.454', '1,234', '12.5 %', '–', '0.00012')
    """
    if value is None or not math.isfinite(value):
        return "–"
    if unit == SHARE:
        return f"{_three(100.0 * value, 1, short)} %"
    return _three(value, 3, short)


def _three(value: float, decimals_max: int, short: bool) -> str:
    size = abs(value)
    if size >= 1000.0:
        return f"{value:,.0f}".replace("-", "−")
    if short:
        return f"{value:.4g}".replace("-", "−")
    if 0.0 < size < 0.5 * 10.0**-decimals_max:
        return f"{value:.2g}".replace("-", "−")
    decimals = min(decimals_max, 0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 1.0 else 3)
    return f"{value:.{decimals}f}".replace("-", "−")


def signed(value: float | None, unit: str = "", short: bool = False) -> str:
    """The same with a sign before positive values.

    >>> signed(0.5), signed(-0.02, "share")
    ('+0.500', '−2.0 %')
    """
    shown = plain(value, unit, short)
    return f"+{shown}" if value is not None and value > 0.0 else shown


def interval(
    mean: float | None,
    low: float | None,
    high: float | None,
    unit: str = "",
    show: Callable[[float | None, str], str] = plain,
) -> str:
    """A mean and its interval in brackets, the unit behind unless it is a percentage.

    >>> interval(1.0, 0.5, 2.0, "m")
    '1.00 [0.500, 2.00] m'
    """
    behind = f" {unit}" if unit and unit != SHARE else ""
    return f"{show(mean, unit)} [{show(low, unit)}, {show(high, unit)}]{behind}"


def shorten(words: str, letters: int) -> str:
    """Text of limited length, with dots in the middle.

    >>> shorten("my.package.module:policy", 12)
    'my.pac…olicy'
    """
    if len(words) <= letters:
        return words
    head = letters // 2
    return f"{words[:head]}…{words[len(words) - (letters - head - 1) :]}"


UNKNOWN = "DIR"  # results that were made up lie in no folder


def replay_command(folder: Path | None, outcome: Outcome, video: bool = True) -> str:
    """What to type, where the benchmark was started, to drive an episode again and film it."""
    words = ["lanebound", "replay-episode", UNKNOWN if folder is None else str(folder), outcome.id]
    return shlex.join([*words, "--video", "replay.mp4"] if video else words)


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
