"""Paired differences as intervals about zero: one picture for each metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from lanebound.agents.benchmark.statistics import VERDICT_SEEDS, is_clear
from lanebound.agents.report.numbers import interval, shorten, signed
from lanebound.agents.report.svg import Frame, Scale, line, picture, span, tag, text

__all__ = ["Difference", "forest"]

WIDTH, LABEL_END, ROW_PX, TOP, FOOT = 360.0, 118.0, 25.0, 10.0, 40.0
NAME_LETTERS = 17


@dataclass(frozen=True)
class Difference:
    """How much more an agent has than the one it is compared with, and the interval of that over so many seeds.

    Attributes
    ----------
    low, high : None where the seeds give no interval
    share_better : share of the seeds on which it does better, None where nothing is better
    failed : episodes in which one of the two failed: what is left may be the easy ones, and nothing is clear
    """

    agent: str
    mean: float
    low: float | None
    high: float | None
    seeds: int
    share_better: float | None = None
    failed: int = 0

    @property
    def clear(self) -> bool:
        """The interval leaves out zero, the seeds suffice, and nobody failed."""
        return not self.failed and is_clear(self.low, self.high, self.seeds)

    @property
    def few(self) -> bool:
        """There are too few seeds for a verdict."""
        return self.seeds < VERDICT_SEEDS

    def verdict(self, better: str | None) -> str:
        """``better``, ``worse``, ``differs`` (neither is better), ``unclear``, or why there is no verdict."""
        if self.failed:
            return f"no verdict, {self.failed} failed"
        if self.few:
            return "too few seeds"
        if not self.clear:
            return "unclear"
        if better is None:
            return "differs"
        return "better" if (self.mean > 0.0) == (better == "higher") else "worse"


def forest(title: str, unit: str, better: str | None, against: str, rows: Sequence[Difference]) -> Markup:
    """A row for each agent: a filled diamond where the interval is clear of zero, an empty circle where it is not."""
    height = TOP + ROW_PX * len(rows) + FOOT
    frame = Frame(LABEL_END + 8.0, TOP, WIDTH - 10.0, height - FOOT)
    x = frame.across(*span([0.0, *(v for row in rows for v in (row.low, row.high, row.mean) if v is not None)]))
    parts = _ground(frame, x, unit, better)
    for i, row in enumerate(rows):
        parts.append(_row(row, x, TOP + ROW_PX * (i + 0.5), unit, better))
    said = "; ".join(f"{r.agent} {_words(r, unit)}, {r.verdict(better)}" for r in rows)
    return picture(WIDTH, height, f"{title}, difference against {against}, 95 % intervals: {said}", *parts)


def _ground(frame: Frame, x: Scale, unit: str, better: str | None) -> list[Markup]:
    """Grid, the line of zero, and which side is the good one."""
    parts = []
    for value in x.ticks(4):
        parts.append(line(x(value), frame.top, x(value), frame.bottom, "grid"))
        parts.append(text(x(value), frame.bottom + 14, signed(value, unit, short=True), "tick", "middle"))
    parts.append(line(x(0.0), frame.top - 4, x(0.0), frame.bottom, "zero"))
    if better is not None:
        right = better == "higher"
        words, at, anchor = ("better →", frame.right, "end") if right else ("← better", frame.left, None)
        parts.append(text(at, frame.bottom + 31, words, "axis", anchor))
    return parts


def _row(row: Difference, x: Scale, y: float, unit: str, better: str | None) -> Markup:
    verdict = row.verdict(better) if row.clear else "unclear"
    note = f"{row.agent}: {_words(row, unit)}, {row.seeds} seeds"
    if row.failed:
        note += f", {row.verdict(better)}"
    if row.share_better is not None:
        note += f", better on {100.0 * row.share_better:.0f} % of the seeds"
    middle = x(row.mean)
    whisker = Markup()
    if row.low is not None and row.high is not None:
        whisker = line(x(row.low), y, x(row.high), y, "whisker")
    mark = (
        tag("path", d=f"M{middle - 5:.1f} {y:.1f}l5 -5l5 5l-5 5z", class_="mark")
        if row.clear
        else tag("circle", cx=middle, cy=y, r=4, class_="mark open")
    )
    return tag(
        "g",
        tag("title", note),
        text(LABEL_END, y + 4, shorten(row.agent, NAME_LETTERS), "name", "end"),
        whisker,
        mark,
        class_=f"v-{verdict}",
    )


def _words(row: Difference, unit: str) -> str:
    """A difference and its interval."""
    if row.low is None or row.high is None:
        return f"{signed(row.mean, unit)}, no interval"
    return interval(row.mean, row.low, row.high, unit, signed)
