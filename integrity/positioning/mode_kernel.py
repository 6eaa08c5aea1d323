"""What RTK and Doppler may be used for now (S1 table 1), for one vehicle."""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["MODE_LIMITS", "doppler_usable", "rtk_usable", "speed_dilution"]

MODE_LIMITS = record(
    rtk_max_hdop="largest HDOP of an RTK position [-]",
    doppler_agreement="largest difference of Doppler and odometer speed [m/s]",
    doppler_max_hdop="largest HDOP for Doppler positioning [-]",
    doppler_max_sdop="largest SDOP for it, inf: no limit [-]",
    doppler_max_s="longest Doppler positioning without RTK [s]",
    doppler_if_tighter=("?", "Doppler only where its velocity has a smaller bound than that of gyro and odometer"),
)
"""ModeConfig as kernels take it."""


@jit
def doppler_usable(solved: bool, v_gnss: float, v_ss: float, hdop: float, limits: Any) -> bool:
    """S1 table 1, second column: the Doppler velocity agrees with the odometer and its geometry is good."""
    return bool(solved and abs(v_gnss - abs(v_ss)) < limits.doppler_agreement and hdop < limits.doppler_max_hdop)


@jit
def speed_dilution(v_e: float, v_n: float, sin_h: float, cos_h: float, q: Any, sigma: float) -> float:
    """SDOP: 1 sigma of the speed over ``sigma``, that of a range rate at the zenith; q (3, 3) of the velocity.

    The speed is that along the velocity; along the heading while the velocity is not larger than its noise.
    """
    speed = math.hypot(v_e, v_n)
    s, c = (v_e / speed, v_n / speed) if speed * speed > q[0, 0] + q[1, 1] else (sin_h, cos_h)
    return math.sqrt(max(s * s * q[0, 0] + 2.0 * s * c * q[0, 1] + c * c * q[1, 1], 0.0)) / sigma


@jit
def rtk_usable(hdop: float, limits: Any) -> bool:
    """S1 table 1, first column: the geometry of the fixed position is good."""
    return bool(hdop < limits.rtk_max_hdop)
