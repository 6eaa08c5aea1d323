"""Places of UTM grids: what defines them, a meridian arc by quadrature and equal angles, and the zones of EPSG."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from lanebound.integrity.core.frames import WGS84_A_M, WGS84_E2
from lanebound.integrity.sky.maps.utm import Utm


@pytest.mark.parametrize("lat_deg", [-60.0, -5.0, 1.0, 35.7, 52.5, 83.0])
def test_the_central_meridian_has_the_length_of_the_arc(lat_deg: float) -> None:
    arc, _ = quad(
        lambda phi: WGS84_A_M * (1.0 - WGS84_E2) / (1.0 - WGS84_E2 * np.sin(phi) ** 2) ** 1.5, 0.0, np.radians(lat_deg)
    )
    south = lat_deg < 0.0
    found = Utm(33, south).lat_lon_of(500_000.0, 0.9996 * arc + (10_000_000.0 if south else 0.0))
    assert found == (pytest.approx(lat_deg, abs=1e-9), pytest.approx(15.0, abs=1e-12))


@pytest.mark.parametrize(
    ("east_m", "north_m"), [(390_590.0, 5_819_390.0), (700_000.0, 4_000_000.0), (200_000.0, 500.0)]
)
def test_angles_are_kept(east_m: float, north_m: float) -> None:
    """With the meridian this defines the projection: a conformal map is determined by its values on a line."""
    grid, step = Utm(33), 1.0
    lat = np.radians(grid.lat_lon_of(east_m, north_m)[0])
    bent = 1.0 - WGS84_E2 * np.sin(lat) ** 2
    radii = np.array([WGS84_A_M * (1.0 - WGS84_E2) / bent**1.5, WGS84_A_M / np.sqrt(bent) * np.cos(lat)])
    ends = [(east_m + step, north_m), (east_m - step, north_m), (east_m, north_m + step), (east_m, north_m - step)]
    a, b, c, d = (np.radians(grid.lat_lon_of(*end)) * radii for end in ends)
    along_east, along_north = (a - b) / (2.0 * step), (c - d) / (2.0 * step)
    assert np.linalg.norm(along_east) == pytest.approx(np.linalg.norm(along_north), abs=1e-6)
    assert along_east @ along_north == pytest.approx(0.0, abs=1e-6)


def test_the_model_of_berlin_lies_where_its_readme_says() -> None:
    low, high = (Utm(33).lat_lon_of(*corner) for corner in ((390_477.99, 5_819_214.19), (390_703.08, 5_819_552.65)))
    np.testing.assert_allclose((low, high), ((52.5120, 13.3861), (52.5151, 13.3893)), atol=1e-4)


def test_a_frame_turns_the_grid_to_north() -> None:
    frame, turn = Utm(33).frame_at(np.array([390_590.0, 5_819_390.0]))
    # Convergence of the meridians, (lambda - lambda_0) sin(phi) to the first order, and the scale of the grid.
    angle = np.radians((frame.lon_deg - 15.0) * np.sin(np.radians(frame.lat_deg)))
    assert np.arctan2(turn[0, 1], turn[1, 1]) == pytest.approx(angle, abs=1e-4)
    assert np.linalg.det(turn) == pytest.approx((1.0 / 0.99975) ** 2, abs=1e-4)


def test_zones_of_epsg() -> None:
    assert Utm.of_epsg(25833) == Utm(33)
    assert Utm.of_epsg(32754) == Utm(54, True)
    assert [Utm.of_epsg(code) for code in (None, 7415, 25827, 32600, 32661, 4326)] == [None] * 6
