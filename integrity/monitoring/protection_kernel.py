"""Protection levels of one epoch from its fault modes: the closed form and the multi-hypothesis root.

The multi-hypothesis level of an axis solves (S2 eq 10-11, with ``P_0 = 2``, ``T_i = K_fa sigma_di``)::

    f(PL) = sum_i P_i Q((PL - T_i - b_i) / sigma_i) = budget

by third-order steps on ``log f``, which is nearly a parabola: two or three evaluations reach 1e-10. The tail sum runs
over whole vectors with a polynomial for the Mills ratio ``Q(z)/phi(z)`` and one for ``exp``, both of relative error
below 4e-11. A level is accepted when an evaluation proves ``f(PL) <= budget``, or after a step so short that its
remainder is less than the amount by which the level is then raised.

Modes: :class:`lanebound.integrity.monitoring.separation_kernel.Modes`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
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
from lanebound.integrity.monitoring.separation_kernel import (
    Modes,
    add_subset,
    find_modes,
    mode_scratch,
    moment_scratch,
    set_factors,
    set_priors,
)
from lanebound.integrity.positioning.geometry_kernel import (
    MAX_GROUPS,
    SOLVED,
    capacity,
    find_geometry,
    geometry_scratch,
)

__all__ = [
    "RULES",
    "Epochs",
    "LevelResults",
    "RiskTables",
    "closed_form",
    "closed_form_published",
    "find_levels",
    "multi_hypothesis_pl",
    "pair_risk",
    "q_inverse",
    "split_budgets",
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


@jit(borrows=True, forceinline=True)
def _find_offsets(count: int, modes: Modes) -> None:
    """Offset and rate of both axes; entries without effect to the next multiple of WIDTH."""
    for axis in range(AXES):
        for k in range(0, count, WIDTH):
            store(1.0 / load(modes.sigma, axis, k), modes.rate, axis, k)
            offset = fma(load(modes.delta, axis, k), load(modes.k_fa, k), load(modes.bias, axis, k))
            store(offset, modes.offset, axis, k)
    for k in range(count, padded(count)):
        modes.weight[k], modes.log_prior[k] = 0.0, -np.inf
        for axis in range(AXES):
            modes.offset[axis, k], modes.rate[axis, k] = 0.0, 0.0


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
def _add_tails(
    x: float, axis: int, k: int, weights: Array, offsets: Array, rates: Array, f: Any, f1: Any, f2: Any, f3: Any
) -> Any:
    """The sums of :func:`tails`, continued by the modes k to k + WIDTH - 1."""
    rate, weight = load(rates, axis, k), load(weights, k)
    z = (x - load(offsets, axis, k)) * rate
    upper, e = _upper_tail(z)
    first = weight * rate * e
    second = first * rate
    return fma(weight, upper, f), f1 + first, fma(second, z, f2), fma(second * rate, fma(z, z, -1.0), f3)


@jit(borrows=True)
def tails(x_at: float, x_ct: float, count: int, weights: Array, offsets: Array, rates: Array) -> Any:
    """``f``, ``-f'``, ``f''`` and ``-f'''`` of AT at x_at, and those of CT at x_ct: two chains side by side."""
    zero = spread(0.0)
    at, ct = (zero, zero, zero, zero), (zero, zero, zero, zero)
    for k in range(0, count, WIDTH):
        at = _add_tails(x_at, 0, k, weights, offsets, rates, *at)
        ct = _add_tails(x_ct, 1, k, weights, offsets, rates, *ct)
    return _summed(at), _summed(ct)


@jit
def _summed(lanes: Any) -> Any:
    f, f1, f2, f3 = lanes
    return total(f), total(f1) * INV_SQRT2PI, total(f2) * INV_SQRT2PI, total(f3) * INV_SQRT2PI


@jit(borrows=True)
def _start(axis: int, log_budget: float, count: int, modes: Modes) -> float:
    """The largest level that one mode alone needs: just below the root."""
    x = spread(0.0)
    for k in range(0, count, WIDTH):
        log_p = log_budget - load(modes.log_prior, k)
        t = root_of(minimum(log_p, -0.7) * -2.0)  # as _rough_quantile
        over = fma(t, fma(t, 0.010328, 0.802853), 2.515517)
        under = fma(t, fma(t, fma(t, 0.001308, 0.189269), 1.432788), 1.0)
        level = fma(t - over / under, load(modes.sigma, axis, k), load(modes.offset, axis, k))
        x = maximum(x, where_less(log_p, -0.7, level, 0.0))
    return float(largest(x))


@jit(borrows=True)
def _ceiling(axis: int, budget: float, count: int, modes: Modes) -> float:
    """A level above the root: every mode then uses at most its prior's share of the budget."""
    priors = 0.0
    for k in range(count):
        priors += modes.weight[k]
    z = max(q_inverse(budget / priors), 0.0)
    x = 0.0
    for k in range(count):
        if modes.weight[k] > 0.0:
            x = max(x, modes.offset[axis, k] + z * modes.sigma[axis, k])
    return x


@jit(borrows=True)
def _next_level(
    i: int, axis: int, x: float, low: float, high: float, sums: Any, budget: float, count: int, modes: Modes
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
        high = min(high, _ceiling(axis, budget, count, modes))
    if i >= PATIENCE and (i % 2 == 0 or not low < x < high):
        x = 0.5 * (low + high)
    elif not low < x < high:
        x = 0.5 * (low + high) if high < np.inf else 2.0 * low + 1e-6
    return False, x, low, high


@jit(borrows=True, forceinline=True)
def _roots(budget_at: float, budget_ct: float, count: int, modes: Modes, out: Array) -> None:
    """The levels where the tail sums of AT and CT meet their budgets, from above; a budget of 0 gives inf."""
    done_at, done_ct = budget_at <= 0.0, budget_ct <= 0.0
    x_at = 0.0 if done_at else _start(0, math.log(budget_at), count, modes)
    x_ct = 0.0 if done_ct else _start(1, math.log(budget_ct), count, modes)
    low_at, low_ct, high_at, high_ct = 0.0, 0.0, np.inf, np.inf
    out[0], out[1] = np.inf, np.inf
    for i in range(MAX_STEPS):
        if done_at and done_ct:
            break
        at, ct = tails(x_at, x_ct, count, modes.weight, modes.offset, modes.rate)
        if not done_at:
            done_at, x_at, low_at, high_at = _next_level(i, 0, x_at, low_at, high_at, at, budget_at, count, modes)
            out[0] = x_at if done_at else high_at
        if not done_ct:
            done_ct, x_ct, low_ct, high_ct = _next_level(i, 1, x_ct, low_ct, high_ct, ct, budget_ct, count, modes)
            out[1] = x_ct if done_ct else high_ct


@jit
def _remaining(budget: float, sigma: float, lost: float, tolerate: bool) -> float:
    """Risk budget of an axis less that of the modes without a solution; 0 when no level can meet it."""
    left = budget - (lost if tolerate else 0.0)
    hopeless = left <= 0.0 or (lost > 0.0 and not tolerate) or not sigma < np.inf
    return 0.0 if hopeless else left


@jit(borrows=True)
def multi_hypothesis_pl(count: int, budgets: Array, lost: float, tolerate: bool, modes: Modes, out: Array) -> None:
    """Multi-hypothesis protection levels (S2 eq 10-11) of ``count`` modes with priors and factors set.

    Parameters
    ----------
    budgets : (R, 2) integrity risk of AT and CT, less what is spent on unmonitored faults; one row for each risk.
    lost : total prior of the modes without a solution.
    tolerate : move that prior into the unmonitored risk; otherwise such a mode makes PL inf.
    out : (R, 2) protection levels [m], never below the root and above it by at most 5e-10 relative; inf without one.
    """
    _find_offsets(count, modes)
    for r in range(budgets.shape[0]):
        at = _remaining(budgets[r, 0], modes.sigma[0, 0], lost, tolerate)
        ct = _remaining(budgets[r, 1], modes.sigma[1, 0], lost, tolerate)
        _roots(at, ct, count, modes, out[r])


@jit(borrows=True)
def closed_form(
    count: int, budgets: Array, share0: float, lost: float, tolerate: bool, modes: Modes, out: Array
) -> None:
    """``max_i K_fa sigma_di + K_md,i sigma_i + b_i``, ``K_md,i = Qinv(w_i budget / P_i)`` (S1 eq 17, exact factors).

    ``share0`` is the fault-free mode's share w_0 of the budget (the others share the rest equally), 0 for equal shares.
    Other parameters as :func:`multi_hypothesis_pl`; the result is never below its level.
    """
    first = 1.0 / count if share0 <= 0.0 or count == 1 else share0
    other = (1.0 - first) / max(count - 1, 1)
    _find_offsets(count, modes)
    for axis in range(AXES):
        for r in range(budgets.shape[0]):
            budget = _remaining(budgets[r, axis], modes.sigma[axis, 0], lost, tolerate)
            if budget <= 0.0:
                out[r, axis] = np.inf
                continue
            level = modes.offset[axis, 0] + q_inverse(0.5 * first * budget) * modes.sigma[axis, 0]
            prior, k_md = -1.0, 0.0
            for k in range(1, count):
                if modes.weight[k] > 0.0:
                    if modes.prior[k] != prior:
                        prior = modes.prior[k]
                        k_md = q_inverse(other * budget / prior)
                    level = max(level, modes.offset[axis, k] + k_md * modes.sigma[axis, k])
            out[r, axis] = level


@jit(borrows=True)
def closed_form_published(count: int, k_md: Array, modes: Modes, out: Array) -> None:
    """S1 eq 17 as printed, one unsplit ``k_md`` (R,) for each risk and every mode; out (R, 2) [m]."""
    _find_offsets(count, modes)
    for axis in range(AXES):
        for r in range(k_md.shape[0]):
            level = 0.0
            for k in range(count):
                level = max(level, modes.offset[axis, k] + k_md[r] * modes.sigma[axis, k])
            out[r, axis] = level


@jit(borrows=True)
def pair_risk(count: int, priors: Array) -> float:
    """Bound of the probability of two or more faults at once, ``sum_{i<j} P_i P_j`` over the modes 1 to count - 1."""
    p, p2, k = spread(0.0), spread(0.0), 1
    while k + WIDTH <= count:
        prior = load(priors, k)
        p, p2, k = p + prior, fma(prior, prior, p2), k + WIDTH
    once, squares = total(p), total(p2)
    for i in range(k, count):
        once += priors[i]
        squares += priors[i] * priors[i]
    return float(0.5 * (once * once - squares))


@jit(borrows=True)
def split_budgets(risks: Array, split_at: float, unmonitored: float, budgets: Array) -> None:
    """``budgets[r] = (risk - unmonitored) (split_at, 1 - split_at)``; not positive when nothing is left."""
    for r in range(risks.shape[0]):
        left = risks[r] - unmonitored
        budgets[r, 0], budgets[r, 1] = left * split_at, left * (1.0 - split_at)


class Epochs(NamedTuple):
    """E epochs of N satellites.

    los (E, N, 3) unit vectors receiver to satellite; in_view (E, N) bool; group (E, N) clock of each satellite;
    variance, accuracy (E, N) [m^2]; bias (E, N) [m]; heading (E,) [rad]; unmonitored (E,) risk already spent [-].
    """

    los: Array
    in_view: Bools
    group: Ints
    variance: Array
    accuracy: Array
    bias: Array
    heading: Array
    unmonitored: Array


class RiskTables(NamedTuple):
    """satellite, constellation (MAX_GROUPS,) priors [-]; subset (M, N) bool and subset_prior (M,) of further modes;
    k_fa (C, K) threshold by the number of fault modes and by rank, as set_factors takes it; risks (R,) [-]."""

    satellite: Array
    constellation: Array
    subset: Bools
    subset_prior: Array
    k_fa: Array
    risks: Array


RULES = record(
    at_share="share of the risk along track [-]",
    fault_free_share="share w_0 of the fault-free mode in the closed form, 0: equal shares [-]",
    constellations=("?", "add a mode for each constellation"),
    multiple=("?", "spend risk on two or more faults at once"),
    tolerate=("?", "spend the prior of modes without a solution"),
    closed=("?", "compute the closed form"),
)
"""Rules of :func:`find_levels`."""


class LevelResults(NamedTuple):
    """status (E,) code of geometry_kernel or BAD_INPUT; root, closed (E, R, 2) protection levels [m]."""

    status: Ints
    root: Array
    closed: Array


@jit(borrows=True)
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
def find_levels(
    first: int, last: int, epochs: Epochs, tables: RiskTables, rules: Records, results: LevelResults
) -> None:
    """Protection levels of the epochs ``first`` to ``last - 1``.

    The status of an epoch with an entry in view that cannot be used is BAD_INPUT.
    """
    rule, size, subsets = rules[0], epochs.in_view.shape[1], tables.subset.shape[0]
    geo, modes = geometry_scratch(size, subsets), mode_scratch(size, subsets)
    moments, columns = moment_scratch(size), capacity(size)
    removed = np.empty(size, np.bool_)
    flat, g, rows = np.empty((1, 3 * columns)), np.empty(size, np.int64), np.empty((3, columns))
    e, v, a, b = flat.reshape((columns, 3)), rows[0], rows[1], rows[2]
    seen = np.empty(size, np.uint64)  # an unsigned index is not checked for counting from the end
    budgets = np.empty((tables.risks.shape[0], AXES))
    los, in_view, group, status = epochs.los, epochs.in_view, epochs.group, results.status
    variance, accuracy, bias = epochs.variance, epochs.accuracy, epochs.bias
    for i in range(first, last):
        n = 0
        for s in range(size):
            seen[n] = s
            n += in_view[i, s]
        for k in range(n):
            j = seen[k]
            e[k, 0], e[k, 1], e[k, 2] = los[i, j, 0], los[i, j, 1], los[i, j, 2]
            g[k], v[k], a[k], b[k] = group[i, j], variance[i, j], accuracy[i, j], bias[i, j]
        if not _usable(n, flat, g, rows):
            status[i] = BAD_INPUT
            continue
        sin_h, cos_h = math.sin(epochs.heading[i]), math.cos(epochs.heading[i])
        status[i] = find_geometry(e, g, v, b, n, sin_h, cos_h, geo)
        if status[i] != SOLVED:
            continue
        count = find_modes(g, a, n, sin_h, cos_h, rule.constellations, False, geo, moments, modes)
        lost = set_priors(g, n, count, tables.satellite, tables.constellation, geo.clocks, modes)
        for m in range(subsets):
            for k in range(n):
                removed[k] = tables.subset[m, seen[k]]
            count, unsolved = add_subset(
                count, tables.subset_prior[m], removed[:n], g, n, sin_h, cos_h, geo, moments, modes
            )
            lost += unsolved
        spent = epochs.unmonitored[i] + (pair_risk(count, modes.prior) if rule.multiple else 0.0)
        split_budgets(tables.risks, rule.at_share, spent, budgets)
        set_factors(n, count, tables.k_fa[count - 1], 0.0, geo.clocks, modes)
        multi_hypothesis_pl(count, budgets, lost, rule.tolerate, modes, results.root[i])
        if rule.closed:
            closed_form(count, budgets, rule.fault_free_share, lost, rule.tolerate, modes, results.closed[i])
