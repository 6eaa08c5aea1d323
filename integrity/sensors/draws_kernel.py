"""Draws of an epoch for the satellites of a vehicle or area."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.streams_kernel import fill, uniform

__all__ = ["Draws", "draw_normals", "draw_uniforms"]


class Draws(NamedTuple):
    """Where the draws of an epoch come from, for N vehicles or areas.

    generators (n, N, 4) of n streams; table (3, 256) of :func:`~lanebound.integrity.core.streams_kernel.fill`; places
    (N, S) of the satellites to draw for, (0, 0): for all; drawn (N, W): the draws themselves where they do not come
    from a generator for each row, else (0, 0).
    """

    generators: NDArray[np.uint64]
    table: NDArray[np.float64]
    places: NDArray[np.bool_]
    drawn: NDArray[np.float64]


@jit(borrows=True)
def draw_normals(generator, v, places, table, out):  # type: ignore[no-untyped-def]
    """Standard normals (S w,), w for each satellite of row v of ``places``, and 0 for the others.

    Without places, (0, 0), all numbers are drawn.
    """
    if places.shape[0] == 0:
        fill(generator, table, out)
        return
    used = places[v]
    width, left = out.shape[0] // used.shape[0], used.sum()
    fill(generator, table, out[: left * width])
    for s in range(used.shape[0] - 1, -1, -1):  # spread the draws, the last first
        left -= used[s]
        for w in range(width):
            out[s * width + w] = out[left * width + w] if used[s] else 0.0


@jit(borrows=True)
def draw_uniforms(generator, v, places, out):  # type: ignore[no-untyped-def]
    """The same of uniforms in [0, 1)."""
    if places.shape[0] == 0:
        for w in range(out.shape[0]):
            out[w] = uniform(generator)
        return
    width = out.shape[0] // places.shape[1]
    for s in range(places.shape[1]):
        for w in range(width):
            out[s * width + w] = uniform(generator) if places[v, s] else 0.0
