"""What RTK and Doppler may be used for now (S1 table 1), for one vehicle."""

from __future__ import annotations

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["MODE_LIMITS", "doppler_usable", "rtk_usable"]

MODE_LIMITS = record(
    rtk_max_hdop="largest HDOP of an RTK position [-]",
    doppler_agreement="largest difference of Doppler and odometer speed [m/s]",
    doppler_max_hdop="largest HDOP for Doppler positioning [-]",
    doppler_max_s="longest Doppler positioning without RTK [s]",
    doppler_if_tighter=("?", "Doppler only where its velocity has a smaller bound than that of gyro and odometer"),
)
"""ModeConfig as kernels take it."""


@jit(borrows=True)
def doppler_usable(solved: bool, v_gnss: float, v_ss: float, hdop: float, limits: Any) -> bool:
    """S1 table 1, second column: the Doppler velocity agrees with the odometer and its geometry is good."""
    return bool(solved and abs(v_gnss - abs(v_ss)) < limits.doppler_agreement and hdop < limits.doppler_max_hdop)


@jit(borrows=True)
def rtk_usable(hdop: float, limits: Any) -> bool:
    """S1 table 1, first column: the geometry of the fixed position is good."""
    return bool(hdop < limits.rtk_max_hdop)
