"""Protection levels of one epoch from the columns of ``mode``: the closed form and the multi-hypothesis root.

The root PL of an axis solves (S2 eq 10-11, with ``P_0 = 2``, ``T_i = K_fa sigma_di``)::

    f(PL) = sum_i P_i Q((PL - T_i - b_i) / sigma_i) = budget

by second-order steps on ``log f``, whose curvature is that of the normal tail: two or three evaluations reach 1e-10.
The tail sum runs over whole vectors with a polynomial for the Mills ratio ``Q(z)/phi(z)`` and one for ``exp``, both of
relative error below 4e-11. The last evaluation always proves ``f(PL) <= budget``.

Columns of ``mode``: :mod:`lanebound.integrity.monitoring.separation_kernel`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.accel import jit, prange
from lanebound.integrity.monitoring.geometry_kernel import (
    BIAS_AT,
    DELTA_AT,
    LOG_PRIOR,
    LOST,
    MAX_GROUPS,
    OFFSET,
    PRIOR,
    RATE,
    SIGMA_AT,
    SOLVED,
    WEIGHT,
    geometry,
    scratch,
)
from lanebound.integrity.lanes_kernel import (
    WIDTH,
    absolute,
    fma,
    largest,
    load,
    maximum,
    minimum,
    padded,
    root_of,
    spread,
    store,
    total,
    where_less,
)
from lanebound.integrity.monitoring.separation_kernel import modes, set_priors

__all__ = [
    "budgets_of",
    "closed_form",
    "closed_form_published",
    "q_inverse",
    "root",
    "run_chunk",
    "run_parallel",
    "tail",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

INV_SQRT2 = 1.0 / math.sqrt(2.0)
INV_SQRT2PI = 1.0 / math.sqrt(2.0 * math.pi)
Z_MAX = 12.0  # Q(12) = 2e-33: nothing of a budget
PATIENCE = 6  # steps before bisection takes turns: a far, flat mode defeats the parabola
MAX_STEPS = 120
NUDGE = 1e-10  # relative, upwards: the level aimed at lies this far above the root
AXES = 2
BAD_INPUT = -1

# coefficients from the highest power down
# Q(z) exp(z^2/2) on 0 <= z <= 12 as a polynomial in (z - 5)/(z + 5), Chebyshev fit of relative error 3.5e-11
MILLS = (
    4.609079919907381e-06, -4.022118382931004e-06, -6.235428010679837e-05, 0.00013601856512301277,
    0.00022074669355228056, -0.0023790368541615225, 0.008991144664521507, -0.02341389447592925,
    0.04785537003641929, -0.08088387731987831, 0.11606881138328852, -0.14345755525916926, 0.07691930497723773,
)  # fmt: skip
# exp(v) on -72/256 <= v <= 0, Chebyshev fit; its 256th power has relative error 9e-12
EXP = (
    0.0001724923140051712, 0.0013773372860555956, 0.008330619011153981, 0.04166631157666266,
    0.16666664138016088, 0.499999999114677, 0.99999999998819, 0.9999999999999745,
)  # fmt: skip


@jit
def q_inverse(p: float) -> float:
    """``Qinv(p)``, the upper-tail quantile of N(0, 1): -inf for p >= 1, inf for p <= 0, else to 1e-11."""
    if p >= 1.0:
        return -np.inf
    if p <= 0.0:
        return np.inf
    small = min(p, 1.0 - p)
    z = _rough_quantile(math.log(small))
    f = 0.5 * math.erfc(z * INV_SQRT2)
    slope = -INV_SQRT2PI * math.exp(-0.5 * z * z) / f
    z += _step(math.log(f / small), slope, slope * (-z - slope))
    return float(z if p <= 0.5 else -z)


@jit
def _rough_quantile(log_p: float) -> float:
    """``Qinv(exp(log_p))`` for log_p <= log(1/2), to 4.5e-4 (Abramowitz and Stegun 26.2.23)."""
    t = math.sqrt(max(-2.0 * log_p, 0.0))
    return t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))


@jit
def _step(g: float, slope: float, curvature: float) -> float:
    """Step to the zero of the parabola ``g + slope d + curvature d^2/2`` nearest to d = 0; slope < 0."""
    square = slope * slope - 2.0 * g * curvature
    return -2.0 * g / (slope - math.sqrt(square)) if square > 0.0 else -g / slope


@jit
def load_axis(axis: int, k_fa: float, count: int, mode: Array) -> None:
    """Rows OFFSET and RATE of one axis; columns without effect to the next multiple of WIDTH."""
    for k in range(0, count, WIDTH):
        store(1.0 / load(mode, SIGMA_AT + axis, k), mode, RATE, k)
        store(fma(load(mode, DELTA_AT + axis, k), k_fa, load(mode, BIAS_AT + axis, k)), mode, OFFSET, k)
    for k in range(count, padded(count)):
        mode[OFFSET, k], mode[RATE, k], mode[WEIGHT, k], mode[LOG_PRIOR, k] = 0.0, 0.0, 0.0, -np.inf


@jit
def _polynomial(s: Any, coefficients: Any) -> Any:
    """Horner's rule in all lanes."""
    p = spread(coefficients[0])
    for i in range(1, len(coefficients)):
        p = fma(p, s, coefficients[i])
    return p


@jit
def tail(x: float, count: int, mode: Array) -> tuple[float, float, float]:
    """``f``, ``-f'`` and ``f''`` of the loaded axis at x."""
    f, f1, f2 = spread(0.0), spread(0.0), spread(0.0)
    for k in range(0, count, WIDTH):
        rate, weight = load(mode, RATE, k), load(mode, WEIGHT, k)
        z = (x - load(mode, OFFSET, k)) * rate
        a = minimum(absolute(z), Z_MAX)
        e = _polynomial(a * a * (-1.0 / 512.0), EXP)
        for _ in range(8):
            e *= e
        upper = e * _polynomial((a - 5.0) / (a + 5.0), MILLS)
        f = fma(weight, where_less(z, 0.0, 1.0 - upper, upper), f)
        density = weight * rate * e
        f1 += density
        f2 = fma(density, rate * z, f2)
    return total(f), total(f1) * INV_SQRT2PI, total(f2) * INV_SQRT2PI


@jit
def _start(axis: int, log_budget: float, count: int, mode: Array) -> float:
    """The largest level that one column alone asks for: just below the root."""
    x = spread(0.0)
    for k in range(0, count, WIDTH):
        log_p = log_budget - load(mode, LOG_PRIOR, k)
        t = root_of(minimum(log_p, -0.7) * -2.0)  # as _rough_quantile
        z = t - fma(t, fma(t, 0.010328, 0.802853), 2.515517) / fma(
            t, fma(t, fma(t, 0.001308, 0.189269), 1.432788), 1.0
        )
        level = fma(z, load(mode, SIGMA_AT + axis, k), load(mode, OFFSET, k))
        x = maximum(x, where_less(log_p, -0.7, level, 0.0))
    return largest(x)


@jit
def _ceiling(axis: int, budget: float, count: int, mode: Array) -> float:
    """A level above the root: every column then uses at most its prior's share of the budget."""
    priors = 0.0
    for k in range(count):
        priors += mode[WEIGHT, k]
    z = max(q_inverse(budget / priors), 0.0)
    x = 0.0
    for k in range(count):
        if mode[WEIGHT, k] > 0.0:
            x = max(x, mode[OFFSET, k] + z * mode[SIGMA_AT + axis, k])
    return x


@jit
def _root_of_axis(axis: int, budget: float, count: int, mode: Array) -> float:
    """The level where the loaded axis' tail sum meets the budget, from above."""
    log_budget = math.log(budget)
    x = _start(axis, log_budget, count, mode)
    low, high = 0.0, np.inf
    for i in range(MAX_STEPS):
        f, f1, f2 = tail(x, count, mode)
        if f <= budget:
            high = x
            if budget - f <= 4.0 * NUDGE * x * f1 or high - low <= 4.0 * NUDGE * x:
                return float(x)
        else:
            low = x
        slope = -f1 / f
        d = _step(math.log(f) - log_budget, slope, f2 / f - slope * slope)
        x = (x + d) * (1.0 + NUDGE)
        if i == PATIENCE:
            high = min(high, _ceiling(axis, budget, count, mode))
        if i >= PATIENCE and (i % 2 == 0 or not low < x < high):
            x = 0.5 * (low + high)
        elif not low < x < high:
            x = 0.5 * (low + high) if high < np.inf else 2.0 * low + 1e-6
    return high


@jit
def root(count: int, k_fa: float, budgets: Array, tolerate: bool, head: Array, mode: Array, out: Array) -> None:
    """Multi-hypothesis protection levels (S2 eq 10-11) of ``count`` columns with priors set.

    Parameters
    ----------
    k_fa : threshold of the separation test, in sigmas.
    budgets : (R, 2) integrity risk of AT and CT, less what is spent on unmonitored faults; one row for each risk.
    tolerate : move the prior of modes without a solution into the unmonitored risk; otherwise they make PL inf.
    out : (R, 2) protection levels [m], never below the root and above it by at most 5e-10 relative; inf without one.
    """
    lost = head[LOST]
    for axis in range(AXES):
        load_axis(axis, k_fa, count, mode)
        for r in range(budgets.shape[0]):
            budget = budgets[r, axis] - (lost if tolerate else 0.0)
            hopeless = budget <= 0.0 or (lost > 0.0 and not tolerate) or not mode[SIGMA_AT + axis, 0] < np.inf
            out[r, axis] = np.inf if hopeless else _root_of_axis(axis, budget, count, mode)


@jit
def closed_form(
    count: int, k_fa: float, budgets: Array, share0: float, tolerate: bool, head: Array, mode: Array, out: Array
) -> None:
    """``max_i K_fa sigma_di + K_md,i sigma_i + b_i``, ``K_md,i = Qinv(w_i budget / P_i)`` (S1 eq 17, exact factors).

    ``share0`` is the fault-free mode's share w_0 of the budget (the others share the rest equally), 0 for equal shares.
    Other parameters as :func:`root`; the result is never below the root's.
    """
    lost = head[LOST]
    first = 1.0 / count if share0 <= 0.0 or count == 1 else share0
    other = (1.0 - first) / max(count - 1, 1)
    for axis in range(AXES):
        load_axis(axis, k_fa, count, mode)
        for r in range(budgets.shape[0]):
            budget = budgets[r, axis] - (lost if tolerate else 0.0)
            hopeless = budget <= 0.0 or (lost > 0.0 and not tolerate) or not mode[SIGMA_AT + axis, 0] < np.inf
            if hopeless:
                out[r, axis] = np.inf
                continue
            level = mode[OFFSET, 0] + q_inverse(0.5 * first * budget) * mode[SIGMA_AT + axis, 0]
            prior, k_md = -1.0, 0.0
            for k in range(1, count):
                if mode[WEIGHT, k] > 0.0:
                    if mode[PRIOR, k] != prior:
                        prior = mode[PRIOR, k]
                        k_md = q_inverse(other * budget / prior)
                    level = max(level, mode[OFFSET, k] + k_md * mode[SIGMA_AT + axis, k])
            out[r, axis] = level


@jit
def closed_form_published(count: int, k_fa: float, k_md: Array, mode: Array, out: Array) -> None:
    """S1 eq 17 as printed, one unsplit ``k_md`` (R,) for each risk and every mode; out (R, 2) [m]."""
    for axis in range(AXES):
        load_axis(axis, k_fa, count, mode)
        for r in range(k_md.shape[0]):
            level = 0.0
            for k in range(count):
                level = max(level, mode[OFFSET, k] + k_md[r] * mode[SIGMA_AT + axis, k])
            out[r, axis] = level


@jit
def pair_risk(count: int, mode: Array) -> float:
    """Bound of the probability of two or more faults at once, ``sum_{i<j} P_i P_j`` over columns 1 to count - 1."""
    p, p2, k = spread(0.0), spread(0.0), 1
    while k + WIDTH <= count:
        prior = load(mode, PRIOR, k)
        p, p2, k = p + prior, fma(prior, prior, p2), k + WIDTH
    once, squares = total(p), total(p2)
    for i in range(k, count):
        once += mode[PRIOR, i]
        squares += mode[PRIOR, i] * mode[PRIOR, i]
    return 0.5 * (once * once - squares)


@jit
def budgets_of(risks: Array, split_at: float, unmonitored: float, budgets: Array) -> None:
    """``budgets[r] = (risk - unmonitored) (split_at, 1 - split_at)``; not positive when nothing is left."""
    for r in range(risks.shape[0]):
        left = risks[r] - unmonitored
        budgets[r, 0], budgets[r, 1] = left * split_at, left * (1.0 - split_at)


@jit
def _usable(n: int, los: Array, group: Ints, variance: Array, accuracy: Array, bias: Array) -> bool:
    """Whether n satellites have directions, groups, variances and biases that make sense; without branches."""
    bad = 0
    for j in range(n):
        bad |= not (abs(los[j, 0]) + abs(los[j, 1]) + abs(los[j, 2]) < 2.0)
    for j in range(n):
        bad |= not ((variance[j] > 0.0) & (variance[j] < np.inf) & (accuracy[j] > 0.0) & (accuracy[j] < np.inf))
    for j in range(n):
        bad |= not ((bias[j] >= 0.0) & (bias[j] < np.inf) & (group[j] >= 0) & (group[j] < MAX_GROUPS))
    return bad == 0


@jit
def run_chunk(
    first: int,
    last: int,
    los: Array,
    mask: Bools,
    group: Ints,
    variance: Array,
    accuracy: Array,
    bias: Array,
    heading: Array,
    unmonitored: Array,
    satellite: Array,
    constellation: Array,
    k_fa: Array,
    risks: Array,
    split_at: float,
    share0: float,
    constellations: bool,
    multiple: bool,
    tolerate: bool,
    want_root: bool,
    want_closed: bool,
    status: Ints,
    level: Array,
    closed: Array,
) -> None:
    """Protection levels of epochs ``first`` to ``last`` - 1; arguments as ``protection_levels_batch`` makes them.

    The status of an epoch with an entry in view that cannot be used is BAD_INPUT.
    """
    size = mask.shape[1]
    geo, head, mode = scratch(size)
    e, g = np.empty((size, 3)), np.empty(size, np.int64)
    v, a, b = np.empty(size), np.empty(size), np.empty(size)
    budgets = np.empty((risks.shape[0], AXES))
    for i in range(first, last):
        n = 0
        for j in range(size):
            if mask[i, j]:
                e[n, 0], e[n, 1], e[n, 2] = los[i, j, 0], los[i, j, 1], los[i, j, 2]
                g[n], v[n], a[n], b[n] = group[i, j], variance[i, j], accuracy[i, j], bias[i, j]
                n += 1
        if not _usable(n, e, g, v, a, b):
            status[i] = BAD_INPUT
            continue
        sin_h, cos_h = math.sin(heading[i]), math.cos(heading[i])
        status[i] = geometry(e, g, v, b, n, sin_h, cos_h, geo, head)
        if status[i] != SOLVED:
            continue
        count = modes(g, v, a, n, sin_h, cos_h, constellations, False, geo, head, mode)
        set_priors(g, n, count, satellite, constellation, head, mode)
        spent = unmonitored[i] + (pair_risk(count, mode) if multiple else 0.0)
        budgets_of(risks, split_at, spent, budgets)
        if want_root:
            root(count, k_fa[count - 1], budgets, tolerate, head, mode, level[i])
        if want_closed:
            closed_form(count, k_fa[count - 1], budgets, share0, tolerate, head, mode, closed[i])


def _run_parallel(
    chunks: int,
    los: Array,
    mask: Bools,
    group: Ints,
    variance: Array,
    accuracy: Array,
    bias: Array,
    heading: Array,
    unmonitored: Array,
    satellite: Array,
    constellation: Array,
    k_fa: Array,
    risks: Array,
    split_at: float,
    share0: float,
    constellations: bool,
    multiple: bool,
    tolerate: bool,
    want_root: bool,
    want_closed: bool,
    status: Ints,
    level: Array,
    closed: Array,
) -> None:
    """:func:`run_chunk` over all epochs, ``chunks`` runs shared among the threads."""
    epochs = mask.shape[0]
    for chunk in prange(chunks):
        run_chunk(
            chunk * epochs // chunks,
            (chunk + 1) * epochs // chunks,
            los,
            mask,
            group,
            variance,
            accuracy,
            bias,
            heading,
            unmonitored,
            satellite,
            constellation,
            k_fa,
            risks,
            split_at,
            share0,
            constellations,
            multiple,
            tolerate,
            want_root,
            want_closed,
            status,
            level,
            closed,
        )


run_parallel = jit(parallel=True)(_run_parallel)
