"""Draws of N single environments side by side: each from generators of its own, for the satellites of its own hour."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core import streams_kernel as sk
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import ZIGGURAT, Streams

__all__ = ["CrewStreams"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
COMMON = ("atmosphere", "station", "network", "broadcast", "augmentation")  # shared by the vehicles of an environment
BY_SATELLITE = ("gnss", "near_objects", "atmosphere", "station", "broadcast", "augmentation")
ALSO_OTHERS = ("station", "broadcast", "augmentation")  # from which an area draws other numbers as well, of one axis


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
        self._used, self._crew = used.copy(), crew.copy()
        self._find_places()

    def _find_places(self) -> None:
        """Places of the satellites of all others (N, (M - 1) S), and whether any place of a vehicle is empty."""
        count = self._used.shape[0]
        self._crew_used = (self._crew[:, :, None] & self._used[:, None, :]).reshape(count, -1)
        self._complete = bool(self._crew.all())

    @property
    def draws_by_row(self) -> bool:
        """Whether every row has a generator of its own: there are egos alone."""
        return bool(self._vehicles == 1)

    @property
    def places(self) -> NDArray[np.bool_]:
        """(N, S) places that hold a satellite; the array stays in place."""
        return self._used

    def normal(self, name: str, *shape: int, where: NDArray[np.bool_] | None = None) -> Array:
        """Standard normal draws (N M, *shape); of a common stream perhaps by some environments alone."""
        if where is not None and name not in COMMON:
            raise InputError(f"where must be None for stream {name!r}, which every vehicle draws by itself")
        draws = None if where is None or where.all() else where[:: self._vehicles]
        return self._draw(name, shape, True, draws)

    def uniform(self, name: str, *shape: int) -> Array:
        """Uniform draws in [0, 1), likewise."""
        return self._draw(name, shape, False, None)

    def adopt(self, rows: Rows, other: Streams, theirs: Rows) -> None:
        """Go on with the generators of the environments ``theirs`` (n,) of other streams in ``rows`` (n,)."""
        if not isinstance(other, CrewStreams):
            raise InputError(f"other must be streams of environments, got {type(other).__name__}: make CrewStreams")
        super().adopt(rows, other, theirs)
        self._others.adopt(rows, other._others, theirs)
        self._used[rows], self._crew[rows] = other._used[theirs], other._crew[theirs]
        self._find_places()

    def _draw(self, name: str, shape: tuple[int, ...], normal: bool, draws: NDArray[np.bool_] | None) -> Array:
        """What every vehicle draws; ``draws`` (N,): the environments that do, None for all."""
        by_satellite = name in BY_SATELLITE and len(shape) > (name in ALSO_OTHERS) and shape[0] == self._used.shape[1]
        used = self._used if by_satellite else None
        if draws is not None:
            used = draws[:, None] if used is None else used & draws[:, None]
        one = self._drawn(self, 1, used, name, shape, normal)
        if self._vehicles > 1:
            if name in COMMON:
                one = np.repeat(one, self._vehicles, 1)
            else:
                used = self._crew_used if by_satellite else None if self._complete else self._crew
                others = self._drawn(self._others, self._vehicles - 1, used, name, shape, normal)
                one = np.concatenate([one, others], 1)
        return one.reshape(self.batch, *shape)

    def _drawn(
        self, streams: Streams, vehicles: int, used: NDArray[np.bool_] | None, name: str, shape: tuple[int, ...],
        normal: bool,
    ) -> Array:  # fmt: skip
        """Draws (N, vehicles, *shape) in the places ``used`` (N, places), zeros in the others; None: in all."""
        states, count = streams.states(name), self._used.shape[0]
        numbers = vehicles * math.prod(shape)
        if used is None:
            every = np.empty((count, numbers))
            if normal:
                sk.normals(states, self._rows, ZIGGURAT, every)
            else:
                sk.uniforms(states, self._rows, every)
            return every.reshape(count, vehicles, *shape)
        some = np.zeros((count, used.shape[1], numbers // used.shape[1]))
        if normal:
            run_rows(sk.normals_at, count, states, used, ZIGGURAT, some, row_us=4.0)
        else:
            sk.uniforms_at(states, used, some)
        return some.reshape(count, vehicles, *shape)
