"""Costs by cause as stacked bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from lanebound.agents.report.numbers import plain, shorten
from lanebound.agents.report.svg import Frame, line, picture, tag, text

__all__ = ["Stack", "stacked"]

WIDTH, ROW_PX, TOP, FOOT = 440.0, 26.0, 6.0, 36.0
LABEL_END, VALUE_PX = 118.0, 44.0


@dataclass(frozen=True)
class Stack:
    """A bar: whose, and what it is made of, by cause, none below zero."""

    agent: str
    parts: Mapping[str, float]

    @property
    def total(self) -> float:
        """Its length."""
        return sum(self.parts.values())


def stacked(title: str, stacks: Sequence[Stack]) -> Markup:
    """A bar for each agent, with its total; the colour of a cause is the class ``c0``, ``c1`` ... in their order."""
    height = TOP + ROW_PX * len(stacks) + FOOT
    frame = Frame(LABEL_END + 8.0, TOP, WIDTH - VALUE_PX, height - FOOT)
    x = frame.across(0.0, 1.02 * max([s.total for s in stacks] + [1e-9]))
    pieces: list[Markup] = []
    for value in x.ticks(5):
        pieces.append(line(x(value), frame.top, x(value), frame.bottom, "grid"))
        pieces.append(text(x(value), frame.bottom + 14, f"{value:g}", "tick", "middle"))
    pieces.append(text(frame.right, frame.bottom + 30, "mean cost of an episode", "axis", "end"))
    for i, stack in enumerate(stacks):
        y, done = TOP + ROW_PX * i, 0.0
        pieces.append(text(LABEL_END, y + ROW_PX / 2 + 4, shorten(stack.agent, 17), "name", "end"))
        for k, (cause, value) in enumerate(stack.parts.items()):
            if value > 0.0:
                note = tag("title", f"{stack.agent}, {cause}: {plain(value)}")
                size = {"x": x(done), "y": y + 4, "width": x(done + value) - x(done), "height": ROW_PX - 8}
                pieces.append(tag("rect", note, **size, class_=f"c{k}"))
                done += value
        pieces.append(text(x(done) + 5, y + ROW_PX / 2 + 4, plain(stack.total), "value"))
    said = "; ".join(f"{s.agent} {plain(s.total)} ({_most(s)})" for s in stacks)
    return picture(WIDTH, height, f"{title}: {said}", *pieces)


def _most(stack: Stack) -> str:
    """The causes of a bar, the greatest first."""
    named = sorted(((v, k) for k, v in stack.parts.items() if v > 0.0), reverse=True)
    return ", ".join(f"{cause} {plain(value)}" for value, cause in named) or "no cost"
