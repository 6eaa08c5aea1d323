"""SBAS levels and error terms against the numbers of others."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.sbas import (
    GIVE_M2,
    UDRE_M2,
    Operation,
    airborne_sigma_m,
    ionospheric_obliquity,
    sbas_levels,
    semi_major_m,
    tropospheric_sigma_m,
)

# sidereon crates/sidereon-core/tests/sbas_pl.rs (MIT): five satellites, recomputed independently
AZIMUTH, ELEVATION = np.deg2rad([15.0, 80, 155, 230, 310]), np.deg2rad([15.0, 70, 25, 55, 35])
LOS = np.stack([np.cos(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION) * np.cos(AZIMUTH), np.sin(ELEVATION)], axis=-1)
VARIANCE = np.array([2.0, 1.0, 1.5, 1.2, 1.8]) ** 2


def test_levels_of_five_satellites() -> None:
    found = sbas_levels(LOS, VARIANCE)
    assert found.major_m == pytest.approx(1.510748501734169, abs=1e-9)
    assert found.up_m == pytest.approx(2.563615538395546, abs=1e-9)
    assert found.hpl_m == pytest.approx(9.064491010405014, abs=1e-9)
    assert found.vpl_m == pytest.approx(13.664070819648263, abs=1e-9)
    en_route = sbas_levels(LOS, VARIANCE, Operation.EN_ROUTE)
    assert en_route.hpl_m == pytest.approx(6.18 * 1.510748501734169, abs=1e-8)


def test_semi_major_axis_is_the_largest_eigenvalue() -> None:
    assert semi_major_m(1.500300322250245**2, 1.214969186420138**2, 0.15925883957300666) == pytest.approx(
        1.510748501734169, abs=1e-12
    )
    matrix = np.array([[3.0, -1.2], [-1.2, 0.9]])
    assert semi_major_m(3.0, 0.9, -1.2) == pytest.approx(np.sqrt(np.linalg.eigvalsh(matrix)[-1]), rel=1e-12)


@pytest.mark.parametrize(
    ("elevation_deg", "troposphere", "obliquity", "airborne"),
    [
        (5.0, 1.2261533298975857, 3.039178452443691, 0.5774229471829632),
        (10.0, 0.6698740632022786, 2.789270370828692, 0.4849839874208109),
        (90.0, 0.12, 1.0, 0.3827754043157743),
    ],
)
def test_error_terms(elevation_deg: float, troposphere: float, obliquity: float, airborne: float) -> None:
    """sidereon's sbas_pl.rs, from DO-229D appendices A and J; its Earth has a radius of 6371 km, DO-229D's 6378."""
    elevation = np.deg2rad(elevation_deg)
    assert tropospheric_sigma_m(elevation) == pytest.approx(troposphere, rel=1e-9)
    assert ionospheric_obliquity(elevation, 6_371_000.0) == pytest.approx(obliquity, rel=1e-9)
    assert ionospheric_obliquity(elevation) == pytest.approx(obliquity, rel=1e-3)
    assert airborne_sigma_m(elevation) == pytest.approx(airborne, rel=1e-9)


def test_tables_grow() -> None:
    assert (len(UDRE_M2), len(GIVE_M2)) == (14, 15)
    assert (np.diff(UDRE_M2) > 0).all()
    assert (np.diff(GIVE_M2) > 0).all()


def test_too_few_satellites_have_no_level_and_bad_variances_are_refused() -> None:
    few = sbas_levels(LOS[:3], VARIANCE[:3])
    assert np.isinf([few.hpl_m, few.vpl_m]).all()
    with pytest.raises(InputError, match="variance_m2"):
        sbas_levels(LOS, [1.0, 1.0, 0.0, 1.0, 1.0])
    with pytest.raises(InputError, match="elevation_rad"):
        tropospheric_sigma_m(-0.1)
