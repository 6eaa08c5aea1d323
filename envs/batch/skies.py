"""Every sky that an environment may draw: the hours of the constellations, and the made-up cities along its roads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.motion_kernel import Whereabouts
from lanebound.envs.batch.sky_ahead_kernel import Forecast, HourTable, SkyRows
from lanebound.envs.sky import Street
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sky.constellation import SatelliteTable, SkyConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import Faces
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["HOURS", "Cities", "Skies"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

HOURS = 24  # the constellations repeat after a day, nearly
STEP_S = 20.0  # between knots, as SkyTrack's
FAR_M = 2e7  # below the horizon, where a place is empty
NO_RANGE = np.zeros((0, 0))  # ranges are not read: measurements are differences to a station


@dataclass(frozen=True)
class Skies:
    """H hours over S places for satellites.

    A place belongs to a system, and holds another satellite of it in each hour: so S is little more than rise in one
    hour. A single environment that draws one hour has the places of all, so that sums over satellites have the same
    order, and the same bits, as in a batch.

    Attributes
    ----------
    table : vectors to the satellites and their rates, and when each hour's sky begins
    used : (H, S) bool, places taken in that hour, by the satellites that rise in it in their order
    prn : (H, S) numbers of the satellites in the places
    track : of the first hour; the other hours have the same systems
    """

    table: HourTable
    used: NDArray[np.bool_]
    prn: Rows
    track: SkyTrack

    @classmethod
    def of(cls, sky: SkyConfig, span_s: float, hours: Sequence[int]) -> Self:
        """The skies of some of the hours, each for ``span_s`` from its beginning."""
        text, knots = sky.to_json(), int(np.ceil(span_s / STEP_S)) + 1
        held = _places(text, knots)[list(hours)]
        tables = [_hour(text, knots, hour) for hour in hours]
        start = np.array([_start_s(sky, hour) for hour in hours])
        offset, rate = np.stack([offset for offset, _ in tables]), np.stack([rate for _, rate in tables])
        satellites, some = _satellites(text), np.where(held >= 0, held, _places(text, knots).max(0))
        system, prn = satellites.system[some[0]], satellites.prn[some]
        track = SkyTrack(float(start[0]), STEP_S, offset[0], rate[0], float(sky.mask_rad), system, prn[0])
        return cls(HourTable(offset, rate, start, STEP_S, track.mask_rad), held >= 0, prn, track)

    @property
    def satellites(self) -> int:
        """Number of places S."""
        return int(self.used.shape[1])

    def risen(self, hour: int) -> SkyTrack:
        """The satellites alone that rise in an hour, the h-th of H."""
        t, table, used = self.track, self.table, self.used[hour]
        return SkyTrack(float(table.start[hour]), STEP_S, table.offset[hour][:, used], table.rate[hour][:, used],
                        t.mask_rad, t.system[used], self.prn[hour, used])  # fmt: skip

    def empty(self, count: int) -> SkyRows:
        """Rows for N environments and one more, in which there is no satellite."""
        shape = count + 1, self.satellites
        return SkyRows(np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.bool_))

    def view(self, sky: SkyRows, index: Rows, hour: int = 0) -> SkyView:
        """The skies as navigators take them; ``index`` (B,): the row of each vehicle, ``hour``: of the numbers."""
        system, prn = self.track.system, self.prn[hour]
        return SkyView(sky.los, sky.elevation, sky.azimuth, NO_RANGE, NO_RANGE, sky.above, system, prn, index)


def _start_s(sky: SkyConfig, hour: int) -> float:
    return float(sky.start_gps_s + 3600.0 * hour)


@lru_cache(maxsize=16)
def _satellites(text: str) -> SatelliteTable:
    return SkyConfig.from_json(text).satellites()


@lru_cache(maxsize=16)
def _places(text: str, knots: int) -> Rows:
    """The satellite in each place at each hour, (HOURS, S), -1 for none: as many places of a system as rise at once."""
    sky = SkyConfig.from_json(text)
    table, times = _satellites(text), STEP_S * np.arange(knots)
    skies = [table.view(_start_s(sky, hour) + times, *sky.place_rad, sky.mask_rad) for hour in range(HOURS)]
    rising = np.stack([view.above.any(0) for view in skies])
    blocks = []
    for one in dict.fromkeys(table.system.tolist()):
        rows = np.flatnonzero(table.system == one)
        block = np.full((HOURS, int(rising[:, rows].sum(1).max())), -1)
        for hour, up in enumerate(rising[:, rows]):
            block[hour, : int(up.sum())] = rows[up]
        blocks.append(block)
    return np.concatenate(blocks, 1).astype(np.int64)


@lru_cache(maxsize=64)
def _hour(text: str, knots: int, hour: int) -> tuple[Array, Array]:
    """Vectors to the satellites of an hour (K, S, 3) and their rates."""
    sky, held = SkyConfig.from_json(text), _places(text, knots)[hour]
    used = held >= 0
    offset, rate = np.zeros((2, knots, held.size, 3))
    offset[..., 2] = -FAR_M
    times = _start_s(sky, hour) + STEP_S * np.arange(knots)
    offset[:, used], rate[:, used] = _satellites(text).take(held[used]).relative_enu(times, *sky.place_rad)
    return offset, rate


@dataclass(frozen=True)
class Cities:
    """The cities of a road network one after another in one mask.

    Attributes
    ----------
    mask, forecast : of all cities
    city_m : (layouts,) arc at which each begins
    begin_m, reach_m : (L,) arc of the beginning of each lane in a city, and up to where the lane has stations
    """

    mask: SkyMask
    forecast: SkyForecast
    city_m: Array
    begin_m: Array
    reach_m: Array

    @classmethod
    def of(cls, streets: Sequence[Street], table: LaneTable) -> Self:
        """The cities of streets along the same lanes.

        Raises
        ------
        ConfigError
            Some are open and some are not.
        """
        first = streets[0]
        begin = np.array([first.lanes.offset_m[index[:2]] for index in table.index])
        reach = np.array([first.lanes.reach_m[index] for index in table.index])
        masks, forecasts = [street.mask for street in streets], [street.forecast for street in streets]
        if len(streets) == 1 or all(mask.closed for mask in masks):  # open skies are the same everywhere
            return cls(first.mask, first.forecast, np.zeros(len(streets)), begin, reach)
        if any(mask.closed for mask in masks):
            raise ConfigError(
                "sky must leave all cities open or none in the vector engine: choose another level or seed"
            )
        stations = np.cumsum([0, *(mask.path.shape[0] for mask in masks)])
        spacing = first.mask.spacing_m
        mask = SkyMask(
            np.concatenate([m.path for m in masks]),
            np.concatenate([m.excess_m for m in masks]),
            first.mask.azimuths,
            first.mask.elevations,
            spacing,
            spacing * float(stations[-1]),
            False,
            faces=Faces.join([m.faces for m in masks]),
        )
        free = np.concatenate([f.free for f in forecasts])
        shown = first.forecast
        forecast = SkyForecast(free, shown.azimuths, shown.elevations, shown.spacing_m)
        return cls(mask, forecast, spacing * stations[:-1], begin, reach)

    def where(self, layout: Rows) -> Whereabouts:
        """Where N environments are, each in the city of its layout (N,)."""
        return Whereabouts(self.begin_m, self.reach_m, np.asarray(self.city_m[layout], dtype=np.float64))

    def ahead(self, distances_m: Sequence[float]) -> Forecast:
        """The forecast at distances ahead."""
        f = self.forecast
        distances = np.array(distances_m, dtype=np.float64)
        return Forecast(f.free, distances, float(f.spacing_m), int(f.azimuths), int(f.elevations))
