"""Many environments of one configuration as arrays, for training at the speed of compiled code.

One step flows through the files in this order: ``motorway_kernel``, ``city_kernel`` or ``course_kernel`` (traffic, the
first two by ``idm_kernel``), ``ego_kernel`` (commands by belief, and how cars move), ``collisions_kernel``; ``senses``
(who is where under which of the ``skies``), with ``trackers`` (where each ego believes to be) and ``perceptions`` (whom
it perceives); ``score_kernel`` with ``costs_kernel`` (truth against belief); ``observe_kernel``. ``step_kernel`` runs
the kernels, ``engine`` owns the arrays and ``env`` is the vector environment of Gymnasium, with ``infos``.

An episode begins in ``start`` (who drives where) and ``scenes`` (city, hour, errors at the start); ``streams`` draws
what single environments would draw. ``lanes`` and ``chart`` are the roads, ``rules`` the configuration, and ``support``
tells what is refused.
"""

from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.env import (
    VectorCarFollowing,
    VectorDrivingEnv,
    VectorHighway,
    VectorLaneKeeping,
    VectorUrbanCanyon,
)

__all__ = [
    "Engine",
    "VectorCarFollowing",
    "VectorDrivingEnv",
    "VectorHighway",
    "VectorLaneKeeping",
    "VectorUrbanCanyon",
]
