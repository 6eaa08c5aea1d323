"""What RTK, Doppler and the odometer may be used for now: S1 table 1 and figure 1, for one vehicle."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit

NONE, RTK, DOPPLER, IMU_ODOMETER = 0, 1, 2, 3  # the values of modes.Mode


@jit
def doppler_usable(solved, v_gnss, v_ss, hdop, limits):  # type: ignore[no-untyped-def]
    """S1 table 1, second column: the Doppler velocity agrees with the odometer and its geometry is good."""
    return solved and abs(v_gnss - abs(v_ss)) < limits[1] and hdop < limits[2]


@jit
def rtk_usable(hdop, limits):  # type: ignore[no-untyped-def]
    """S1 table 1, first column: the geometry of the fixed position is good."""
    return hdop < limits[0]


@jit
def bridge_mode(doppler_solved, v_gnss, v_ss, hdop_doppler, outage_s, initialised, limits):  # type: ignore[no-untyped-def]
    """What the position goes on by without RTK: Doppler, then IMU + odometer; nothing before a first RTK position.

    limits: RTK HDOP, Doppler speed agreement [m/s], Doppler HDOP, longest Doppler positioning without RTK [s].
    """
    if not initialised:
        return NONE
    if doppler_usable(doppler_solved, v_gnss, v_ss, hdop_doppler, limits) and outage_s <= limits[3]:
        return DOPPLER
    return IMU_ODOMETER
