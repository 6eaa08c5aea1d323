"""The fault campaign as a figure: for each kind, how often it is noticed and how often it misleads, by size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

__all__ = ["faults_figure"]

COLUMNS = 4


def faults_figure(cells: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of vehicles by size of the fault, all lengths and profiles together."""
    kinds = list(dict.fromkeys(cell["kind"] for cell in cells))
    rows = -(-len(kinds) // COLUMNS)
    figure = Figure(figsize=(3.2 * COLUMNS, 2.6 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    for axis, kind in zip(axes, kinds, strict=False):
        sizes = sorted({cell["size"] for cell in cells if cell["kind"] == kind})
        for name, of, colour in (("noticed", _noticed, "tab:green"), ("misled", _misled, "tab:red")):
            shares = [np.mean([of(c) for c in cells if c["kind"] == kind and c["size"] == size]) for size in sizes]
            axis.plot(range(len(sizes)), shares, "o-", color=colour, label=name)
        axis.set_title(kind.replace("_", " "), fontsize=9)
        axis.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes])
        axis.set_ylim(-0.05, 1.05)
    for axis in axes[len(kinds) :]:
        axis.set_axis_off()
    axes[0].set_ylabel("share of vehicles")
    axes[0].legend(fontsize=8)
    return figure


def _noticed(cell: Mapping[str, Any]) -> float:
    return float(cell["noticed"]["rate"])


def _misled(cell: Mapping[str, Any]) -> float:
    return float(cell["misled_vehicles"] / cell["vehicles"])
