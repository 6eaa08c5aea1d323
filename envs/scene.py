"""Sets the scene of an episode: the street for a network, the sky of an hour, the navigators of all vehicles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.cockpit import Surroundings
from lanebound.envs.config import EnvConfig
from lanebound.envs.fleet import Fleet
from lanebound.envs.perception import Perception
from lanebound.envs.sky import SkyLevel, build_street
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.risk import upper_quantile
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.campaign import random_campaign
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack

__all__ = ["MAP_SHARE", "alert_limits_m", "map_bound_m", "navigator_config", "set_scene"]

HOURS = 24  # the constellations repeat after a day, nearly
MARGIN_S = 60.0  # of sky beyond what an episode is expected to last
EGO = 0  # its row in faults; None strikes everybody
MAP_SHARE = 0.1  # of the integrity risk, for the map: of both, its Gaussian level pays less for a small share
NEWCOMERS = 24  # slots kept for vehicles that appear later, where the world makes some


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
        .replace(dt_s=1.0 / config.navigation.rate_hz, positioning={"axle_m": 0.5 * Vehicle.LENGTH})
    )
    given = base.replace(**config.navigator)
    limits = [max(limit - map_bound_m(config, given), 0.01) for limit in limits_m]
    spent = MAP_SHARE * given.risk.integrity_risk if config.navigation.map_sigma_m > 0.0 else 0.0
    return given.replace(
        alert={"limits": {"al_at_m": limits[0], "al_ct_m": limits[1]}},
        risk={"unmonitored_risk": given.risk.unmonitored_risk + spent},
    )


def set_scene(
    world: AbstractEnv, config: EnvConfig, seed: int, duration_s: float, faults: tuple[Fault, ...] | None = None
) -> Surroundings:
    """What an episode of ``duration_s`` takes place in, all of it drawn from ``seed`` by named streams.

    ``faults`` takes the place of the random campaign when given; their times count from the start of the episode, and
    vehicle 0 is the ego, 1 and up the slots of the others, None everybody.
    """
    streams = Streams([seed])
    scene = streams.generator("scene")
    layout, hour, fleet_seed = (int(scene.integers(n)) for n in (config.layouts, HOURS, 2**62))
    street = build_street(world.road.network, config.level, layout, getattr(world, "sections", ()), config.extent_m)
    settings = navigator_config(config, alert_limits_m(world, config))
    others = sum(v is not world.vehicle for v in world.road.vehicles)
    capacity = min(config.slots, others + (NEWCOMERS if isinstance(world, IntersectionEnv) else 0))
    broadcast = capacity > 0 and config.perception.source in ("v2v", "both")
    track = track_of(settings.sky, hour, config.navigation.warm_up_s + duration_s + MARGIN_S)
    # one street: the same atmosphere, reference station and network for all
    ego = Navigator(settings, track, street.mask, [seed], area_seed=seed) if config.navigation.source.senses else None
    fleet = Navigator(settings, track, street.mask, fleet_seed, capacity, area_seed=seed) if broadcast else None
    campaign = _campaign(track, config, duration_s, capacity, streams) if faults is None else faults
    clock = [fault.replace(start_s=fault.start_s + config.navigation.clock_start_s) for fault in campaign]
    others_faults = FaultSchedule([_row(f, f.vehicle - 1) if f.vehicle else f for f in clock if f.vehicle != EGO])
    if ego is not None:
        ego.faults = FaultSchedule([_row(f, None) for f in clock if f.vehicle in (None, EGO)])
    if fleet is not None:
        fleet.faults = others_faults
    epoch_s = config.navigation.steps_per_epoch(config.simulation_hz) / config.simulation_hz
    return Surroundings(
        street=street,
        navigator=ego,
        fleet=Fleet(world, street, fleet, config.navigation, Streams(fleet_seed, max(capacity, 1)), capacity),
        perception=Perception(config.perception, capacity + 1, epoch_s, streams),
        streams=streams,
        faults=others_faults,
        map_bound_m=map_bound_m(config, settings) if ego is not None else 0.0,
    )


def _campaign(
    track: SkyTrack, config: EnvConfig, duration_s: float, others: int, streams: Streams
) -> tuple[Fault, ...]:
    """The random faults of an episode: of what all share, of the ego (row 0) and of the other slots (1 and up)."""
    priors = config.faults.priors
    if priors is None:
        return ()
    sky = track.at(track.start_s, np.zeros(others + 1, dtype=np.int64))
    return random_campaign(priors, duration_s, streams.generator("faults"), sky)


def _row(fault: Fault, vehicle: int | None) -> Fault:
    return fault.replace(vehicle=vehicle)


@lru_cache(maxsize=64)
def _track(text: str, hour: int, duration_s: float) -> SkyTrack:
    config = SkyConfig.from_json(text)
    place = config.place_rad
    return SkyTrack.build(config.satellites(), config.start_gps_s + 3600.0 * hour, duration_s, place, config.mask_rad)


def track_of(config: SkyConfig, hour: int, duration_s: float) -> SkyTrack:
    """The sky ``hour`` hours after a configuration's start, kept for other episodes at that hour."""
    return _track(config.to_json(), hour, duration_s)
