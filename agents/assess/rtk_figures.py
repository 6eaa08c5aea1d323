"""Figures of conventional RTK solutions, and their tables: a recorded drive beside simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.availability import find_outages
from lanebound.integrity.assessment.conventional_rtk import RtkOutcome

__all__ = ["WRONG_M", "changes", "figures", "rtk_rows", "sky_rows", "without_offsets"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

WRONG_M = 0.5  # horizontal error of a fixed position that is called wrong
QUANTILES = (0.5, 0.9, 0.95)
MOVING_MPS = 0.5
CHANGE_S = 1.0  # over which errors of fixed positions are compared
ROUNDS, LEAST_LENGTH_M = 30, 1e-3  # of re-weighting


def figures(
    time_s: Array, outcome: Ints, error_en_m: Array, satellites: Array, speed_mps: Array, heading_rad: Array
) -> dict[str, Any]:
    """What describes solutions of B vehicles at T epochs, all (T, B) but the time, and the errors, (T, B, 2).

    Shares are of all epochs, ``satellites.share`` is the median number over the greatest one. Errors are horizontal;
    those of fixed positions also without what a recording adds: their median vector, which comes from the coordinates
    of its base; and with it an offset that turns with the vehicle, of its lever arm (:func:`without_offsets`).
    """
    fixed, floated = outcome == RtkOutcome.FIXED, outcome == RtkOutcome.FLOAT
    outages = find_outages(fixed, time_s).length_s
    most = float(satellites.max())
    error_m = np.hypot(error_en_m[..., 0], error_en_m[..., 1])
    centre = np.median(error_en_m[fixed], 0) if fixed.any() else np.zeros(2)
    low, middle, high = np.quantile(satellites, (0.1, 0.5, 0.9))
    wrong, count = int((error_m[fixed] > WRONG_M).sum()), int(fixed.sum())
    return {
        "epochs": int(outcome.size),
        "vehicles": int(outcome.shape[1]),
        "moving": float((speed_mps > MOVING_MPS).mean()),
        "satellites": {"low": float(low), "median": float(middle), "high": float(high), "most": most,
                       "share": float(middle / most) if most else 0.0},
        "fixed": float(fixed.mean()),
        "float": float(floated.mean()),
        "wrong": wrong / count if count else None,
        "fixed_error_m": _quantiles(error_m[fixed]),
        "fixed_spread_m": _quantiles(np.hypot(*(error_en_m[fixed] - centre).T)),
        "fixed_mounted_m": _quantiles(without_offsets(error_en_m[fixed], heading_rad[fixed])),
        "fixed_change_m": _quantiles(changes(time_s, fixed, error_en_m)),
        "float_error_m": _quantiles(error_m[floated]),
        "outage_s": {
            "count": int(outages.size),
            "median": float(np.median(outages)) if outages.size else None,
            "high": float(np.quantile(outages, 0.9)) if outages.size else None,
            "longest": float(outages.max()) if outages.size else None,
        },
    }  # fmt: skip


def without_offsets(error_en_m: Array, heading_rad: Array) -> Array:
    """Length (n,) of errors (n, 2) less one offset fixed to the ground and one fixed to the vehicle [m].

    The four numbers make the sum of the lengths least (re-weighted least squares). Empty without headings.
    """
    if not len(error_en_m) or not np.isfinite(heading_rad).all():
        return np.zeros(0)
    sine, cosine, one, none = np.sin(heading_rad), np.cos(heading_rad), *np.eye(2)[:, :1].repeat(len(heading_rad), 1)
    east, north = np.stack([one, none, sine, cosine], -1), np.stack([none, one, cosine, -sine], -1)
    left = np.hypot(*error_en_m.T)
    for _ in range(ROUNDS):
        root = 1.0 / np.sqrt(np.maximum(left, LEAST_LENGTH_M))[:, None]
        design, y = np.concatenate([east * root, north * root]), np.concatenate((error_en_m * root).T)
        offsets = np.linalg.lstsq(design, y, rcond=None)[0]
        left = np.hypot(error_en_m[:, 0] - east @ offsets, error_en_m[:, 1] - north @ offsets)
    return np.asarray(left)


def changes(time_s: Array, fixed: Bools, error_en_m: Array) -> Array:
    """Length (n,) of the change of the error over CHANGE_S, between epochs fixed throughout [m].

    Offsets of base and lever arm are not in it, but for turns; noise is, and what multipath changes in a second.
    """
    step = max(round(CHANGE_S / float(np.median(np.diff(time_s)))), 1) if len(time_s) > 1 else 1
    if len(time_s) <= step:
        return np.zeros(0)
    whole = np.abs(time_s[step:] - time_s[:-step] - CHANGE_S) < 0.5 * CHANGE_S / step
    count = np.cumsum(np.concatenate([np.zeros((1, fixed.shape[1])), fixed]), 0)
    throughout = (count[step + 1 :] - count[: -step - 1] == step + 1) & whole[:, None]
    change = error_en_m[step:] - error_en_m[:-step]
    return np.asarray(np.hypot(change[..., 0], change[..., 1])[throughout])


def _quantiles(values: Array) -> list[float] | None:
    return [float(q) for q in np.quantile(values, QUANTILES)] if values.size else None


def _quantile(found: Mapping[str, Any], key: str, index: int) -> float | None:
    return found[key] and float(found[key][index])


ERRORS = {
    "fixed_error_m": "error of fixed positions",
    "fixed_spread_m": "the same less their median vector",
    "fixed_mounted_m": "the same less offsets of ground and vehicle",
    "fixed_change_m": "its change over 1 s of fixes",
    "float_error_m": "error of float positions",
}
ROWS: dict[str, tuple[str, str, Callable[[Mapping[str, Any]], float | None]]] = {
    "fixed": ("fixed, share of epochs", "%", lambda f: f["fixed"]),
    "float": ("float, share of epochs", "%", lambda f: f["float"]),
    "wrong": (f"fixed more than {WRONG_M:g} m off, share of fixed", "%", lambda f: f["wrong"]),
    **{
        f"{key} {q:g}": (f"{text}, {100 * q:g} %", "m", partial(_quantile, key=key, index=i))
        for key, text in ERRORS.items()
        for i, q in enumerate(QUANTILES)
    },
    "outage median": ("time without a fix, median", "s", lambda f: f["outage_s"]["median"]),
    "outage 90": ("time without a fix, 90 %", "s", lambda f: f["outage_s"]["high"]),
    "outage longest": ("time without a fix, longest", "s", lambda f: f["outage_s"]["longest"]),
}  # fmt: skip
"""Quantities that are compared: text, unit, and how they follow from figures."""


def rtk_rows(result: Mapping[str, Any]) -> Table:
    """Each quantity of the recorded drive and of the sky that comes nearest, with the factor between them."""
    recorded, simulated, rows = result["recorded"], result["skies"][result["nearest"]], []
    for text, unit, get in ROWS.values():
        pair = get(recorded), get(simulated)
        factor = pair[1] / pair[0] if pair[0] and pair[1] is not None else None
        within = "" if factor is None else "yes" if 0.5 <= factor <= 2.0 else "no"
        cells = ["-" if v is None else f"{100.0 * v:.1f} %" if unit == "%" else f"{v:.3g} {unit}" for v in pair]
        rows.append((text, *cells, "-" if factor is None else f"{factor:.2g}", within))
    return ("quantity", "recorded", result["nearest"], "factor", "within 2"), rows


def sky_rows(result: Mapping[str, Any]) -> Table:
    """Usable satellites, share of them, and failures of the recorded drive and of every sky."""
    rows: list[tuple[str, ...]] = []
    for name, f in ({"recorded": result["recorded"]} | result["skies"]).items():
        s = f["satellites"]
        wrong = "-" if f["wrong"] is None else f"{100.0 * f['wrong']:.1f} %"
        rows.append((
            name, f"{f['epochs']:,}", f"{100.0 * f['moving']:.0f} %",
            f"{s['median']:.0f} ({s['low']:.0f} to {s['high']:.0f}) of {s['most']:.0f}", f"{s['share']:.2f}",
            f"{100.0 * f['fixed']:.1f} %", wrong,
        ))  # fmt: skip
    return ("sky", "epochs", "moving", "satellites (10 to 90 %)", "share", "fixed", "wrong of fixed"), rows
