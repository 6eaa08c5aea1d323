"""Triangles of a polygon by cutting off its ears; ``x``, ``y`` are two axes of its plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit

__all__ = ["clip_ears"]


@jit
def clip_ears(x: Any, y: Any) -> Any:
    """Cut a polygon (n,), counter-clockwise, into n - 2 triangles of its corners.  -> (n - 2, 3).

    A corner is an ear if it is convex and no other corner lies in its triangle. Where rounding leaves no ear, as in
    polygons whose sides touch, the corner of the largest area is cut off, so that the work always ends.
    """
    n = x.size
    following, before = np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        following[k], before[k] = (k + 1) % n, (k - 1) % n
    out = np.empty((max(n - 2, 0), 3), np.int64)
    left, here, waited, made = n, 0, 0, 0
    while left > 3:
        a, b = before[here], following[here]
        if _area(x, y, a, here, b) > 0.0 and _is_empty(x, y, a, here, b, following):
            ear = here
        elif waited > left:
            ear, largest, k = here, -np.inf, here
            for _ in range(left):
                size = _area(x, y, before[k], k, following[k])
                if size > largest:
                    ear, largest = k, size
                k = following[k]
        else:
            here, waited = b, waited + 1
            continue
        a, b = before[ear], following[ear]
        out[made, 0], out[made, 1], out[made, 2] = a, ear, b
        following[a], before[b] = b, a
        left, made, waited, here = left - 1, made + 1, 0, b
    if n > 2:
        out[made, 0], out[made, 1], out[made, 2] = before[here], here, following[here]
    return out


@jit
def _area(x: Any, y: Any, a: int, b: int, c: int) -> Any:
    """Twice the signed area of a triangle of corners."""
    return (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])


@jit
def _is_empty(x: Any, y: Any, a: int, b: int, c: int, following: Any) -> bool:
    """Whether no other corner that is left lies in the triangle of three; corners at the same place do not count."""
    k = following[c]
    while k != a:
        if not (
            (x[k] == x[a] and y[k] == y[a]) or (x[k] == x[b] and y[k] == y[b]) or (x[k] == x[c] and y[k] == y[c])
        ) and (_area(x, y, a, b, k) >= 0.0 and _area(x, y, b, c, k) >= 0.0 and _area(x, y, c, a, k) >= 0.0):
            return False
        k = following[k]
    return True
