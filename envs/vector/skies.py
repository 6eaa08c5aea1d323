"""Every sky that an environment may draw: the hours of the constellations, and the made-up cities along its road."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.core import DrivingEnv
from lanebound.envs.scene import HOURS, MARGIN_S
from lanebound.envs.sky import build_street
from lanebound.envs.vector.lanes import lane_rows
from lanebound.envs.vector.senses_kernel import skies_at
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["Skies"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
STEP_S = 20.0  # between knots, as SkyTrack's
FAR_M = 2e7  # below the horizon, where a place is empty
NO_RANGE = np.zeros((0, 0))  # ranges are not asked for: measurements are differences to a station


@dataclass(frozen=True)
class Skies:
    """H hours over S places for satellites, and the cities of a road one after another in one mask.

    A place belongs to a system, and holds another satellite of it in each hour: so S is little more than rise in one.

    Attributes
    ----------
    start_s : (H,) GPS time at which each hour's sky begins
    offset_m, rate_mps : (H, K, S, 3) vectors to the satellites and their rates at knots
    used : (H, S) bool, places taken in that hour, by the satellites of a single environment's track in their order
    track : of the first hour, for what does not depend on the time
    mask, forecast : of all cities; city_m (layouts,): arc at which each begins
    begin_m, reach_m : (L,) arc of the beginning of each lane in a city, and up to where it has stations
    """

    start_s: Array
    offset_m: Array
    rate_mps: Array
    used: NDArray[np.bool_]
    track: SkyTrack
    mask: SkyMask
    forecast: SkyForecast
    city_m: Array
    begin_m: Array
    reach_m: Array

    @classmethod
    def of(cls, single: DrivingEnv, settings: NavigatorConfig, duration_s: float) -> Self:
        """The skies of an environment's configuration.

        Raises
        ------
        ConfigError
            Cities of which some are open and some are not.
        """
        sky = settings.sky
        table, place, mask_rad = sky.satellites(), sky.place_rad, sky.mask_rad
        start = np.asarray(sky.start_gps_s + 3600.0 * np.arange(HOURS), dtype=np.float64)
        knots = STEP_S * np.arange(
            int(np.ceil((single.config.navigation.warm_up_s + duration_s + MARGIN_S) / STEP_S)) + 1
        )
        rising = np.stack([table.view(begin + knots, *place, mask_rad).above.any(0) for begin in start])
        held = _places(table.system, rising)
        used = held >= 0
        offset = np.zeros((HOURS, knots.size, held.shape[1], 3))
        rate = np.zeros_like(offset)
        offset[..., 2] = -FAR_M
        for hour, begin in enumerate(start):
            satellites = table.take(held[hour, used[hour]])
            offset[hour][:, used[hour]], rate[hour][:, used[hour]] = satellites.relative_enu(begin + knots, *place)
        some = table.take(held.max(0))
        track = SkyTrack(float(start[0]), STEP_S, offset[0], rate[0], float(mask_rad), some.system, some.prn)
        return cls(start, offset, rate, used, track, *_cities(single))

    @property
    def hours(self) -> int:
        """Number of hours H."""
        return int(self.start_s.shape[0])

    def view(self, hour: Rows, clock_s: Array, there: NDArray[np.bool_]) -> SkyView:
        """The skies of N environments of M vehicles: a row for each environment, and one without any satellite.

        hour (N,), and ``clock_s`` (N,) after that hour's beginning; there (N, M): whether there is a vehicle. Where
        there is none nothing is received, which is soon navigated.
        """
        begin = self.start_s[hour]
        place = (begin + clock_s - begin) / STEP_S  # rounded as by SkyTrack.at
        knot = np.minimum(np.maximum(place.astype(np.int64), 0), self.offset_m.shape[1] - 2)
        count, satellites = hour.shape[0], self.offset_m.shape[2]
        los, elevation, azimuth = np.zeros((count + 1, satellites, 3)), *np.zeros((2, count + 1, satellites))
        above = np.zeros((count + 1, satellites), dtype=np.bool_)
        run_rows(
            skies_at, count, self.offset_m, self.rate_mps, hour, knot, place - knot, STEP_S, self.track.mask_rad, los,
            elevation, azimuth, above, row_us=2.0,
        )  # fmt: skip
        index = np.where(there, np.arange(count)[:, None], count).ravel()
        return SkyView(los, elevation, azimuth, NO_RANGE, NO_RANGE, above, self.track.system, self.track.prn, index)


def _places(system: NDArray[np.int64], rising: NDArray[np.bool_]) -> Rows:
    """The satellite in each place at each hour, (H, S), -1 for none: as many places of a system as rise at once.

    system (n,) of all satellites; rising (H, n).
    """
    blocks = []
    for one in dict.fromkeys(system.tolist()):
        rows = np.flatnonzero(system == one)
        block = np.full((rising.shape[0], int(rising[:, rows].sum(1).max())), -1)
        for hour, up in enumerate(rising[:, rows]):
            block[hour, : int(up.sum())] = rows[up]
        blocks.append(block)
    return np.concatenate(blocks, 1).astype(np.int64)


def _cities(single: DrivingEnv) -> tuple[Any, ...]:
    """Mask and forecast of all layouts in a row, where each begins, and where each lane does."""
    config, world = single.config, single.world
    network, sections = world.road.network, getattr(world, "sections", ())
    streets = [build_street(network, config.level, n, sections, config.extent_m) for n in range(config.layouts)]
    first, rows = streets[0], lane_rows(network)
    begin = np.array([first.lanes.offset_m[index[:2]] for index in rows])
    reach = np.array([first.lanes.reach_m[index] for index in rows])
    masks, forecasts = [street.mask for street in streets], [street.forecast for street in streets]
    if all(mask.closed for mask in masks):  # open skies, the same everywhere
        return first.mask, first.forecast, np.zeros(len(streets)), begin, reach
    if any(mask.closed for mask in masks):
        raise ConfigError("sky must leave all cities open or none in the vector engine: choose another level or seed")
    stations = np.cumsum([0, *(mask.path.shape[0] for mask in masks)])
    mask = SkyMask(
        np.concatenate([m.path for m in masks]),
        np.concatenate([m.excess_m for m in masks]),
        first.mask.azimuths,
        first.mask.elevations,
        first.mask.spacing_m,
        first.mask.spacing_m * float(stations[-1]),
        False,
    )
    free = np.concatenate([f.free for f in forecasts])
    forecast = SkyForecast(free, first.forecast.azimuths, first.forecast.elevations, first.forecast.spacing_m)
    return mask, forecast, first.mask.spacing_m * stations[:-1], begin, reach
