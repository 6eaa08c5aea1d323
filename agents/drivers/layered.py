"""A driver whose every action the hard rules permit: ``layer`` over any agent, also written ``AGENT+layer``."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from pydantic import field_validator

from lanebound.agents.drivers import require_bindable
from lanebound.agents.drivers.base import Driver, Starts, States
from lanebound.agents.drivers.rules import RULES, RuleBook, SafetyRules
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field

__all__ = ["LayerConfig", "LayeredDriver", "make_layer"]


class LayerConfig(SafetyRules):
    """The rules, and the agent that they bind."""

    over: str = Field(
        "nominal",
        min_length=1,
        description="agent whose actions are bound, any without layer or a memory of its commands",
    )

    @field_validator("over")
    @classmethod
    def _is_another(cls, over: str) -> str:
        require_bindable(over)
        return over


class LayeredDriver:
    """Passes the action of a driver, or the nearest one that the rules permit.

    Attributes
    ----------
    config : the rules
    counts : ``decisions``, those that were ``intervened`` in, and those that each rule changed, by its name
    """

    def __init__(self, env: DrivingEnv, driver: Driver, rules: SafetyRules | None = None) -> None:
        self.driver, self.book = driver, RuleBook(env, rules)
        self.config = self.book.rules
        self.counts: Counter[str] = Counter({name: 0 for name in ("decisions", "intervened", *RULES)})

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The permitted action, and the driver's own state."""
        action, after = self.driver.predict(observation, state, episode_start, deterministic)
        found = self.book.project(observation, action)
        self.counts.update({"decisions": found.changed.size, "intervened": int(np.sum(found.changed))})
        self.counts.update({name: int(np.sum(changed)) for name, changed in found.by.items()})
        return found.actions, after

    def reseed(self, seed: int) -> None:
        """Pass an episode's seed to a driver with random draws."""
        if hasattr(self.driver, "reseed"):
            self.driver.reseed(seed)


def make_layer(env: DrivingEnv, config: LayerConfig | None = None) -> LayeredDriver:
    """The rules over the agent that its figures name, the nominal one by default.

    Raises
    ------
    InputError
        The agent cannot drive this environment, or the observation lacks an entry that a rule needs.
    """
    from lanebound.agents.drivers import make_agent  # which makes this one

    chosen = config or LayerConfig()
    return LayeredDriver(env, make_agent(chosen.over, env), chosen)
