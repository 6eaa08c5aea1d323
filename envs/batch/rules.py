"""The configuration of an environment as the record that kernels read."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.alert_limits import AlertLimit
from lanebound.envs.batch.records_kernel import (
    BUDGET,
    BY_LEVEL,
    BY_ROADS,
    COST_FIGURES,
    GIVEN,
    LANE_SENSOR,
    REWARD_WEIGHTS,
    RULES,
    SENSED,
    TERMS,
)
from lanebound.envs.batch.view_kernel import BLIND, FULL, ORACLE
from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.costs import AlertSpeed
from lanebound.envs.navigation import Source
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

__all__ = ["cost_figures", "rules_of"]

SHOWN = {"full": FULL, "clock": BLIND, "blind": BLIND, "oracle": ORACLE}


def rules_of(config: EnvConfig, limits_m: tuple[float, float], map_bound_m: float) -> Records:
    """What the kernels read of a configuration, (1,) RULES; limits and bound as the scene finds them."""
    n, a = config.navigation, config.actuators
    at, ct = (n.offset_at_m, n.offset_ct_m) if n.source is Source.OFFSET else (0.0, 0.0)
    step_s = 1.0 / config.simulation_hz
    return one_record(
        RULES,
        step_s=step_s,
        epoch_s=step_s * n.steps_per_epoch(config.simulation_hz),
        policy_s=1.0 / config.policy_hz,
        meta=config.action is ActionKind.META,
        source=SENSED if n.source.uses_sensors else GIVEN,
        offset_at_m=at,
        offset_ct_m=ct,
        jump_m=n.jump_m,
        smoothing_s=n.smoothing_s,
        map_bound_m=map_bound_m,
        al_at_m=limits_m[0],
        al_ct_m=limits_m[1],
        budgets=config.alert_limit is AlertLimit.BUDGET,
        budget=one_record(BUDGET, **{name: getattr(config.budget, name) for name in BUDGET.names or ()}),
        permits={AlertSpeed.SHARE: 0, AlertSpeed.LEVEL: BY_LEVEL, AlertSpeed.ROADS: BY_ROADS}[config.cost.alert_speed],
        actuated=a is not None,
        pursues=a is not None and a.steering_rate_radps is not None,
        lateral_mps2=_or_none(a.lateral_acceleration_mps2 if a else None),
        wheel_rate_radps=_or_none(a.steering_rate_radps if a else None),
        hold_mps2=a.hold_mps2 if a else 0.0,
        off_road_ends=config.off_road_ends,
        wrong_way_s=config.wrong_way_s,
        success_share=config.success_share,
        behind_s=config.success_behind_s,
        keep_lane=config.keep_lane,
        max_speed_mps=Vehicle.MAX_SPEED,
        fastest_mps=max(config.action_options.get("target_speeds", (inf,))),
        reason_none=AlertReason.NONE.code,
        reason_at=AlertReason.PL_AT.code,
        reason_ct=AlertReason.PL_CT.code,
        reason_both=AlertReason.BOTH.code,
        reason_holding=AlertReason.HOLDING.code,
        mode_given=int(Mode.RTK),
        rtk_given=RtkStatus.FIXED.code,
        pl_most_m=config.observation.pl_max_m,
        shown=SHOWN[config.observation.integrity],
        sees_truth=config.perception.source == "truth",
        camera=config.lane_sensor is not None,
        lane_sensor=_of_camera(config, step_s),
        rewards=one_record(REWARD_WEIGHTS, **{name: getattr(config.reward, name) for name in TERMS}),
        costs=cost_figures(config.cost),
    )


def cost_figures(config: Any) -> Records:
    """Weights and figures of the costs, (1,) COST_FIGURES: the fields of ``CostConfig``."""
    return one_record(COST_FIGURES, **{name: getattr(config, name) for name in COST_FIGURES.names or ()})


def _of_camera(config: EnvConfig, step_s: float) -> Records:
    """Figures of the lane sensor, (1,) LANE_SENSOR; zeros without one."""
    sensor = config.lane_sensor
    return np.zeros(1, LANE_SENSOR) if sensor is None else one_record(LANE_SENSOR, **sensor.figures(step_s))


def _or_none(limit: float | None) -> float:
    """A limit, or the mark of none."""
    return -1.0 if limit is None else limit
