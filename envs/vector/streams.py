"""Draws of N single environments side by side: each from generators of its own, for the satellites of its own hour."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity import streams_kernel as sk
from lanebound.integrity.streams import ZIGGURAT, Streams

__all__ = ["CrewStreams"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
COMMON = ("atmosphere", "station", "network")  # to the vehicles of an environment, which share its area
BY_SATELLITE = ("gnss", "atmosphere", "station")


class CrewStreams(Streams):
    """Draws for N environments of M vehicles, the ego first, in N M rows: the numbers that each would draw alone.

    A single environment draws for the satellites that rise in its hour, the engine has places for those of all hours:
    the numbers are spread over the places taken, with zeros in the others; and so over those of vehicles.

    Parameters
    ----------
    seeds : (N) of the episodes, for the egos' instruments and for the areas
    fleet_seeds : (N) of the others' instruments
    crew : (N, M - 1) bool, places of the others that a vehicle has taken
    used : (N, S) bool, places that hold a satellite
    """

    def __init__(
        self, seeds: Sequence[int], fleet_seeds: Sequence[int], crew: NDArray[np.bool_], used: NDArray[np.bool_]
    ) -> None:
        super().__init__(list(seeds))
        self._others, self._vehicles = Streams(list(fleet_seeds)), 1 + crew.shape[1]
        self.batch = len(seeds) * self._vehicles
        self._used, self._crew, self._egos = used.copy(), crew.copy(), np.ones((len(seeds), 1), dtype=np.bool_)

    def normal(self, name: str, *shape: int) -> Array:
        """Standard normal draws (N M, *shape)."""
        return self._draw(name, shape, normal=True)

    def uniform(self, name: str, *shape: int) -> Array:
        """Uniform draws in [0, 1), likewise."""
        return self._draw(name, shape, normal=False)

    def adopt(self, rows: Rows, other: CrewStreams) -> None:
        """Go on with the generators of the environments of other streams (n) in ``rows`` (n,)."""
        self._used[rows], self._crew[rows] = other._used, other._crew
        for mine, theirs in ((self, other), (self._others, other._others)):
            for row, seed in zip(rows.tolist(), theirs._seeds, strict=True):
                mine._seeds[row] = seed
            for name in {*mine._states, *theirs._states}:
                mine.states(name)[rows] = theirs.states(name)

    def _draw(self, name: str, shape: tuple[int, ...], normal: bool) -> Array:
        one = self._drawn(self, self._egos, name, shape, normal)
        if self._vehicles > 1:
            if name in COMMON:
                one = np.repeat(one, self._vehicles, 1)
            else:
                others = self._drawn(self._others, self._crew, name, shape, normal)
                one = np.concatenate([one, others], 1)
        return one.reshape(self.batch, *shape)

    def _drawn(
        self, streams: Streams, crew: NDArray[np.bool_], name: str, shape: tuple[int, ...], normal: bool
    ) -> Array:
        """Draws (N, m, *shape) of a crew (N, m) in the places taken, by vehicles and, where it is so, satellites."""
        count, vehicles = crew.shape
        places = self._used.shape[1]
        states = streams.states(name)
        by_satellite = name in BY_SATELLITE and len(shape) > (name == "station") and shape[0] == places
        if by_satellite or not crew.all():
            taken = crew[:, :, None] & self._used[:, None, :] if by_satellite else crew
            taken = taken.reshape(count, -1)
            out = np.zeros((count, 1, taken.shape[1], vehicles * math.prod(shape) // taken.shape[1]))
            if normal:
                sk.normals_at(states, taken, ZIGGURAT, out)
            else:
                sk.uniforms_at(states, taken, out)
        else:
            out = np.empty((count, vehicles * math.prod(shape)))
            if normal:
                sk.normals(states, self._rows, ZIGGURAT, out)
            else:
                sk.uniforms(states, self._rows, out)
        return out.reshape(count, vehicles, *shape)
