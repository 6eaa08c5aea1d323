"""Draws of an epoch for rows of vehicles, into arrays that last."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.streams_kernel import fill, uniform

__all__ = ["draw_normals", "draw_uniforms"]


@jit(borrows=True)
def draw_normals(first, last, states, table, out):  # type: ignore[no-untyped-def]
    """Standard normals in the rows ``first`` to ``last - 1`` of out (B, W); states (B, 4), a generator for each row.

    A single generator (1, 4) draws all rows, with the first.
    """
    if states.shape[0] == out.shape[0]:
        for v in range(first, last):
            fill(states[v], table, out[v])
    elif first == 0:
        for v in range(out.shape[0]):
            fill(states[0], table, out[v])


@jit(borrows=True)
def draw_uniforms(first, last, states, out):  # type: ignore[no-untyped-def]
    """The same of uniforms in [0, 1)."""
    if states.shape[0] == out.shape[0]:
        for v in range(first, last):
            for w in range(out.shape[1]):
                out[v, w] = uniform(states[v])
    elif first == 0:
        for v in range(out.shape[0]):
            for w in range(out.shape[1]):
                out[v, w] = uniform(states[0])
