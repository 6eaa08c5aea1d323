"""The pictures of a report: paired differences, gains against costs, costs by cause, Stanford diagrams, episodes.

Figures are inline SVG: small, with text as text, and with variables of the page's style as colours.
"""

from __future__ import annotations

import io
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from lanebound.agents.benchmark.results import Paired
from lanebound.agents.report.style import interval, plain, shorten, signed
from lanebound.envs.costs import CAUSES
from lanebound.integrity.assessment.plotting import ZoneCounts, count_zones, mode_colour
from lanebound.integrity.assessment.record import AXES, Axis, Record, Zone
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


NAME_PX = 12.0
NAME_LETTERS = 17
AXIS_NAMES: dict[Axis, str] = {"at": "along the track", "ct": "across the track"}


# Paired differences


def forest(title: str, unit: str, better: str | None, against: str, rows: Mapping[str, Paired]) -> Markup:
    """A row for each agent, by the name to show: a filled diamond where the difference is clear, else a circle."""
    width, height = 360.0, 50.0 + 25.0 * len(rows)
    figure, box = new_figure(width, height), Box(126.0, 10.0, width - 10.0, height - 40.0)
    x = span([0.0, *(v for row in rows.values() for v in (row.low, row.high, row.difference))])
    axes = new_axes(figure, box, x, (len(rows) - 0.5, -0.5), (4, 0), show=lambda value: signed(value, unit, short=True))
    axes.axvline(0.0, color=colour("soft"), linewidth=1.2)
    if better is not None:
        words, at, side = ("better →", 1.0, "right") if better == "higher" else ("← better", 0.0, "left")
        axes.annotate(
            words, (at, 0.0), (0, -31), "axes fraction", "offset points", ha=side, fontsize=11, color=colour("soft")
        )
    names = [shorten(name, NAME_LETTERS) for name in rows]
    axes.set_yticks(range(len(rows)), names, fontsize=NAME_PX, color=colour("ink"))
    axes.grid(False, axis="y")
    notes = {}
    for i, (name, row) in enumerate(rows.items()):
        verdict = row.verdict(better)
        look: dict[str, Any] = {
            "color": colour(verdict if verdict in ("better", "worse") else "soft"), "gid": f"row-{i}"
        }  # fmt: skip
        if row.low is not None and row.high is not None:
            axes.plot([row.low, row.high], [i, i], linewidth=1.8, solid_capstyle="butt", **look)
        inside = look["color"] if row.clear else colour("card")
        mark: dict[str, Any] = {"marker": "D" if row.clear else "o", "markersize": 7.0, "mew": 1.6}
        axes.plot(np.array([row.difference], dtype=float), [i], markerfacecolor=inside, **mark, **look)
        better_on = "" if row.better is None else f", better on {100.0 * row.better:.0f} % of the seeds"
        failed = f", {verdict}" if row.failed else ""
        notes[f"row-{i}"] = f"{name}: {_words(row, unit)}, {row.n} seeds{failed}{better_on}"
    said = "; ".join(f"{name} {_words(row, unit)}, {row.verdict(better)}" for name, row in rows.items())
    return to_svg(figure, f"{title}, difference against {against}, 95 % intervals: {said}", notes)


def _words(row: Paired, unit: str) -> str:
    """A difference and its interval."""
    if row.low is None or row.high is None:
        return f"{signed(row.difference, unit)}, no interval"
    return interval(row.difference, row.low, row.high, unit, signed)


# Gains against costs


@dataclass(frozen=True)
class ParetoPoint:
    """An agent in the plane of two metrics, ``(mean, low, high)`` each; ``bound`` where it observes the truth."""

    agent: str
    look: int
    x: tuple[float, float, float]
    y: tuple[float, float, float]
    bound: bool = False


@dataclass(frozen=True)
class ParetoAxis:
    """The metric of an axis, and which direction is better."""

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


def front(points: Sequence[ParetoPoint], x: ParetoAxis, y: ParetoAxis) -> list[ParetoPoint]:
    """The points that no other dominates by its means, from left to right."""

    def dominated(p: ParetoPoint) -> bool:
        return any(
            x.beats(q.x[0], p.x[0]) and y.beats(q.y[0], p.y[0]) and (q.x[0], q.y[0]) != (p.x[0], p.y[0]) for q in points
        )

    return sorted((p for p in points if not dominated(p)), key=lambda p: (p.x[0], p.y[0]))


def pareto(points: Sequence[ParetoPoint], x: ParetoAxis, y: ParetoAxis) -> Markup:
    """The plane of two metrics; a line joins the front of the agents that do not observe the truth."""
    width, height, box = 440.0, 300.0, Box(46.0, 26.0, 318.0, 258.0)
    figure = new_figure(width, height)
    axes = new_axes(figure, box, span(v for p in points for v in p.x), span(v for p in points for v in p.y),
                    labels=(x.label, y.label))  # fmt: skip
    best = front([p for p in points if not p.bound], x, y)
    axes.plot([p.x[0] for p in best], [p.y[0] for p in best], ":", color=colour("soft"), linewidth=1.4)
    low, high = axes.get_ylim()
    wanted = [box.bottom + (p.y[0] - low) / (high - low) * (box.top - box.bottom) for p in points]
    rows = spread_out(wanted, 15.0)
    shift = max(0.0, 14.0 - min(rows)) - max(0.0, max(rows) - height + 8.0)
    notes = {}
    for i, (p, row) in enumerate(zip(points, rows, strict=True)):
        tone, gid = colour(f"s{p.look % 8}"), f"point-{i}"
        axes.plot(p.x[1:], [p.y[0]] * 2, [p.x[0]] * 2, p.y[1:], color=tone, linewidth=1.2, alpha=0.7, gid=gid)
        axes.plot([p.x[0]], [p.y[0]], "os^Dv P"[p.look % 6 if p.look % 6 < 5 else 6], color=tone, markersize=9, gid=gid,
                  markerfacecolor=colour("card") if p.bound else tone)  # fmt: skip
        look: dict[str, Any] = {
            "xytext": (box.right + 18.0, height - row - shift - 4.0), "textcoords": "figure points",
            "fontsize": NAME_PX, "color": colour("ink"),
            "arrowprops": {"arrowstyle": "-", "color": tone, "alpha": 0.55, "linewidth": 0.8, "relpos": (0, 0.5),
                           "shrinkA": 2, "shrinkB": 6},
        }  # fmt: skip
        axes.annotate(shorten(p.agent, 15), (p.x[0], p.y[0]), **look)
        notes[gid] = f"{p.agent}: {x.title} {interval(*p.x, x.unit)} · {y.title} {interval(*p.y, y.unit)}"
    said = "; ".join(f"{p.agent} {plain(p.x[0], x.unit)}, {plain(p.y[0], y.unit)}" for p in points)
    names = ", ".join(p.agent for p in best)
    return to_svg(figure, f"{y.title} against {x.title.lower()}. On the Pareto front: {names}. Means: {said}", notes)


# Costs by cause


@dataclass(frozen=True)
class CostBar:
    """The mean costs of an agent by cause, none below zero."""

    agent: str
    parts: Mapping[str, float]

    @property
    def total(self) -> float:
        """Sum over the causes."""
        return sum(self.parts.values())

    @property
    def words(self) -> str:
        """The causes, the greatest first."""
        named = sorted(((v, k) for k, v in self.parts.items() if v > 0.0), reverse=True)
        return ", ".join(f"{cause} {plain(value)}" for value, cause in named) or "no cost"


def stacked(title: str, bars: Sequence[CostBar]) -> Markup:
    """A bar for each agent with its total; causes have the colours ``c0``, ``c1`` ... in their order."""
    width, height = 440.0, 42.0 + 26.0 * len(bars)
    figure = new_figure(width, height)
    most = 1.02 * max([bar.total for bar in bars] + [1e-9])
    axes = new_axes(figure, Box(126.0, 6.0, width - 44.0, height - 36.0), (0.0, most), (len(bars) - 0.5, -0.5), (5, 0),
                    labels=("mean cost of an episode", ""))  # fmt: skip
    names = [shorten(bar.agent, NAME_LETTERS) for bar in bars]
    axes.set_yticks(range(len(bars)), names, fontsize=NAME_PX, color=colour("ink"))
    axes.grid(False, axis="y")
    notes = {}
    for i, bar in enumerate(bars):
        done = 0.0
        for k, (cause, value) in enumerate(bar.parts.items()):
            if value > 0.0:
                (part,) = axes.barh(
                    i, value, 0.7, done, color=colour(f"c{k}"), edgecolor=colour("ground"), linewidth=1.0
                )
                part.set_gid(f"part-{i}-{k}")
                notes[f"part-{i}-{k}"] = f"{bar.agent}, {cause}: {plain(value)}"
                done += value
        axes.annotate(
            plain(bar.total),
            (done, i),
            (5, 0),
            textcoords="offset points",
            va="center",
            fontsize=11,
            color=colour("soft"),
        )
    said = "; ".join(f"{bar.agent} {plain(bar.total)} ({bar.words})" for bar in bars)
    return to_svg(figure, f"{title}: {said}", notes)


# Stanford diagrams

LIMITS_SHOWN = 2.0  # alert limits that a diagram reaches
CELLS, LEVELS = 48, 5  # of the density: cells along each axis, degrees of darkness
OPACITY = (0.28, 0.45, 0.62, 0.8, 1.0)


def stanford(agent: str, record: Record, axis: Axis, al_m: float) -> tuple[Markup, ZoneCounts]:
    """The Stanford diagram of one axis up to twice the alert limit, and the epochs in each zone."""
    zones, top = count_zones(record, axis, al_m), LIMITS_SHOWN * al_m
    figure, box = new_figure(176.0, 190.0), Box(27.0, 22.0, 171.0, 157.0)
    labels = ("error (m)", f"PL {axis.upper()} (m)")
    axes = new_axes(figure, box, (0.0, top), (0.0, top), (3, 4), labels, tick_px=9.5)
    axes.grid(False)
    for zone, outline in _outlines(al_m, top).items():
        axes.fill(*zip(*outline, strict=True), color=colour(f"z{int(zone)}"), linewidth=0)
    _draw_density(axes, np.minimum(record.error(axis), top), np.minimum(record.pl(axis), top), top)
    axes.plot([0.0, top], [0.0, top], color=colour("soft"), linewidth=0.8)
    axes.plot([0.0, top], [al_m, al_m], [al_m, al_m], [0.0, al_m], color=colour("limit"), linewidth=1.3, dashes=(3, 2))
    said = ", ".join(f"{zone.label} {share_text(zones.rate(zone))}" for zone in Zone)
    return to_svg(figure, f"Stanford diagram of {agent} {AXIS_NAMES[axis]}, alert limit {al_m:g} m: {said}"), zones


def _outlines(al: float, top: float) -> dict[Zone, list[tuple[float, float]]]:
    """Corners of the zones (error, PL) [m]."""
    return {
        Zone.NOMINAL: [(0, 0), (al, al), (0, al)],
        Zone.MISLEADING: [(0, 0), (al, 0), (al, al)],
        Zone.HAZARDOUS: [(al, 0), (top, 0), (top, al), (al, al)],
        Zone.UNAVAILABLE: [(0, al), (al, al), (top, top), (0, top)],
        Zone.UNAVAILABLE_MISLEADING: [(al, al), (top, al), (top, top)],
    }


def _draw_density(axes: Axes, error_m: NDArray[np.float64], pl_m: NDArray[np.float64], top_m: float) -> None:
    """Cells by the logarithm of their epochs, one path for each degree; a single epoch stays visible.

    A path runs along the middles of its cells and is as wide as they are, which takes less text than outlines.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    edges = np.linspace(0.0, top_m, CELLS + 1)
    counts, _, _ = np.histogram2d(pl_m.ravel(), error_m.ravel(), bins=[edges, edges])
    with np.errstate(divide="ignore"):
        degree = np.where(counts > 0, np.floor(LEVELS * np.log(counts) / np.log(max(10.0, counts.max()))), -1.0)
    width = axes.get_window_extent().height / CELLS
    for k in range(LEVELS):
        there = np.pad(np.minimum(degree, LEVELS - 1) == k, ((0, 0), (1, 1))).astype(int)
        row, start = np.nonzero(np.diff(there) == 1)
        end = np.nonzero(np.diff(there) == -1)[1]
        height = edges[row] + 0.5 * edges[1]
        ends = np.stack([edges[start], height, edges[end], height], -1).reshape(-1, 2)
        if ends.size:
            path = Path(ends, [Path.MOVETO, Path.LINETO] * len(row))
            axes.add_patch(
                PathPatch(path, fill=False, color=colour("dense"), linewidth=width, alpha=OPACITY[k], capstyle="butt")
            )


def share_text(rate: float) -> str:
    """A share as a percentage with enough digits to distinguish a rare event from none."""
    if rate in (0.0, 1.0):
        return f"{100.0 * rate:.0f} %"
    return f"{100.0 * rate:.1f} %" if 0.001 <= rate <= 0.999 else f"{100.0 * rate:.3g} %"


# Episodes

LEVEL_QUANTILE = 0.98  # of the levels within the scale
MOST_LIMITS = 3.0  # alert limits that the scale reaches for levels alone


@dataclass(frozen=True)
class EpisodeTrace:
    """Errors and levels of an episode after every decision, and its alert limits [m]."""

    record: Record
    al_at_m: float
    al_ct_m: float

    def limit_m(self, axis: Axis) -> float:
        """The alert limit of an axis."""
        return self.al_at_m if axis == "at" else self.al_ct_m


def trace(episode: EpisodeTrace, title: str) -> Markup:
    """A panel for each axis: error filled, level a line, alert limit dashed, alerts shaded, modes in a strip above."""
    figure = new_figure(340.0, 288.0)
    for i, axis in enumerate(AXES):
        _draw_panel(
            figure, episode, axis, Box(30.0, 30.0 + 134.0 * i, 336.0, 122.0 + 134.0 * i), "time (s)" if i else ""
        )
    return to_svg(figure, f"{title}. {_said(episode)}")


def _draw_panel(figure: Figure, episode: EpisodeTrace, axis: Axis, box: Box, x_label: str) -> None:
    record, al = episode.record, episode.limit_m(axis)
    time, error, pl = record.time_s, record.error(axis), record.pl(axis)
    finite = pl[np.isfinite(pl)]
    level = float(np.quantile(finite, LEVEL_QUANTILE)) if finite.size else 0.0
    top = 1.08 * max(1.15 * al, float(error.max()), min(level, MOST_LIMITS * al))
    axes = new_axes(figure, box, (0.0, float(time[-1])), (0.0, top), (6, 3), (x_label, f"{axis.upper()} (m)"))
    for a, b in _spans(record.alert, time):
        axes.axvspan(a, b, color=colour("alert"), alpha=0.75, linewidth=0, zorder=0.5)
    outline = [time[-1], time[0], *time], [0.0, 0.0, *error]
    axes.fill(*outline, facecolor=colour("error"), alpha=0.35, linewidth=0)
    axes.plot(time, error, color=colour("error"), linewidth=1.0)
    axes.plot(time, np.minimum(pl, top), color=colour("level"), linewidth=1.6)
    axes.plot([0.0, time[-1]], [al, al], color=colour("limit"), linewidth=1.3, dashes=(3, 2))
    for mode in Mode:
        for a, b in _spans(record.mode == mode, time):
            axes.axvspan(a, b, 1.0, 1.0 + 6.0 / (box.bottom - box.top), color=mode_colour(mode), linewidth=0)


def _spans(on: NDArray[np.bool_], time: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Times of uninterrupted stretches, from the decision before each to its last [s]."""
    change = np.diff(np.concatenate([[0], np.asarray(on, dtype=int), [0]]))
    before = np.concatenate([[0.0], time])
    return list(zip(before[np.nonzero(change == 1)[0]], time[np.nonzero(change == -1)[0] - 1], strict=True))


def _said(episode: EpisodeTrace) -> str:
    """The episode in words."""
    record, words = episode.record, []
    for axis in AXES:
        beyond = float((record.error(axis) > episode.limit_m(axis)).mean())
        unbounded = float((record.error(axis) > record.pl(axis)).mean())
        words.append(
            f"{axis.upper()}: error up to {record.error(axis).max():.2f} m, beyond the alert limit of "
            f"{episode.limit_m(axis):g} m {100 * beyond:.0f} % of the time, beyond its level {100 * unbounded:.0f} %"
        )
    shares = [
        f"{mode.label} {100 * float((record.mode == mode).mean()):.0f} %"
        for mode in Mode
        if (record.mode == mode).any()
    ]
    alert = f"alert on {100 * float(record.alert.mean()):.0f} % of the time"
    return "; ".join([*words, "position from " + ", ".join(shares), alert])
