"""Pictures of a journey."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.journeys.engine import Journeys
from lanebound.integrity.assessment.plotting import new_figure

__all__ = ["picture_of"]


def picture_of(journeys: Journeys, row: int) -> NDArray[np.uint8]:
    """Streets by the predicted probability of a usable position, origin, goal and the way so far; (600, 600, 3)."""
    from matplotlib.collections import LineCollection

    at, own = journeys.at(row), journeys.state[row]
    town, ahead = at.town, at.mapped.ahead
    figure = new_figure(6.0, 6.0)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    time_s = town.edges["length_m"] / town.edges["limit_mps"]
    lines: Any = LineCollection([edge.points_en_m for edge in town.graph.edges], cmap="viridis", linewidths=2.5)
    lines.set_array(1.0 - ahead["lost_s"][:, 0] / time_s)
    lines.set_clim(0.0, 1.0)
    axes.add_collection(lines)
    way = [town.graph.edges[k].points_en_m for k in journeys.ways[row]]
    if way:
        axes.plot(*np.concatenate(way).T, color="#D55E00", lw=5.0, alpha=0.8)
    for place, mark in ((town.places[own["origin"]], "o"), (town.places[own["goal"]], "s")):
        axes.plot(*place, mark, color="#FFFFFF", markeredgecolor="#000000", markersize=10)
    state = f"{own['time_s']:.0f} s, unusable {own['unusable_s']:.0f} s (predicted {own['predicted_s']:.0f} s)"
    axes.text(0.01, 0.985, state, transform=axes.transAxes, va="top", fontsize=10)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.axis("off")
    canvas: Any = figure.canvas
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
