"""Many environments of one configuration as arrays, for training at the speed of compiled code.

One step flows through the files in this order: ``motorway_kernel`` or ``course_kernel`` (traffic), ``ego_kernel``
(commands by belief, and how the car moves), ``collisions_kernel``, ``perceive_kernel``, ``score_kernel`` with
``costs_kernel`` (truth against belief), ``observe_kernel``; ``step_kernel`` runs them, ``engine`` owns the arrays and
``env`` is the Gymnasium vector environment. ``lanes`` and ``chart`` are the roads, ``rules`` the configuration and
``start`` the starts of episodes, ``support`` what is refused.
"""

from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import VectorDrivingEnv

__all__ = ["Engine", "VectorDrivingEnv"]
