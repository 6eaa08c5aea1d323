"""Figures printed by the source papers, as data, and the bands within which ours should fall.

S1: El-Mowafy and Kubo, integrated RTK, IMU and odometer positioning (tables 2, 4, 5 and the text of section 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["CELLS", "MODES", "RISKS", "PrintedFigure"]

MODES = ("rtk", "doppler", "imu_odometer")
RISKS = (1e-3, 1e-4, 1e-5, 1e-6)

MODE_SHARE = {"rtk": 0.722, "doppler": 0.258, "imu_odometer": 0.02}  # S1 section 5
ERROR_M = {  # S1 table 2
    "rtk": {"median_at_m": 0.058, "median_ct_m": 0.054, "rmse_at_m": 0.077, "rmse_ct_m": 0.105},
    "doppler": {"median_at_m": 0.163, "median_ct_m": 0.172, "rmse_at_m": 0.332, "rmse_ct_m": 0.442},
    "imu_odometer": {"median_at_m": 0.150, "median_ct_m": 0.321, "rmse_at_m": 0.249, "rmse_ct_m": 0.206},
}
PL_AT_M = {  # S1 table 4, by risk 1e-3 .. 1e-6
    "rtk": (0.176, 0.197, 0.215, 0.232),
    "doppler": (1.355, 1.621, 1.851, 2.057),
    "imu_odometer": (1.208, 1.368, 1.506, 1.601),
}
PL_CT_M = {  # S1 table 5
    "rtk": (0.148, 0.164, 0.177, 0.188),
    "doppler": (1.802, 2.159, 2.468, 2.623),
    "imu_odometer": (0.884, 1.101, 1.150, 1.191),
}
IMPOSSIBLE = {("error", "imu_odometer", "rmse_ct_m"), ("error", "imu_odometer", "median_ct_m")}


@dataclass(frozen=True)
class PrintedFigure:
    """One printed figure: ``path`` in tables.json, its value, the band we aim at and a remark."""

    path: tuple[str, ...]
    published: float
    low: float
    high: float
    remark: str = ""


def risk_key(risk: float) -> str:
    """``1e-3`` for 0.001."""
    return f"1e-{round(-math.log10(risk))}"


def _cells() -> list[PrintedFigure]:
    share_band = {"rtk": (0.672, 0.772), "doppler": (0.208, 0.308), "imu_odometer": (0.01, 0.04)}
    cells = [PrintedFigure(("mode_share", m), MODE_SHARE[m], *share_band[m]) for m in MODES]
    for mode in MODES:
        tolerance = 0.6 if mode == "imu_odometer" else 0.3
        for key, value in ERROR_M[mode].items():
            remark = (
                "printed RMSE is below the printed median over sqrt 2" if ("error", mode, key) in IMPOSSIBLE else ""
            )
            cells.append(
                PrintedFigure(("error", mode, key), value, value * (1 - tolerance), value * (1 + tolerance), remark)
            )
    for mode in MODES:
        tolerance = 0.4 if mode == "imu_odometer" else 0.25
        for axis, table in (("at", PL_AT_M), ("ct", PL_CT_M)):
            for risk, value in zip(RISKS, table[mode], strict=True):
                path = ("pl_median", mode, f"{axis}_m", risk_key(risk))
                remark = "0.567 K + 0.050 gives 2.745" if (mode, axis, risk) == ("doppler", "ct", 1e-6) else ""
                cells.append(PrintedFigure(path, value, value * (1 - tolerance), value * (1 + tolerance), remark))
    return cells


CELLS = _cells()
