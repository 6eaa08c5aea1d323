"""Draws of an epoch for rows of vehicles, into arrays that last."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.streams_kernel import fill, uniform

__all__ = ["draw_normals", "draw_normals_at", "draw_uniforms", "draw_uniforms_at"]


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


@jit(borrows=True)
def draw_normals_at(first, last, states, places, table, out):  # type: ignore[no-untyped-def]
    """:func:`draw_normals` by satellite, out (B, S W), for the satellites of ``places`` (B, S) alone; 0 for the others.

    Without places (0, 0) all satellites draw.
    """
    if places.shape[0] == 0:
        draw_normals(first, last, states, table, out)
        return
    width = out.shape[1] // places.shape[1]
    for v in range(first, last):
        row, left = out[v], 0
        for s in range(places.shape[1]):
            left += places[v, s]
        fill(states[v], table, row[: left * width])
        for s in range(places.shape[1] - 1, -1, -1):  # spread the draws, the last first
            left -= places[v, s]
            for w in range(width):
                row[s * width + w] = row[left * width + w] if places[v, s] else 0.0


@jit(borrows=True)
def draw_uniforms_at(first, last, states, places, out):  # type: ignore[no-untyped-def]
    """The same of uniforms in [0, 1)."""
    if places.shape[0] == 0:
        draw_uniforms(first, last, states, out)
        return
    width = out.shape[1] // places.shape[1]
    for v in range(first, last):
        for s in range(places.shape[1]):
            for w in range(width):
                out[v, s * width + w] = uniform(states[v]) if places[v, s] else 0.0
