"""Protection levels of one epoch from the columns of ``mode``: the closed form and the multi-hypothesis root.

The root PL of an axis solves (S2 eq 10-11, with ``P_0 = 2``, ``T_i = K_fa sigma_di``)::

    f(PL) = sum_i P_i Q((PL - T_i - b_i) / sigma_i) = budget

by third-order steps on ``log f``, which is nearly a parabola: two or three evaluations reach 1e-10. The tail sum runs
over whole vectors with a polynomial for the Mills ratio ``Q(z)/phi(z)`` and one for ``exp``, both of relative error
below 4e-11. A level is accepted when an evaluation proves ``f(PL) <= budget``, or after a step so short that what it
leaves out is less than what the level is then raised by.

Columns of ``mode``: :mod:`lanebound.integrity.monitoring.separation_kernel`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.simd_kernel import (
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
from lanebound.integrity.monitoring.geometry_kernel import (
    BIAS_AT,
    DELTA_AT,
    LOG_PRIOR,
    LOST,
    MAX_GROUPS,
    OFFSET_AT,
    OFFSET_CT,
    PRIOR,
    RATE_AT,
    RATE_CT,
    SIGMA_AT,
    SOLVED,
    WEIGHT,
    capacity,
    geometry,
    scratch,
)
from lanebound.integrity.monitoring.separation_kernel import add_subset, modes, set_priors

__all__ = [
    "budgets_of",
    "closed_form",
    "closed_form_published",
    "q_inverse",
    "root",
    "run_chunk",
    "tails",
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
STEEP = 1e4  # change of log f over the level beyond which no step counts as shorter: f is then a clamped tail
AXES = 2
BAD_INPUT = -1
LONGEST = 1.1  # of the components of a unit vector, with room for rounding

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
def _third_order(g: float, slope: float, curvature: float, twist: float) -> float:
    """:func:`_step`, mended by the third derivative where the parabola serves."""
    d = _step(g, slope, curvature)
    there = slope + d * (curvature + 0.5 * d * twist)
    return float(d - d * d * d * twist / (6.0 * there)) if there < 0.5 * slope else float(d)


@jit
def load_axes(k_fa: float, count: int, mode: Array) -> None:
    """Rows OFFSET and RATE of both axes; columns without effect to the next multiple of WIDTH."""
    for axis in range(AXES):
        for k in range(0, count, WIDTH):
            store(1.0 / load(mode, SIGMA_AT + axis, k), mode, RATE_AT + axis, k)
            offset = fma(load(mode, DELTA_AT + axis, k), k_fa, load(mode, BIAS_AT + axis, k))
            store(offset, mode, OFFSET_AT + axis, k)
    for k in range(count, padded(count)):
        mode[WEIGHT, k], mode[LOG_PRIOR, k] = 0.0, -np.inf
        mode[OFFSET_AT, k], mode[OFFSET_CT, k], mode[RATE_AT, k], mode[RATE_CT, k] = 0.0, 0.0, 0.0, 0.0


@jit
def _polynomial(s: Any, coefficients: Any) -> Any:
    """Horner's rule in all lanes."""
    p = spread(coefficients[0])
    for i in range(1, len(coefficients)):
        p = fma(p, s, coefficients[i])
    return p


@jit
def _upper_tail(z: Any) -> tuple[Any, Any]:
    """``Q(z)`` and ``exp(-z^2/2)`` in all lanes."""
    a = minimum(absolute(z), Z_MAX)
    e = _polynomial(a * a * (-1.0 / 512.0), EXP)
    for _ in range(8):
        e *= e
    upper = e * _polynomial((a - 5.0) / (a + 5.0), MILLS)
    return where_less(z, 0.0, 1.0 - upper, upper), e


@jit
def _add_tails(x: float, axis: int, k: int, mode: Array, f: Any, f1: Any, f2: Any, f3: Any) -> Any:
    """The sums of :func:`tails`, continued by columns k to k + WIDTH - 1."""
    rate, weight = load(mode, RATE_AT + axis, k), load(mode, WEIGHT, k)
    z = (x - load(mode, OFFSET_AT + axis, k)) * rate
    upper, e = _upper_tail(z)
    first = weight * rate * e
    second = first * rate
    return fma(weight, upper, f), f1 + first, fma(second, z, f2), fma(second * rate, fma(z, z, -1.0), f3)


@jit
def tails(x_at: float, x_ct: float, count: int, mode: Array) -> Any:
    """``f``, ``-f'``, ``f''`` and ``-f'''`` of AT at x_at, and those of CT at x_ct: two chains side by side."""
    zero = spread(0.0)
    at, ct = (zero, zero, zero, zero), (zero, zero, zero, zero)
    for k in range(0, count, WIDTH):
        at = _add_tails(x_at, 0, k, mode, *at)
        ct = _add_tails(x_ct, 1, k, mode, *ct)
    return _summed(at), _summed(ct)


@jit
def _summed(lanes: Any) -> Any:
    f, f1, f2, f3 = lanes
    return total(f), total(f1) * INV_SQRT2PI, total(f2) * INV_SQRT2PI, total(f3) * INV_SQRT2PI


@jit
def _start(axis: int, log_budget: float, count: int, mode: Array) -> float:
    """The largest level that one column alone asks for: just below the root."""
    x = spread(0.0)
    for k in range(0, count, WIDTH):
        log_p = log_budget - load(mode, LOG_PRIOR, k)
        t = root_of(minimum(log_p, -0.7) * -2.0)  # as _rough_quantile
        over = fma(t, fma(t, 0.010328, 0.802853), 2.515517)
        under = fma(t, fma(t, fma(t, 0.001308, 0.189269), 1.432788), 1.0)
        level = fma(t - over / under, load(mode, SIGMA_AT + axis, k), load(mode, OFFSET_AT + axis, k))
        x = maximum(x, where_less(log_p, -0.7, level, 0.0))
    return float(largest(x))


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
            x = max(x, mode[OFFSET_AT + axis, k] + z * mode[SIGMA_AT + axis, k])
    return x


@jit
def _next_level(
    i: int, axis: int, x: float, low: float, high: float, sums: Any, budget: float, count: int, mode: Array
) -> tuple[bool, float, float, float]:
    """Whether the root is found, the next level to try (or the root), and the bracket; ``sums`` at x."""
    f, f1, f2, f3 = sums
    if f <= budget:
        high = x
        if budget - f <= 4.0 * NUDGE * x * f1 or high - low <= 4.0 * NUDGE * x:
            return True, x, low, high
    else:
        low = x
    slope, bend = -f1 / f, f2 / f
    twist = -f3 / f - slope * (3.0 * bend - 2.0 * slope * slope)
    g = math.log(f / budget)
    d = _third_order(g, slope, bend - slope * slope, twist)
    if max(abs(g), abs(d * slope)) ** 4 <= NUDGE * min(-slope * x, STEEP):
        return True, (x + d) * (1.0 + 2.0 * NUDGE), low, high
    x = (x + d) * (1.0 + NUDGE)
    if i == PATIENCE:
        high = min(high, _ceiling(axis, budget, count, mode))
    if i >= PATIENCE and (i % 2 == 0 or not low < x < high):
        x = 0.5 * (low + high)
    elif not low < x < high:
        x = 0.5 * (low + high) if high < np.inf else 2.0 * low + 1e-6
    return False, x, low, high


@jit
def _roots(budget_at: float, budget_ct: float, count: int, mode: Array, out: Array) -> None:
    """The levels where the tail sums of AT and CT meet their budgets, from above; a budget of 0 gives inf."""
    done_at, done_ct = budget_at <= 0.0, budget_ct <= 0.0
    x_at = 0.0 if done_at else _start(0, math.log(budget_at), count, mode)
    x_ct = 0.0 if done_ct else _start(1, math.log(budget_ct), count, mode)
    low_at, low_ct, high_at, high_ct = 0.0, 0.0, np.inf, np.inf
    out[0], out[1] = np.inf, np.inf
    for i in range(MAX_STEPS):
        if done_at and done_ct:
            break
        at, ct = tails(x_at, x_ct, count, mode)
        if not done_at:
            done_at, x_at, low_at, high_at = _next_level(i, 0, x_at, low_at, high_at, at, budget_at, count, mode)
            out[0] = x_at if done_at else high_at
        if not done_ct:
            done_ct, x_ct, low_ct, high_ct = _next_level(i, 1, x_ct, low_ct, high_ct, ct, budget_ct, count, mode)
            out[1] = x_ct if done_ct else high_ct


@jit
def _left_of(budget: float, axis: int, tolerate: bool, head: Array, mode: Array) -> float:
    """What of an axis' budget is left to the modes with a solution; 0 when no level can hold it."""
    lost = head[LOST]
    left = budget - (lost if tolerate else 0.0)
    hopeless = left <= 0.0 or (lost > 0.0 and not tolerate) or not mode[SIGMA_AT + axis, 0] < np.inf
    return 0.0 if hopeless else left


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
    load_axes(k_fa, count, mode)
    for r in range(budgets.shape[0]):
        at = _left_of(budgets[r, 0], 0, tolerate, head, mode)
        ct = _left_of(budgets[r, 1], 1, tolerate, head, mode)
        _roots(at, ct, count, mode, out[r])


@jit
def closed_form(
    count: int, k_fa: float, budgets: Array, share0: float, tolerate: bool, head: Array, mode: Array, out: Array
) -> None:
    """``max_i K_fa sigma_di + K_md,i sigma_i + b_i``, ``K_md,i = Qinv(w_i budget / P_i)`` (S1 eq 17, exact factors).

    ``share0`` is the fault-free mode's share w_0 of the budget (the others share the rest equally), 0 for equal shares.
    Other parameters as :func:`root`; the result is never below the root's.
    """
    first = 1.0 / count if share0 <= 0.0 or count == 1 else share0
    other = (1.0 - first) / max(count - 1, 1)
    load_axes(k_fa, count, mode)
    for axis in range(AXES):
        for r in range(budgets.shape[0]):
            budget = _left_of(budgets[r, axis], axis, tolerate, head, mode)
            if budget <= 0.0:
                out[r, axis] = np.inf
                continue
            level = mode[OFFSET_AT + axis, 0] + q_inverse(0.5 * first * budget) * mode[SIGMA_AT + axis, 0]
            prior, k_md = -1.0, 0.0
            for k in range(1, count):
                if mode[WEIGHT, k] > 0.0:
                    if mode[PRIOR, k] != prior:
                        prior = mode[PRIOR, k]
                        k_md = q_inverse(other * budget / prior)
                    level = max(level, mode[OFFSET_AT + axis, k] + k_md * mode[SIGMA_AT + axis, k])
            out[r, axis] = level


@jit
def closed_form_published(count: int, k_fa: float, k_md: Array, mode: Array, out: Array) -> None:
    """S1 eq 17 as printed, one unsplit ``k_md`` (R,) for each risk and every mode; out (R, 2) [m]."""
    load_axes(k_fa, count, mode)
    for axis in range(AXES):
        for r in range(k_md.shape[0]):
            level = 0.0
            for k in range(count):
                level = max(level, mode[OFFSET_AT + axis, k] + k_md[r] * mode[SIGMA_AT + axis, k])
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
    return float(0.5 * (once * once - squares))


@jit
def budgets_of(risks: Array, split_at: float, unmonitored: float, budgets: Array) -> None:
    """``budgets[r] = (risk - unmonitored) (split_at, 1 - split_at)``; not positive when nothing is left."""
    for r in range(risks.shape[0]):
        left = risks[r] - unmonitored
        budgets[r, 0], budgets[r, 1] = left * split_at, left * (1.0 - split_at)


@jit
def _usable(n: int, e: Array, group: Ints, rows: Array) -> bool:
    """Whether n satellites have directions, groups, variances and biases that make sense; without branches.

    e (1, 3 n) components of the directions, rows (3, n) variances and biases; both are padded here.
    """
    for i in range(3 * n, padded(3 * n)):
        e[0, i] = 0.0
    for i in range(n, padded(n)):
        rows[0, i], rows[1, i], rows[2, i] = 1.0, 1.0, 1.0
    bad = spread(0.0)
    for i in range(0, 3 * n, WIDTH):
        bad += where_less(absolute(load(e, 0, i)), LONGEST, 0.0, 1.0)
    for i in range(0, n, WIDTH):
        variance, accuracy, bias = load(rows, 0, i), load(rows, 1, i), load(rows, 2, i)
        bad += where_less(0.0, variance, 0.0, 1.0) + where_less(variance, np.inf, 0.0, 1.0)
        bad += where_less(0.0, accuracy, 0.0, 1.0) + where_less(accuracy, np.inf, 0.0, 1.0)
        bad += where_less(bias, 0.0, 1.0, 0.0) + where_less(bias, np.inf, 0.0, 1.0)
    bits = 0
    for i in range(n):
        bits |= group[i]
    return total(bad) == 0.0 and 0 <= bits < MAX_GROUPS


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
    subset: Bools,
    subset_prior: Array,
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
    subsets = subset.shape[0]
    geo, head, mode = scratch(size, subsets)
    columns = capacity(size, subsets)
    removed = np.empty(size, np.bool_)
    flat, g, rows = np.empty((1, 3 * columns)), np.empty(size, np.int64), np.empty((3, columns))
    e, v, a, b = flat.reshape((columns, 3)), rows[0], rows[1], rows[2]
    seen = np.empty(size, np.uint64)  # an unsigned index is not checked for counting from the end
    budgets = np.empty((risks.shape[0], AXES))
    for i in range(first, last):
        n = 0
        for s in range(size):
            seen[n] = s
            n += mask[i, s]
        for k in range(n):
            j = seen[k]
            e[k, 0], e[k, 1], e[k, 2] = los[i, j, 0], los[i, j, 1], los[i, j, 2]
            g[k], v[k], a[k], b[k] = group[i, j], variance[i, j], accuracy[i, j], bias[i, j]
        if not _usable(n, flat, g, rows):
            status[i] = BAD_INPUT
            continue
        sin_h, cos_h = math.sin(heading[i]), math.cos(heading[i])
        status[i] = geometry(e, g, v, b, n, sin_h, cos_h, geo, head)
        if status[i] != SOLVED:
            continue
        count = modes(g, v, a, n, sin_h, cos_h, constellations, False, geo, head, mode)
        set_priors(g, n, count, satellite, constellation, head, mode)
        for m in range(subsets):
            for k in range(n):
                removed[k] = subset[m, seen[k]]
            count = add_subset(count, subset_prior[m], removed[:n], g, a, n, sin_h, cos_h, geo, head, mode)
        spent = unmonitored[i] + (pair_risk(count, mode) if multiple else 0.0)
        budgets_of(risks, split_at, spent, budgets)
        if want_root:
            root(count, k_fa[count - 1], budgets, tolerate, head, mode, level[i])
        if want_closed:
            closed_form(count, k_fa[count - 1], budgets, share0, tolerate, head, mode, closed[i])
