"""How well the covariance of a filter says its errors: NEES by state, NIS by sensor vector; and paired differences.

A mean of 1 is that of a covariance that is right. Below 1 the filter is better than it states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import ttest_rel, wilcoxon

from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.vehicle_filter.navigator import FilterNavigator
from lanebound.integrity.positioning.filters.vehicle_models import S

__all__ = ["MARGIN_M", "Consistency", "paired"]

Array = NDArray[np.float64]
VECTORS = ("position", "wheels", "gyro", "steering", "slip", "compass")  # in the order of their NIS
MOVING_MPS = 1.0  # slower, the course of the truth is not defined
MARGIN_M = 0.05  # differences of RMS below this count as none; chosen
LEAST = 6  # pairs


class Consistency:
    """Means over epochs and vehicles of one filter.

    Of the states that combine all models: squared error over its variance, of the position the NEES over 2; of vectors
    NIS over their dimension. The slip is that of the course, ``slip + slide``.
    """

    def __init__(self) -> None:
        self._nees: list[Array] = []
        self._slip: list[Array] = []
        self._nis, self._count = np.zeros(len(VECTORS)), np.zeros(len(VECTORS))

    def count(self, navigator: FilterNavigator, truth: Truth, sampled: bool) -> None:
        """Add an epoch; its states only where it is ``sampled``."""
        assert navigator.report is not None
        nis = navigator.report.nis
        used = np.isfinite(nis) & (nis > 0.0)
        self._nis += np.where(used, nis, 0.0).sum(0) / np.array([2.0] + [1.0] * (len(VECTORS) - 1))
        self._count += used.sum(0)
        if sampled:
            self._sample(navigator, truth)

    def _sample(self, navigator: FilterNavigator, truth: Truth) -> None:
        probability, models = navigator.state.belief.probability, navigator.state.belief.models
        x = np.einsum("bj,bjk->bk", probability, models["x"])
        apart = models["x"] - x[:, None]
        p = np.einsum("bj,bjkl->bkl", probability, models["p"] + apart[..., :, None] * apart[..., None, :])
        velocity = truth.velocity_enu_mps[:, :2]
        speed, course = np.linalg.norm(velocity, axis=-1), np.arctan2(velocity[:, 0], velocity[:, 1])
        moving = speed > MOVING_MPS
        off = truth.position_enu_m[:, :2] - x[:, :2]
        position = 0.5 * np.einsum("bi,bij,bj->b", off, np.linalg.inv(p[:, :2, :2]), off)
        heading = np.square(wrap_angle(truth.heading_rad - x[:, S.HEADING])) / p[:, S.HEADING, S.HEADING]
        fast = np.square(speed - x[:, S.SPEED]) / p[:, S.SPEED, S.SPEED]
        slip = wrap_angle(wrap_angle(course - truth.heading_rad) - x[:, S.SLIP] - x[:, S.SLIDE])
        spread = p[:, S.SLIP, S.SLIP] + p[:, S.SLIDE, S.SLIDE] + 2.0 * p[:, S.SLIP, S.SLIDE]
        self._nees.append(np.where(moving, [position, heading, fast, np.square(slip) / spread], np.nan).T)
        self._slip.append(np.where(moving, np.square(slip), np.nan))

    def figures(self) -> dict[str, Any]:
        """NEES by state, NIS by sensor vector, and the RMS of the slip [deg]."""
        found = dict(zip(("position", "heading", "speed", "slip"), _mean(np.array(self._nees), (0, 1)), strict=True))
        shares = self._nis / np.maximum(self._count, 1.0)
        return {
            **{f"NEES of {name}": float(value) for name, value in found.items()},
            **{f"NIS of {name}": float(v) for name, v, n in zip(VECTORS, shares, self._count, strict=True) if n > 0},
            "slip rms [deg]": float(np.rad2deg(np.sqrt(_mean(np.array(self._slip), (0, 1))))),
        }


def _mean(values: Array, axes: tuple[int, ...]) -> Array:
    """Mean without NaN; 0 of nothing."""
    there = np.isfinite(values)
    return np.asarray(np.where(there, values, 0.0).sum(axes) / np.maximum(there.sum(axes), 1))


def paired(name: str, more: Array, less: Array) -> dict[str, Any]:
    """Differences ``more - less`` (n,) of drives: 5 %, median, 95 % of the drives; mean with its 90 % interval, which
    is the test of equivalence (TOST) at 5 % for any margin that holds it; p of the Wilcoxon test and of TOST."""
    apart = more - less
    found: dict[str, Any] = {name: [float(q) for q in np.quantile(apart, [0.05, 0.5, 0.95])]}
    if apart.size < LEAST or not apart.any():
        return found
    mean, error = float(apart.mean()), float(apart.std(ddof=1) / np.sqrt(apart.size))
    half = float(student.isf(0.05, apart.size - 1)) * error
    above = ttest_rel(more, less - MARGIN_M, alternative="greater").pvalue
    below = ttest_rel(more, less + MARGIN_M, alternative="less").pvalue
    return found | {
        f"{name}, mean and 90 %": [mean - half, mean, mean + half],
        f"{name}, p of a difference": float(wilcoxon(more, less).pvalue),
        f"{name}, p of one beyond {MARGIN_M:g} m": float(max(above, below)),
    }
