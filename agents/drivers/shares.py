"""Commands of continuous actions: shares of a range, from -1 at its low end to 1 at its high end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["share_of", "value_of"]

Array = NDArray[np.float64]


def share_of(value: Array, bounds: tuple[float, float]) -> Array:
    """Values as shares of their bounds, from -1 to 1, clipped.  (...) -> (...)."""
    low, high = bounds
    return np.clip(2.0 * (value - low) / (high - low) - 1.0, -1.0, 1.0)


def value_of(share: Array, bounds: tuple[float, float]) -> Array:
    """The inverse of :func:`share_of` within the bounds.  (...) -> (...)."""
    low, high = bounds
    return low + 0.5 * (share + 1.0) * (high - low)
