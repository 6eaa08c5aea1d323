"""The least-squares solver of code positions for many epochs, compiled: one call of :mod:`.geometry_kernel` for each.

The same functions give the positions of services, one vehicle at a time, in the chain of the navigator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.positioning.geometry_kernel import (
    MAX_GROUPS,
    SINGULAR,
    SOLVED,
    Geometry,
    find_geometry,
    geometry_scratch,
    solve,
)

__all__ = ["CodeRows", "CodeSolutions", "solve_epochs"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

MOST_SPREAD = 1e9  # variance of the position over that of the best row, above which the geometry counts as singular


class CodeRows(NamedTuple):
    """E epochs of m codes: los (E, m, 3), y and variance (E, m), used (E, m), system (E, m); known height (E,) and its
    weight (E,) [1/m^2], 0 for none."""

    los: Array
    y: Array
    variance: Array
    used: Bools
    system: Ints
    height: Array
    height_weight: Array


class CodeSolutions(NamedTuple):
    """Fields of :class:`~lanebound.integrity.positioning.code_solution.CodeFit`, zeros where nothing is found."""

    x: Array
    cofactor: Array
    rows: Array
    gain: Array
    residual: Array
    redundancy: Array
    weight: Array
    clock_share: Array
    df: Ints
    wsse: Array
    status: Ints


@jit
def solve_epochs(first: int, last: int, codes: CodeRows, out: CodeSolutions) -> None:
    """Solve the epochs first to last - 1."""
    m = codes.system.shape[1]
    geo, place, los = geometry_scratch(m), np.empty(m, np.int64), np.empty((m, 3))
    group, variance, bias, y = np.empty(m, np.int64), np.empty(m), np.zeros(m), np.empty(m)
    for e in range(first, last):
        n = 0
        for s in range(m):
            if codes.used[e, s]:
                place[n], group[n], variance[n], y[n] = s, codes.system[e, s], codes.variance[e, s], codes.y[e, s]
                los[n, 0], los[n, 1], los[n, 2] = codes.los[e, s, 0], codes.los[e, s, 1], codes.los[e, s, 2]
                n += 1
        fix = geo.fix[0]
        fix.height, fix.height_weight = codes.height[e], codes.height_weight[e]
        status = find_geometry(los, group, variance, bias, n, 1.0, 0.0, geo)
        if status == SOLVED and spread_out(n, geo):
            solve(y, group, n, geo)
            copy_out(e, n, place, group, geo, out)
        else:
            out.status[e] = SINGULAR if status == SOLVED else status
            copy_weights(e, n, place, group, variance, out)


@jit(borrows=True)
def spread_out(n: int, geo: Geometry) -> bool:
    """Whether no axis is worse than the best row by more than MOST_SPREAD: sights that differ by rounding alone are
    singular."""
    best = 0.0
    for i in range(n):
        best = max(best, geo.weight[i])
    fix = geo.fix[0]
    return bool(max(fix.p_ee, fix.p_nn, fix.p_uu) * best < MOST_SPREAD)


@jit(borrows=True)
def copy_out(e: int, n: int, place: Ints, group: Ints, geo: Geometry, out: CodeSolutions) -> None:
    """Copy a solution to its epoch."""
    fix = geo.fix[0]
    for k in range(3):
        out.x[e, k] = fix.position[k]
    c = out.cofactor[e]
    c[0, 0], c[1, 1], c[2, 2] = fix.p_ee, fix.p_nn, fix.p_uu
    c[0, 1], c[0, 2], c[1, 2] = fix.p_en, fix.p_eu, fix.p_nu
    c[1, 0], c[2, 0], c[2, 1] = fix.p_en, fix.p_eu, fix.p_nu
    for i in range(n):
        s, w = place[i], geo.weight[i]
        out.weight[e, s], out.residual[e, s], out.clock_share[e, s] = w, geo.residual[i], w * geo.clock[i]
        out.redundancy[e, s] = min(max(geo.free[i], 0.0), 1.0)
        for k in range(3):
            out.rows[e, s, k], out.gain[e, s, k] = geo.row[k, i], w * geo.lever[k, i]
    known = 1 if fix.height_weight > 0.0 else 0
    out.df[e], out.wsse[e], out.status[e] = n + known - 3 - fix.groups, fix.chi2, SOLVED


@jit(borrows=True)
def copy_weights(e: int, n: int, place: Ints, group: Ints, variance: Array, out: CodeSolutions) -> None:
    """Weights and their shares of an epoch without a solution."""
    for g in range(MAX_GROUPS):
        total = 0.0
        for i in range(n):
            if group[i] == g:
                total += 1.0 / variance[i]
        for i in range(n):
            if group[i] == g:
                out.weight[e, place[i]] = 1.0 / variance[i]
                out.clock_share[e, place[i]] = 1.0 / (variance[i] * total)
