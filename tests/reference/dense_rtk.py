"""RTK by single differences as one dense least-squares problem: the reference that the fast kernel must equal.

Single differences with one receiver clock for each system, band and observable type are equivalent to double
differences (equations of S1 section 2): the clock takes the place of the reference satellite. Unknowns are
``[x (3), clocks, ambiguities]``; rows are code and phase of each band with ``y = -e x + clock (+ lambda N)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape

__all__ = ["DenseSolution", "double_difference_matrix", "solve_dense"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DenseSolution:
    """Position (3,) [m] and covariance (3,3); ambiguities (n,) [cycles], covariance (n,n), owners and bands (n,)."""

    position_enu_m: Array
    covariance_m2: Array
    ambiguity_cycles: Array
    ambiguity_covariance: Array
    owner: NDArray[np.int64]
    band: NDArray[np.int64]


def _unknown_ambiguities(
    system: NDArray[np.int64], held: NDArray[np.bool_], candidates: NDArray[np.int64], bands: int
) -> list[tuple[int, int]]:
    """(satellite, band) pairs to estimate: all candidates but the first of each system in which none is held."""
    referenced = {int(c) for c in np.unique(system[held])}
    pairs: list[tuple[int, int]] = []
    for s in candidates:
        if int(system[s]) not in referenced:
            referenced.add(int(system[s]))
            continue
        pairs += [(int(s), b) for b in range(bands)]
    return pairs


def solve_dense(
    los_enu: Array,
    system: NDArray[np.int64],
    code_m: Array,
    phase_m: Array,
    variance_code_m2: Array,
    variance_phase_m2: Array,
    wavelength_m: Array,
    code_used: NDArray[np.bool_],
    held: NDArray[np.bool_],
    integers: Array,
    candidates: NDArray[np.int64],
    bands: int = 2,
) -> DenseSolution:
    """Weighted least squares over all rows at once.

    Parameters
    ----------
    los_enu : (S, 3); system : (S,); code_m, phase_m : (S, 2) single differences [m]
    variance_code_m2, variance_phase_m2 : (S,) of one band
    wavelength_m : (systems, bands); code_used, held : (S,) bool; integers : (S, 2) of the held satellites [cycles]
    candidates : indices of the satellites whose ambiguities are to be estimated, most precise first

    Raises
    ------
    InputError
        When a shape is wrong, a variance is not positive, or the geometry is singular.
    """
    require_shape("los_enu", require_finite("los_enu", los_enu), (None, 3))
    for name, variance in (("variance_code_m2", variance_code_m2), ("variance_phase_m2", variance_phase_m2)):
        if not (variance > 0.0).all():
            raise InputError(f"{name} must be positive, got {variance.min()}: give each satellite a variance above 0")
    unknown = _unknown_ambiguities(system, held, candidates, bands)
    column = {pair: i for i, pair in enumerate(unknown)}
    clocks: dict[tuple[int, int, str], int] = {}
    rows: list[tuple[Array, int, int | None, float, float, float]] = []

    def add(s: int, b: int, kind: str, y: float, variance: float) -> None:
        clock = clocks.setdefault((int(system[s]), b, kind), len(clocks))
        wavelength = float(wavelength_m[system[s], b])
        rows.append((-los_enu[s], clock, column.get((s, b)) if kind == "phase" else None, wavelength, y, variance))

    for b in range(bands):
        for s in np.flatnonzero(code_used):
            add(int(s), b, "code", float(code_m[s, b]), float(variance_code_m2[s]))
        for s in np.flatnonzero(held):
            resolved = float(phase_m[s, b] - wavelength_m[system[s], b] * integers[s, b])
            add(int(s), b, "phase", resolved, float(variance_phase_m2[s]))
        for s in candidates:
            add(int(s), b, "phase", float(phase_m[s, b]), float(variance_phase_m2[s]))

    n_clock, n_amb = len(clocks), len(unknown)
    G = np.zeros((len(rows), 3 + n_clock + n_amb))
    for i, (g, clock, ambiguity, wavelength, _, _) in enumerate(rows):
        G[i, :3] = g
        G[i, 3 + clock] = 1.0
        if ambiguity is not None:
            G[i, 3 + n_clock + ambiguity] = wavelength
    y = np.array([row[4] for row in rows])
    root_w = 1.0 / np.sqrt([row[5] for row in rows])
    if np.linalg.matrix_rank(root_w[:, None] * G) < G.shape[1]:
        raise InputError("the geometry is singular: use more satellites in one system")
    orthogonal, triangle = np.linalg.qr(root_w[:, None] * G)  # the normal equations would lose half of the digits
    inverse = np.linalg.inv(triangle)
    Q = inverse @ inverse.T
    x = inverse @ (orthogonal.T @ (root_w * y))
    a = slice(3 + n_clock, None)
    return DenseSolution(
        position_enu_m=x[:3],
        covariance_m2=Q[:3, :3],
        ambiguity_cycles=x[a],
        ambiguity_covariance=Q[a, a],
        owner=np.array([s for s, _ in unknown], dtype=np.int64),
        band=np.array([b for _, b in unknown], dtype=np.int64),
    )


def double_difference_matrix(system: NDArray[np.int64], reference: NDArray[np.int64]) -> Array:
    """D with ``D y`` = double differences: each satellite minus its system's reference.  system (S,) -> (S - refs, S).

    reference : (systems,) index of each system's reference satellite, -1 where it has none.
    """
    count = len(system)
    rows = []
    for s in range(count):
        r = int(reference[system[s]])
        if r >= 0 and r != s:
            row = np.zeros(count)
            row[s], row[r] = 1.0, -1.0
            rows.append(row)
    return np.array(rows).reshape(-1, count)
