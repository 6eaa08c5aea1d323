"""Small pictures as inline SVG: elements, scales with round ticks, and axes; colours are classes of the style."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup, escape

__all__ = ["Frame", "Scale", "axes", "line", "path_of", "picture", "round_step", "span", "spread_out", "tag", "text"]


def tag(name: str, *children: Any, **attributes: Any) -> Markup:
    """One element; ``class_`` is ``class``, ``stroke_width`` is ``stroke-width``, None leaves an attribute out.

    >>> tag("text", "a < b", x=1.25, class_="small")
    Markup('<text x="1.2" class="small">a &lt; b</text>')
    """
    named = ((key.rstrip("_").replace("_", "-"), value) for key, value in attributes.items() if value is not None)
    inside = "".join(f' {key}="{escape(_short(value))}"' for key, value in named)
    return Markup(f"<{name}{inside}>{''.join(escape(child) for child in children)}</{name}>")


def _short(value: Any) -> Any:
    """A tenth of a pixel is fine enough."""
    return f"{value:.1f}".removesuffix(".0") if isinstance(value, float) else value


def picture(width: float, height: float, label: str, *children: Any, class_: str = "chart") -> Markup:
    """An image that scales with its place; ``label`` says in words what there is to see."""
    size = {"viewBox": f"0 0 {width:g} {height:g}", "width": f"{width:g}", "height": f"{height:g}"}
    return tag("svg", *children, **size, role="img", aria_label=label, class_=class_)


def text(x: float, y: float, words: Any, class_: str = "", anchor: str | None = None) -> Markup:
    """Words; ``anchor`` is ``middle`` or ``end``."""
    return tag("text", words, x=x, y=y, class_=class_ or None, text_anchor=anchor)


def line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Markup:
    """A straight line."""
    return tag("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=class_)


def path_of(points: Iterable[tuple[float, float]]) -> str:
    """The ``d`` of a path through points."""
    return "M" + "L".join(f"{_short(float(x))} {_short(float(y))}" for x, y in points)


def span(values: Iterable[float | None], pad: float = 0.06, low: float | None = None) -> tuple[float, float]:
    """From the least to the greatest finite value with some air, never empty; ``low`` is included, without air below.

    >>> span([1.0, 3.0], pad=0.5)
    (0.0, 4.0)
    >>> span([2.0], low=0.0)
    (0.0, 2.12)
    """
    finite = [float(v) for v in values if v is not None and math.isfinite(v)] or [0.0]
    bottom, top = min(finite), max(finite)
    if low is not None:
        bottom = min(bottom, low)
    if top - bottom < 1e-9:
        return (bottom, bottom + 1.0) if low is not None else (bottom - 0.5, top + 0.5)
    air = pad * (top - bottom)
    return (bottom if bottom == low else bottom - air), top + air


def round_step(width: float, count: int) -> float:
    """The step 1, 2 or 5 times a power of ten that cuts ``width`` into at most ``count`` pieces, or nearly.

    >>> round_step(0.9, 4)
    0.5
    """
    raw = width / count
    power = 10.0 ** math.floor(math.log10(raw))
    return float(next((m * power for m in (1.0, 2.0, 5.0) if m * power >= raw * 0.999), 10.0 * power))


@dataclass(frozen=True)
class Scale:
    """A straight map from values ``low..high`` to pixels ``start..end``."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def held(self, value: float) -> float:
        """The pixel of a value, at the edge for one outside."""
        return self(min(max(value, self.low), self.high))

    def ticks(self, count: int = 4) -> list[float]:
        """Round values inside."""
        step = round_step(self.high - self.low, count)
        first, last = math.ceil(self.low / step - 1e-6), math.floor(self.high / step + 1e-6)
        return [round(i * step, 12) for i in range(first, last + 1)]


@dataclass(frozen=True)
class Frame:
    """The rectangle that axes span [px]."""

    left: float
    top: float
    right: float
    bottom: float

    def across(self, low: float, high: float) -> Scale:
        """The scale from left to right."""
        return Scale(low, high, self.left, self.right)

    def up(self, low: float, high: float) -> Scale:
        """The scale from bottom to top."""
        return Scale(low, high, self.bottom, self.top)


def axes(frame: Frame, x: Scale, y: Scale, x_label: str, y_label: str, ticks: tuple[int, int] = (5, 5)) -> list[Markup]:
    """Grid, ticks and labels: x below, y above the frame's left corner, where it needs no turning."""
    parts: list[Markup] = []
    for value in x.ticks(ticks[0]):
        parts.append(line(x(value), frame.top, x(value), frame.bottom, "grid"))
        parts.append(text(x(value), frame.bottom + 14, _tick(value), "tick", "middle"))
    for value in y.ticks(ticks[1]):
        parts.append(line(frame.left, y(value), frame.right, y(value), "grid"))
        parts.append(text(frame.left - 5, y(value) + 3.5, _tick(value), "tick", "end"))
    parts.append(text(frame.right, frame.bottom + 29, x_label, "axis", "end"))
    parts.append(text(4, frame.top - 9, y_label, "axis"))
    return parts


def _tick(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def spread_out(wanted: Sequence[float], gap: float) -> list[float]:
    """Positions near the wanted ones, in their order, at least ``gap`` apart.

    >>> spread_out([10.0, 11.0, 40.0], 10.0)
    [5.5, 15.5, 40.0]
    """
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    groups: list[tuple[list[int], float]] = []  # members, and where their middle is
    for i in order:
        members, middle = [i], wanted[i]
        while groups and middle - gap * (len(members) - 1) / 2 < _end_of(groups[-1], gap) + gap:
            before, at = groups.pop()
            middle = (at * len(before) + middle * len(members)) / (len(before) + len(members))
            members = before + members
        groups.append((members, middle))
    placed = [0.0] * len(wanted)
    for members, middle in groups:
        for k, i in enumerate(members):
            placed[i] = middle + gap * (k - (len(members) - 1) / 2)
    return placed


def _end_of(group: tuple[list[int], float], gap: float) -> float:
    members, middle = group
    return middle + gap * (len(members) - 1) / 2
