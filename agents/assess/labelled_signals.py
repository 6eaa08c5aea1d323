"""Errors of code and Doppler by path: signals with a direct ray, and signals whose direct ray is blocked.

Signals of one satellite are not independent: intervals of recorded quantiles are by resampling satellites.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.assess.signal_residuals import SignalResiduals
from lanebound.integrity.assessment.plotting import legend, new_figure, tidy
from lanebound.integrity.core.streams import named_generator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["compare_paths", "path_rows", "paths_figure"]

Array = NDArray[np.float64]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

PATHS = {"direct": 0, "blocked": 1}  # values of SignalResiduals.blocked
OBSERVABLES = {"code_m": ("code", "m"), "rate_mps": ("Doppler", "m/s")}
QUANTILES = (0.5, 0.75, 0.9, 0.95)
SHARES = np.linspace(0.005, 0.995, 199)  # of signals, in the figure
RESAMPLES, CONFIDENCE = 2000, 0.95
COLOURS = {"direct": "#009E73", "blocked": "#D55E00"}


def compare_paths(recorded: SignalResiduals, simulated: SignalResiduals) -> list[dict[str, Any]]:
    """Quantiles of absolute residuals of each observable and path, recorded with intervals by satellite."""
    rows = []
    for name in OBSERVABLES:
        for path in PATHS:
            theirs, satellite = _of(recorded, name, path), recorded.satellite[_rows(recorded, name, path)]
            ours = _of(simulated, name, path)
            low, high = _by_satellite(theirs, satellite)
            rows.append({
                "observable": name, "path": path, "signals": len(theirs), "satellites": len(np.unique(satellite)),
                "recorded": _quantiles(theirs), "low": low, "high": high, "simulated": _quantiles(ours),
                "simulated_signals": len(ours),
            })  # fmt: skip
    return rows


def _rows(signals: SignalResiduals, name: str, path: str) -> NDArray[np.bool_]:
    return np.asarray((signals.blocked == PATHS[path]) & np.isfinite(getattr(signals, name)))


def _of(signals: SignalResiduals, name: str, path: str) -> Array:
    """Absolute residuals of an observable and a path."""
    return np.asarray(np.abs(getattr(signals, name)[_rows(signals, name, path)]))


def _quantiles(values: Array) -> list[float] | None:
    return [float(q) for q in np.quantile(values, QUANTILES)] if values.size else None


def _by_satellite(values: Array, satellite: NDArray[np.int64]) -> tuple[list[float] | None, list[float] | None]:
    """Interval of each quantile by resampling satellites; None with fewer than two."""
    groups = [values[satellite == one] for one in np.unique(satellite)]
    if len(groups) < 2:
        return None, None
    drawn = named_generator(0, "resamples").integers(len(groups), size=(RESAMPLES, len(groups)))
    found = np.array([np.quantile(np.concatenate([groups[k] for k in row]), QUANTILES) for row in drawn])
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(found, (tail, 1.0 - tail), axis=0)
    return low.tolist(), high.tolist()


def path_rows(result: Mapping[str, Any]) -> Table:
    """Recorded quantiles with intervals, and simulated ones, by observable and path."""
    rows = []
    for one in result["paths"]:
        observable, unit = OBSERVABLES[one["observable"]]
        cells = []
        for k in range(len(QUANTILES)):
            text = "-" if one["recorded"] is None else f"{one['recorded'][k]:.2g}"
            band = "" if one["low"] is None else f" [{one['low'][k]:.2g}, {one['high'][k]:.2g}]"
            ours = "-" if one["simulated"] is None else f"{one['simulated'][k]:.2g}"
            cells.append(f"{text}{band}; {ours}")
        rows.append((f"{observable} [{unit}]", one["path"], f"{one['signals']} of {one['satellites']}", *cells))
    heads = "observable", "direct ray", "signals, satellites", *(f"{100 * q:g} %" for q in QUANTILES)
    return heads, rows


def paths_figure(recorded: SignalResiduals, simulated: SignalResiduals) -> Figure:
    """Distributions of absolute residuals by path: recorded drawn through, simulated dashed."""
    figure = new_figure(8.0, 3.2)
    for axes, (name, (observable, unit)) in zip(figure.subplots(1, 2), OBSERVABLES.items(), strict=True):
        for path, colour in COLOURS.items():
            for what, signals, line in (("recorded", recorded, "-"), ("simulated", simulated, "--")):
                values = _of(signals, name, path)
                if values.size:
                    label = f"direct ray {path}" if path == "blocked" else "direct ray received"
                    axes.plot(np.quantile(values, SHARES), SHARES, line, color=colour, label=f"{label}, {what}")
        axes.set_xscale("log")
        axes.set_ylim(0.0, 1.0)
        tidy(axes, xlabel=f"absolute error of {observable} [{unit}]", ylabel="share of signals below")
        legend(axes, fontsize=7)
    return figure
