"""Figures of the context study: the threshold sweep of S5 figure 8, rates of the rules, shares of right links."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.reproduce.context_tables import MAIN, RULES
from lanebound.integrity.assessment.plotting import INK, LIMIT_COLOUR, PL_COLOUR, legend, new_figure, save, tidy

__all__ = ["write_figures"]

S5_THRESHOLD = 71.0
COLOURS = ("#009E73", "#E69F00", "#CC79A7")


def write_figures(tables: Mapping[str, Any], out: Path) -> None:
    """Write ``threshold.png``, ``rules.png`` and ``matchers.png``."""
    _threshold(tables, out / "threshold.png")
    _rules(tables, out / "rules.png")
    _matchers(tables, out / "matchers.png")


def _threshold(tables: Mapping[str, Any], path: Path) -> None:
    """False alarms and missed detections against the threshold; S5 figure 8."""
    environments = tables["environments"]
    figure = new_figure(4.2 * len(environments), 3.4)
    for axes, (name, env) in zip(
        np.atleast_1d(figure.subplots(1, len(environments))), environments.items(), strict=True
    ):
        sweep = env["of"][MAIN]["sweep"]
        points = max(sweep["points"], 1)
        for key, colour, label in (("false_alarms", PL_COLOUR, "FAR"), ("missed", LIMIT_COLOUR, "MDR")):
            axes.plot(np.arange(len(sweep[key])), 100.0 * np.array(sweep[key]) / points, color=colour, label=label)
        axes.axvline(S5_THRESHOLD, color=INK, linewidth=0.8, linestyle=":", label="71 (S5)")
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_ylim(0.0, 100.0)
        tidy(axes, title=name, xlabel="threshold of the score", ylabel="share of points [%]")
        legend(axes)
    save(figure, path)


def _rules(tables: Mapping[str, Any], path: Path) -> None:
    """Warned of right points against wrong points not warned of."""
    figure = new_figure(6.0, 4.6)
    axes = figure.subplots()
    for colour, (name, env) in zip(COLOURS, tables["environments"].items(), strict=False):
        axes.plot([], [], "o", color=colour, label=name)
        names: dict[tuple[int, int], list[str]] = {}
        for rule in RULES:
            p = env["of"][MAIN]["rules"][rule]["pooled"]
            if p["per_right"] is not None and p["per_wrong"] is not None:
                at = round(50.0 * p["per_right"]), round(50.0 * p["per_wrong"])  # rules within 2 % share a label
                names.setdefault(at, []).append(rule)
                axes.plot(100.0 * p["per_right"], 100.0 * p["per_wrong"], "o", color=colour, markersize=5)
        for (x, y), rules in names.items():
            axes.annotate(
                "\n".join(rules), (2.0 * x, 2.0 * y), fontsize=5.5, xytext=(5, -4), textcoords="offset points",
                color=colour, va="top",
            )  # fmt: skip
    tidy(axes, title="Rules of warning", xlabel="right points warned of [%]", ylabel="wrong points not warned of [%]")
    legend(axes)
    save(figure, path)


def _matchers(tables: Mapping[str, Any], path: Path) -> None:
    """Share of right links of each matcher with both maps."""
    environments = tables["environments"]
    figure = new_figure(3.2 * len(environments), 3.4)
    for axes, (name, env) in zip(
        np.atleast_1d(figure.subplots(1, len(environments))), environments.items(), strict=True
    ):
        keys = list(env["of"])
        middle, low, high = 100.0 * np.array([env["of"][key]["right"] for key in keys]).T
        at = np.arange(len(keys))
        axes.bar(at, middle, color=[COLOURS[k % 3] for k in at])
        axes.errorbar(at, middle, yerr=[middle - low, high - middle], fmt="none", ecolor=INK, linewidth=0.8)
        axes.set_xticks(at, [key.replace(", ", "\n").replace("_", "\n") for key in keys], fontsize=6)
        tidy(axes, title=name, ylabel="right link [%]")
        axes.set_ylim(max(0.0, float(low.min()) - 5.0), 100.0)
    save(figure, path)
