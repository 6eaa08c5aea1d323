"""Named random streams: one generator for each vehicle and purpose, derived by name from the seed of the vehicle.

A new stream, or a draw from one stream, does not change the draws of other streams. The same seed gives the same bits
in every process.
"""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core import streams_kernel as sk
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.seeding_kernel import fill_words

__all__ = ["EVERY_PLACE", "STREAM_NAMES", "ZIGGURAT", "Streams", "named_generator", "named_states"]

STREAM_NAMES = (
    "traffic", "gnss", "clock", "corrections", "imu", "odometer", "v2v", "sensor", "faults", "start", "scene",
    "atmosphere", "station", "network", "broadcast", "wander", "sensor_bias", "augmentation",
    "steering", "wheels", "compass", "barometer", "near_objects", "others", "lane_sensor",
)  # fmt: skip
"""Names of all streams; the vehicles of an area share atmosphere, station, network, broadcast and augmentation."""
ZIGGURAT: NDArray[np.float64] = np.load(str(resources.files("lanebound.integrity.core") / "ziggurat.npy"))
"""(3, 256) tables of normal draws (:func:`~lanebound.integrity.core.streams_kernel.fill`), rounded as in NumPy."""

EVERY_PLACE = np.empty((0, 0), np.bool_)


@cache
def _name_key(name: str) -> int:
    """A stable 64-bit key of a stream's name (Python's ``hash`` differs between processes)."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def _entropy(seed: int | Sequence[int]) -> list[int]:
    """One or several seeds as a list of non-negative ints."""
    entropy = [int(seed)] if isinstance(seed, int | np.integer) else [int(s) for s in seed]
    if any(e < 0 for e in entropy):
        raise InputError(f"seed must be non-negative, got {seed}: choose 0 or a positive integer")
    return entropy


def _sequence(seed: int | Sequence[int], name: str) -> np.random.SeedSequence:
    return np.random.SeedSequence([*_entropy(seed), _name_key(name)])


def named_generator(seed: int | Sequence[int], name: str) -> np.random.Generator:
    """Create the generator of stream ``name`` for ``seed`` (a non-negative int or a sequence of them)."""
    return np.random.Generator(np.random.SFC64(_sequence(seed, name)))


def named_states(seeds: Sequence[int], name: str) -> NDArray[np.uint64]:
    """States (n, 4) of the generators of stream ``name`` for n seeds, for compiled draws of the same bits."""
    numbers = _entropy(seeds)
    words, states = np.empty((len(numbers), 3), np.uint64), np.empty((len(numbers), 4), np.uint64)
    if max(numbers) < 2**64:
        fill_words(np.array(numbers, np.uint64), np.uint64(_name_key(name)), words)
    else:
        words[:] = [_sequence(number, name).generate_state(3, np.uint64) for number in numbers]
    sk.begin(words, states)
    return states


class Streams:
    """Generators by name for a batch of vehicles.

    Parameters
    ----------
    seeds
        One seed for each vehicle, or one int that seeds ``batch`` vehicles jointly. With joint seeding row b of a draw
        belongs to vehicle b, but all rows come from one generator; this is the fastest form, for Monte Carlo.
    batch
        Number of vehicles; needed only with a single seed.

    All draws have the shape ``(B, *shape)``.

    Raises
    ------
    InputError
        A seed is negative, no seed is given, or ``batch`` is missing or differs from the number of seeds.
    """

    def __init__(self, seeds: int | Sequence[int], batch: int | None = None) -> None:
        self._joint = isinstance(seeds, int | np.integer)
        if self._joint and (batch is None or batch < 1):
            raise InputError(f"batch must be a positive int when one seed serves many vehicles, got {batch}")
        self._seeds = _entropy(seeds)
        self.batch: int = int(batch) if self._joint and batch is not None else len(self._seeds)
        if self.batch < 1 or batch not in (None, self.batch):
            raise InputError(
                f"seeds must hold one seed for each vehicle, got {self.batch} for batch {batch}: make them agree"
            )
        self._rows = np.arange(len(self._seeds))
        self._states: dict[str, NDArray[np.uint64]] = {}
        self._generators: dict[str, np.random.Generator] = {}

    @property
    def seeds(self) -> tuple[int, ...] | None:
        """Seed of each vehicle; None with joint seeding."""
        return None if self._joint else tuple(self._seeds)

    def states(self, name: str) -> NDArray[np.uint64]:
        """States (n, 4) of the generators of one stream, n vehicles or 1 with joint seeding; draws change them."""
        found = self._states.get(name)
        if found is None:
            self._require_undrawn(name, self._generators)
            found = self._states[name] = named_states(self._seeds, name)
        return found

    def together(self, names: Sequence[str]) -> NDArray[np.uint64]:
        """:meth:`states` of several streams as one array (streams, n, 4), in whose rows they stay."""
        block = self.states(names[0]).base
        if block is None or len(block) != len(names):  # not yet, or a copy of such an array
            block = np.array([self.states(name) for name in names])
            self._states.update(zip(names, block, strict=True))
        return block

    @property
    def draws_by_row(self) -> bool:
        """Whether kernels draw from the states themselves: a generator for each vehicle, or one for all."""
        return True

    @property
    def places(self) -> NDArray[np.bool_]:
        """(n, S) satellites for which each vehicle draws by satellite, zeros for the others; (0, 0): for all."""
        return EVERY_PLACE

    def generator(self, name: str) -> np.random.Generator:
        """Generator of a stream of the first vehicle (or the joint one), for distributions without batch draws.

        Raises
        ------
        InputError
            The stream has batch draws: the same numbers would be drawn twice.
        """
        found = self._generators.get(name)
        if found is None:
            self._require_undrawn(name, self._states)
            found = self._generators[name] = named_generator(self._seeds[0], name)
        return found

    def normal(self, name: str, *shape: int, where: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """Standard normal draws ``(B, *shape)`` from stream ``name``.

        ``where`` (B,) selects the vehicles that draw. The rows of the others are undefined, and their generators do not
        advance.

        Raises
        ------
        InputError
            With joint seeding ``where`` selects some but not all vehicles.
        """
        out = np.empty((self.batch, *shape))
        if where is None or where.all():
            sk.normals(self.states(name), self._rows, ZIGGURAT, self._by_generator(out))
            return out
        if self._joint:
            raise InputError("where must name all vehicles seeded jointly, or none: give one seed for each vehicle")
        rows = np.flatnonzero(where)
        drawn = np.empty((rows.size, math.prod(shape)))
        sk.normals(self.states(name), rows, ZIGGURAT, drawn)
        out[rows] = drawn.reshape(rows.size, *shape)
        return out

    def uniform(self, name: str, *shape: int) -> NDArray[np.float64]:
        """Uniform draws in [0, 1) of shape ``(B, *shape)`` from stream ``name``."""
        out = np.empty((self.batch, *shape))
        sk.uniforms(self.states(name), self._rows, self._by_generator(out))
        return out

    def reseed(self, index: int, seed: int) -> None:
        """Reset all streams of vehicle ``index`` to ``seed``; refused with joint seeding."""
        if self._joint:
            raise InputError("streams seeded jointly cannot reseed one vehicle: give one seed for each vehicle")
        self._seeds[index] = _entropy(seed)[0]
        for name, states in self._states.items():
            states[index] = named_states([seed], name)[0]
        if index == 0:
            self._generators.clear()

    def adopt(self, rows: NDArray[np.int64], other: Streams, other_rows: NDArray[np.int64]) -> None:
        """Copy seeds and generators of the vehicles ``other_rows`` (n,) of ``other`` to the vehicles ``rows`` (n,).

        Raises
        ------
        InputError
            One of the two is seeded jointly.
        """
        if self._joint or other._joint:
            raise InputError("streams seeded jointly cannot copy a vehicle: give one seed for each vehicle")
        if 0 in rows:
            self._generators.clear()
        for row, other_row in zip(rows.tolist(), other_rows.tolist(), strict=True):
            self._seeds[row] = other._seeds[other_row]
        for name in {*self._states, *other._states}:
            self.states(name)[rows] = other.states(name)[other_rows]

    def snapshot(self) -> Streams:
        """An independent copy that produces the same draws."""
        return copy.deepcopy(self)

    def _by_generator(self, out: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same array with one row for each generator."""
        return out.reshape(len(self._seeds), math.prod(out.shape) // len(self._seeds))

    @staticmethod
    def _require_undrawn(name: str, other: dict[str, Any]) -> None:
        if name in other:
            raise InputError(f"stream {name!r} must be drawn from in one way, got two: use another stream")
