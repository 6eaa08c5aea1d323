"""Signals of one epoch for conventional RTK, with errors of RTKLIB's sigmas."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.assessment.conventional_rtk import RtkSignals
from lanebound.integrity.sky.systems import WAVELENGTH_M, System

TRUE_M = np.array([12.3, -45.6, 1.5])


def signals(seed: int = 1, noise: float = 1.0, satellites: int = 16) -> RtkSignals:
    """GPS and Galileo in all directions above 32 degrees; errors of RTKLIB's sigmas times ``noise``."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(0.0, 4.0 * np.pi, satellites, endpoint=False) + 0.1
    elevation = np.radians(np.linspace(32.0, 80.0, satellites))
    e = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    system = np.where(np.arange(satellites) % 2, int(System.GALILEO), int(System.GPS))
    wave = WAVELENGTH_M[system][:, :2]
    sigma = noise * np.sqrt(2.0) * 0.003 * np.sqrt(1.0 + 1.0 / np.sin(elevation) ** 2)[:, None]
    clock = rng.normal(0.0, 100.0, (2, 5, 2))
    code = -(e @ TRUE_M)[:, None] + clock[0][system] + 100.0 * sigma * rng.standard_normal((satellites, 2))
    integers = rng.integers(-1000, 1000, (satellites, 2))
    phase = -(e @ TRUE_M)[:, None] + clock[1][system] + wave * integers + sigma * rng.standard_normal((satellites, 2))
    return RtkSignals(e, elevation, system, np.full(satellites, 45.0), np.ones(satellites, bool), code, phase, wave)
