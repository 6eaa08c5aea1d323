"""Figure of the informativeness of levels: AUC without and with the level, by sky."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["auc_figure"]

SHOWN = {"auc_clock": ("mode and age of RTK", INK, "o"), "auc_level": ("and protection level", PL_COLOUR, "D")}


def auc_figure(cells: Sequence[Mapping[str, Any]]) -> Figure:
    """AUC of both models with intervals by street, a row for each sky."""
    figure = new_figure(6.4, 1.2 + 0.4 * len(cells))
    axes = figure.subplots()
    for shift, (key, (label, colour, mark)) in zip((0.12, -0.12), SHOWN.items(), strict=True):
        rows = [(k, cell[key]) for k, cell in enumerate(cells) if cell[key]["value"] is not None]
        for k, found in rows:
            axes.plot([found["low"], found["high"]], [shift - k, shift - k], color=colour, lw=1.5)
        axes.plot([f["value"] for _, f in rows], [shift - k for k, _ in rows], mark, color=colour, label=label)
    axes.set_yticks([-k for k in range(len(cells))], [c["sky"] for c in cells])
    axes.set_ylim(0.5 - len(cells), 0.5)
    axes.set_xlabel("AUC of large errors across the track, streets held out [-]")
    tidy(axes)
    legend(axes)
    return figure
