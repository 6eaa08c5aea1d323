"""Named random streams: one generator per vehicle and purpose, all spawned from one seed by name.

Adding a stream, or a draw in one stream, never moves another; the same seed gives the same bits in any process.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.errors import InputError

__all__ = ["STREAM_NAMES", "Streams", "named_generator"]

STREAM_NAMES = (
    "traffic", "gnss", "clock", "corrections", "imu", "odometer", "v2v", "sensor", "faults", "start", "scene",
    "atmosphere", "station", "network",
)  # fmt: skip
"""All streams; the last three are what the vehicles of an area have in common."""


def _name_key(name: str) -> int:
    """A stable 64-bit key of a stream's name (Python's own ``hash`` changes from process to process)."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def _entropy(seed: int | Sequence[int]) -> list[int]:
    """One seed, or several, as plain non-negative ints."""
    entropy = [int(seed)] if isinstance(seed, int | np.integer) else [int(s) for s in seed]
    if any(e < 0 for e in entropy):
        raise InputError(f"seed must be non-negative, got {seed}: choose 0 or a positive integer")
    return entropy


def named_generator(seed: int | Sequence[int], name: str) -> np.random.Generator:
    """The generator of stream ``name`` under ``seed`` (a non-negative int, or a sequence of them)."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([*_entropy(seed), _name_key(name)])))


class Streams:
    """Generators by name for a batch of vehicles.

    Parameters
    ----------
    seeds
        One seed for each vehicle, or one int that seeds ``batch`` vehicles jointly (row b of a draw then belongs to
        vehicle b, but the rows come from one generator: the fastest form, for Monte Carlo).
    batch
        Number of vehicles; needed only with a single seed.

    A draw is always shaped ``(B, *shape)``.

    Raises
    ------
    InputError
        When a seed is negative, none is given, or ``batch`` is missing or contradicts the number of seeds.
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
        self._generators: dict[str, list[np.random.Generator]] = {}

    def generators(self, name: str) -> list[np.random.Generator]:
        """The generators of one stream: one for each vehicle, or a single joint one."""
        found = self._generators.get(name)
        if found is None:
            found = self._generators[name] = [named_generator(s, name) for s in self._seeds]
        return found

    def normal(self, name: str, *shape: int) -> NDArray[np.float64]:
        """Standard normal draws ``(B, *shape)`` from stream ``name``."""
        out = np.empty((self.batch, *shape))
        generators = self.generators(name)
        if len(generators) == 1:
            generators[0].standard_normal(out=out)
        else:
            for row, generator in zip(out.reshape(self.batch, -1), generators, strict=True):
                generator.standard_normal(out=row)
        return out

    def uniform(self, name: str, *shape: int) -> NDArray[np.float64]:
        """Uniform draws in [0, 1) of shape ``(B, *shape)`` from stream ``name``."""
        out = np.empty((self.batch, *shape))
        generators = self.generators(name)
        if len(generators) == 1:
            generators[0].random(out=out)
        else:
            for row, generator in zip(out.reshape(self.batch, -1), generators, strict=True):
                generator.random(out=row)
        return out

    def reseed(self, index: int, seed: int) -> None:
        """Start vehicle ``index`` anew under ``seed`` (all its streams); refused for joint seeding."""
        if self._joint:
            raise InputError("streams seeded jointly cannot reseed one vehicle: give one seed for each vehicle")
        self._seeds[index] = _entropy(seed)[0]
        for name, generators in self._generators.items():
            generators[index] = named_generator(seed, name)

    def snapshot(self) -> Streams:
        """An independent copy that will produce the same draws."""
        return copy.deepcopy(self)
