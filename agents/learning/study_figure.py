"""Learning curves: return and cost at the checkpoints, the mean over seeds and their range, by place and arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from lanebound.envs import make_config
from lanebound.integrity.assessment.plotting import INK, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["curves_figure"]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#9A9A9A", "#000000")  # Okabe and Ito 2008
ROWS = (("return", "return"), ("cost", "cost"))


def curves_figure(trainings: Sequence[Mapping[str, Any]], arms: Sequence[str]) -> Figure:
    """A column for each place; trainings as they are kept, with their ``checkpoints``."""
    places = list(dict.fromkeys((one["env"], one["sky"]) for one in trainings))
    figure = new_figure(3.6 * len(places), 5.0)
    axes = figure.subplots(len(ROWS), len(places), squeeze=False, sharex="col")
    for column, (env, sky) in enumerate(places):
        here = [one for one in trainings if (one["env"], one["sky"]) == (env, sky)]
        for row, (key, label) in enumerate(ROWS):
            axis = axes[row, column]
            for arm, colour in zip(arms, cycle(COLOURS), strict=False):
                _draw(axis, [one["checkpoints"] for one in here if one["arm"] == arm], key, arm, colour)
            if key == "cost":
                limit = make_config(f"lanebound/{env}").cost_limit
                line = axis.axhline(limit, color=INK, linestyle="--", linewidth=1.0, label=f"limit of {limit:g}")
                axis.legend(handles=[line], loc="upper right", frameon=False, fontsize=8)
            title = f"{env.removesuffix('-v0')}, {sky}" if row == 0 else ""
            tidy(axis, title=title, ylabel=label if column == 0 else "", xlabel="thousand decisions" if row else "")
            axis.locator_params(axis="x", nbins=5)
    named = {label: line for axis in axes[0] for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named), frameon=False)
    return figure


def _draw(axis: Any, trainings: Sequence[Sequence[Mapping[str, float]]], key: str, arm: str, colour: str) -> None:
    if not trainings:
        return
    length = min(map(len, trainings))
    steps = [row["steps"] / 1000.0 for row in trainings[0][:length]]
    values = np.array([[row[key] for row in rows[:length]] for rows in trainings])
    axis.plot(steps, values.mean(0), color=colour, label=arm, linewidth=1.4)
    axis.fill_between(steps, values.min(0), values.max(0), color=colour, alpha=0.15, linewidth=0)
