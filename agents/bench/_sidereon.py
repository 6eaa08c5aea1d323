"""The independent package sidereon (3.0.4), where it is installed: the other side of comparisons."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Araim", "installed", "package"]

Array = NDArray[np.float64]

LETTERS = "GERC"
"""Satellite numbers by the groups of this package; the systems are GPS, Galileo, GLONASS, BeiDou."""


def installed() -> bool:
    """Whether sidereon can be imported."""
    return find_spec("sidereon") is not None


def package() -> Any:
    """The module itself."""
    return import_module("sidereon")


class Araim:
    """One geometry as sidereon takes it: LPV-200 risks, single faults.

    los_enu (m, 3), group (m,) 0 to 3, variances and biases (m,). The receiver stands where equator and prime meridian
    meet, where East, North and Up are y, z and x.
    """

    def __init__(
        self,
        los_enu: Array,
        group: NDArray[np.int64],
        variance_m2: Array,
        accuracy_m2: Array,
        bias_m: Array,
        satellite_prior: float = 1e-5,
        constellation_prior: float = 1e-4,
    ) -> None:
        s = package()
        systems = (s.GnssSystem.GPS, s.GnssSystem.GALILEO, s.GnssSystem.GLONASS, s.GnssSystem.BEIDOU)
        names = [f"{LETTERS[g]}{i + 1:02d}" for i, g in enumerate(group)]
        rows = [
            s.AraimRow(name, los[[2, 0, 1]], float(np.arcsin(np.clip(los[2], -1.0, 1.0))))
            for name, los in zip(names, los_enu, strict=True)
        ]
        present = [systems[g] for g in np.unique(group)]
        self.geometry = s.AraimGeometry(rows, s.Wgs84Geodetic(0.0, 0.0, 0.0), present)
        usual = s.SatelliteIsmModel.new_with_effective_sigmas(1.0, 1.0, 0.0, satellite_prior, 1.0, 1.0)
        own = [
            s.SatelliteIsm.new_with_effective_sigmas(name, 1.0, 1.0, float(b), satellite_prior, float(i), float(a))
            for name, b, i, a in zip(names, bias_m, np.sqrt(variance_m2), np.sqrt(accuracy_m2), strict=True)
        ]
        self.message = s.Ism([s.ConstellationIsm(system, constellation_prior, usual) for system in present], own)
        self.allocation = s.IntegrityAllocation(1e-7, 9.8e-8, 2e-9, 3.9e-6, 9e-8, 8e-8, 1)
        self._solve = s.araim

    def solve(self) -> Any:
        """Its result: ``vpl_m``, ``hpl_m``, ``emt_m``, ``sigma_acc_v_m``, ``fault_modes``."""
        return self._solve(self.geometry, self.message, self.allocation)
