"""Fit code errors of a drive, recorded or simulated, to classes of C/N0, elevation and path; save them as a preset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from lanebound.agents.studies.monitored_drives import simulated_epochs
from lanebound.agents.studies.street_drives import StreetDrivesConfig
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.error_classes import ErrorClasses, ErrorLaw, FittedErrors
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.laws import (
    NormalMixture,
    fit_jumps,
    fit_mixture,
    fit_normal,
    fit_pareto,
    fit_rayleigh,
)
from lanebound.integrity.monitoring.family.overbounds import BoundForm, ErrorSides, overbound
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.code_epochs import TrackedEpochs, recorded_epochs

__all__ = ["FitErrorsConfig", "FittedErrors", "class_rows", "code_errors_of", "fit_errors", "law_rows", "write_preset"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STRONG_DBHZ = 42.0
ENOUGH_STRONG = 3
RISKS = (1e-1, 1e-2, 1e-3)


class FitErrorsConfig(Config):
    """Which part is fitted, and how."""

    training_share: float = Field(0.4, gt=0, le=1, description="first part of a recorded drive that is fitted [-]")
    streets: int = Field(4, ge=1, description="streets that are fitted under a sky")
    form: BoundForm = Field(BoundForm.TAIL, description="what of the errors' law is bounded")
    sides: ErrorSides = Field(ErrorSides.BOTH, description="sides bounded; reflections are late")
    centred: bool = Field(True, description="bound about the median, which is subtracted from codes")
    cn0_edges_dbhz: tuple[float, ...] = Field(
        (0.0, 28.0, 33.0, 38.0, 43.0, 60.0), min_length=2, description="edges of classes of C/N0 [dB-Hz]"
    )
    elevation_edges_deg: tuple[float, ...] = Field(
        (0.0, 20.0, 40.0, 90.0), min_length=2, description="edges of classes of elevation [deg]"
    )
    fewest: int = Field(60, ge=10, description="errors of a class; with fewer it has the law of its C/N0, or of all")
    drives: StreetDrivesConfig = StreetDrivesConfig(vehicles=8, duration_s=60.0, seed=1001)


def fit_errors(dataset: Path | None, sky: str | None, config: FitErrorsConfig) -> tuple[FittedErrors, dict[str, Any]]:
    """Classes and position laws of a data set or of simulated streets, and how well laws of all errors fit.

    Raises
    ------
    InputError
        Neither or both are given, or there are too few errors.
    """
    if (dataset is None) == (sky is None):
        raise InputError("fit-errors must have a DATASET or --sky, got both or none: name one")
    if dataset is not None:
        tracked = _first_part(recorded_epochs(read_city(dataset)), config.training_share)
        parts, source = [tracked], f"first {config.training_share:g} of {dataset.name}"
    else:
        assert sky is not None
        parts = [simulated_epochs(config.drives, sky, k) for k in range(config.streets)]
        source = f"{config.streets} simulated streets under {sky}, seed {config.drives.seed}"
    found = [(*code_errors_of(part), part.epochs) for part in parts]
    error = np.concatenate([e[ok] for e, ok, _ in found])
    cn0, elevation = (np.concatenate([getattr(p, name)[ok] for _, ok, p in found]) for name in FIELDS)
    mapped = all(p.shadowed is not None for _, _, p in found)
    path = np.concatenate([p.shadowed[ok] for _, ok, p in found if p.shadowed is not None]) if mapped else None
    method = f"{config.form.value} overbound of {config.sides.value} sides; {error.size} errors of lanebound fit-errors"
    classes = _classes(error, cn0, elevation, path, config, f"{source}; {method}")
    fitted = FittedErrors.load({"classes": classes.to_dict(), **_position_laws(parts)})
    return fitted, {"errors": int(error.size), "laws": _laws(error)}


FIELDS = ("cn0_dbhz", "elevation_rad")


def _first_part(tracked: TrackedEpochs, share: float) -> TrackedEpochs:
    time = tracked.epochs.time_s
    own = time < time[0] + share * (time[-1] - time[0])
    return TrackedEpochs(tracked.epochs.take(own), tracked.truth_enu_m[own], tracked.known[own])


def code_errors_of(tracked: TrackedEpochs) -> tuple[Array, Bools]:
    """Errors of codes (E, m) [m] with known truth, and where they are known.

    The clock of each epoch is the median of strong codes less the offset of their system, the offset the median over
    the drive of each receiver. What strong codes have in common counts as clock.
    """
    e = tracked.epochs
    known = e.used & tracked.known[:, None]
    error = np.zeros(e.y_m.shape)
    for drive in np.unique(e.drive):  # each receiver has a clock of its own
        own = e.drive == drive
        error[own] = _errors_of_drive(e.take(own), tracked.truth_enu_m[own], known[own])
    return error, known


def _errors_of_drive(e: CodeEpochs, truth_enu_m: Array, known: Bools) -> Array:
    """Errors of the codes of one receiver, 0 where not known.  (E, m) [m]."""
    away = e.y_m + (e.los_enu @ truth_enu_m[..., None])[..., 0]
    strong = known & (e.cn0_dbhz >= STRONG_DBHZ)
    strong = np.where((strong.sum(-1) < ENOUGH_STRONG)[:, None], known, strong)
    offset = np.zeros(e.y_m.shape[1])
    for _ in range(3):
        clock = _median(np.where(strong, away - offset, np.nan))
        for system in np.unique(e.system):
            own = e.system == system
            values = (away - clock[:, None])[:, own][strong[:, own]]
            offset[own] = np.median(values) if values.size else 0.0
    return np.where(known, away - offset - clock[:, None], 0.0)


def _median(values: Array) -> Array:
    out = np.zeros(len(values))
    some = np.isfinite(values).any(-1)
    out[some] = np.nanmedian(values[some], -1)
    return out


def _classes(
    error: Array, cn0: Array, elevation: Array, path: Bools | None, config: FitErrorsConfig, source: str
) -> ErrorClasses:
    """The law of each class; with few errors that of its C/N0 class, and then that of all."""
    paths = ("any",) if path is None else ("direct", "shadowed")
    shape = len(config.cn0_edges_dbhz) - 1, len(config.elevation_edges_deg) - 1, len(paths)
    blank = {
        "source": source, "cn0_edges_dbhz": config.cn0_edges_dbhz, "elevation_edges_deg": config.elevation_edges_deg,
        "paths": paths, "sides": config.sides.value,
    }  # fmt: skip
    table = ErrorClasses.load({**blank, "laws": [{"sigma_m": 1.0}] * int(np.prod(shape))})
    index = np.array(np.unravel_index(table.index(cn0, elevation, path), shape))
    laws = []
    for c in np.ndindex(shape):
        same = index == np.array(c)[:, None]
        own = next(
            (mask for mask in (same.all(0), same[0] & same[2], same[0]) if mask.sum() >= config.fewest),
            np.ones(error.size, bool),
        )
        laws.append(_law(error[own], int(same.all(0).sum()), config))
    return ErrorClasses.load({**blank, "laws": laws})


def _law(error: Array, count: int, config: FitErrorsConfig) -> dict[str, Any]:
    found = overbound(error, config.form, config.sides, centred=config.centred)
    centre, sigma, bias = (round(float(v), 3) for v in (found.centre_m, found.sigma_m, found.bias_m))
    return ErrorLaw(count=count, centre_m=centre, sigma_m=max(sigma, 1e-3), bias_m=bias).to_dict()


def _position_laws(parts: Sequence[TrackedEpochs]) -> dict[str, float]:
    """Rayleigh and Pareto laws of the horizontal error over the deviation stated for the codes."""
    ratios = []
    for part in parts:
        fit = solve_codes(part.epochs)
        own = fit.solved & part.known
        away = np.hypot(*(fit.x_m - part.truth_enu_m)[own, :2].T)
        ratios.append(away / fit.major_m[own])
    ratio = np.concatenate(ratios)
    tail = fit_pareto(ratio)
    values = {
        "rayleigh_factor": fit_rayleigh(ratio), "pareto_threshold": tail.threshold, "pareto_share": tail.share,
        "pareto_scale": tail.scale, "pareto_shape": tail.shape,
    }  # fmt: skip
    return {name: round(value, 4) for name, value in values.items()}


def _laws(error: Array) -> dict[str, Any]:
    """Criterion and quantiles of each law of all errors, next to the errors themselves."""
    laws = {"normal": fit_normal(error), "mean and variance jump": fit_jumps(error), "mixture": fit_mixture(error)}
    process = dirichlet_mixture(error)
    laws |= {} if process is None else {"dirichlet process": process}
    rows = {
        name: {"parts": int(law.share.size), "criterion": law.criterion(error),
               "quantiles_m": [law.quantile_m(risk) for risk in RISKS]}
        for name, law in laws.items()
    }  # fmt: skip
    rows["errors"] = {
        "parts": 0,
        "criterion": None,
        "quantiles_m": np.quantile(np.abs(error), [1 - r for r in RISKS]).tolist(),
    }
    return rows


def dirichlet_mixture(error_m: Array) -> NormalMixture | None:
    """Dirichlet-process mixture by variational Bayes; None without scikit-learn, which is an optional package."""
    try:
        from sklearn.mixture import BayesianGaussianMixture
    except ImportError:
        return None
    model = BayesianGaussianMixture(
        n_components=8, weight_concentration_prior_type="dirichlet_process", random_state=0, max_iter=5000,
        tol=1e-3,
    )  # fmt: skip
    model.fit(error_m[:, None])
    kept = model.weights_ > 1e-3
    share = model.weights_[kept] / model.weights_[kept].sum()
    sigma = np.sqrt(model.covariances_[kept, 0, 0])
    return NormalMixture(share, model.means_[kept, 0], sigma, 3 * int(kept.sum()) - 1)


def write_preset(path: Path, fitted: FittedErrors) -> None:
    """The preset as YAML."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump({"kind": "fitted_errors", **fitted.to_dict()}, sort_keys=False), encoding="utf-8")


Table = tuple[tuple[str, ...], list[tuple[Any, ...]]]


def class_rows(classes: ErrorClasses) -> Table:
    """One row for each class."""
    rows: list[tuple[Any, ...]] = []
    c, e = classes.cn0_edges_dbhz, classes.elevation_edges_deg
    for (i, j, k), law in zip(np.ndindex(len(c) - 1, len(e) - 1, len(classes.paths)), classes.laws, strict=True):
        span = f"{c[i]:g} to {c[i + 1]:g}", f"{e[j]:g} to {e[j + 1]:g}", classes.paths[k]
        rows.append((*span, law.count, law.centre_m, law.sigma_m, law.bias_m))
    return ("C/N0 [dB-Hz]", "elevation [deg]", "path", "errors", "centre [m]", "sigma [m]", "bias [m]"), rows


def law_rows(result: Mapping[str, Any]) -> Table:
    """One row for each law of all errors."""
    rows = [
        (name, law["parts"] or "-", law["criterion"], *(round(q, 2) for q in law["quantiles_m"]))
        for name, law in result["laws"].items()
    ]
    return ("law", "parts", "BIC", *(f"beyond at {risk:g} [m]" for risk in RISKS)), rows
