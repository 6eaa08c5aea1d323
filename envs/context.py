"""Read-out of the context monitor of the ego: what a driver is shown.

>>> import gymnasium, lanebound.envs
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open", "navigator": {"context": {}}})
>>> observation, info = env.reset(seed=1)
>>> shown = context_of(env.unwrapped)
>>> shown.light, shown.reason
('amber', 'COLLECTING')

The monitor itself runs in the navigator (:mod:`lanebound.integrity.navigators.context_guard`), in the vector engine
too. Its entries are in the observation, its cost is ``cost_context``.
"""

from __future__ import annotations

from typing import NamedTuple

from lanebound.envs.core import DrivingEnv
from lanebound.envs.road_map import road_map_of
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.context.monitor import ContextReason, Light
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK

__all__ = ["ShownContext", "context_of"]


class ShownContext(NamedTuple):
    """What the driver is shown: names of Light and ContextReason, and the rest of the report; road: of the link."""

    light: str
    reason: str
    phases: int
    score: float
    link_probability: float
    road: str

    @property
    def advice(self) -> str:
        """What the driver reads."""
        return str(ContextReason[self.reason].value)


def context_of(env: DrivingEnv) -> ShownContext:
    """The last report on the ego of an environment.

    Raises
    ------
    InputError
        Before a reset, or without a context monitor.
    """
    loop = env.belief_loop
    navigation = None if loop is None else loop.episodes.navigation
    guard = None if navigation is None else navigation.navigator.state.guard
    if guard is None:
        raise InputError("navigator.context must be configured, and the environment reset: neither shows a verdict")
    last = {name: value[0].item() for name, value in guard.last.items()}
    link, names = last["link"], road_map_of(env.world.road.network)[1]
    return ShownContext(
        Light(last["light"]).name.lower(), ContextReason.from_code(last["reason"]).name, last["context_phases"],
        last["context_score"], last["link_probability"], "" if link == NO_LINK else names[link],
    )  # fmt: skip
