"""Sets the scene of an episode: the street for a network, the sky of an hour, the navigators of all vehicles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.intersection_env import IntersectionEnv

from lanebound.envs.cockpit import Surroundings
from lanebound.envs.config import EnvConfig
from lanebound.envs.fleet import Fleet
from lanebound.envs.perception import Perception
from lanebound.envs.sky import build_street
from lanebound.integrity.monitoring.risk import upper_quantile
from lanebound.integrity.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.campaign import random_campaign
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.streams import Streams

__all__ = ["map_bound_m", "navigator_config", "set_scene"]

HOURS = 24  # the constellations repeat after a day, nearly
MARGIN_S = 60.0  # of sky beyond what an episode is expected to last
NEWCOMERS = 12  # slots kept for vehicles that appear later, where the world makes some


def map_bound_m(config: EnvConfig, navigator: NavigatorConfig) -> float:
    """A bound of the map's shift on one axis, at half the navigator's risk."""
    return float(upper_quantile(np.array(0.25 * navigator.risk.integrity_risk))) * config.navigation.map_sigma_m


def navigator_config(config: EnvConfig, car_width_m: float) -> NavigatorConfig:
    """The level's navigator with the environment's rate, alert limits and overrides.

    The limits are for the pose on the map, so the map's own bound is taken off them.
    """
    return _navigator_config(config.to_json(), car_width_m)


@lru_cache(maxsize=32)
def _navigator_config(text: str, car_width_m: float) -> NavigatorConfig:
    config = EnvConfig.from_json(text)
    base = config.level.navigator().replace(dt_s=1.0 / config.navigation.rate_hz)
    given = base.replace(**config.navigator)
    limits = [max(limit - map_bound_m(config, given), 0.01) for limit in config.limits_m(car_width_m)]
    return given.replace(alert={"limits": {"al_at_m": limits[0], "al_ct_m": limits[1]}})


def set_scene(
    world: AbstractEnv, config: EnvConfig, seed: int, duration_s: float, faults: tuple[Fault, ...] | None = None
) -> Surroundings:
    """What an episode of ``duration_s`` takes place in, all of it drawn from ``seed`` by named streams.

    ``faults`` takes the place of the random campaign when given; their times count from the start of the episode.
    """
    streams = Streams([seed])
    scene = streams.generators("scene")[0]
    layout, hour, fleet_seed = (int(scene.integers(n)) for n in (config.layouts, HOURS, 2**62))
    street = build_street(world.road.network, config.level, layout, getattr(world, "sections", ()), config.extent_m)
    settings = navigator_config(config, world.vehicle.WIDTH)
    others = sum(v is not world.vehicle for v in world.road.vehicles)
    capacity = min(config.slots, others + (NEWCOMERS if isinstance(world, IntersectionEnv) else 0))
    broadcast = capacity > 0 and config.perception.source in ("v2v", "both")
    track = track_of(settings.sky, hour, config.navigation.warm_up_s + duration_s + MARGIN_S)
    ego = Navigator(settings, track, street.mask, [seed]) if config.navigation.source.senses else None
    if ego is not None:
        ego.faults = _faults(ego, config, duration_s, streams, faults)
    fleet = Navigator(settings, track, street.mask, fleet_seed, capacity) if broadcast else None
    epoch_s = config.navigation.steps_per_epoch(config.simulation_hz) / config.simulation_hz
    return Surroundings(
        street=street,
        navigator=ego,
        fleet=Fleet(world, street, fleet, config.navigation, Streams(fleet_seed, max(capacity, 1)), capacity),
        perception=Perception(config.perception, capacity + 1, epoch_s, streams),
        streams=streams,
        map_bound_m=map_bound_m(config, settings) if ego is not None else 0.0,
    )


def _faults(
    navigator: Navigator, config: EnvConfig, duration_s: float, streams: Streams, given: tuple[Fault, ...] | None
) -> FaultSchedule:
    """The campaign of an episode, on the navigator's clock, which starts with the warm-up."""
    priors, start_s = config.faults.priors, config.navigation.warm_up_s
    if given is None and priors is None:
        return FaultSchedule()
    if given is None:
        sky = navigator.track.at(navigator.track.start_s, np.zeros(1, dtype=np.int64))
        assert priors is not None
        given = random_campaign(priors, duration_s, streams.generators("faults")[0], sky)
    return FaultSchedule([fault.replace(start_s=fault.start_s + start_s) for fault in given])


@lru_cache(maxsize=64)
def _track(text: str, hour: int, duration_s: float) -> SkyTrack:
    config = SkyConfig.from_json(text)
    place = config.place_rad
    return SkyTrack.build(config.satellites(), config.start_gps_s + 3600.0 * hour, duration_s, place, config.mask_rad)


def track_of(config: SkyConfig, hour: int, duration_s: float) -> SkyTrack:
    """The sky ``hour`` hours after a configuration's start, kept for other episodes at that hour."""
    return _track(config.to_json(), hour, duration_s)
