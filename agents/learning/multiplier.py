"""The Lagrange multiplier of a cost limit, under PID control (Stooke, Achiam and Abbeel 2020, algorithm 2).

Symbols: J_C mean cost of the latest episodes, d its limit, Delta = (J_C - d) / d the excess, I its integral, lambda
multiplier. J_C is a mean over many episodes (:class:`.costs.EpisodeCosts`): with rare crashes most excesses of single
episodes are negative and the others cut off, whatever their mean.

No term takes more of an excess than the integral can reduce below the limit: crashes at the beginning cost 14 times the
limit, and a multiplier driven by them makes a policy stand still for long. Where one crash among the episodes of the
mean exceeds twice the limit, what is held is therefore between median and mean: in Merge (limit 0.7) one crash in 200
episodes costs 1.0 in the mean and may leave the multiplier at 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError

__all__ = ["Multiplier", "MultiplierConfig"]


class MultiplierConfig(Config):
    """Gains of the controller, on the relative excess over the limit."""

    proportional: float = Field(0.3, ge=0, description="K_P [-]")
    integral: float = Field(0.02, ge=0, description="K_I, by update [-]; small: at 0.05 policies stood still")
    derivative: float = Field(0.0, ge=0, description="K_D, of growing costs alone [-]; Stooke 2020")
    smoothing: float = Field(
        0.8, ge=0, lt=1, description="share of the old value in the input of the P and D terms [-]"
    )
    most: float = Field(1.0, gt=0, description="excess that counts at most; none falls below -1 [-]")
    start: float = Field(0.1, ge=0, description="multiplier before the first update [-]")
    after_steps: int = Field(0, ge=0, description="decisions of learning without a limit, before it counts")
    window: int = Field(
        64, ge=1, description="episodes, the latest, whose mean cost counts; at least one of each environment"
    )
    largest: float = Field(20.0, gt=0, description="multiplier at most [-]; the integral stops there too")


@dataclass
class Multiplier:
    """The weight of a unit of cost against a unit of reward, 0 at least.

    Parameters
    ----------
    limit : of an episode's cost, positive
    name : of the limit, for messages

    Attributes
    ----------
    value : lambda now, 0 until the limit counts

    Raises
    ------
    InputError
        A limit that is not positive.
    """

    limit: float
    config: MultiplierConfig
    name: str = "cost_limit"
    value: float = 0.0
    integral: float = 0.0
    _seen: float | None = None  # smoothed excess
    _slow: float | None = None  # smoothed cost, of the derivative

    def __post_init__(self) -> None:
        if not 0.0 < self.limit < math.inf:
            raise InputError(
                f"{self.name} must be > 0 and finite, got {self.limit}: an excess is a share of the limit, give a "
                "small one"
            )
        self.value = 0.0 if self.config.after_steps else self.config.start
        self.integral = self.config.start / self.config.integral if self.config.integral > 0.0 else 0.0

    def update(self, cost: float, steps: float = math.inf) -> float:
        """Take the mean cost of the latest episodes, after ``steps`` decisions; returns the new value."""
        c = self.config
        if steps < c.after_steps:
            return self.value
        excess = min((cost - self.limit) / self.limit, c.most)
        ceiling = c.largest / c.integral if c.integral > 0.0 else math.inf
        self.integral = min(max(self.integral + excess, 0.0), ceiling)
        self._seen = excess if self._seen is None else c.smoothing * self._seen + (1.0 - c.smoothing) * excess
        before = excess if self._slow is None else self._slow
        self._slow = c.smoothing * before + (1.0 - c.smoothing) * excess
        growth = max(0.0, self._slow - before)
        wanted = c.proportional * self._seen + c.integral * self.integral + c.derivative * growth
        self.value = min(max(wanted, 0.0), c.largest)
        return self.value
