"""The interpolated sky equals the computed one."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack

CONFIG = SkyConfig()


@pytest.fixture(scope="module")
def track() -> SkyTrack:
    return SkyTrack.from_config(CONFIG, 100.0)


@pytest.mark.parametrize("after_s", [0.0, 7.3, 20.0, 59.9, 100.0])
def test_between_knots(track: SkyTrack, after_s: float) -> None:
    t = CONFIG.start_gps_s + after_s
    view = track.at(t, np.zeros(3, dtype=np.int64))
    knots = CONFIG.start_gps_s + 20.0 * np.arange(6)
    table = CONFIG.satellites().rising(knots, *CONFIG.place_rad, CONFIG.mask_rad)
    exact = table.view(t, *CONFIG.place_rad, CONFIG.mask_rad)
    np.testing.assert_array_equal(view.prn, exact.prn)
    np.testing.assert_allclose(view.los_enu, exact.los_enu, atol=1e-11)
    np.testing.assert_allclose(view.elevation_rad, exact.elevation_rad, atol=1e-11)
    np.testing.assert_allclose(view.azimuth_rad, exact.azimuth_rad, atol=1e-10)
    np.testing.assert_allclose(view.range_m, exact.range_m, atol=1e-4)
    np.testing.assert_allclose(view.range_rate_mps, exact.range_rate_mps, atol=1e-5)
    np.testing.assert_array_equal(view.above, exact.above)
    assert view.batch == 3


def test_outside_the_track_is_refused(track: SkyTrack) -> None:
    assert track.end_s == CONFIG.start_gps_s + 100.0
    for t in (CONFIG.start_gps_s - 1.0, track.end_s + 1.0, np.nan):
        with pytest.raises(InputError, match="gps_time_s"):
            track.at(t)


def test_bad_tracks_are_refused() -> None:
    with pytest.raises(InputError, match="duration_s"):
        SkyTrack.from_config(CONFIG, 0.0)
    with pytest.raises(InputError, match="rise above"):
        SkyTrack.build(CONFIG.satellites(), 1e9, 60.0, CONFIG.place_rad, mask_rad=1.57)
