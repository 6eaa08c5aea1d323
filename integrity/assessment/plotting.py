"""One look for all figures: a colour-blind safe palette, quiet axes, files without a display."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["INK", "MODE_COLOURS", "PL_COLOUR", "new_figure", "save", "tidy"]

# Okabe and Ito (2008), distinguishable with every common colour vision deficiency.
MODE_COLOURS = {
    Mode.NONE: "#9A9A9A",
    Mode.RTK: "#009E73",
    Mode.DOPPLER: "#E69F00",
    Mode.IMU_ODOMETER: "#CC79A7",
    Mode.CODE: "#56B4E9",
}
PL_COLOUR = "#0072B2"
LIMIT_COLOUR = "#D55E00"
INK = "#2B2B2B"
GRID = "#DDDDDD"
DPI = 150


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure of its own, outside pyplot: no display, no global state, nothing to close."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes, **labels: str) -> None:
    """Quiet frame, light grid, readable ticks; ``labels`` go to ``Axes.set``."""
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


def legend(axes: Axes, **options: Any) -> None:
    """A small legend with a light frame."""
    axes.legend(**({"fontsize": 8, "framealpha": 0.9, "edgecolor": GRID, "fancybox": False} | options))


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure, making its folder; returns the path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=DPI)
    return target
