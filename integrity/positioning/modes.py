"""How a position was obtained: the modes of S1 Fig. 1, in their order of preference."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Mode"]


class Mode(IntEnum):
    """Source of the position of an epoch (S1 Fig. 1); ``CODE`` is the metre-level start-up fix before any RTK."""

    NONE = 0
    RTK = 1
    DOPPLER = 2
    IMU_ODOMETER = 3
    CODE = 4

    @property
    def key(self) -> str:
        """Name used in tables and JSON, for instance ``imu_odometer``."""
        return self.name.lower()

    @property
    def label(self) -> str:
        """Name used in figures and printed tables, for instance ``IMU + odometer``."""
        return _LABELS[self]


_LABELS = {
    Mode.NONE: "no solution",
    Mode.RTK: "RTK",
    Mode.DOPPLER: "Doppler",
    Mode.IMU_ODOMETER: "IMU + odometer",
    Mode.CODE: "code",
}
