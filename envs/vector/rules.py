"""The configuration of an environment as what the kernels of the engine read."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.core import ENDLESS_S, DrivingEnv
from lanebound.envs.costs import CAUSES
from lanebound.envs.navigation import Source
from lanebound.envs.rewards import TERMS
from lanebound.envs.scene import alert_limits_m
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.ego_kernel import FASTER, IDLE, LEFT, RIGHT, SLOWER
from lanebound.envs.vector.observe_kernel import BLIND, FULL, ORACLE
from lanebound.envs.vector.step_kernel import CITY, COURSE, MOTORWAY, Rules
from lanebound.envs.worlds.base import World as OwnWorld
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["direct_ranges", "duration_s", "meta_codes", "rules_of", "trail_length"]

Array = NDArray[np.float64]
SHOWN = {"full": FULL, "blind": BLIND, "oracle": ORACLE}
META_CODES = {"LANE_LEFT": LEFT, "IDLE": IDLE, "LANE_RIGHT": RIGHT, "FASTER": FASTER, "SLOWER": SLOWER}
EPS_S = 1e-6  # of observation/build.py
END_M = 20.0  # before the end of a road of our own, where an episode is over


def rules_of(single: DrivingEnv) -> Rules:
    """What all environments of a batch share with a single one of the same configuration, but for the roads."""
    config, world = single.config, single.world
    index = single.observer.index
    return Rules(
        figures=_figures(config, world),
        speeds=_target_speeds(world),
        scale=np.array([[1.0 / e.scale for e in index], [e.low for e in index], [e.high for e in index]]),
        preview=np.array(config.observation.preview_m, dtype=np.float64),
        reasons=np.array([reason.code for reason in AlertReason], dtype=np.int64),
        modes=np.array([int(mode) for mode in Mode], dtype=np.int64),
        rtks=np.array([status.code for status in RtkStatus], dtype=np.int64),
        drivers=_drivers(world),
        shown=SHOWN[config.observation.integrity],
        rows=config.observation.vehicles,
        sees_truth=config.perception.source == "truth",
        most=config.observation.pl_max_m,
    )


def _drivers(world: AbstractEnv) -> int:
    """Whose drivers the others are."""
    if isinstance(world, UrbanCanyonWorld):
        return CITY
    return COURSE if isinstance(world, OwnWorld) else MOTORWAY


def duration_s(config: EnvConfig, world: AbstractEnv) -> float:
    """When an episode is truncated."""
    return float(config.duration_s or world.config.get("duration", ENDLESS_S))


def trail_length(config: EnvConfig) -> int:
    """How many observations a trend looks back over, the present one included."""
    return 1 + int(np.ceil((config.observation.trend_window_s - EPS_S) * config.policy_hz))


def meta_codes(world: AbstractEnv) -> NDArray[np.int64]:
    """The code of each meta-action of the world's action space, (A,); empty under continuous actions."""
    inner = world.action_type
    actions = inner.actions if isinstance(inner, DiscreteMetaAction) else {}
    return np.array([META_CODES[actions[n]] for n in range(len(actions))], dtype=np.int64)


def _target_speeds(world: AbstractEnv) -> Array:
    inner = world.action_type
    return np.array(inner.target_speeds if isinstance(inner, DiscreteMetaAction) else [0.0, 1.0], dtype=np.float64)


def _figures(config: EnvConfig, world: AbstractEnv) -> Array:
    """The figures in their columns."""
    limits, c, a = alert_limits_m(world, config), config.cost, config.actuators
    own, endless = isinstance(world, OwnWorld), isinstance(world, UrbanCanyonWorld)
    speeds = getattr(world.action_type, "speed_range", None) or (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    policy_s = 1.0 / config.policy_hz
    values: dict[int, Any] = {
        k.F_STEP_S: 1.0 / config.simulation_hz, k.F_POLICY_S: policy_s,
        k.F_META: config.action is ActionKind.META, k.F_PERFECT: config.navigation.source is Source.PERFECT,
        k.F_SPEED_MIN: speeds[0], k.F_SPEED_MAX: speeds[1],
        k.F_ACTUATED: a is not None, k.F_PURSUES: a is not None and a.steering_rate_radps is not None,
        k.F_LATERAL_MPS2: _or_none(a.lateral_acceleration_mps2 if a else None),
        k.F_WHEEL_RATE: _or_none(a.steering_rate_radps if a else None), k.F_HOLD_MPS2: (a and a.hold_mps2) or 0.0,
        k.F_AL_AT: limits[0], k.F_AL_CT: limits[1],
        k.F_OFF_ROAD_ENDS: config.off_road_ends, k.F_WRONG_WAY_S: config.wrong_way_s,
        k.F_SUCCESS_SHARE: config.success_share, k.F_DURATION_S: duration_s(config, world),
        k.F_WORLD_DURATION_S: world.config["duration"], k.F_WORLD_TOLERANCE_S: 0.5 * policy_s if own else 0.0,
        k.F_WORLD_OFF_ROAD: world.config["offroad_terminal"], k.F_END_M: END_M if own and not endless else k.NONE,
        k.F_AGAINST_ENDS: own, k.F_KEEP_LANE: config.keep_lane, k.F_RESPONSE_S: c.response_s,
        k.F_ACCELERATE: c.accelerate_mps2, k.F_BRAKE_MIN: c.brake_min_mps2, k.F_BRAKE_MAX: c.brake_max_mps2,
        k.F_ALERT_SHARE: c.alert_speed_share, k.F_TTA_S: c.time_to_alert_s, k.F_MAX_SPEED: Vehicle.MAX_SPEED,
    }  # fmt: skip
    values |= {k.F_REWARD_WEIGHTS + n: getattr(config.reward, name) for n, name in enumerate(TERMS)}
    causes = [getattr(c, cause.removeprefix("cost_")) for cause in CAUSES]
    values |= {k.F_COST_WEIGHTS + n: weight for n, weight in enumerate(causes)}
    values |= {k.F_BASE + n: value for n, value in enumerate(_own_reward(world, own))}
    figures = np.zeros(k.FIGURES)
    figures[list(values)] = [float(value) for value in values.values()]
    return figures


def _or_none(limit: float | None) -> float:
    """A limit, or the mark of none."""
    return k.NONE if limit is None else limit


def _own_reward(world: AbstractEnv, own: bool) -> tuple[float, ...]:
    """Kind, weights and range of the wrapped world's own reward."""
    w = world.config
    if own:
        return 1.0, w["collision_reward"], w["progress_reward"], w["centring_reward"]
    slow, fast = w["reward_speed_range"]
    weights = w["collision_reward"], w["right_lane_reward"], w["high_speed_reward"]
    return 0.0, *weights, slow, fast, w["normalize_reward"]


def direct_ranges(world: AbstractEnv) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Ranges of acceleration and steering of continuous actions, None for one that is not commanded."""
    inner = world.action_type
    if not isinstance(inner, ContinuousAction):
        return None, None
    return (
        inner.acceleration_range if inner.longitudinal else None,
        inner.steering_range if inner.lateral else None,
    )
