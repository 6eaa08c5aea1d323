"""How fast the sky is: rays through a street, and the look-up that every epoch pays."""

from __future__ import annotations

import statistics

import numpy as np

from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.raytrace import first_hits, first_hits_reference
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["measure"]

STREET_M = 1000.0
ANTENNAS = 200
VEHICLES = 256


def measure(rounds: int = 5) -> list[Row]:
    """Line of sight in a dense street against the plain NumPy form (same answers first), look-up and sky track."""
    rng = np.random.default_rng(0)
    road = Road.straight(STREET_M, 0.4, lane_count=3)
    city = build_city(road, CityConfig.uniform(SectionKind.DENSE_CANYON), rng)
    config = SkyConfig()
    track = SkyTrack.from_config(config, 600.0)
    sky = track.at(config.start_gps_s, np.zeros(VEHICLES, dtype=np.int64))
    los = sky.los_enu[0][sky.above[0]]
    arc, lane = rng.uniform(0.0, STREET_M, ANTENNAS), rng.integers(0, 3, ANTENNAS)
    antenna = np.column_stack([road.pose_at(arc, road.lane_lateral_m(lane))[0], np.full(ANTENNAS, 1.5)])
    origin, direction = (
        np.ascontiguousarray(np.broadcast_to(x, (ANTENNAS, *los.shape)).reshape(-1, 3)) for x in (antenna[:, None], los)
    )
    few = slice(0, 40 * los.shape[0], 40)
    fast, slow = (
        first_hits(city.grid, origin[few], direction[few]),
        first_hits_reference(origin[few], direction[few], city.triangles_enu_m, city.foliage),
    )
    if not np.array_equal(fast.clear, slow.clear):
        raise AssertionError("the grid and the plain form disagree on line of sight")

    def numba_side() -> int:
        first_hits(city.grid, origin, direction)
        return int(origin.shape[0])

    def numpy_side() -> int:
        first_hits_reference(origin[few], direction[few], city.triangles_enu_m, city.foliage)
        return int(los.shape[0])

    rates = alternate({"numba": numba_side, "numpy": numpy_side}, rounds)
    mask = SkyMask.build(road, city)
    where, row = rng.uniform(0.0, STREET_M, VEHICLES), rng.integers(0, 3, VEHICLES)

    def look_side() -> int:
        mask.look(where, row, sky)
        return 1

    def track_side() -> int:
        track.at(config.start_gps_s + 33.0, sky.index)
        return 1

    calls = alternate({"look": look_side, "track": track_side}, rounds, seconds=0.2)
    return [
        Row("line_of_sight_sat_epochs_per_s", statistics.median(rates["numba"]), "1/s"),
        Row("line_of_sight_vs_numpy", median_ratio(rates, "numba", "numpy"), "x"),
        Row(
            f"sky_mask_look_us_b{VEHICLES}",
            1e6 / statistics.median(calls["look"]),
            "us",
            gate=100.0,
            higher_is_better=False,
        ),
        Row("sky_track_us", 1e6 / statistics.median(calls["track"]), "us", gate=20.0, higher_is_better=False),
    ]
