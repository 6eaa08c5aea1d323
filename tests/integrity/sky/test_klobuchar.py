"""The broadcast model of the ionosphere against a published value, by night, and its reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.klobuchar import Klobuchar, read_klobuchar
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

# Ovstedal, GPS Toolbox (ngs.noaa.gov/gps-toolbox/ovstedal.htm): 40 N, 260 E, azimuth 210, elevation 20 deg
OVSTEDAL = Klobuchar((0.382e-7, 0.149e-7, -0.179e-6, 0.0), (0.143e6, 0.0, -0.328e6, 0.113e6))


def _delay(model: Klobuchar, elevation_deg: float, tow_s: float) -> float:
    angles = np.deg2rad([40.0, 260.0, 210.0, elevation_deg])
    return float(model.delay_m(angles[0], angles[1], angles[2:3], angles[3:4], tow_s)[0])


def test_the_delay_is_that_of_the_gps_toolbox() -> None:
    assert _delay(OVSTEDAL, 20.0, 593_100.0) == pytest.approx(23.784, abs=1e-3)


def test_five_nanoseconds_remain_at_night() -> None:
    slant = 1.0 + 16.0 * (0.53 - 0.5) ** 3
    assert _delay(OVSTEDAL, 90.0, 593_100.0 + 43_200.0) == pytest.approx(5e-9 * SPEED_OF_LIGHT_MPS * slant)
    assert _delay(OVSTEDAL, 20.0, 593_100.0 + 7 * 86_400.0) == pytest.approx(23.784, abs=1e-3)  # a day is a day


def test_a_header_is_read(tmp_path: Path) -> None:
    rows = (
        "     3.04           N: GNSS NAV DATA    M: MIXED            RINEX VERSION / TYPE",
        "GPSA   8.3819E-09  1.4901E-08 -5.9605E-08 -5.9605E-08       IONOSPHERIC CORR",
        "GPSB   8.3968E+04  1.6384E+04 -1.3107E+05 -6.5536E+04       IONOSPHERIC CORR",
        "                                                            END OF HEADER",
    )
    path = tmp_path / "a.nav"
    path.write_text("\n".join(rows), encoding="ascii")
    found = read_klobuchar([path])
    assert found == Klobuchar((8.3819e-9, 1.4901e-8, -5.9605e-8, -5.9605e-8), (83968.0, 16384.0, -131070.0, -65536.0))
    path.write_text("\n".join((rows[0], rows[3], rows[1], rows[2])), encoding="ascii")
    assert read_klobuchar([path]) is None
    path.write_text("\n".join((rows[0], rows[1].replace("1.4901E-08", "1.49x1E-08"), rows[3])), encoding="ascii")
    with pytest.raises(InputError, match="GPSA of IONOSPHERIC CORR must have four numbers"):
        read_klobuchar([path])
