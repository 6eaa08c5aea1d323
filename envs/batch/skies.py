"""The skies that environments draw: the hours of the constellations, and the generated cities along their roads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.motion_kernel import Whereabouts
from lanebound.envs.batch.sky_ahead_kernel import Forecast, HourTable, SkyRows
from lanebound.envs.sky import Street
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records
from lanebound.integrity.sky.constellation import SatelliteTable, SkyConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.mask_kernel import EDGE_LINE, FACE, REFLECTION, MaskRows
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["HOURS", "NO_SEED", "Cities", "Sites", "Skies"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

HOURS = 24  # the constellations repeat after a day, nearly
STEP_S = 20.0  # between knots, as SkyTrack's
FAR_M = 2e7  # below the horizon, where a place is empty
NOWHERE_M = -1.0  # arc of the city of an environment without one
SPARE = 1.5  # room of a slot over what the city has for which it was made
KINDS = REFLECTION, FACE, EDGE_LINE
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


NO_SEED = -1


class Sites(NamedTuple):
    """Where the lanes (L,) of a network are: number of the site, arc of the beginning of each lane in a city there, up
    to where the lane has stations [m]; the largest number of stations of a site; and the seed of the city of each site,
    NO_SEED where it is drawn."""

    number: Rows
    begin_m: Array
    reach_m: Array
    stations: int
    seed: Rows


class Cities:
    """The cities along the lanes of a network that episodes are in, each in a slot of one mask.

    A city at one of several sites of the network is a city of its own.

    A city is made when the first episode begins in it, and keeps its slot until that is needed and no episode runs or
    waits in it. With at least as many slots as there are such episodes, every city finds one; which slot it has, and
    how many there are, changes nothing that episodes measure.

    Parameters
    ----------
    street : makes the street of a city from its seed and the number of a site
    sites : of the lanes
    slots : largest number of cities at a time
    first, one : seed and site of the first city, and its street

    Attributes
    ----------
    mask, forecast : of all slots, one after another
    made : number of cities that have been put into slots
    """

    def __init__(
        self, street: Callable[[int, int], Street], sites: Sites, slots: int, first: tuple[int, int], one: Street
    ) -> None:
        self.sites, self.mask, self.forecast = sites, one.mask, one.forecast
        self._street, self._slots, self._held, self.made = street, slots, {first: 0}, 1
        self._arcs: list[Array] = []  # of the environments, as they have been given out
        self._stations = sites.stations
        if slots > 1 and not one.mask.closed:  # open skies are the same everywhere
            self._allocate(one)
            self._write(0, one)

    @property
    def nbytes(self) -> int:
        """Memory of all slots, once they are all used."""
        return self.mask.nbytes + self.forecast.free.nbytes

    def where(self, count: int) -> Whereabouts:
        """Where ``count`` environments are, before any start in the first slot."""
        self._arcs.append(np.zeros(count))
        return Whereabouts(self.sites.begin_m, self.sites.reach_m, self._arcs[-1])

    def ahead(self, distances_m: Sequence[float]) -> Forecast:
        """The forecast at distances ahead."""
        f = self.forecast
        distances = np.array(distances_m, dtype=np.float64)
        return Forecast(f.free, distances, float(f.spacing_m), int(f.azimuths), int(f.elevations))

    def settle(self, where: Whereabouts, rows: Rows, seeds: Rows, lanes: Rows) -> None:
        """Put environments ``rows`` into the cities of seeds (n,) at the sites of lanes (n,); missing ones are made.

        Raises
        ------
        ConfigError
            Some cities are open and some are not.
        """
        where.city[rows] = NOWHERE_M  # leave their slots to others
        for row, seed, site in zip(rows.tolist(), seeds.tolist(), self.sites.number[lanes].tolist(), strict=True):
            own = int(self.sites.seed[site])
            slot = self._slot((seed if own == NO_SEED else own, site))
            where.city[row] = self.mask.spacing_m * self._stations * slot

    def _slot(self, city: tuple[int, int]) -> int:
        """The slot of a city at a site."""
        slot = self._held.pop(city, None)
        if slot is None:
            street = self._street(*city)
            if street.mask.closed != self.mask.closed:
                raise ConfigError(
                    "sky must leave all cities open or none in the vector engine: choose another level or other cities"
                )
            slot = 0 if self.mask.closed else self._free()
            if not self.mask.closed:
                self._write(slot, street)
            self.made += 1
        self._held[city] = slot  # the last one is the newest
        return slot

    def _free(self) -> int:
        """A slot in which nothing is, or the one of the city that was drawn least recently and is not used."""
        length = self.mask.spacing_m * self._stations
        used = {round(arc / length) for arcs in self._arcs for arc in arcs.tolist() if arc != NOWHERE_M}
        empty = set(range(self._slots)) - set(self._held.values()) - used
        if empty:
            return min(empty)
        city = next(city for city, slot in self._held.items() if slot not in used)
        return self._held.pop(city)

    def _allocate(self, one: Street) -> None:
        """Make room for cities of about the size of one; memory is taken as slots are written."""
        rows, slots, n = one.mask.rows, self._slots, self._stations
        self._room = [int(SPARE * len(part)) for part in (rows.reflection, rows.faces, rows.edges)]
        rules = rows.rules.copy()
        rules["length"] = rules["spacing"] * n * slots
        cell, first, edge, free = (
            np.zeros((slots * n if len(part) else 0, *part.shape[1:]), part.dtype)
            for part in (rows.cell, rows.first, rows.edge, one.forecast.free)
        )
        reflection, faces, edges = self._tables(self._room)
        self.mask = SkyMask.of_rows(MaskRows(rules, cell, first, reflection, edge, faces, edges))
        shown = one.forecast
        self.forecast = SkyForecast(free, shown.azimuths, shown.elevations, shown.spacing_m)

    def _tables(self, room: list[int]) -> list[Records]:
        """Empty tables of reflections, faces and edges of all slots, each with so much room."""
        return [np.zeros(self._slots * size, kind) for size, kind in zip(room, KINDS, strict=True)]

    def _write(self, slot: int, street: Street) -> None:
        """Put a city into a slot."""
        theirs, rows = street.mask.rows, self.mask.rows
        sizes = [len(part) for part in (theirs.reflection, theirs.faces, theirs.edges)]
        if any(size > room for size, room in zip(sizes, self._room, strict=True)):
            self._widen([max(int(SPARE * size), room) for size, room in zip(sizes, self._room, strict=True)])
            rows = self.mask.rows
        begin, (r, f, e) = slot * self._stations, (slot * k for k in self._room)
        at = slice(begin, begin + len(theirs.cell))  # a shorter road leaves the rest unused
        rows.cell[at], rows.first[at], self.forecast.free[at] = theirs.cell, theirs.first + r, street.forecast.free
        if len(rows.edge):
            rows.edge[at] = _from(theirs.edge, e)
        rows.reflection[r : r + sizes[0]] = theirs.reflection
        rows.reflection["face"][r : r + sizes[0]] = _from(theirs.reflection["face"], f)
        rows.faces[f : f + sizes[1]], rows.edges[e : e + sizes[2]] = theirs.faces, theirs.edges

    def _widen(self, room: list[int]) -> None:
        """Give every slot more room for reflections, faces and edges; the cities are put in again."""
        self._room, rows = room, self.mask.rows
        reflection, faces, edges = self._tables(room)
        self.mask.rows = rows._replace(reflection=reflection, faces=faces, edges=edges)
        for city, slot in self._held.items():
            self._write(slot, self._street(*city))


def _from(index: NDArray[np.int32], begin: int) -> NDArray[np.int32]:
    """Indices from the beginning of a slot; -1 stays."""
    return np.where(index < 0, -1, index + begin).astype(np.int32)
