"""Environments in which a car drives on what its navigation believes.

Importing this package registers the ids with Gymnasium:

>>> import gymnasium, lanebound.envs
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"})
>>> observation, info = env.reset(seed=1)
>>> info["pl_ct_m"] < info["al_ct_m"]
True

Gymnasium imports it by itself when an id names it: ``gymnasium.make("lanebound.envs:lanebound/LaneKeeping-v0")``.
"""

from lanebound.envs import deferred  # noqa: F401 - before all that imports highway-env
from lanebound.envs.config import ActionKind, EnvConfig, FaultLevel
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import IDS, make_config, register_all, wrap, wrap_vec

__all__ = ["IDS", "ActionKind", "DrivingEnv", "EnvConfig", "FaultLevel", "make_config", "wrap", "wrap_vec"]

register_all()
