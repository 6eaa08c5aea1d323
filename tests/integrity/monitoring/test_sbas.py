"""SBAS levels against the numbers of others."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.sbas import GIVE_M2, UDRE_M2, Operation
from lanebound.integrity.positioning.code_solution import semi_major_m
from lanebound.integrity.positioning.least_squares import design_matrix, gain, weights

# sidereon crates/sidereon-core/tests/sbas_pl.rs (MIT): five satellites, recomputed independently
AZIMUTH, ELEVATION = np.deg2rad([15.0, 80, 155, 230, 310]), np.deg2rad([15.0, 70, 25, 55, 35])
LOS = np.stack([np.cos(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION) * np.cos(AZIMUTH), np.sin(ELEVATION)], axis=-1)
VARIANCE = np.array([2.0, 1.0, 1.5, 1.2, 1.8]) ** 2


def test_levels_of_five_satellites() -> None:
    found = gain(design_matrix(LOS, np.zeros(5, np.int64), 1), weights(np.diag(VARIANCE)))
    q, (k_h, k_v) = found.cofactor, Operation.PRECISION_APPROACH.value
    major, up = semi_major_m(q[0, 0], q[1, 1], q[0, 1]), np.sqrt(q[2, 2])
    assert major == pytest.approx(1.510748501734169, abs=1e-9)
    assert up == pytest.approx(2.563615538395546, abs=1e-9)
    assert k_h * major == pytest.approx(9.064491010405014, abs=1e-9)
    assert k_v * up == pytest.approx(13.664070819648263, abs=1e-9)
    assert Operation.EN_ROUTE.value[0] * major == pytest.approx(6.18 * 1.510748501734169, abs=1e-8)


def test_semi_major_axis_is_the_largest_eigenvalue() -> None:
    assert semi_major_m(1.500300322250245**2, 1.214969186420138**2, 0.15925883957300666) == pytest.approx(
        1.510748501734169, abs=1e-12
    )
    matrix = np.array([[3.0, -1.2], [-1.2, 0.9]])
    assert semi_major_m(3.0, 0.9, -1.2) == pytest.approx(np.sqrt(np.linalg.eigvalsh(matrix)[-1]), rel=1e-12)


def test_tables_grow() -> None:
    assert (len(UDRE_M2), len(GIVE_M2)) == (14, 15)
    assert (np.diff(UDRE_M2) > 0).all()
    assert (np.diff(GIVE_M2) > 0).all()
