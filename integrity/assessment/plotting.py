"""Common style of all figures: a colour-blind safe palette, plain axes, output without a display."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

__all__ = [
    "INK",
    "MODE_COLOURS",
    "PL_COLOUR",
    "legend",
    "mode_colour",
    "mode_key",
    "new_figure",
    "risk_text",
    "save",
    "tidy",
]

# Okabe and Ito (2008), distinguishable with every common colour vision deficiency.
MODE_COLOURS = {
    Mode.NONE: "#9A9A9A",
    Mode.RTK: "#009E73",
    Mode.DOPPLER: "#E69F00",
    Mode.IMU_ODOMETER: "#CC79A7",
    Mode.CODE: "#56B4E9",
    Mode.SPP: "#8B5E3C",
    Mode.DGPS: "#C9A227",
    Mode.SBAS_L1: "#5E81AC",
    Mode.SBAS_DFMC: "#2F4B7C",
    Mode.PPP: "#6A3D9A",
    Mode.NRTK: "#1B7837",
}
FURTHER_COLOURS = ("#8C564B", "#17BECF", "#BCBD22", "#7F3C8D")
PL_COLOUR = "#0072B2"
LIMIT_COLOUR = "#D55E00"
INK = "#2B2B2B"
GRID = "#DDDDDD"
DPI = 150


def mode_colour(mode: Mode) -> str:
    """Colour of a mode; those that users add take further ones in turn."""
    further = FURTHER_COLOURS[int(mode) % len(FURTHER_COLOURS)]
    return MODE_COLOURS.get(mode, further)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Create a figure without pyplot: no display, no global state, no close necessary."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes, **labels: str) -> None:
    """Apply the common style to axes (frame, grid, ticks); ``labels`` are passed to ``Axes.set``."""
    axes.set(**labels)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#888888")
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=INK)
    axes.xaxis.label.set(size=9, color=INK)
    axes.yaxis.label.set(size=9, color=INK)


def legend(axes: Axes, **options: Any) -> Legend:
    """Add a small legend with a light frame."""
    return axes.legend(**({"fontsize": 8, "framealpha": 0.9, "edgecolor": GRID, "fancybox": False} | options))


def mode_key(figure: Figure, modes: Iterable[Mode], lead: str, loc: Any) -> None:
    """Add a legend of the mode colours to the figure, in one line after the text ``lead``."""
    from matplotlib.patches import Patch

    handles = [Patch(facecolor="none", edgecolor="none", label=lead)]
    handles += [Patch(facecolor=mode_colour(mode), label=mode.label) for mode in modes]
    look: dict[str, Any] = {"fontsize": 9, "frameon": False, "handlelength": 1.6, "handleheight": 0.7}
    figure.legend(handles=handles, loc=loc, ncols=len(handles), columnspacing=1.4, **look)


def risk_text(risk: float | None) -> str:
    """Suffix of a title, for example ``", integrity risk 10^-6"``; "" for None."""
    if risk is None:
        return ""
    exponent = round(math.log10(risk))
    power = f"$10^{{{exponent}}}$" if math.isclose(risk, 10.0**exponent) else f"{risk:g}"
    return f", integrity risk {power}"


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure and create its folder if necessary; returns the path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=DPI)
    return target
