"""Satellite systems and their carrier frequencies."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.systems_kernel import N_SYSTEMS

__all__ = [
    "CARRIER_HZ", "CHIP_M", "FIXABLE", "N_SYSTEMS", "PRN_BEFORE", "SPEED_OF_LIGHT_MPS", "WAVELENGTH_M",
    "System",
]  # fmt: skip

SPEED_OF_LIGHT_MPS = 299_792_458.0  # SI definition of the metre


class System(IntEnum):
    """A satellite system; the value indexes the tables of this module and the clock columns of a design matrix."""

    GPS = 0
    GALILEO = 1
    GLONASS = 2
    BEIDOU = 3
    QZSS = 4


PRN_BEFORE = {"J": 192}
"""By RINEX letter, the PRN before that of satellite 01: J01 is PRN 193 (RINEX 3.04 table 5); others 0."""

CARRIER_HZ: NDArray[np.float64] = 1e6 * np.array(
    [
        [1575.42, 1227.60, 1176.45],  # L1, L2, L5: IS-GPS-200N 3.3.1.1, IS-GPS-705J 3.3.1.1
        [1575.42, 1207.14, 1176.45],  # E1, E5b, E5a: Galileo OS SIS ICD 2.1, table 2
        [1602.0, 1246.0, 1202.025],  # G1, G2 at channel 0: GLONASS ICD 5.1 table 3.1; G3: GLONASS CDMA L3 ICD 1.0
        [1561.098, 1207.14, 1176.45],  # B1I, B2I, B2a: BDS-SIS-ICD-2.1 4.2.1, BDS-SIS-ICD-B2a-1.0 4.1
        [1575.42, 1227.60, 1176.45],  # L1, L2, L5: IS-QZSS-PNT-005 4.1
    ]
)
"""Carrier frequencies [Hz], (N_SYSTEMS, 3): band 0 = L1/E1/B1I, 1 = L2/E5b/B2I, 2 = L5/E5a/B2a."""

WAVELENGTH_M: NDArray[np.float64] = SPEED_OF_LIGHT_MPS / CARRIER_HZ
"""Carrier wavelengths [m], (N_SYSTEMS, 3); GLONASS at its nominal centre frequencies (channel 0)."""

CHIP_M: NDArray[np.float64] = SPEED_OF_LIGHT_MPS / (
    1e6
    * np.array(
        [
            [1.023, 1.023, 10.23],  # L1 C/A, L2C, L5: IS-GPS-200N, IS-GPS-705J
            [1.023, 10.23, 10.23],  # E1 BOC(1,1), E5b, E5a: Galileo OS SIS ICD 2.1
            [0.511, 0.511, 10.23],  # GLONASS ICD 5.1; L3 CDMA ICD 1.0
            [2.046, 2.046, 10.23],  # B1I, B2I, B2a: BDS-SIS-ICD
            [1.023, 1.023, 10.23],  # IS-QZSS-PNT-005
        ]
    )
)
"""Length of a chip of the code [m], (N_SYSTEMS, 3)."""

FIXABLE: NDArray[np.bool_] = np.array([True, True, False, True, True])
"""Whether double-differenced ambiguities of a system are integers, (N_SYSTEMS,); those of GLONASS FDMA are not."""

for _table in (CARRIER_HZ, CHIP_M, WAVELENGTH_M, FIXABLE):
    _table.setflags(write=False)
