"""The worlds that can be driven: our own by name, highway-env's by id, under either kind of action."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv

from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.world import make_world, world_defaults
from lanebound.envs.worlds import world_kind
from lanebound.envs.worlds.base import META

__all__ = ["world_of"]

TYPES = {ActionKind.META: "DiscreteMetaAction", ActionKind.CONTINUOUS: "ContinuousAction"}


def world_of(config: EnvConfig) -> AbstractEnv:
    """The true world of a configuration.

    Raises
    ------
    ConfigError
        See :func:`lanebound.envs.world.make_world`.
    """
    continuous = config.action is ActionKind.CONTINUOUS
    declared = world_kind(config.base)
    name = (declared.continuous if declared is not None and continuous else "") or config.base
    defaults = world_defaults(name)
    kind = world_kind(name)
    ours = kind is not None and kind.world is not None
    own = dict(META) if ours and not continuous else _action(defaults["action"], config.action)
    world = dict(config.world)
    if "offroad_terminal" in defaults:
        world.setdefault("offroad_terminal", config.off_road_ends)
    return make_world(
        name, world, {**own, **config.action_options}, config.simulation_hz, config.policy_hz, config.duration_s
    )


def _action(native: dict[str, Any], kind: ActionKind) -> dict[str, Any]:
    """The world's own action where it is of this kind; else the standard one, with its own choice of speeds."""
    if native["type"] == TYPES[kind]:
        return dict(native)
    if kind is ActionKind.CONTINUOUS:
        return {"type": TYPES[kind], "steering_range": [-np.pi / 4, np.pi / 4]}
    speeds = {"target_speeds": native["target_speeds"]} if "target_speeds" in native else {}
    return {"type": TYPES[kind], **speeds}
