"""What is gained against what it costs: a point for each agent, with the intervals of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from lanebound.agents.report.numbers import interval, plain, shorten
from lanebound.agents.report.svg import Frame, Scale, axes, line, path_of, picture, span, spread_out, tag, text

__all__ = ["Place", "Side", "front", "pareto"]

WIDTH, HEIGHT = 440.0, 300.0
FRAME = Frame(46.0, 26.0, 318.0, 258.0)
LABEL_PX = 15.0
COLOURS = 8
SHAPES = (
    "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z",
    "M-4.5 -4.5h9v9h-9z",
    "M0 -5.8L5.6 4.2H-5.6z",
    "M0 -6L6 0L0 6L-6 0z",
    "M0 5.8L5.6 -4.2H-5.6z",
    "M-5 -2H-2V-5H2V-2H5V2H2V5H-2V2H-5z",
)


@dataclass(frozen=True)
class Place:
    """Where an agent stands: ``(mean, low, high)`` of each axis; ``bound`` for one that sees the truth."""

    agent: str
    look: int
    x: tuple[float, float, float]
    y: tuple[float, float, float]
    bound: bool = False


@dataclass(frozen=True)
class Side:
    """What an axis shows, and which end of it is better."""

    title: str
    unit: str
    better: str | None

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def beats(self, one: float, other: float) -> bool:
        """Whether ``one`` is at least as good."""
        return one <= other if self.better == "lower" else one >= other


def front(places: Sequence[Place], x: Side, y: Side) -> list[Place]:
    """Those to whom nobody is preferable on both axes at once, by their means, from left to right."""

    def dominated(p: Place) -> bool:
        return any(
            x.beats(q.x[0], p.x[0]) and y.beats(q.y[0], p.y[0]) and (q.x[0], q.y[0]) != (p.x[0], p.y[0]) for q in places
        )

    return sorted((p for p in places if not dominated(p)), key=lambda p: (p.x[0], p.y[0]))


def pareto(places: Sequence[Place], x: Side, y: Side) -> Markup:
    """The plane of two metrics; the line joins the agents of the front, those that see the truth left out."""
    across = FRAME.across(*span(v for p in places for v in p.x))
    up = FRAME.up(*span(v for p in places for v in p.y))
    best = front([p for p in places if not p.bound], x, y)
    parts = axes(FRAME, across, up, x.label, y.label)
    if len(best) > 1:
        parts.append(tag("path", d=path_of((across(p.x[0]), up(p.y[0])) for p in best), class_="front"))
    rows = spread_out([up(p.y[0]) for p in places], LABEL_PX)
    shift = max(0.0, 14.0 - min(rows)) - max(0.0, max(rows) - HEIGHT + 8.0)
    for place, row in zip(places, rows, strict=True):
        parts.append(_point(place, across, up, row + shift, (x, y)))
    names = ", ".join(p.agent for p in best)
    said = "; ".join(f"{p.agent} {plain(p.x[0], x.unit)}, {plain(p.y[0], y.unit)}" for p in places)
    label = f"{y.title} against {x.title.lower()}. On the Pareto front: {names}. Means: {said}"
    return picture(WIDTH, HEIGHT, label, *parts)


def _point(place: Place, across: Scale, up: Scale, row: float, sides: tuple[Side, Side]) -> Markup:
    """A mark, its intervals, and its name in the margin with a line that leads there."""
    px, py = across(place.x[0]), up(place.y[0])
    note = " · ".join(
        f"{side.title} {interval(*value, side.unit)}" for side, value in zip(sides, (place.x, place.y), strict=True)
    )
    return tag(
        "g",
        tag("title", f"{place.agent}: {note}"),
        tag("path", d=path_of([(px, py), (FRAME.right + 6, row), (FRAME.right + 14, row)]), class_="lead"),
        line(across(place.x[1]), py, across(place.x[2]), py, "whisker"),
        line(px, up(place.y[1]), px, up(place.y[2]), "whisker"),
        tag(
            "path",
            d=SHAPES[place.look % len(SHAPES)],
            transform=f"translate({px:.1f} {py:.1f})",
            class_="mark open" if place.bound else "mark",
        ),
        text(FRAME.right + 18, row + 4, shorten(place.agent, 15), "name"),
        class_=f"s{place.look % COLOURS}",
    )
