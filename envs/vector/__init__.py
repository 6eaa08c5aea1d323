"""Many environments of one configuration as arrays, for training at the speed of compiled code.

Belief, perception, observations and scores are in :mod:`lanebound.envs.batch`, as for single environments. This package
moves the cars: ``network_kernel``, ``motorway_kernel`` and ``course_kernel`` (traffic, the first two by
``idm_kernel``), ``crossing_kernel`` (right of way), ``drivers_kernel`` (motion of a car), ``collisions_kernel``;
``drive_kernel`` runs them, ``world_kernel`` holds the end rules of the worlds, ``turnover`` lets vehicles enter and
leave. ``engine`` owns the arrays, ``env`` is the vector environment of Gymnasium, ``support`` refuses options that the
engine does not have.
"""

from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import VectorDrivingEnv, __getattr__, engine_class, engines

__all__ = ["Engine", "VectorDrivingEnv", "__getattr__", "engine_class", "engines"]
