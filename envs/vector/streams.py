"""Draws of N single environments side by side: each from generators of its own, for the satellites of its own hour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.vector.senses_kernel import spread
from lanebound.integrity.streams import Streams

__all__ = ["CrewStreams"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
COMMON = ("atmosphere", "station", "network")  # to the vehicles of an environment, which share its area
BY_SATELLITE = ("gnss", "atmosphere", "station")


class CrewStreams(Streams):
    """Draws for N environments of M vehicles, the ego first, in N M rows: the numbers that each would draw alone.

    A single environment draws for the satellites that rise in its hour, the engine has places for those of all hours:
    the numbers are spread over the places taken, with zeros in the others.

    Parameters
    ----------
    seeds : (N) of the episodes, for the egos' instruments and for the areas
    fleet_seeds : (N) of the others' instruments
    vehicles : number M
    used : (N, S) bool, places that hold a satellite
    """

    def __init__(
        self, seeds: Sequence[int], fleet_seeds: Sequence[int], vehicles: int, used: NDArray[np.bool_]
    ) -> None:
        super().__init__(list(seeds))
        self.batch = len(seeds) * vehicles
        self._others, self._vehicles = Streams(list(fleet_seeds)), vehicles
        self._used, self._counts = used.copy(), used.sum(1).tolist()

    def normal(self, name: str, *shape: int) -> Array:
        """Standard normal draws (N M, *shape)."""
        return self._draw(name, shape, "standard_normal")

    def uniform(self, name: str, *shape: int) -> Array:
        """Uniform draws in [0, 1), likewise."""
        return self._draw(name, shape, "random")

    def adopt(self, rows: Rows, other: CrewStreams) -> None:
        """Go on with the generators of the environments of other streams (n) in ``rows`` (n,)."""
        self._used[rows] = other._used
        self._counts = self._used.sum(1).tolist()
        for mine, theirs in ((self, other), (self._others, other._others)):
            _follow(mine._seeds, theirs._seeds, rows)
            for name in {*mine._generators, *theirs._generators}:
                _follow(mine.generators(name), theirs.generators(name), rows)

    def _draw(self, name: str, shape: tuple[int, ...], law: str) -> Array:
        one = self._drawn(self, 1, name, shape, law)
        if self._vehicles > 1:
            if name in COMMON:
                one = np.repeat(one, self._vehicles, 1)
            else:
                others = self._drawn(self._others, self._vehicles - 1, name, shape, law)
                one = np.concatenate([one, others], 1)
        return one.reshape(self.batch, *shape)

    def _drawn(self, streams: Streams, vehicles: int, name: str, shape: tuple[int, ...], law: str) -> Array:
        """Draws (N, vehicles, *shape), those for satellites in the places taken."""
        count, places = self._used.shape
        generators, width = streams.generators(name), math.prod(shape)
        out = np.empty((count, vehicles * width))
        sparse = name in BY_SATELLITE and len(shape) > (name == "station") and shape[0] == places
        sizes = self._counts if sparse else [places] * count
        each = vehicles * width // places if sparse else 0
        for row, generator, size in zip(out, generators, sizes, strict=True):
            getattr(generator, law)(out=row[: size * each] if sparse else row)
        if not sparse:
            return out.reshape(count, vehicles, *shape)
        whole = np.zeros((count, vehicles, places, width // places))
        spread(out, self._used, whole)
        return whole.reshape(count, vehicles, *shape)


def _follow(mine: list[Any], theirs: list[Any], rows: Rows) -> None:
    """Put the entries of another list in place of some of one's own."""
    for row, new in zip(rows.tolist(), theirs, strict=True):
        mine[row] = new
