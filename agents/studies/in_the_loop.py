"""How often errors exceed their levels in drives of the whole navigator, and whether levels say more than mode and age.

Rates are by sky, mode and risk. Vehicles of one street share its city, its satellites and its faults, so that the
spread between streets limits the accuracy of a rate: its interval is that of the mean over streets, by resampling whole
streets. Where no street has an exceedance, the interval is the exact one of the share of streets that have any.

What a level says of large errors beyond the mode and the age of RTK, by sky: each second of each vehicle is a sample:
mode, time since the last RTK position, level across the track and error across the track. Two models of one form
predict whether the error is large, one from mode and age, the other from mode, age and level. The area under the ROC
curve (AUC) of predictions for streets that the model has not seen compares them. A third model predicts the logarithm
of the level from mode and age; its R^2 says how much of a level is a clock.

The models are piecewise (bi)linear in the logarithms of age and level (tensor products of linear B-splines), one for
each mode, fitted by ridge regression: logistic for the error, least squares for the level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.street_drives import DriveMoment, StreetDrivesConfig, drive_street, work_streets
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.splines import KNOTS, Basis, fit_linear, fit_logistic
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.modes import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

AXES = ("along", "across")
RESAMPLES, CONFIDENCE = 2000, 0.95
SAMPLE_S = 1.0  # between the levels that medians are taken of
NO_LEVEL_M = 1e4  # in place of a missing level, for quantiles
NEAR_M = 7.0  # a trust level below it (S4 section III-E)
FEW_STREETS = 30  # fewer say little of a rate: where none has an event, 1 in 9 of all streets may have one


class InTheLoopConfig(StreetDrivesConfig):
    """Drives, and the risks at which exceedances are counted."""

    risks: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = Field(
        (1e-3, 1e-4, 1e-5), min_length=1, description="total horizontal risks counted [-]"
    )
    epochs: int = Field(1_000_000, ge=1, description="epochs under each sky, rounded up to whole streets")

    @property
    def epochs_of_street(self) -> int:
        """Number of epochs of a street, of all its vehicles."""
        return self.vehicles * round(self.duration_s / self.navigator.dt_s)

    @property
    def streets(self) -> int:
        """Number of streets of each sky."""
        return -(-self.epochs // self.epochs_of_street)

    @property
    def rounding(self) -> str:
        """What is driven under each sky where the epochs are not those of whole streets; "" where they are."""
        if self.epochs == self.streets * self.epochs_of_street:
            return ""
        return (
            f"{self.epochs:,} epochs under each sky are rounded up to whole streets: {self.streets} of "
            f"{self.epochs_of_street:,} epochs each"
        )

    def with_levels(self) -> InTheLoopConfig:
        """The same with further protection levels at all the risks; the operative one stays that of the navigator."""
        more = [{"integrity_risk": risk} for risk in self.risks]
        return self.replace(navigator=self.navigator.replace(more_levels=more).to_dict())


def assess_in_the_loop(
    config: InTheLoopConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing streets, and write ``results.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    found = work_streets(config, "bounding in the loop", config.streets, work_street, out, jobs, on_progress)
    skies = {sky: _summary(config, streets) for sky, streets in found.items()}
    return stored({"config": config.to_dict(), "skies": skies}, out)


def work_street(config: InTheLoopConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Drive one street; it does not depend on others."""
    tally, sampled = _Tally(config), []
    every = round(SAMPLE_S / config.navigator.dt_s)
    for k, moment in enumerate(drive_street(config.with_levels(), sky, number, advance)):
        tally.count(moment)
        if k % every == 0:
            sampled.append(_sample(moment))
    return tally.counts() | {"samples": np.concatenate(sampled).T.tolist()}


class _Tally:
    """Counts of a street by mode: epochs, exceedances by risk and axis, usable and misleading epochs.

    Of the trust level of a filter: epochs with one, with a horizontal error beyond it, with one below NEAR_M. Of the
    SBAS level of its positions: epochs with one, with an error of the filter beyond it, and their sum [m].
    """

    def __init__(self, config: InTheLoopConfig) -> None:
        modes, risks = max(Mode) + 1, len(config.risks)
        self.epochs, self.usable, self.misleading = np.zeros((3, modes), dtype=np.int64)
        self.exceed = np.zeros((modes, risks, 2), dtype=np.int64)
        self.trust, self.sbas = np.zeros(3, dtype=np.int64), np.zeros(3)

    def count(self, moment: DriveMoment) -> None:
        """Add an epoch."""
        s = moment.solution
        beyond = np.abs(moment.error_m)[:, None, :] > s.pl_cases_m
        np.add.at(self.epochs, s.mode, 1)
        np.add.at(self.exceed, s.mode, beyond[:, 1:])
        np.add.at(self.usable, s.mode, s.available & ~s.alert)
        np.add.at(self.misleading, s.mode, s.available & ~s.alert & beyond[:, 0].any(-1))
        off, there = np.linalg.norm(moment.error_m, axis=-1), np.isfinite(s.trust_m) & np.isfinite(s.pl_at_m)
        self.trust += [there.sum(), (there & (off > s.trust_m)).sum(), (there & (s.trust_m < NEAR_M)).sum()]
        both = there & np.isfinite(s.hpl_sbas_m)
        self.sbas += [both.sum(), (both & (off > s.hpl_sbas_m)).sum(), s.hpl_sbas_m[both].sum()]

    def counts(self) -> dict[str, Any]:
        """The counts as plain data."""
        return {
            "epochs": self.epochs.tolist(),
            "usable": self.usable.tolist(),
            "misleading": self.misleading.tolist(),
            "exceed": self.exceed.tolist(),
            "trust": self.trust.tolist(),
            "sbas": self.sbas.tolist(),
        }


def _sample(moment: DriveMoment) -> NDArray[np.float64]:
    """Mode and levels [m] at the operative risk of B vehicles, (B, 3), rounded to a tenth of a millimetre."""
    s = moment.solution
    levels = np.minimum(np.stack([s.pl_at_m, s.pl_ct_m], -1), NO_LEVEL_M)
    return np.round(np.column_stack([s.mode, levels]), 4)


def _summary(config: InTheLoopConfig, streets: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates, modes and medians of a sky."""
    epochs = np.array([street["epochs"] for street in streets])
    exceed = np.array([street["exceed"] for street in streets])
    mode, along, across = np.concatenate([np.array(street["samples"]).T for street in streets]).T
    found = {
        "streets": len(streets),
        "epochs": int(epochs.sum()),
        "usable": float(sum(sum(street["usable"]) for street in streets) / epochs.sum()),
        "misleading": rate_by_street(np.array([sum(street["misleading"]) for street in streets]), epochs.sum(1)),
        "level_m": [float(np.median(along)), float(np.median(across))],
        "rates": {
            f"{risk:g}": {axis: rate_by_street(exceed[:, :, r, a].sum(1), epochs.sum(1)) for a, axis in enumerate(AXES)}
            for r, risk in enumerate(config.risks)
        },
    }
    with_trust, beyond, near = np.array([street["trust"] for street in streets]).T
    if with_trust.any():
        found["trust"] = rate_by_street(beyond, with_trust) | {
            "epochs": int(with_trust.sum()), "below": float(near.sum() / with_trust.sum()),
        }  # fmt: skip
    with_sbas, outside, total = np.array([street["sbas"] for street in streets]).sum(0)
    if with_sbas:
        found["sbas"] = {"epochs": int(with_sbas), "beyond": float(outside / with_sbas), "mean_m": total / with_sbas}
    return found | {"modes": _modes(epochs, exceed, mode, along, across)}


def _modes(epochs: Any, exceed: Any, mode: Any, along: Any, across: Any) -> dict[str, Any]:
    """Share, median operative levels, and rates at the first risk, by mode."""
    return {
        m.name.lower(): {
            "share": float(epochs[:, m].sum() / epochs.sum()),
            "level_m": [float(np.median(level[mode == m])) if (mode == m).any() else None for level in (along, across)],
            "rates": {axis: rate_by_street(exceed[:, m, 0, a], epochs[:, m]) for a, axis in enumerate(AXES)},
        }
        for m in Mode
        if epochs[:, m].any()
    }


def rate_by_street(events: NDArray[np.int64], epochs: NDArray[np.int64]) -> dict[str, Any]:
    """Rate of events per epoch with its interval by street; streets with an event, and the interval of their share."""
    streets, total = int((events > 0).sum()), int(events.sum())
    low, high = clopper_pearson(streets, len(events), CONFIDENCE)
    found: dict[str, Any] = {
        "events": total,
        "rate": total / max(int(epochs.sum()), 1),
        "streets": streets,
        "streets_low": low,
        "streets_high": high,
        "low": None,
        "high": None,
    }
    if streets > 1:
        chosen = named_generator(0, "resamples").integers(len(events), size=(RESAMPLES, len(events)))
        rates = events[chosen].sum(1) / np.maximum(epochs[chosen].sum(1), 1)
        tail = 0.5 * (1.0 - CONFIDENCE)
        found["low"], found["high"] = (float(q) for q in np.quantile(rates, (tail, 1.0 - tail)))
    return found


def exceedance_rows(result: Mapping[str, Any]) -> Table:
    """Rate over the risk by sky, axis and risk, with streets that have any."""
    rows = []
    for sky, found in result["skies"].items():
        streets = found["streets"]
        for axis in AXES:
            cells = [rate_cell(rates[axis], float(risk), streets) for risk, rates in found["rates"].items()]
            rows.append((sky, axis, f"{found['epochs']:,}", *cells))
    risks = next(iter(result["skies"].values()))["rates"]
    return ("sky", "axis", "epochs", *(f"at {risk}" for risk in risks)), rows


def shown_in_the_loop(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables of the drives, and what they say."""
    yield "In the loop: rate of errors beyond the level over the risk, 95 % by street", exceedance_rows(result)
    risk = f"{result['config']['risks'][0]:g}"
    yield f"Modes, median levels and epochs beyond at {risk}", mode_rows(result)
    yield "Horizontal trust level, 6 sigma of the longer axis (S4 section II-F)", trust_rows(result)
    yield "HPL_SBAS, en route, of the positions by codes (DO-229)", sbas_rows(result)
    yield "A rate over the risk above 1 breaks the promise."
    if any(found["streets"] < FEW_STREETS for found in result["skies"].values()):
        yield f"Fewer than {FEW_STREETS} streets of a sky say little of a rate: give more --epochs."


def rate_cell(rate: Mapping[str, Any], risk: float, streets: int) -> str:
    """Rate of events over the risk with its interval, and in how many of the streets there are any."""
    few, of = streets < FEW_STREETS, f"{streets} street{'' if streets == 1 else 's'}"
    if not rate["events"]:
        return f"none in {of}" + (
            ", too few to tell" if few else f" (share of streets below {rate['streets_high']:.2g})"
        )
    band = "" if rate["low"] is None else f" ({rate['low'] / risk:.3g} .. {rate['high'] / risk:.3g})"
    return f"{rate['rate'] / risk:.3g}{band} in {rate['streets']} of {of}{', few' if few else ''}"


def mode_rows(result: Mapping[str, Any]) -> Table:
    """Share, median levels and exceedances of each mode at the first risk; misleading epochs are usable ones beyond."""
    rows = []
    for sky, found in result["skies"].items():
        everything = {"share": 1.0, "level_m": found["level_m"], "rates": next(iter(found["rates"].values()))}
        for name, mode in ({"all": everything} | found["modes"]).items():
            levels = ["-" if level is None or level >= NO_LEVEL_M else f"{level:.2f} m" for level in mode["level_m"]]
            events = [str(mode["rates"][axis]["events"]) for axis in AXES]
            usable = f"{100.0 * found['usable']:.1f} %" if name == "all" else ""
            misleading = str(found["misleading"]["events"]) if name == "all" else ""
            rows.append((sky, name, f"{100.0 * mode['share']:.1f} %", usable, misleading, *levels, *events))
    heads = "sky", "mode", "epochs", "usable", "misleading", "PL along", "PL across", "beyond along", "beyond across"
    return heads, rows


def trust_rows(result: Mapping[str, Any]) -> Table:
    """S4's horizontal trust level of filters: how often the horizontal error is beyond it; no row without one."""
    rows: list[tuple[str, ...]] = [
        (
            sky,
            f"{t['epochs']:,}",
            f"{t['events']:,} ({t['rate']:.2g})",
            str(t["streets"]),
            f"{100.0 * t['below']:.1f} %",
        )
        for sky, found in result["skies"].items()
        if (t := found.get("trust")) is not None
    ]
    return ("sky", "epochs with one", "errors beyond it (rate)", "in streets", f"below {NEAR_M:g} m"), rows


def sbas_rows(result: Mapping[str, Any]) -> Table:
    """HPL_SBAS of the positions by codes: its mean, and how often the filter's error is beyond it."""
    rows: list[tuple[str, ...]] = [
        (sky, f"{s['epochs']:,}", f"{s['mean_m']:.2f} m", f"{s['beyond']:.2g}")
        for sky, found in result["skies"].items()
        if (s := found.get("sbas")) is not None
    ]
    return ("sky", "epochs with one", "mean", "errors of the filter beyond it"), rows


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


LONGEST_S = 1e4  # in place of the age of an RTK position that never was


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
    found = work_streets(config, "informativeness of levels", config.streets, sample_street, out, jobs, on_progress)
    cells = [{"sky": sky} | compare(streets, config.error_m) for sky, streets in found.items()]
    save(auc_figure(cells), out / "informativeness.svg")
    return stored({"config": config.to_dict(), "cells": cells}, out)


def sample_street(config: InformativenessConfig, sky: str, number: int, advance: Advance = ignore) -> dict[str, Any]:
    """Samples of one street; they do not depend on others."""
    every, found = round(SAMPLE_S / config.navigator.dt_s), []
    for k, moment in enumerate(drive_street(config, sky, number, advance)):
        if k % every == 0:
            found.append(_sample_of(moment))
    columns = np.concatenate(found).T
    return {name: column.tolist() for name, column in zip(("mode", "age_s", "pl_m", "error_m"), columns, strict=True)}


def _sample_of(moment: DriveMoment) -> Array:
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
    clock, whole, predicted = np.zeros((3, street.size))
    for held in np.unique(street):
        for mode in np.unique(columns["mode"]):
            own = columns["mode"] == mode
            fitted, asked = own & (street != held), own & (street == held)
            if not asked.any():
                continue
            if not fitted.any():
                fitted = street != held  # a mode that no other street has
            for scores, knots in ((clock, 1), (whole, KNOTS)):
                basis = Basis(age[fitted], level[fitted], (KNOTS, knots))
                known, new = basis.at(age[fitted], level[fitted]), basis.at(age[asked], level[asked])
                scores[asked] = new @ fit_logistic(known, large[fitted])
                if knots == 1:
                    predicted[asked] = new @ fit_linear(known, level[fitted])
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
        "r2": _interval(_weighted_r2(predicted, level, street, every)),
    }


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


def _weighted_r2(predicted: Array, value: Array, street: NDArray[np.int64], weight: Array) -> Array:
    """``1 - sum (v - f)^2 / sum (v - mean)^2`` with each street counted ``weight`` (R, streets) times.  (R,)."""
    number, first, second, left = (
        weight @ np.bincount(street, values, weight.shape[1])
        for values in (np.ones(value.size), value, value**2, (value - predicted) ** 2)
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


def shown_informativeness(result: Mapping[str, Any]) -> Iterator[Shown]:
    """The table of all skies."""
    error = f"{result['config']['error_m']:g}"
    title = f"Errors across the track above {error} m, foretold for streets held out; 95 % by street"
    yield title, informativeness_rows(result)


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
