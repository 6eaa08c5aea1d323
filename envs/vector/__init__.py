"""Many environments of one configuration as arrays, for training at the speed of compiled code.

What egos know and how they are scored is :mod:`lanebound.envs.batch`, as for single environments. Here is what moves the
cars: ``motorway_kernel``, ``city_kernel`` and ``course_kernel`` (traffic, the first two by ``idm_kernel``),
``drivers_kernel`` (how cars move), ``collisions_kernel``; ``drive_kernel`` runs them, ``world_kernel`` says what ends an
episode. ``engine`` owns the arrays, ``env`` is the vector environment of Gymnasium, ``support`` refuses what cannot be
done.
"""

from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import VectorDrivingEnv, engine_class, engines

__all__ = ["Engine", "VectorDrivingEnv", "engine_class", "engines"]
