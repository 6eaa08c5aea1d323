"""Speed of cooperative positioning: an epoch of a whole fleet, by its size and estimator."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

import numpy as np

from lanebound.agents.bench.runner import Row, alternate
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.positioning.cooperative.network import Local, Network, NetworkConfig
from lanebound.integrity.positioning.cooperative.particles import Ranges
from lanebound.integrity.positioning.cooperative.shared_codes import double_differences

SATELLITES, REACH_M, SPACING_M, NOISE_M2 = 24, 90.0, 25.0, 9.0
SIZES = {
    "split": (2, 8, 16, 32, 50),
    "gaussian": (2, 8, 16, 32, 50),
    "md_spawn": (2, 8, 16, 32, 50),
    "spawn": (2, 8, 16, 32, 50),
    "mdpc": (2, 4, 8),
}
GATE_MS = 100.0  # of 50 vehicles at 10 Hz on one core, decentralised; issue 42


def _epoch(vehicles: int, estimator: str) -> Callable[[], int]:
    """One epoch of vehicles in two lanes that share codes and ranges with all others within reach."""
    rng = named_generator(1, f"fleet-{estimator}")
    number = np.arange(vehicles)
    place = np.stack([0.5 * SPACING_M * number, 4.0 * (number % 2), np.zeros(vehicles)], -1)
    apart = np.linalg.norm(place[:, None] - place, axis=-1)
    pairs = np.argwhere(np.tril(apart < REACH_M, -1))
    azimuth, sine = rng.uniform(0.0, 2.0 * np.pi, SATELLITES), rng.uniform(0.2, 1.0, SATELLITES)
    flat = np.sqrt(1.0 - sine**2)
    los, system = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1), np.arange(SATELLITES) % 3
    network = Network(NetworkConfig(estimator=estimator), np.empty((0, 3)), rng)
    shape, unit = (vehicles, SATELLITES), np.tile(np.eye(3), (vehicles, 1, 1))
    local = Local(place + rng.standard_normal(place.shape), 4.0 * unit, 0.0 * place, 0.01 * unit)
    code = -place @ los.T + rng.standard_normal(shape)
    ranges = Ranges(pairs, apart[pairs[:, 0], pairs[:, 1]], np.full(len(pairs), 0.1))
    begun = network.start(local)

    def once() -> int:
        variance, none = np.full(shape, NOISE_M2), np.zeros(shape)
        factors = double_differences(pairs, los, code, variance, np.ones(shape, np.bool_), system, none)
        network.step(begun.copy(), local, factors, ranges)
        return 1

    return once


def measure_fleets(rounds: int = 5) -> list[Row]:
    """Milliseconds of an epoch of all vehicles of a fleet: its factors and messages, without the local filters."""
    sides = {(name, size): _epoch(size, name) for name, sizes in SIZES.items() for size in sizes}
    rates = alternate({f"{name} {size}": work for (name, size), work in sides.items()}, rounds)
    return [
        Row(
            f"fleet of {size}: {name}", 1e3 / median(rates[f"{name} {size}"]), "ms", higher_is_better=False,
            gate=GATE_MS if (name, size) == ("split", 50) else None,
        )
        for name, size in sides
    ]  # fmt: skip
