"""Whether protection levels say more about large errors than positioning mode and age of RTK, by sky.

Each second of each vehicle is a sample: mode, time since the last RTK position, level across the track and error across
the track. Two models of one form predict whether the error is large, one from mode and age, the other from mode, age
and level. The area under the ROC curve (AUC) of predictions for streets that the model has not seen compares them. A
third model predicts the logarithm of the level from mode and age; its R^2 says how much of a level is a clock.

The models are piecewise (bi)linear in the logarithms of age and level (tensor products of linear B-splines), one for
each mode, fitted by ridge regression: logistic for the error, least squares for the level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.studies.street_drives import PACKAGES, DriveMoment, StreetDrivesConfig, drive_street, work_streets
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["InformativenessConfig", "assess_informativeness", "auc_figure", "informativeness_rows", "work_street"]

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


Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

SAMPLE_S = 1.0  # between samples of a vehicle
LONGEST_S = 1e4  # in place of the age of an RTK position that never was
RESAMPLES, CONFIDENCE = 2000, 0.95
AGE_KNOTS, LEVEL_KNOTS = 6, 6  # at quantiles of the streets that are fitted
RIDGE = 1.0  # penalty of a squared coefficient, in samples
NEWTON_STEPS, LONGEST_STEP, SETTLED = 30, 5.0, 1e-4


class InformativenessConfig(StreetDrivesConfig):
    """Drives, and the error that is to be predicted."""

    skies: tuple[str, ...] = Field(
        ("urban", "dense", "skies/plaza"), min_length=1, description="levels of sky, with their instruments"
    )
    streets: int = Field(12, ge=2, description="streets of each sky; each is predicted from all others")
    error_m: float = Field(0.3, gt=0, description="errors across the track above this value are to be predicted [m]")


def assess_informativeness(
    config: InformativenessConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing streets, and write ``results.json`` and ``informativeness.svg``; returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    ResultFolder(out, "informativeness of levels", config.to_dict(), code_digest(*PACKAGES)).claim()
    found = work_streets(config, config.streets, work_street, out, jobs, on_progress)
    cells = [{"sky": sky} | compare(streets, config.error_m) for sky, streets in found.items()]
    result = {"config": config.to_dict(), "cells": cells}
    write_json(out / "results.json", result)
    save(auc_figure(cells), out / "informativeness.svg")
    return result


def work_street(config: InformativenessConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Samples of one street; they do not depend on others."""
    every, found = round(SAMPLE_S / config.navigator.dt_s), []
    for k, moment in enumerate(drive_street(config, sky, number, advance)):
        if k % every == 0:
            found.append(_sample(moment))
    columns = np.concatenate(found).T
    return {name: column.tolist() for name, column in zip(("mode", "age_s", "pl_m", "error_m"), columns, strict=True)}


def _sample(moment: DriveMoment) -> Array:
    """Mode, age [s], level and absolute error across the track [m] of the vehicles that have a level, (n, 4)."""
    s = moment.solution
    rows = np.column_stack([s.mode, np.minimum(s.since_rtk_s, LONGEST_S), s.pl_ct_m, np.abs(moment.error_m[:, 1])])
    return np.asarray(np.round(rows[(s.mode != Mode.NONE) & np.isfinite(s.pl_ct_m)], 4))


def compare(streets: Sequence[Mapping[str, Any]], error_m: float) -> dict[str, Any]:
    """AUC of both models, their difference, and R^2 of the logarithm of the level, each with its interval by street.

    ``streets`` are the data of parts. A figure is None where it is not defined: no error, or every one, is large.
    """
    columns = {key: np.concatenate([np.asarray(s[key], float) for s in streets]) for key in streets[0]}
    street = np.repeat(np.arange(len(streets)), [len(s["mode"]) for s in streets])
    large, level = columns["error_m"] > error_m, np.log(columns["pl_m"])
    age = np.log1p(columns["age_s"])
    clock, whole, foretold = np.zeros((3, street.size))
    for held in np.unique(street):
        for mode in np.unique(columns["mode"]):
            own = columns["mode"] == mode
            fitted, asked = own & (street != held), own & (street == held)
            if not asked.any():
                continue
            if not fitted.any():
                fitted = street != held  # a mode that no other street has
            for scores, knots in ((clock, 1), (whole, LEVEL_KNOTS)):
                basis = _Basis(age[fitted], level[fitted], knots)
                known, new = basis.at(age[fitted], level[fitted]), basis.at(age[asked], level[asked])
                scores[asked] = new @ fit_logistic(known, large[fitted])
                if knots == 1:
                    foretold[asked] = new @ fit_linear(known, level[fitted])
    chosen = named_generator(0, "resamples").integers(len(streets), size=(RESAMPLES, len(streets)))
    weight = np.stack([np.bincount(row, minlength=len(streets)) for row in chosen]).astype(float)
    every = np.concatenate([np.ones((1, len(streets))), weight])
    aucs = [_weighted_auc(scores, large, street, every) for scores in (clock, whole)]
    return {
        "samples": int(street.size),
        "streets": len(streets),
        "large": float(large.mean()),
        "auc_clock": _interval(aucs[0]),
        "auc_level": _interval(aucs[1]),
        "gain": _interval(aucs[1] - aucs[0]),
        "r2": _interval(_weighted_r2(foretold, level, street, every)),
    }


class _Basis:
    """Columns of a model: an intercept, and products of hat functions of age and level with knots at their quantiles.

    With one level knot the level does not enter.
    """

    def __init__(self, age: Array, level: Array, level_knots: int) -> None:
        self._age, self._level = _knots(age, AGE_KNOTS), _knots(level, level_knots)

    def at(self, age: Array, level: Array) -> Array:
        """The columns (n, k) of samples."""
        products = _hats(age, self._age)[:, :, None] * _hats(level, self._level)[:, None, :]
        return np.concatenate([np.ones((age.size, 1)), products.reshape(age.size, -1)], 1)


def _knots(values: Array, count: int) -> Array:
    """Distinct quantiles of values."""
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, count) if count > 1 else [0.5]))


def _hats(values: Array, knots: Array) -> Array:
    """Linear B-splines (n, K), whose sum is 1; constant beyond the knots."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(knots.size)], -1)


def _penalty(columns: Array) -> Array:
    """The ridge, without the intercept."""
    ridge = np.full(columns.shape[1], RIDGE)
    ridge[0] = 1e-6
    return ridge


def fit_linear(columns: Array, target: Array) -> Array:
    """Coefficients of ridge regression."""
    return np.asarray(np.linalg.solve(columns.T @ columns + np.diag(_penalty(columns)), columns.T @ target))


def fit_logistic(columns: Array, target: Bools) -> Array:
    """Coefficients of ridge-penalised logistic regression, by Newton's method."""
    ridge, x = _penalty(columns), np.zeros(columns.shape[1])
    for _ in range(NEWTON_STEPS):
        p = expit(columns @ x)
        slope = columns.T @ (target - p) - ridge * x
        step = np.linalg.solve((columns * (p * (1.0 - p))[:, None]).T @ columns + np.diag(ridge), slope)
        x += np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        if np.abs(step).max() < SETTLED:
            break
    return x


def _weighted_auc(scores: Array, large: Bools, street: NDArray[np.int64], weight: Array) -> Array:
    """AUC with each street counted ``weight`` (R, streets) times, (R,); NaN where it is not defined.

    ``sum_ij w_i w_j U_ij / (sum_i w_i P_i sum_j w_j N_j)``: U_ij pairs of a large error in street i and another one in
    street j that the scores order correctly, ties half; P_i and N_j numbers of both.
    """
    count = weight.shape[1]
    large_of, other_of = ([np.sort(scores[(street == i) & which]) for i in range(count)] for which in (large, ~large))
    pairs = np.array([
        [0.5 * sum(np.searchsorted(n, p, side).sum() for side in ("left", "right")) for n in other_of] for p in large_of
    ])  # fmt: skip
    of = (weight @ [p.size for p in large_of]) * (weight @ [n.size for n in other_of])
    ordered = np.einsum("ri,ij,rj->r", weight, pairs, weight)
    return np.asarray(np.divide(ordered, of, out=np.full(of.shape, np.nan), where=of > 0.0))


def _weighted_r2(foretold: Array, value: Array, street: NDArray[np.int64], weight: Array) -> Array:
    """``1 - sum (v - f)^2 / sum (v - mean)^2`` with each street counted ``weight`` (R, streets) times.  (R,)."""
    number, first, second, left = (
        weight @ np.bincount(street, values, weight.shape[1])
        for values in (np.ones(value.size), value, value**2, (value - foretold) ** 2)
    )
    return np.asarray(1.0 - left / (second - first**2 / number))


def _interval(values: Array) -> dict[str, float | None]:
    """The first value, and the interval of the others; None where they are not defined."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    defined = values[1:][np.isfinite(values[1:])]
    if not np.isfinite(values[0]) or not defined.size:
        return {"value": None, "low": None, "high": None}
    low, high = np.quantile(defined, (tail, 1.0 - tail))
    return {"value": float(values[0]), "low": float(low), "high": float(high)}


def informativeness_rows(result: Mapping[str, Any]) -> Table:
    """Share of large errors, AUC without and with the level, their difference, and R^2, by sky."""
    rows = [
        (
            cell["sky"], f"{cell['samples']:,}", f"{100.0 * cell['large']:.1f} %",
            *(_cell(cell[key]) for key in ("auc_clock", "auc_level", "gain", "r2")),
        )
        for cell in result["cells"]
    ]  # fmt: skip
    heads = "sky", "samples", "large", "AUC: mode, age", "and level", "gain", "R^2 of log PL"
    return heads, rows


def _cell(found: Mapping[str, float | None]) -> str:
    if found["value"] is None:
        return "-"
    return f"{found['value']:.3f} [{found['low']:.3f}, {found['high']:.3f}]"
