"""Generated streets along any lane network: houses, trees, overpasses and tunnels, and the sky masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from highway_env.road.road import RoadNetwork

from lanebound.envs.sky import cache
from lanebound.envs.sky.corridors import Corridor, Edge, LaneGround, corridors, edges_of
from lanebound.envs.sky.level import SkyLevel
from lanebound.envs.sky.recorded import recorded_street, recording_of
from lanebound.envs.sky.street import LaneMap, Street
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.city import CityConfig, SectionKind, Stretch, line_street
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import City, clad
from lanebound.integrity.sky.survey import as_mapped
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["SPACING_M", "Section", "build_street"]

Section = tuple[str, str, float, float, str]  # edge from, edge to, start [m], end [m], SectionKind

ANTENNA_HEIGHT_M = 1.5
SPACING_M = 5.0
LEAST_STRETCH_M = 6.0  # a shorter rest of a stretch at the end of an edge is left open
AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG = 4.0, 3.0


def build_street(
    network: RoadNetwork,
    level: SkyLevel,
    layout_seed: int,
    sections: Sequence[Section] | None = None,
    extent_m: float = 2500.0,
    surroundings: City | None = None,
    *,
    widest: int = 0,
    reuse: bool = True,
) -> Street:
    """Build the street of a network at a level; the same inputs give the same bits.

    Parameters
    ----------
    network : any highway-env network
    layout_seed : seed of the generated city
    sections : stretches given by a world, ``(edge from, edge to, start [m], end [m], kind)``; heights and the rest of
        the edges are those of the level
    extent_m : largest length of an edge with buildings; the last station is used beyond
    surroundings : the obstacles of a map given by a world, in place of a generated city; their facades are drawn
    widest : number of lanes of the masks, where that is more than the network has
    reuse : use a street from the cache in memory or on disk, and store this one

    Raises
    ------
    InputError
        There are no lanes, ``sections`` has an unknown edge or kind, the extent is not positive, or a recorded sky
        cannot be read completely.
    """
    if not extent_m > 0.0:
        raise InputError(f"extent_m must be positive, got {extent_m}: pass a length in metres")
    if not any(edges_of(network)):
        raise InputError("network must have lanes, got none: pass env.unwrapped.road.network after reset")
    sections = tuple(sections or ())
    if not reuse:
        return _build(network, level, layout_seed, sections, extent_m, surroundings, widest)
    more: list[object] = [widest] if widest else []
    more += [] if level.recording is None else [recording_of(level.recording).digest]
    more += [] if surroundings is None else [surroundings.digest]
    key = cache.key_of(network, level, layout_seed, sections, float(extent_m), *more)
    street = cache.remember(key)
    if street is None:
        street = cache.load(key, LaneMap.of(network, extent_m, SPACING_M))
        if street is None:
            street = _build(network, level, layout_seed, sections, extent_m, surroundings, widest, key)
            cache.save(key, street)
        cache.remember(key, street)
    return street


def _build(
    network: RoadNetwork,
    level: SkyLevel,
    layout_seed: int,
    sections: tuple[Section, ...],
    extent_m: float,
    surroundings: City | None = None,
    widest: int = 0,
    digest: str = "",
) -> Street:
    members = corridors(network, extent_m)
    lanes = LaneMap.of(network, extent_m, SPACING_M)
    if level.recording is not None:
        return recorded_street(network, members, lanes, recording_of(level.recording), layout_seed, widest)
    city = surroundings if level.follow_sections else None
    if city is None:
        city = _city(network, members, level, layout_seed, _named(members, sections), extent_m)
    facades = clad(city.building, level.material_shares, named_generator(layout_seed, "facades"))
    city = replace(city, material=facades)
    if not len(city):
        return Street(SkyMask.open(), SkyForecast.open(), city, lanes)
    antennas, cells = lanes.antennas(network, ANTENNA_HEIGHT_M, widest), (AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG)
    mask = SkyMask.of_stations(antennas, city, SPACING_M, *cells, digest)
    mapped = as_mapped(city, level.map, named_generator(layout_seed, "map"))
    return Street(mask, SkyForecast.of_stations(antennas, mapped, SPACING_M, *cells), city, lanes)


def _city(
    network: RoadNetwork,
    members: list[Corridor],
    level: SkyLevel,
    layout_seed: int,
    named: dict[Edge, list[Stretch]],
    extent_m: float,
) -> City:
    """Obstacles on both sides of every edge, of the level's kinds of street or of the named ones."""
    cycle = sum(section.length_m for section in level.city.sections)
    phase = cycle * named_generator(layout_seed, "city").random(max(c.chain for c in members) + 1)
    ground = LaneGround(network, members, extent_m)
    city = City.empty()
    for number, corridor in enumerate(members):
        at = corridor.start_m + float(phase[corridor.chain])
        stretches = _cut(level.city, at, corridor.road.length_m)
        if level.follow_sections:
            stretches = _overlaid(stretches, named.get(corridor.edge, []))
        rng = named_generator([layout_seed, number], "city")
        kinds = level.streets_along(2.0 * corridor.road.edge_m)
        city = city + line_street(corridor.road, stretches, kinds, rng, ground.plot(corridor))
    return city


def _cut(config: CityConfig, at_m: float, length_m: float) -> list[Stretch]:
    """The stretches between two arcs of an endless street, with arcs from the first."""
    whole = config.stretches(at_m + length_m)
    inside = [Stretch(max(s.start_m - at_m, 0.0), s.end_m - at_m, s.kind, s.left_kind) for s in whole]
    return [s for s in inside if s.end_m - s.start_m >= LEAST_STRETCH_M]


def _overlaid(below: list[Stretch], above: list[Stretch]) -> list[Stretch]:
    """The stretches ``above``, and the uncovered parts of ``below``."""
    out = list(above)
    for s in below:
        at = s.start_m
        for cover in [*sorted(above, key=lambda c: c.start_m), Stretch(s.end_m, s.end_m, s.kind, s.kind)]:
            if cover.start_m > at:
                out.append(Stretch(at, min(cover.start_m, s.end_m), s.kind, s.left_kind))
            at = max(at, cover.end_m)
            if at >= s.end_m:
                break
    return sorted(out, key=lambda s: s.start_m)


def _named(members: list[Corridor], sections: Sequence[Section]) -> dict[Edge, list[Stretch]]:
    """The stretches given by a world, by edge, limited to the lengths of the edges."""
    lengths = {corridor.edge: corridor.road.length_m for corridor in members}
    out: dict[Edge, list[Stretch]] = {}
    for start, end, low, high, name in sections:
        if (start, end) not in lengths:
            raise InputError(f"sections must name edges of the network, got ({start!r}, {end!r}): correct the section")
        if name not in list(SectionKind):
            raise InputError(f"sections must name kinds among {[k.value for k in SectionKind]}, got {name!r}")
        kind, last = SectionKind(name), min(float(high), lengths[start, end])
        if last > max(low, 0.0):
            out.setdefault((start, end), []).append(Stretch(max(float(low), 0.0), last, kind, kind))
    return out
