"""The ionospheric model that GPS broadcasts (Klobuchar 1987; IS-GPS-200N 20.3.3.5.2.5), and its figures in RINEX.

The vertical delay at the pierce point is a half cosine over the local day, largest at 14:00, on 5 ns by night. Its
amplitude and period are cubic polynomials of the geomagnetic latitude. All angles of the model are in semicircles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.rinex_navigation import navigation_text
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

__all__ = ["Klobuchar", "read_klobuchar"]

Array = NDArray[np.float64]

LABEL, HEADER_END = "IONOSPHERIC CORR", "END OF HEADER"
NIGHT_S, PEAK_S, DAY_S = 5e-9, 50_400.0, 86_400.0
SHORTEST_PERIOD_S, LARGEST_PHASE = 72_000.0, 1.57
HIGHEST_LATITUDE = 0.416  # of the pierce point [semicircles]
POLE_LATITUDE, POLE_LONGITUDE = 0.064, 1.617  # tilt and longitude of the geomagnetic pole [semicircles]


@dataclass(frozen=True)
class Klobuchar:
    """Coefficients alpha (4,) [s, s per semicircle ...] and beta (4,) [s, s per semicircle ...]."""

    alpha: tuple[float, ...]
    beta: tuple[float, ...]

    def delay_m(
        self, latitude_rad: float, longitude_rad: float, azimuth_rad: Array, elevation_rad: Array, tow_s: float
    ) -> Array:
        """Slant delay on L1 towards satellites (S,) at a time of the GPS week [m], (S,)."""
        e, a = np.asarray(elevation_rad) / np.pi, np.asarray(azimuth_rad)
        angle = 0.0137 / (e + 0.11) - 0.022
        latitude = np.clip(latitude_rad / np.pi + angle * np.cos(a), -HIGHEST_LATITUDE, HIGHEST_LATITUDE)
        longitude = longitude_rad / np.pi + angle * np.sin(a) / np.cos(latitude * np.pi)
        magnetic = latitude + POLE_LATITUDE * np.cos((longitude - POLE_LONGITUDE) * np.pi)
        local = np.mod(0.5 * DAY_S * longitude + tow_s, DAY_S)
        amplitude = np.maximum(np.polyval(self.alpha[::-1], magnetic), 0.0)
        period = np.maximum(np.polyval(self.beta[::-1], magnetic), SHORTEST_PERIOD_S)
        x = 2.0 * np.pi * (local - PEAK_S) / period
        by_day = amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0)
        slant = 1.0 + 16.0 * (0.53 - e) ** 3
        return np.asarray(SPEED_OF_LIGHT_MPS * slant * (NIGHT_S + np.where(np.abs(x) < LARGEST_PHASE, by_day, 0.0)))


def read_klobuchar(navigation: Sequence[str | Path]) -> Klobuchar | None:
    """The first complete figures of GPS (GPSA and GPSB) in the headers of RINEX 3 navigation files; None without.

    Raises
    ------
    InputError
        A line with this label is malformed.
    """
    for path in navigation:
        found: dict[str, tuple[float, ...]] = {}
        for line in navigation_text(path).splitlines():
            label = line[60:80].strip()
            if label == HEADER_END:
                break
            if label == LABEL and line[:4] in ("GPSA", "GPSB") and line[5:53].strip():
                found[line[:4]] = _figures(line, path)
        if len(found) == 2:
            return Klobuchar(found["GPSA"], found["GPSB"])
    return None


def _figures(line: str, path: str | Path) -> tuple[float, ...]:
    """Four numbers of 12 characters from column 6 on (RINEX 3.04 table A5)."""
    try:
        return tuple(float(line[5 + 12 * k : 17 + 12 * k].replace("D", "E")) for k in range(4))
    except ValueError:
        raise InputError(
            f"{path}: {line[:4]} of {LABEL} must have four numbers, got {line[5:53]!r}: correct the header"
        ) from None
