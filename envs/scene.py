"""Sets the scene of an episode: the street for a network, the sky of an hour, the navigators of all vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.batch.episodes import Episodes, empty_cars, reach_of
from lanebound.envs.batch.faults import NO_FAULTS
from lanebound.envs.batch.fleet import FleetNavigation
from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.navigation import NavigationBatch, Starts, draw_starts
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.route_map import routes_of
from lanebound.envs.batch.rules import rules_of
from lanebound.envs.batch.skies import HOURS, NO_SEED, Cities, Sites, Skies
from lanebound.envs.config import EnvConfig, FaultLevel
from lanebound.envs.info import FAULT_INFO
from lanebound.envs.recordings import recordings_of
from lanebound.envs.records import LaneIndex
from lanebound.envs.road_map import road_map_of
from lanebound.envs.sky import LaneMap, Section, SkyLevel, Street, build_street
from lanebound.envs.sky.build import SPACING_M
from lanebound.envs.worlds import world_kind
from lanebound.envs.worlds.street_maps import map_place
from lanebound.integrity.core.config_errors import joined
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.risk import upper_quantile
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.campaign import random_campaign, single_fault
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.scene import City

__all__ = ["MAP_SHARE", "EpisodeContext", "alert_limits_m", "begin_all", "duration_s", "give_faults", "make_batch",
           "map_bound_m", "navigator_config", "set_scene"]  # fmt: skip

ENDLESS_S = 300.0  # of sky for worlds that set no duration
FLEET = "fleet"  # stream of the seeds of the other vehicles of a fleet
MARGIN_S = 60.0  # of sky beyond what an episode is expected to last
MAP_SHARE = 0.1  # of the integrity risk, for the map, whose Gaussian bound a small share widens least


def map_bound_m(config: EnvConfig, navigator: NavigatorConfig) -> float:
    """A bound of the map's shift on each axis: ``Qinv(risk MAP_SHARE / 4) sigma``, for two sides of two axes.

    The navigator's levels are left the rest of the risk, so that the pose on the map keeps to the stated total.
    """
    tail = 0.25 * MAP_SHARE * navigator.risk.integrity_risk
    return float(upper_quantile(np.array(tail))) * config.navigation.map_sigma_m


def alert_limits_m(world: AbstractEnv, config: EnvConfig) -> tuple[float, float]:
    """Alert limits along and across the track, of the world's narrowest lane and its ego."""
    narrowest = min(float(lane.width_at(0.0)) for lane in world.road.network.lanes_list())
    return config.limits_m(narrowest, float(world.vehicle.WIDTH))


def navigator_config(config: EnvConfig, limits_m: tuple[float, float]) -> NavigatorConfig:
    """The level's navigator with the environment's rate, alert limits and overrides.

    The limits are for the pose on the map, so the map's own bound is taken off them, and its risk off the total.
    """
    return _navigator_config(config.to_json(), config.level.to_json(), limits_m)


@lru_cache(maxsize=32)
def _navigator_config(text: str, level: str, limits_m: tuple[float, float]) -> NavigatorConfig:
    config = EnvConfig.from_json(text)
    base = (
        SkyLevel.from_json(level)
        .navigator()
        .replace(
            dt_s=1.0 / config.navigation.rate_hz,
            start=config.navigation.start,
            positioning={"axle_m": 0.5 * Vehicle.LENGTH},
            chassis={"wheelbase_m": Vehicle.LENGTH, "axle_m": 0.5 * Vehicle.LENGTH},
            **map_place(config.world),
        )
    )
    try:
        given = base.replace(**config.navigator)
    except ConfigError as error:
        raise ConfigError("\n".join(joined("navigator", (line,)) for line in str(error).splitlines())) from None
    limits = [max(limit - map_bound_m(config, given), 0.01) for limit in limits_m]
    spent = MAP_SHARE * given.risk.integrity_risk if config.navigation.map_sigma_m > 0.0 else 0.0
    return given.replace(
        alert={"limits": {"al_at_m": limits[0], "al_ct_m": limits[1]}},
        risk={"unmonitored_risk": given.risk.unmonitored_risk + spent},
    )


def duration_s(config: EnvConfig, world: AbstractEnv) -> float:
    """When an episode is truncated."""
    return float(config.duration_s or world.config.get("duration", ENDLESS_S))


def make_batch(
    world: AbstractEnv, config: EnvConfig, count: int, waiting: int, vehicles: int, capacity: int
) -> Episodes:  # fmt: skip
    """N episodes of the vector engine, each in any of the cities at any hour.

    waiting : next episodes that may wait, each in a city of its own
    vehicles : that there may be in each
    capacity : slots of the others
    """
    streets, first = Streets.of(world, config), (config.cities.seed_of(0), 0)
    slots = min((1 if streets.seeds else config.cities.number) * len(streets.networks), count + waiting)
    return _episodes(world, config, streets, first, streets(*first), slots, range(HOURS), count, vehicles, capacity)


@dataclass(frozen=True)
class Streets:
    """Makes the streets of cities along the roads of a world, or of its map, at each site of its network.

    seeds : of the cities at the sites; empty where any city may be at any of them
    """

    networks: tuple[RoadNetwork, ...]
    level: SkyLevel
    sections: tuple[Section, ...]
    extent_m: float
    vary: bool
    surroundings: tuple[City, ...]
    widest: int
    seeds: tuple[int, ...]

    @classmethod
    def of(cls, world: AbstractEnv, config: EnvConfig) -> Self:
        """Of a world."""
        sections, around = tuple(getattr(world, "sections", ())), _around(world, config.extent_m)
        whole, sites = world.road.network, len(getattr(world.road.network, "sites", ()))
        networks = tuple(whole.alone(k) for k in range(sites)) or (whole,)
        widest = max(len(lanes) for ends in whole.graph.values() for lanes in ends.values()) if sites else 0
        seeds = tuple(world.config.get("seeds", ()))
        return cls(networks, config.level, sections, config.extent_m, config.cities.vary, around, widest, seeds)

    def __call__(self, seed: int, site: int) -> Street:
        level, network = self.level.of_city(seed) if self.vary else self.level, self.networks[site]
        around = self.surroundings[site] if self.surroundings else None
        return build_street(network, level, seed, self.sections, self.extent_m, around, widest=self.widest)

    def site_of(self, index: LaneIndex) -> int:
        """The site of a lane."""
        return next((k for k, one in enumerate(self.networks) if index[1] in one.graph.get(index[0], ())), 0)

    def sites(self, table: LaneTable) -> Sites:
        """Where the lanes of a table are."""
        number = np.zeros(len(table.index), dtype=np.int64)
        begin_m, reach_m, stations = np.zeros(len(table.index)), np.zeros(len(table.index)), 0
        for k, network in enumerate(self.networks):
            lanes = LaneMap.of(network, self.extent_m, SPACING_M)
            for index, reach in lanes.reach_m.items():
                row = table.row[index]
                number[row], begin_m[row], reach_m[row] = k, lanes.offset_m[index[:2]], reach
            stations = max(stations, lanes.count)
        return Sites(number, begin_m, reach_m, stations, np.array(self.seeds or len(self.networks) * [NO_SEED]))


def _around(world: AbstractEnv, extent_m: float) -> tuple[City, ...]:
    """The obstacles of a world's map at each site, none without a map.

    Raises
    ------
    ConfigError
        A road of the map is longer than ``extent_m``, up to which the sky of a road is computed.
    """
    around: tuple[City, ...] = getattr(world, "surroundings", ())
    if around:
        longest = max(float(lane.length) for lane in world.road.network.lanes_list())
        if longest > extent_m:
            raise ConfigError(
                f"extent_m must be {longest:.0f} m or more with this world.map, got {extent_m:g}: raise it"
            )
    return around


def begin_all(
    episodes: Episodes, rows: NDArray[np.int64], seeds: Sequence[int], newcomers: int, duration_s: float
) -> Starts | None:  # fmt: skip
    """Begin episodes of the engine, whose cars are in their places; ``duration_s``: of an episode.

    newcomers : slots of each beside those of the others that are there
    """
    slots = np.minimum(episodes.ego["vehicles"][rows] - 1 + newcomers, episodes.config.slots)
    crew = np.arange(episodes.perception.capacity) < slots[:, None]
    config, navigation = episodes.config, episodes.navigation
    starts = None
    if navigation is not None:
        navigating = crew[:, : navigation.vehicles - 1]
        starts = draw_starts(seeds, config.cities, HOURS, navigating, config.navigation.source.uses_sensors)
    episodes.begin(rows, seeds, starts, crew)
    if navigation is not None:
        for row, others, seed in zip(rows.tolist(), slots.tolist(), seeds, strict=True):
            _put(navigation, row, config, _drawn(episodes, row, duration_s, others, seed))
    return starts


def _episodes(
    world: AbstractEnv,
    config: EnvConfig,
    streets: Streets,
    city: tuple[int, int],
    street: Street,
    slots: int,
    hours: Sequence[int],
    count: int,
    vehicles: int,
    capacity: int,
    views: int = 1,
) -> Episodes:
    """N episodes at some hours, of up to V vehicles, of which C others have a slot.

    city, street, slots : seed and site of the first city, its street, and how many there are at a time
    views : rows of each episode, with another vehicle as the ego; more than one for a fleet, N is 1 then
    """
    settings = navigator_config(config, alert_limits_m(world, config))
    uses_sensors = config.navigation.source.uses_sensors
    navigate = capacity > 0 and (config.perception.others_navigate or views > 1)
    recorded = capacity > 0 and config.perception.has_radio and not navigate
    routes = routes_of(world.road.network, reach_of(config))
    steps = config.navigation.steps_per_epoch(config.simulation_hz)
    step_s = 1.0 / config.simulation_hz
    navigation = None
    if uses_sensors or (navigate and config.perception.others_navigate):
        span_s = config.navigation.warm_up_s + duration_s(config, world) + MARGIN_S
        skies = Skies.of(settings.sky, span_s, hours)
        cities = Cities(streets, streets.sites(routes.table), slots, city, street)
        members = 1 + (capacity if navigate else 0)
        navigation = (NavigationBatch if views == 1 else FleetNavigation)(
            config.navigation, settings, skies, cities, cities.ahead(config.observation.satellites_m),
            routes.table.lanes, count, members, step_s, steps,
            None if settings.context is None else road_map_of(world.road.network)[0],
        )  # fmt: skip
    perception = PerceptionBatch(
        config.perception,
        count * views,
        capacity,
        vehicles,
        step_s * steps,
        recordings_of(config) if recorded else None,
        settings.risk.integrity_risk,
    )
    rules = rules_of(config, alert_limits_m(world, config), map_bound_m(config, settings) if uses_sensors else 0.0)
    return Episodes(config, rules, routes, empty_cars(count * views, vehicles), navigation, perception)


@dataclass(frozen=True)
class EpisodeContext:
    """What the episode of a single environment takes place in: its street, and the episode as one row.

    The episode of a fleet has a row for each vehicle as the ego, with a seed of its own.
    """

    street: Street
    episodes: Episodes
    seeds: list[int]
    starts: Starts

    @property
    def seed(self) -> int:
        """Of the episode."""
        return self.seeds[0]


def set_scene(
    world: AbstractEnv, config: EnvConfig, seed: int, faults: tuple[Fault, ...] | None = None, fleet: bool = False
) -> EpisodeContext:
    """What an episode takes place in, all of it drawn from ``seed`` by named streams.

    ``fleet``: every vehicle is the ego of a row, the first one that of the world; the others have seeds of their own.

    ``faults`` takes the place of the random campaign when given; their times count from the start of the episode, and
    vehicle 0 is the ego, 1 and up the slots of the others, None all of them.

    Raises
    ------
    InputError
        A given fault cannot act.
    """
    others = sum(v is not world.vehicle for v in world.road.vehicles)
    kind = world_kind(config.base)
    capacity = min(config.slots, others + (0 if kind is None else kind.newcomers))
    seeds = [seed, *named_generator(seed, FLEET).integers(2**62, size=others if fleet else 0).tolist()]
    crew = np.zeros((len(seeds), capacity if fleet or config.perception.others_navigate else 0), dtype=np.bool_)
    crew[0] = True
    starts = draw_starts(seeds, config.cities, HOURS, crew, config.navigation.source.uses_sensors)
    hour, streets = int(starts.hour[0]), Streets.of(world, config)
    site = streets.site_of(world.vehicle.lane_index)
    city = streets.seeds[site] if streets.seeds else int(starts.city[0]), site
    street = streets(*city)
    episodes = _episodes(world, config, streets, city, street, 1, [hour], 1, 1 + others, capacity, len(seeds))
    navigation, ends_s = episodes.navigation, duration_s(config, world)
    if faults is not None:
        give_faults(episodes, 0, faults, ends_s)
    elif navigation is not None:
        _put(navigation, 0, config, _drawn(episodes, 0, ends_s, capacity, seed))
    return EpisodeContext(street, episodes, seeds, starts._replace(hour=np.zeros_like(starts.hour)))


def give_faults(episodes: Episodes, row: int, faults: Sequence[Fault], duration_s: float) -> None:
    """Put faults in the place of the random ones of an episode of ``duration_s`` [s]; see :func:`set_scene`.

    Raises
    ------
    InputError
        One of them cannot act, or each episode has one random fault by configuration.
    """
    # They would count with the weight and the probability of another fault.
    if episodes.config.faults is FaultLevel.ONE:
        raise InputError(f"options.faults must be left out with faults 'one', got {len(faults)}: set faults to none")
    if faults:
        alone = episodes.perception.recordings is not None
        _require_effect(faults, episodes.navigation, row, duration_s, alone)
    if episodes.navigation is not None:
        _put(episodes.navigation, row, episodes.config, faults)


def _put(navigation: NavigationBatch, row: int, config: EnvConfig, faults: Sequence[Fault]) -> None:
    """Give an episode faults whose times count from its start."""
    start_s = config.navigation.clock_start_s
    of_clock = [fault.replace(start_s=fault.start_s + start_s) for fault in faults]
    navigation.faults.put(row, FaultSchedule(of_clock) if of_clock else NO_FAULTS)


def _require_effect(
    faults: Sequence[Fault], navigation: NavigationBatch | None, row: int, duration_s: float, alone: bool
) -> None:  # fmt: skip
    """Refuse faults that cannot act in an episode of ``duration_s`` [s]: a driver would seem robust against them.

    ``alone``: the ego alone navigates, others have surrogates.
    """
    if navigation is None:
        raise InputError("options.faults must be left out where nothing navigates: set navigation.source to navigator")
    track, crew = navigation.skies.risen(int(navigation.hour[row])), navigation.crew(row)
    for i, fault in enumerate(faults):
        name = f"options.faults.{i}"
        if fault.start_s >= duration_s:
            raise InputError(
                f"{name}.start_s must be before the end of the episode, {duration_s:g} s, got {fault.start_s:g}: "
                "begin it earlier, or raise duration_s"
            )
        if fault.vehicle is not None and fault.vehicle >= crew:
            raise InputError(
                f"{name}.vehicle must be below {crew}, the vehicles that navigate (0: the ego), got "
                f"{fault.vehicle}: name another, or none for all"
            )
        if fault.kind == "v2v_lie" and (crew == 1 or fault.vehicle == 0):
            raise InputError(
                f"{name}.kind must not be v2v_lie where no other vehicle lies, got it for vehicle {fault.vehicle}: "
                "name another; perception.source must be v2v, both or cooperative, and perception.others full"
            )
        # Under full a fault of all vehicles acts in the others as well, whose surrogates have no receivers.
        if alone and fault.vehicle != 0:
            raise InputError(
                f"{name}.vehicle must be 0 with perception.others surrogate, got {fault.vehicle}: name the ego, or set "
                "perception.others to full"
            )
        if fault.prn is not None and not ((track.system == fault.system) & (track.prn == fault.prn)).any():
            known = ", ".join(map(str, sorted(track.prn[track.system == fault.system]))) or "none"
            raise InputError(
                f"{name}.prn must be of a satellite of this sky, got {fault.prn}: it has {known} of that system"
            )


def _wrong_senders(config: EnvConfig, duration_s: float, others: int, seed: int) -> tuple[Fault, ...]:
    """Faults of the slots whose broadcasts are displaced in the whole episode, in any direction."""
    perception, rng = config.perception, named_generator(seed, "wrong_senders")
    if not perception.wrong_share:
        return ()
    draws = [(rng.random(), rng.uniform(*perception.wrong_m), rng.uniform(0.0, 360.0)) for _ in range(others)]
    return tuple(
        Fault(kind="v2v_lie", vehicle=slot, duration_s=duration_s, magnitude_m=size, azimuth_deg=azimuth)
        for slot, (chance, size, azimuth) in enumerate(draws, 1)
        if chance < perception.wrong_share
    )


def _drawn(episodes: Episodes, row: int, duration_s: float, others: int, seed: int) -> tuple[Fault, ...]:
    """The random faults of an episode: of what all share, of the ego (row 0) and of the other slots (1 and up).

    The one fault of ``faults: one`` is of the ego or of what all share, and ``info`` tells it.
    """
    level, navigation = episodes.config.faults, episodes.navigation
    priors, wrong = level.priors, _wrong_senders(episodes.config, duration_s, others, seed)
    if priors is None or navigation is None:
        return wrong
    track, rng = navigation.skies.risen(int(navigation.hour[row])), named_generator(seed, "faults")
    crew = 1 if level is FaultLevel.ONE else 1 + others
    sky = track.at(track.start_s, np.zeros(crew, dtype=np.int64))
    if level is not FaultLevel.ONE:
        return random_campaign(priors, duration_s, rng, sky) + wrong
    fault, *figures = single_fault(priors, duration_s, rng, sky)
    told = fault_kinds().index(fault.declaration), fault.start_s, *figures
    for name, value in zip(FAULT_INFO, told, strict=True):
        episodes.own_info[name][row] = value
    return (fault,)
