"""Ionosphere-free codes in a street against the deviation that SBAS DFMC declares of strong ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lanebound.agents.studies.street_drives import StreetDrivesConfig, street_of
from lanebound.integrity.navigators.navigator import Measurements, NavigatorConfig
from lanebound.integrity.sky.systems import WAVELENGTH_M, System
from lanebound.integrity.sky.visibility import SignalPath

NAVIGATOR = NavigatorConfig.preset("services/sbas_dfmc")
DECLARED = NAVIGATOR.services.sbas_dfmc.errors
NORMAL = 2.7e-3  # of normal errors beyond three sigma
ZENITH_DBHZ, HORIZON_DBHZ = 48.0, 38.0  # C/N0 of an open sky


def over_deviation(m: Measurements, v: int, position: np.ndarray, direct: np.ndarray) -> Iterator[np.ndarray]:
    """Errors of the strong codes of vehicle v over their deviation, by system, less the median of codes (S,) that
    nothing reflects."""
    los, cn0, a = m.sky.los_enu[m.sky.index[v]], m.gnss.cn0_dbhz[v], m.gnss
    assert a.raw_code_m is not None
    assert a.corrections is not None
    held = a.corrections["sbas_dfmc"]
    there = a.tracked[v] & (a.raw_code_m[v] != 0.0).all(-1) & (los[:, 2] > np.sin(np.deg2rad(10.0)))
    strong = cn0 > HORIZON_DBHZ + (ZENITH_DBHZ - HORIZON_DBHZ) * los[:, 2]
    parts = DECLARED.errors(np.maximum(los[:, 2], 0.05), cn0)
    for system in (int(System.GPS), int(System.GALILEO)):
        rows = there & (m.sky.system == system)
        if (rows & direct).sum() < 2:
            continue
        ratio = (WAVELENGTH_M[system, 2] / WAVELENGTH_M[system, 0]) ** 2
        share = np.array([ratio, -1.0]) / (ratio - 1.0)
        y = a.raw_code_m[v] @ share - held.satellite_m[v] + los @ position
        variance = parts.fast_m2 * (share @ share) + held.declared_m**2 + parts.common_m[:, 1] ** 2
        yield (np.abs(y - np.median(y[rows & direct])) / np.sqrt(variance))[rows & strong]


def test_strong_codes_are_beyond_three_sigma_no_more_often_than_normal_errors() -> None:
    """Of a street that chose 0.8 m: its errors are few and last, so the limit is the rate of normal errors itself."""
    config = StreetDrivesConfig(skies=("urban",), seed=51, faults=None, navigator=NAVIGATOR)
    navigator, drive = street_of(config, "urban", 2)
    found: list[np.ndarray] = []
    for k, truth in zip(range(1000), drive, strict=False):
        m = navigator.measure(truth)
        if k >= 200 and k % 10 == 0:
            look = navigator.mask.look(truth.arc_m, truth.lane, m.sky)
            direct = (look.path == SignalPath.LOS) & (look.excess_m == 0.0)
            for v in range(truth.batch):
                found.extend(over_deviation(m, v, truth.position_enu_m[v], direct[v]))
    every = np.concatenate(found)
    assert every.size > 4000
    assert (every > 3.0).mean() <= NORMAL
    assert (every > 3.0 * 0.75).mean() > NORMAL  # 0.6 m in place of 0.8 m would be too little
