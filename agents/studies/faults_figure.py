"""Figures of the fault campaign: by kind and size, how often a fault is noticed and how often it misleads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

__all__ = ["detectability_figure", "faults_figure"]

COLUMNS = 4
SHOWN = {"noticed": "noticed while it lasts", "misled_vehicles": "error above its level"}


def faults_figure(cells: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of vehicles by size of the fault, all lengths together: steps drawn through, ramps dashed."""
    kinds = list(dict.fromkeys(cell["kind"] for cell in cells))
    rows = -(-len(kinds) // COLUMNS)
    figure = Figure(figsize=(3.2 * COLUMNS, 2.6 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    for axis, kind in zip(axes, kinds, strict=False):
        here = [cell for cell in cells if cell["kind"] == kind]
        sizes = sorted({cell["size"] for cell in here})
        for profile, line in (("step", "o-"), ("ramp", "^--")):
            for name, colour in (("noticed", "tab:green"), ("misled_vehicles", "tab:red")):
                shares = [_share(here, size, profile, name) for size in sizes]
                if None not in shares:
                    axis.plot(range(len(sizes)), shares, line, color=colour, label=f"{SHOWN[name]}, {profile}")
        unit = f" [{here[0]['unit']}]" if here[0]["unit"] else ""
        axis.set_title(kind.replace("_", " ") + unit, fontsize=9)
        axis.set_xticks(range(len(sizes)), [f"{size:g}" if size else "" for size in sizes])
        axis.set_ylim(-0.05, 1.05)
    for axis in axes[len(kinds) :]:
        axis.set_axis_off()
    axes[0].set_ylabel("share of vehicles")
    axes[0].legend(fontsize=7)
    return figure


def _share(cells: Sequence[Mapping[str, Any]], size: float, profile: str, name: str) -> float | None:
    """Mean share of vehicles in the cells of a size and profile; None without any."""
    found = [cell[name]["rate"] for cell in cells if (cell["size"], cell["profile"]) == (size, profile)]
    return float(np.mean(found)) if found else None


def detectability_figure(powers: Sequence[Mapping[str, Any]]) -> Figure:
    """Theory and what detection and exclusion do, by the size of a bias; a panel for each number of satellites."""
    figure = Figure(figsize=(4.2 * len(powers), 3.4), layout="constrained")
    for axis, found in zip(np.atleast_1d(figure.subplots(1, len(powers), squeeze=False).ravel()), powers, strict=True):
        rows = found["by_factor"]
        factor = [row["factor"] for row in rows]
        axis.plot(factor, [row["theory"] for row in rows], "k-", label="its own test, theory")
        for key, mark, label in (
            ("own", "k+", "its own test"),
            ("noticed", "g^-", "noticed"),
            ("right", "bv-", "excluded"),
        ):
            axis.plot(factor, [row[key]["rate"] for row in rows], mark, label=label)
        axis.set_title(f"{found['satellites']} satellites, redundancy {found['redundancy']}", fontsize=9)
        axis.set_xlabel("bias over the minimal detectable one")
        axis.set_ylim(-0.05, 1.05)
        axis.set_ylabel("share of epochs")
        axis.legend(fontsize=8)
    return figure
