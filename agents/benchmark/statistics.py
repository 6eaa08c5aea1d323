"""Means over seeds with 95 % intervals whose coverage is about nominal, with few seeds too.

Means and paired differences have at each end the wider of Student's interval and that of the studentised bootstrap:
Student's alone is too short where values are skewed or mostly zero, the bootstrap's where they have heavy tails.
Interquartile means have the percentile interval expanded for the number of seeds. Rates have the interval of Clopper
and Pearson, their paired differences that of Agresti and Min. A paired difference also has a p-value for Holm's method:
of Student's t test, of rates McNemar's exact one. The resamples are drawn from a stream named by the number of seeds:
equal values give equal intervals in any order and any process, and all metrics share the resamples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, ndtr, stdtr, stdtrit

from lanebound.agents.benchmark.metrics import ANYTHING, Better, Bounds
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.streams import named_generator

__all__ = [
    "METHOD", "RESAMPLES", "SPREAD_SEEDS", "VERDICT_SEEDS", "Difference", "Estimate", "difference", "estimate", "holm",
    "interquartile_mean", "is_clear", "seeds_to_exclude", "student_ends", "student_p", "within",
]  # fmt: skip

Array = NDArray[np.float64]
Ends = tuple[float, float] | tuple[None, None]
RESAMPLES = 2000
SPREAD_SEEDS = 4
"""With fewer seeds no mean has an interval."""
VERDICT_SEEDS = 8
"""With fewer seeds no agent is called better: they do not show the spread of values."""
METHOD = {
    "means": "at each end the wider of Student's t and the studentised bootstrap, over seeds",
    "interquartile_means": f"expanded percentile bootstrap, from {VERDICT_SEEDS} seeds on",
    "rates": "Clopper-Pearson",
    "paired": "as means, of the differences seed by seed; of rates Agresti-Min with Student's quantile",
    "p": "two-sided: Student's t, no less than signs can give; of rates McNemar's exact test",
}
TAIL = 0.025
CHUNK = 2_000_000  # entries of a resampled array at a time
WIDEST = float(stdtrit(1, 1.0 - TAIL))  # standard errors, of an interval from two values
ROUNDING = 1e-12  # of the largest value: less is no spread
NONE: Ends = (None, None)


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
    """A mean difference over n seeds, its 95 % interval, and the share of the seeds with a better value.

    ``p`` is the two-sided p-value of no difference; None with fewer than two seeds.
    """

    difference: float | None
    low: float | None
    high: float | None
    n: int
    better: float | None
    p: float | None = None


def interquartile_mean(values: Array) -> Array:
    """Mean less a quarter (rounded down) of the values at each end.  (..., n) -> (...); Agarwal et al. 2021."""
    n = values.shape[-1]
    cut = n // 4
    return np.asarray(np.sort(values, axis=-1)[..., cut : n - cut].mean(axis=-1))


def estimate(values: Array, rate: bool = False, bounds: Bounds = ANYTHING) -> Estimate:
    """Mean and interquartile mean with 95 % intervals, None where the seeds do not show the spread.  (n,).

    The mean has no interval with fewer than four seeds, and where all values, or all but about three, are (nearly)
    equal: then so many resamples have no spread that an end would be beyond that of two seeds. The interquartile mean
    has none with fewer than eight seeds, and where its resamples are equal.

    Parameters
    ----------
    values : one for each seed
    rate : values are 0 or 1; the interval of 0 of n ends at ``1 - 0.025^(1/n)``, about 3.7 / n. The interquartile mean
        of a rate has no interval
    bounds : of the values, and of the intervals
    """
    n = values.size
    if n == 0:
        return Estimate(None, None, None, None, None, None, 0)
    mean, iqm = float(values.mean()), float(interquartile_mean(values))
    if rate:
        low, high = clopper_pearson(int(values.sum()), n) if n > 1 else NONE
        return Estimate(mean, low, high, iqm, None, None, n)
    low, high = within(_mean_ends(values), bounds)
    iqm_low, iqm_high = within(_middle_ends(values), bounds)
    return Estimate(mean, low, high, iqm, iqm_low, iqm_high, n)


def difference(ours: Array, theirs: Array, better: Better, rate: bool = False) -> Difference:
    """Mean of ``ours - theirs`` with its 95 % interval; values of a ``rate`` are 0 or 1.  (n,)."""
    gap = ours - theirs
    n = gap.size
    if n == 0:
        return Difference(None, None, None, 0, None)
    share = None if better is None else float((gap > 0.0 if better == "higher" else gap < 0.0).mean())
    low, high = NONE if n == 1 else _agresti_min(gap) if rate else _mean_ends(gap)
    return Difference(float(gap.mean()), low, high, n, share, _p_value(gap, rate) if n > 1 else None)


def is_clear(low: float | None, high: float | None, n: int) -> bool:
    """Whether an interval of a difference over n seeds excludes 0, and n suffices."""
    return n >= VERDICT_SEEDS and low is not None and high is not None and (low > 0.0 or high < 0.0)


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values adjusted for their number: at most 5 % of families have a wrong one of 0.05 or less; Holm 1979.

    >>> holm([0.04, 0.01, 0.03])
    [0.06, 0.03, 0.06]
    """
    found, least = [0.0] * len(p_values), 0.0
    for done, i in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        least = max(least, min(1.0, (len(p_values) - done) * p_values[i]))
        found[i] = least
    return found


def seeds_to_exclude(rise: float) -> int:
    """Least number of seeds that excludes a rise of a rate by more than ``rise`` where no seed differs."""
    return next(n for n in range(2, 1_000_000) if _agresti_min(np.zeros(n))[1] <= rise)


def _p_value(gap: Array, rate: bool) -> float:
    """P-value of no difference, at least the smallest one of a sign test, ``2^(1 - k)`` with k differing seeds."""
    differing = int(np.count_nonzero(gap))
    if rate:
        fewer = int(min((gap > 0.0).sum(), (gap < 0.0).sum()))
        return min(1.0, 2.0 * float(bdtr(fewer, differing, 0.5))) if differing else 1.0
    return max(min(1.0, 2.0 ** (1 - differing)), student_p(gap))


def student_p(gap: Array) -> float:
    """Two-sided, of Student's paired test; of a sign test where all differences are equal.  (n,), n > 1."""
    error = float(_error(gap))
    if error <= ROUNDING * float(np.abs(gap).max()):
        return min(1.0, 2.0 ** (1 - int(np.count_nonzero(gap))))
    return 2.0 * float(stdtr(gap.size - 1, -abs(float(gap.mean())) / error))


def student_ends(values: Array) -> Ends:
    """Ends of Student's 95 % interval of a mean; none of a single value.  (n,)."""
    if values.size < 2:
        return NONE
    mean, reach = float(values.mean()), float(_error(values) * stdtrit(values.size - 1, 1.0 - TAIL))
    return mean - reach, mean + reach


def within(ends: Ends, bounds: Bounds) -> Ends:
    """An interval clipped to the bounds of its values."""
    low, high = ends
    return NONE if low is None or high is None else (max(low, bounds[0]), min(high, bounds[1]))


def _agresti_min(gap: Array) -> tuple[float, float]:
    """Interval of a difference of paired rates: half a pair more of each of the four kinds; Agresti and Min 2005."""
    n, differing, net = gap.size + 2, float(np.abs(gap).sum()) + 1.0, float(gap.sum())
    reach = float(stdtrit(n - 1, 1.0 - TAIL) * np.sqrt(differing - net**2 / n) / n)
    return max(net / n - reach, -1.0), min(net / n + reach, 1.0)


def _mean_ends(values: Array) -> Ends:
    """At each end the wider of Student's interval and the studentised bootstrap's; at most that of two values."""
    n = values.size
    mean, error = float(values.mean()), float(_error(values))
    nothing = ROUNDING * float(np.abs(values).max())
    if n < SPREAD_SEEDS or error <= nothing:
        return NONE
    away, errors = _resampled(values, lambda some: some.mean(axis=-1) - mean), _resampled(values, _error)
    away[np.abs(away) <= nothing] = 0.0
    spread = errors > nothing
    studentised = np.where(spread, away / np.where(spread, errors, 1.0), np.copysign(np.inf, away))
    studentised[away == 0.0] = 0.0
    least = float(np.quantile(studentised, TAIL, method="lower"))
    most = float(np.quantile(studentised, 1.0 - TAIL, method="higher"))
    reach = float(stdtrit(n - 1, 1.0 - TAIL))
    if max(most, -least) > WIDEST:
        return NONE
    return mean - error * max(most, reach), mean - error * min(least, -reach)


def _error(values: Array) -> Any:
    """Standard error of the mean, 0 of one value.  (..., n) -> (...)."""
    n = values.shape[-1]
    return values.std(axis=-1, ddof=1) / np.sqrt(n) if n > 1 else 0.0


def _middle_ends(values: Array) -> Ends:
    """Percentile interval of the interquartile mean, expanded as Student's; Hesterberg 2015, 5.2."""
    n = values.size
    if n < VERDICT_SEEDS:
        return NONE
    tail = float(ndtr(np.sqrt(n / (n - 1)) * stdtrit(n - 1, TAIL)))
    low, high = map(float, np.quantile(_resampled(values, interquartile_mean), [tail, 1.0 - tail]))
    return (low, high) if high - low > ROUNDING * float(np.abs(values).max()) else NONE


def _resampled(values: Array, figure: Callable[[Array], Array]) -> Array:
    """A figure of all resamples.  (n,) -> (RESAMPLES,)."""
    rows = max(1, CHUNK // values.size)
    blocks = np.split(_choices(values.size), range(rows, RESAMPLES, rows))
    return np.concatenate([figure(values[block]) for block in blocks])


@lru_cache(maxsize=4)
def _choices(n: int) -> NDArray[np.int64]:
    """Seeds of each resample, (RESAMPLES, n)."""
    return named_generator(n, "bootstrap").integers(n, size=(RESAMPLES, n))
