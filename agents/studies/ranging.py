"""Recorded UWB ranges against the law of :mod:`lanebound.integrity.sensors.uwb_kernel`.

The recording is the Labyrinth of TU Chemnitz (libRSF, Indoor_UWB): a robot among four fixed modules indoors, with its
true positions. The errors of its ranges have an offset for each module (antenna delays, heights and the lever arm of
the robot, which are not known), a core of noise, and a tail of ranges that are too long. The law is fitted by maximum
likelihood: after the offset o an error is ``N(0, sigma^2)``, and with probability p that plus an exponential of mean m.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import exponnorm, norm

from lanebound.agents.studies.study import Shown, claim, stored
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.uwb import RangingConfig

__all__ = ["fit_law", "read_errors", "run_ranging", "shown"]

Array = NDArray[np.float64]
FILES = "Indoor_UWB_Input.txt", "Indoor_UWB_GT.txt"
PACKAGES = ("lanebound.integrity", "lanebound.agents.studies")
NORMAL_MAD = 1.4826  # of a normal distribution: sigma over the median of absolute deviations
OUTLIER_SIGMAS = 3.0
TAILS = 0.2, 0.1, 0.05, 0.02
LEAST_M, LEAST_SHARE = 1e-3, 1e-4  # of fitted figures


def read_errors(data: Path) -> tuple[NDArray[np.int64], Array, Array]:
    """Module, true distance and error of each range of the recording, (R,) each; the truth is interpolated in time.

    Raises
    ------
    InputError
        A file is missing or is not of this kind.
    """
    for name in FILES:
        if not (data / name).is_file():
            raise InputError(f"data must be a folder with {' and '.join(FILES)}, got {data}: {name} is missing")
    lines = [[line.split() for line in (data / name).read_text().splitlines()] for name in FILES]
    ranges = [line[1:7] for line in lines[0] if line and line[0] == "range2"]
    points = [line[1:4] for line in lines[1] if line and line[0] == "point2"]
    if not ranges or not points:
        raise InputError(f"data must hold lines range2 and point2, got none in {data}: see its readme")
    time_s, measured_m, _, *place, module = np.array(ranges, dtype=np.float64).T
    true_s, *true = np.array(points, dtype=np.float64).T
    x, y = (np.interp(time_s, true_s, axis) for axis in true)
    distance = np.hypot(x - place[0], y - place[1])
    return module.astype(np.int64), distance, measured_m - distance


def tail(x: Array, sigma: float, share: float, mean: float) -> Array:
    """Probability that an error of the law exceeds x."""
    late = exponnorm.sf(x, mean / sigma, scale=sigma)
    return np.asarray((1.0 - share) * norm.sf(x, scale=sigma) + share * late)


def fit_law(errors: Array) -> dict[str, float]:
    """Offset, sigma, share p and mean m of late ranges of errors (R,), by maximum likelihood."""

    def cost(at: Array) -> float:
        offset, sigma, mean = at[0], np.exp(at[1]), np.exp(at[2])
        share, left = 1.0 / (1.0 + np.exp(-at[3])), errors - at[0]
        density = (1.0 - share) * norm.pdf(left, scale=sigma)
        density = density + share * exponnorm.pdf(errors, mean / sigma, loc=offset, scale=sigma)
        return -float(np.log(np.maximum(density, 1e-300)).sum())

    start_m = NORMAL_MAD * float(np.median(np.abs(errors - np.median(errors))))
    bounds = [(-1.0, 1.0), (np.log(LEAST_M), 0.0), (np.log(LEAST_M), 1.0), (-np.log(1.0 / LEAST_SHARE), 4.0)]
    found = [
        minimize(cost, [np.median(errors), np.log(start_m), np.log(mean), 0.0], method="L-BFGS-B", bounds=bounds)
        for mean in (0.5 * start_m, 2.0 * start_m, 8.0 * start_m)
    ]
    best = min(found, key=lambda one: one.fun).x
    share = 1.0 / (1.0 + np.exp(-best[3]))
    return {"offset_m": best[0], "sigma_m": np.exp(best[1]), "late_mean_m": np.exp(best[2]), "late_share": share}


def _row(errors: Array) -> dict[str, float]:
    """Figures of the errors of a module, and what is beyond three deviations of their core."""
    offset = float(np.median(errors))
    sigma = NORMAL_MAD * float(np.median(np.abs(errors - offset)))
    left = errors - offset
    far = left[left > OUTLIER_SIGMAS * sigma]
    return {
        "ranges": errors.size, "offset_m": offset, "core_sigma_m": sigma, "late_share": far.size / errors.size,
        "short_share": float((left < -OUTLIER_SIGMAS * sigma).mean()),
        "late_mean_m": float(far.mean()) if far.size else 0.0, "late_most_m": float(left.max()),
    }  # fmt: skip


def _bounds(left: Array, sigma: float, share: float, mean: float) -> list[dict[str, Any]]:
    """How many errors exceed the quantiles of a law, for the shares that should."""
    grid, found = np.linspace(-5.0 * sigma, 20.0 * (sigma + mean), 20_001), []
    over = tail(grid, sigma, share, mean)
    for wanted in TAILS:
        bound = float(np.interp(-wanted, -over, grid))
        count = int((left > bound).sum())
        found.append({"wanted": wanted, "bound_m": bound, "share": count / left.size,
                      "share_95": clopper_pearson(count, left.size)})  # fmt: skip
    return found


def run_ranging(data: Path, out: Path) -> dict[str, Any]:
    """Compare the law with the recording and write ``ranging.json``; returns its data.

    Raises
    ------
    InputError
        A file is missing, or ``out`` cannot be claimed.
    """
    module, distance, errors = read_errors(data)
    claim(out, "ranging study", RangingStudyConfig(data=str(data)), PACKAGES)
    names = [int(name) for name in np.unique(module)]
    rows = {str(name): _row(errors[module == name]) for name in names}
    left = np.concatenate([errors[module == name] - rows[str(name)]["offset_m"] for name in names])
    fitted, figures = fit_law(left), RangingConfig().figures(0.1)[0]
    ours = {"sigma_m": float(figures["sigma_m"]), "late_share": float(figures["late_share"]),
            "late_mean_m": float(figures["late_mean_m"])}  # fmt: skip
    result = {
        "ranges": int(errors.size), "nearest_m": float(distance.min()), "farthest_m": float(distance.max()),
        "modules": rows, "all": _row(left), "fitted": fitted, "default": ours,
        "bounds": _bounds(left - fitted["offset_m"], *(fitted[k] for k in ("sigma_m", "late_share", "late_mean_m"))),
        "default_bounds": _bounds(left, *(ours[k] for k in ("sigma_m", "late_share", "late_mean_m"))),
    }  # fmt: skip
    return stored(result, out, "ranging.json")


class RangingStudyConfig(Config):
    """What a folder of this study is of."""

    data: str


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """Figures of the modules, of the fitted law and of ours, and how their bounds hold."""
    names = ("ranges", "offset_m", "core_sigma_m", "late_share", "late_mean_m", "late_most_m", "short_share")
    rows = [
        (name, *(f"{row[key]:.3f}" if key != "ranges" else str(row[key]) for key in names))
        for name, row in [*result["modules"].items(), ("all", result["all"])]
    ]
    yield f"Errors of {result['ranges']} ranges, {result['nearest_m']:.1f} to {result['farthest_m']:.1f} m", (
        ("module", *names), rows,
    )  # fmt: skip
    laws = [
        (name, *(f"{result[kind][key]:.3f}" for key in ("sigma_m", "late_share", "late_mean_m")))
        for name, kind in (("fitted", "fitted"), ("default", "default"))
    ]
    yield "Law: noise, share and mean excess of late ranges", (("", "sigma_m", "late_share", "late_mean_m"), laws)
    held = [
        (f"{a['wanted']:g}", f"{a['bound_m']:.3f}", f"{a['share']:.3f}", _interval(a), f"{b['bound_m']:.3f}",
         f"{b['share']:.3f}")
        for a, b in zip(result["bounds"], result["default_bounds"], strict=True)
    ]  # fmt: skip
    heads = (
        "share beyond, by the law",
        "bound, fitted [m]",
        "share found",
        "95 %",
        "bound, default [m]",
        "share found",
    )
    yield "How the bounds hold", (heads, held)


def _interval(row: Mapping[str, Any]) -> str:
    low, high = row["share_95"]
    return f"{low:.3f} to {high:.3f}"
