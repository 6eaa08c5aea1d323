"""Matplotlib figures as inline SVG: small, with text as text, and with variables of the page's style as colours."""

from __future__ import annotations

import io
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from markupsafe import Markup, escape

from lanebound.envs.costs import CAUSES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Box", "colour", "new_axes", "new_figure", "span", "spread_out", "to_svg"]

VARIABLES = (
    "ink", "soft", "grid", "card", "ground", "better", "worse", "level", "limit", "error", "alert", "dense",
    *(f"s{k}" for k in range(8)), *(f"c{k}" for k in range(len(CAUSES))), *(f"z{k}" for k in range(5)),
)  # fmt: skip
STAND_INS = {name: f"#0101{k:02x}" for k, name in enumerate(VARIABLES)}
KEPT = ("d", "style", "x", "y", "width", "height", "transform", "id", "href")  # attributes of elements


class Box(NamedTuple):
    """The rectangle of axes in a picture [px], y downwards."""

    left: float
    top: float
    right: float
    bottom: float


def colour(name: str) -> str:
    """The colour that stands for a variable of the style in a figure: ``ink`` for ``var(--ink)``."""
    return STAND_INS[name]


def new_figure(width_px: float, height_px: float) -> Figure:
    """An empty figure whose points are pixels of the page."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_px / 72.0, height_px / 72.0), dpi=72)
    FigureCanvasSVG(figure)
    return figure


def new_axes(
    figure: Figure, box: Box, x: tuple[float, float], y: tuple[float, float], ticks: tuple[int, int] = (5, 5),
    labels: tuple[str, str] = ("", ""), show: Callable[[float], str] = "{:g}".format, tick_px: float = 10.5,
) -> Axes:  # fmt: skip
    """Axes without a frame over a grid; the label of x stands below the right end, that of y above the left one.

    Parameters
    ----------
    x, y : ranges of the axes
    ticks : about how many on each axis; 0 for none
    show : text of a value on x
    """
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    width, height = 72.0 * figure.get_size_inches()
    size = ((box.right - box.left) / width, (box.bottom - box.top) / height)
    axes = figure.add_axes((box.left / width, 1.0 - box.bottom / height, *size), xlim=x, ylim=y, frame_on=False)
    for axis, count, text in ((axes.xaxis, ticks[0], show), (axes.yaxis, ticks[1], "{:g}".format)):
        axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]) if count else NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _, text=text: text(value).replace("-", "−")))
    axes.tick_params(left=False, bottom=False, labelsize=tick_px, labelcolor=colour("soft"), pad=5)
    axes.grid(color=colour("grid"), linewidth=1.0)
    axes.set_axisbelow(True)
    look: dict[str, Any] = {"fontsize": 11, "color": colour("soft"), "transform": None}
    axes.text(box.right, height - box.bottom - 29.0, labels[0], ha="right", **look)
    axes.text(4.0, height - box.top + 9.0, labels[1], **look)
    return axes


def to_svg(figure: Figure, label: str, notes: Mapping[str, str] | None = None, class_: str = "chart") -> Markup:
    """A figure as an SVG element that scales with its place.

    Parameters
    ----------
    label : the content in words
    notes : tooltips by the ``gid`` of artists
    """
    from matplotlib import rc_context

    for artist in figure.findobj():
        artist.set_clip_on(False)
    raw = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": label, "path.simplify": False}):
        figure.savefig(
            raw, format="svg", transparent=True, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
        )
    inside = "".join(_element(child, notes or {}) for child in ET.fromstring(raw.getvalue()))
    for name, stand_in in STAND_INS.items():
        inside = inside.replace(stand_in, f"var(--{name})")
    width, height = 72.0 * figure.get_size_inches()
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
    return Markup(f'<svg {size} role="img" aria-label="{escape(label)}" class="{class_}">{inside}</svg>')


def _element(element: ET.Element, notes: Mapping[str, str]) -> str:
    """An element without superfluous parts; groups only where they have a tooltip."""
    name = element.tag.partition("}")[2]
    inside = "".join(_element(child, notes) for child in element)
    if name == "g":
        note = notes.get(element.get("id", ""))
        return inside if note is None else f"<g><title>{escape(note)}</title>{inside}</g>"
    if name in ("metadata", "style") or (name == "defs" and not inside):
        return ""
    attributes = ((key.rpartition("}")[2], value) for key, value in element.items())
    shown = "".join(
        f' {key}="{escape(text)}"' for key, value in attributes if key in KEPT and (text := _short(key, value))
    )
    return f"<{name}{shown}>{escape((element.text or '').strip())}{inside}</{name}>"


def _short(key: str, value: str) -> str:
    """A shortened attribute: tenths of a pixel, no fonts, no rotations by 0."""
    if key == "style":
        return re.sub(r"font-family: [^;]*(; |$)|; stroke-linecap: square|(?<=[:;]) ", "", value)
    if key == "transform":
        return "" if value.startswith("rotate(-0 ") else value
    if key in ("id", "href"):
        return value
    short = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.1f}".removesuffix(".0"), " ".join(value.split()))
    return short.replace(" L ", "L").replace("M ", "M").replace(" M", "M").replace(" z", "z")


def span(values: Iterable[float | None], pad: float = 0.06) -> tuple[float, float]:
    """From the least to the greatest finite value with a margin, never empty.

    >>> span([1.0, 3.0], pad=0.5)
    (0.0, 4.0)
    """
    finite = [float(v) for v in values if v is not None and math.isfinite(v)] or [0.0]
    bottom, top = min(finite), max(finite)
    air = pad * (top - bottom) if top - bottom >= 1e-9 else 0.5
    return bottom - air, top + air


def spread_out(wanted: Sequence[float], gap: float) -> list[float]:
    """Positions near the wanted ones, in their order, at least ``gap`` apart.

    >>> spread_out([10.0, 11.0, 40.0], 10.0)
    [5.5, 15.5, 40.0]
    """
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    groups: list[list[int]] = []

    def middle(group: Sequence[int]) -> float:
        return sum(wanted[i] for i in group) / len(group)

    for i in order:
        groups.append([i])
        while (
            len(groups) > 1 and middle(groups[-1]) - middle(groups[-2]) < gap * (len(groups[-1]) + len(groups[-2])) / 2
        ):
            last = groups.pop()
            groups[-1] = groups[-1] + last
    placed = [0.0] * len(wanted)
    for group in groups:
        for k, i in enumerate(group):
            placed[i] = middle(group) + gap * (k - (len(group) - 1) / 2)
    return placed
