"""Speed of the monitor family: epochs of 30 satellites of 4 systems in a second, on one core."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lanebound.agents.bench.rows import Row, alternate
from lanebound.integrity.core.accel import serial
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import CODES, FAMILY, monitor_named
from lanebound.integrity.monitoring.family.monitor import MEMORY, watch

__all__ = ["measure"]

SATELLITES, SYSTEMS, EPOCHS = 30, 4, 4096
GATE = 1e5  # epochs/s of snapshot monitors that have one solution and a closed level; issue 25
GATED = ("residual", "weighted", "ibpl", "sbas")
SHOWN = tuple(k.name for k in FAMILY.values() if k.needs == (CODES,) and k.config().level not in MEMORY)
"""Snapshot monitors of codes; those with an exclusion, weights or modes do not reach the gate, and are shown."""
FEWER = {"ransac": 64, "p_ransac": 64, "araim": 256, "araim_lpv200": 256}
FEW = 1024  # epochs of other kinds without a gate


def epochs_of_noise(epochs: int, seed: int = 1) -> CodeEpochs:
    """Normal errors under a random sky."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (epochs, SATELLITES))
    sine = rng.uniform(np.sin(np.radians(8.0)), 1.0, (epochs, SATELLITES))
    flat = np.sqrt(1.0 - sine**2)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
    sigma = 1.0 + 0.5 / sine
    return CodeEpochs.of(sigma * rng.normal(size=sine.shape), los, sigma, True, np.arange(SATELLITES) % SYSTEMS)


def measure(rounds: int = 5, seconds: float = 0.4) -> list[Row]:
    """Rows of all shown monitors."""

    def work(name: str) -> Callable[[], int]:
        number = EPOCHS if name in GATED else FEWER.get(name, FEW)
        epochs, config = epochs_of_noise(number), monitor_named(name).config()

        def once() -> int:
            with serial():
                watch(epochs, config, 1e-5)
            return epochs.count

        return once

    rates = alternate({name: work(name) for name in SHOWN}, rounds, seconds)
    return [
        Row(f"monitors: {name}", float(np.median(rates[name])), "epochs/s", gate=GATE if name in GATED else None)
        for name in SHOWN
    ]
