"""Means over seeds with intervals: percentile bootstrap, interquartile means, paired differences.

The resamples are drawn from a stream named by the number of seeds, so that the same figures give the same intervals in
any order and any process, and metrics of as many seeds share their resamples.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.metrics import Better
from lanebound.integrity.streams import named_generator

__all__ = ["RESAMPLES", "Difference", "Estimate", "difference", "estimate", "interquartile_mean"]

Array = NDArray[np.float64]
RESAMPLES = 2000
TAIL = 0.025
CHUNK = 2_000_000  # entries of a resampled array at a time


@dataclass(frozen=True)
class Estimate:
    """A mean and an interquartile mean over n seeds with their 95 % intervals; None where n does not suffice."""

    mean: float | None
    low: float | None
    high: float | None
    iqm: float | None
    iqm_low: float | None
    iqm_high: float | None
    n: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Difference:
    """A mean difference over n seeds, its 95 % interval, and the share of the seeds in which it is for the better."""

    difference: float | None
    low: float | None
    high: float | None
    n: int
    better: float | None


def interquartile_mean(values: Array) -> Array:
    """Mean less a quarter (rounded down) of the values at each end.  (..., n) -> (...); Agarwal et al. 2021."""
    n = values.shape[-1]
    cut = n // 4
    return np.asarray(np.sort(values, axis=-1)[..., cut : n - cut].mean(axis=-1))


def estimate(values: Array, rate: bool = False) -> Estimate:
    """Mean and interquartile mean with 95 % percentile bootstrap intervals.  values (n,).

    Where all seeds say the same of a ``rate`` resampling knows no doubt: then the interval is that of Clopper and
    Pearson, which for 0 of n ends at ``1 - 0.025^(1/n)``, about 3.7 / n.
    """
    n = values.size
    if n == 0:
        return Estimate(None, None, None, None, None, None, 0)
    mean, iqm = float(values.mean()), float(interquartile_mean(values))
    if n == 1:
        return Estimate(mean, None, None, iqm, None, None, 1)
    means, iqms = _resampled(values)
    low, high = _interval(means)
    if rate and mean in (0.0, 1.0):
        reach = 1.0 - TAIL ** (1.0 / n)
        low, high = (0.0, reach) if mean == 0.0 else (1.0 - reach, 1.0)
    return Estimate(mean, low, high, iqm, *_interval(iqms), n)


def difference(ours: Array, theirs: Array, better: Better) -> Difference:
    """Mean of ``ours - theirs``, paired entry by entry, with its 95 % percentile bootstrap interval.  (n,), (n,)."""
    gap = ours - theirs
    n = gap.size
    if n == 0:
        return Difference(None, None, None, 0, None)
    share = None if better is None else float((gap > 0.0 if better == "higher" else gap < 0.0).mean())
    if n == 1:
        return Difference(float(gap[0]), None, None, 1, share)
    low, high = _interval(_resampled(gap)[0])
    return Difference(float(gap.mean()), low, high, n, share)


def _interval(resampled: Array) -> tuple[float, float]:
    low, high = np.quantile(resampled, [TAIL, 1.0 - TAIL])
    return float(low), float(high)


def _resampled(values: Array) -> tuple[Array, Array]:
    """Means and interquartile means of all resamples.  (n,) -> (RESAMPLES,), (RESAMPLES,)."""
    rows = max(1, CHUNK // values.size)
    parts = [values[block] for block in np.split(_choices(values.size), range(rows, RESAMPLES, rows))]
    return np.concatenate([p.mean(axis=-1) for p in parts]), np.concatenate([interquartile_mean(p) for p in parts])


@lru_cache(maxsize=4)
def _choices(n: int) -> NDArray[np.int64]:
    """Which seeds each resample takes, (RESAMPLES, n)."""
    return named_generator(n, "bootstrap").integers(n, size=(RESAMPLES, n))
