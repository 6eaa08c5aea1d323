"""Geometries of code epochs for tests of the monitor family."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.monitoring.family.epochs import CodeEpochs

Array = NDArray[np.float64]


def directions(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> Array:
    """Unit vectors (m, 3) of azimuths and elevations."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    flat = np.cos(elevation)
    return np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)


def sky(rng: np.random.Generator, satellites: int, epochs: int = 1) -> Array:
    """Unit vectors (epochs, satellites, 3) above 10 degrees, the same at every epoch."""
    azimuth, sine = rng.uniform(0.0, 2.0 * np.pi, satellites), rng.uniform(np.sin(np.radians(10.0)), 1.0, satellites)
    flat = np.sqrt(1.0 - sine**2)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), sine], -1)
    return np.broadcast_to(los, (epochs, satellites, 3))


def ring(satellites: int, epochs: int = 1) -> Array:
    """All but one satellite evenly around at 30 degrees, one at the zenith: the plane is circular."""
    azimuth = 2.0 * np.pi * np.arange(satellites - 1) / (satellites - 1)
    flat, up = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.full(satellites - 1, up)], -1)
    return np.broadcast_to(np.concatenate([los, [[0.0, 0.0, 1.0]]]), (epochs, satellites, 3))


def quiet(epochs: int = 400, satellites: int = 10, systems: int = 2, seed: int = 1, sigma_m: float = 2.0) -> CodeEpochs:
    """Normal errors of the stated deviation at the origin."""
    rng = np.random.default_rng(seed)
    system = np.arange(satellites) % systems
    y = sigma_m * rng.normal(size=(epochs, satellites)) + 30.0 * system
    return CodeEpochs.of(y, sky(rng, satellites, epochs), sigma_m, True, system)


def with_everything(epochs: CodeEpochs, seed: int = 2) -> CodeEpochs:
    """The same epochs with a map, displacements, carriers and resolved integers of a vehicle at rest."""
    rng = np.random.default_rng(seed)
    shape = epochs.y_m.shape
    return CodeEpochs(**{
        **vars(epochs),
        "shadowed": rng.random(shape) < 0.1,
        "step_enu_m": 0.05 * rng.normal(size=(shape[0], 3)),
        "step_sigma_m": np.full(shape[0], 0.05),
        "carrier_step_m": 0.01 * rng.normal(size=shape),
        "carrier_sigma_m": np.full(shape, 0.01),
        "carrier_kept": epochs.used.copy(),
        "fixed_m": 0.01 * rng.normal(size=shape),
        "fixed_sigma_m": np.full(shape, 0.01),
        "fixed_kept": epochs.used.copy(),
        "fix_risk": np.full(shape[0], 1e-7),
    })  # fmt: skip
