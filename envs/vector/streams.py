"""Draws of N single environments side by side: each from generators of its own, for the satellites of its own hour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.streams import Streams

__all__ = ["StackedStreams"]

Array = NDArray[np.float64]


class StackedStreams(Streams):
    """One seed for each environment, whose draws for satellites are spread over the columns of all hours' satellites.

    So each environment meets the same numbers as alone, and an engine over these streams is equal to single ones. They
    are drawn generator by generator, which is slower than jointly.

    Parameters
    ----------
    seeds : of the environments' instruments
    used : (N, S) bool, satellites that each environment's own sky holds
    """

    def __init__(self, seeds: Sequence[int], used: NDArray[np.bool_]) -> None:
        super().__init__(list(seeds))
        self._used = used

    def normal(self, name: str, *shape: int) -> Array:
        """Standard normal draws (N, *shape), zeros for satellites that an environment's sky does not hold."""
        return self._spread(name, shape, "standard_normal")

    def uniform(self, name: str, *shape: int) -> Array:
        """Uniform draws in [0, 1), likewise."""
        return self._spread(name, shape, "random")

    def adopt(self, rows: NDArray[np.int64], other: StackedStreams) -> None:
        """Go on with the generators of other streams (n) in ``rows`` (n,)."""
        self._used[rows] = other._used
        for name in {*self._generators, *other._generators}:
            mine, theirs = self.generators(name), other.generators(name)
            for row, generator in zip(rows.tolist(), theirs, strict=True):
                mine[row] = generator

    def _spread(self, name: str, shape: tuple[int, ...], law: str) -> Array:
        out, by_satellite = np.zeros((self.batch, *shape)), bool(shape) and shape[0] == self._used.shape[1]
        for row, generator in enumerate(self.generators(name)):
            if by_satellite:
                columns = np.flatnonzero(self._used[row])
                out[row, columns] = getattr(generator, law)((columns.size, *shape[1:]))
            else:
                out[row] = getattr(generator, law)(shape)
        return out
