"""Figures of S4's trials: paths, errors over seeds, model probabilities, trust levels (S4 figures 7 to 21)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["save_figures"]

COLOURS = {
    "DR": "#8a8f98",
    "IMM-EKF": "#1b6ca8",
    "IMM-EKF as S4": "#c2571a",
    "EKF": "#1b6ca8",
    "UKF": "#c2571a",
    "SM-EKF": "#c2571a",
    "SM-EKF, yaw noise of curved": "#d9a441",
    "CM-EKF": "#7a3e9d",
}
SHADE = "#e8e8ea"


def save_figures(parts: Mapping[str, Any], out: Path) -> list[Path]:
    """Write the figures of each trial; returns their files."""
    files = []
    for number, part in parts.items():
        series = part["series"]
        for name, draw in (("errors", _errors), ("path", _path), ("integrity", _integrity)):
            figure = new_figure(6.4, 4.4 if name == "path" else 3.4)
            axes = figure.subplots()
            draw(axes, series)
            axes.set_title(f"Scenario {number}: {part['title']}", fontsize=9, loc="left")
            files.append(save(figure, out / f"scenario-{number}-{name}.png"))
    return files


def _gaps(axes: Axes, series: Mapping[str, Any]) -> None:
    """Shade the time without GNSS."""
    time, missing = np.array(series["time_s"]), ~np.array(series["covered"])
    for k in np.flatnonzero(missing):
        axes.axvspan(time[k] - 0.5, time[k] + 0.5, color=SHADE, lw=0, zorder=0)


def _errors(axes: Axes, series: Mapping[str, Any]) -> None:
    """Median errors with the band of 5 to 95 % of the drives (S4 figures 11 to 16 and 19)."""
    _gaps(axes, series)
    for name, (low, middle, high) in series["error_m"].items():
        colour = COLOURS.get(name, INK)
        axes.fill_between(series["time_s"], low, high, color=colour, alpha=0.15, lw=0)
        axes.plot(series["time_s"], middle, color=colour, lw=1.3, label=name)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("horizontal error [m]")
    tidy(axes)
    legend(axes)


def _path(axes: Axes, series: Mapping[str, Any]) -> None:
    """The first drive on the map (S4 figures 7 to 10, 17 and 20)."""
    for name, points in series["path"].items():
        east, north = np.array(points).T
        style: dict[str, Any] = {"color": COLOURS.get(name, INK), "lw": 1}
        if name == "truth":
            style = {"color": INK, "lw": 2.5, "alpha": 0.35}
        axes.plot(east, north, label=name, **style)
    axes.set_aspect("equal")
    axes.set_xlabel("East [m]")
    axes.set_ylabel("North [m]")
    tidy(axes)
    legend(axes)


def _integrity(axes: Axes, series: Mapping[str, Any]) -> None:
    """Error of the first drive, the median trust level and, of two models, the probability (S4 figures 18 and 21)."""
    _gaps(axes, series)
    name = list(series["htl_m"])[-1]
    axes.plot(series["time_s"], series["one_m"][name], color=COLOURS.get(name, INK), lw=1.2, label=f"error, {name}")
    axes.plot(series["time_s"], series["htl_m"][name], color=PL_COLOUR, lw=1.2, ls="-.", label="HTL, median")
    axes.plot(series["time_s"], 2.0 * np.array(series["sigma_m"][name]), color=INK, lw=0.8, ls=":", label="2 sigma")
    if max(series["curved"]) > 0.0:
        axes.plot(series["time_s"], series["curved"], color="#7a3e9d", lw=0.9, label="probability of curved [-]")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("[m]")
    tidy(axes)
    legend(axes)
