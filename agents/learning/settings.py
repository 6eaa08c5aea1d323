"""Bounds of an algorithm's settings: a bad value is refused by its name before anything starts.

Settings have stable-baselines3's names and defaults. Those without a bound here are judged by the algorithm itself.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import field_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError

__all__ = ["BOUNDS", "require_settings"]

OWN = ("seed", "cost_limit", "multiplier")
"""Fields of an experiment that algorithms take as well: two values would contradict each other in the card."""
TEMPERATURE = re.compile(r"auto(_(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)?")


class _Shared(Config):
    """Of all algorithms."""

    learning_rate: float = Field(3e-4, gt=0, description="of the networks, by Adam")
    gamma: float = Field(0.99, gt=0, le=1, description="discount of rewards")
    stats_window_size: int = Field(100, ge=1, description="episodes that logs are means of")
    cost_gamma: float = Field(0.99, gt=0, le=1, description="discount of costs")


class _OnPolicy(_Shared):
    """Of proximal policy optimisation."""

    n_steps: int = Field(2048, ge=1, description="decisions of each environment between updates")
    batch_size: int = Field(64, ge=1, description="decisions that a step takes")
    n_epochs: int = Field(10, ge=1, description="over the decisions of an update")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="of advantages")
    clip_range: float = Field(0.2, gt=0, description="of the ratio of probabilities")
    clip_range_vf: float | None = Field(None, gt=0, description="of values; None: not clipped")
    ent_coef: float = Field(0.0, ge=0, description="weight of the entropy")
    vf_coef: float = Field(0.5, ge=0, description="weight of the critic's loss")
    max_grad_norm: float = Field(0.5, gt=0, description="that gradients are clipped to")
    target_kl: float | None = Field(None, gt=0, description="that ends an update early; None: never")
    cost_gae_lambda: float = Field(0.95, ge=0, le=1, description="of advantages of costs")
    cost_learning_rate: float = Field(1e-3, gt=0, description="of the cost critic")


class _Recurrent(_OnPolicy):
    """The same with a memory."""

    n_steps: int = Field(128, ge=1, description="decisions of each environment between updates")
    batch_size: int = Field(128, ge=1, description="decisions that a step takes")


class _OffPolicy(_Shared):
    """Of soft actor-critic."""

    buffer_size: int = Field(1_000_000, ge=1, description="transitions that are kept")
    learning_starts: int = Field(100, ge=0, description="decisions before the first update")
    batch_size: int = Field(256, ge=1, description="transitions that a step takes")
    tau: float = Field(0.005, gt=0, le=1, description="share of the critic that its target takes over")
    train_freq: int = Field(1, ge=1, description="decisions of each environment between updates")
    gradient_steps: int = Field(1, ge=-1, description="of an update; -1: as many as decisions")
    n_steps: int = Field(1, ge=1, description="rewards that a target sums")
    target_update_interval: int = Field(1, ge=1, description="steps between updates of the target")
    ent_coef: Any = Field("auto", description="weight of the entropy; auto, or auto_X from X on: learnt")

    @field_validator("ent_coef")
    @classmethod
    def _is_temperature(cls, given: Any) -> Any:
        number = isinstance(given, int | float) and not isinstance(given, bool)
        if (number and given >= 0) or (isinstance(given, str) and TEMPERATURE.fullmatch(given)):
            return given
        raise ConfigError(
            f"settings.ent_coef must be >= 0, auto or auto_X with X where it begins, got {given!r}: "
            "correct that value (the default is auto)"
        )


class _ConstrainedOffPolicy(_OffPolicy):
    """The same under a limit of cost, whose transitions are single steps that are kept whole."""

    n_steps: int = Field(1, ge=1, le=1, description="rewards that a target sums; costs are summed over one")
    optimize_memory_usage: bool = Field(False, description="whether observations are kept once; costs need both")

    @field_validator("optimize_memory_usage")
    @classmethod
    def _is_off(cls, given: bool) -> bool:
        if given:
            raise ConfigError("settings.optimize_memory_usage must be false for sac_lagrangian, got true: leave it out")
        return given


BOUNDS: dict[str, type[Config]] = {
    "ppo": _OnPolicy,
    "recurrent_ppo": _Recurrent,
    "ppo_lagrangian": _OnPolicy,
    "sac": _OffPolicy,
    "sac_lagrangian": _ConstrainedOffPolicy,
}


def require_settings(algorithm: str, settings: Mapping[str, Any]) -> None:
    """Raise ConfigError for settings out of their bounds, and for fields of the experiment among them."""
    for name in OWN:
        if name in settings:
            raise ConfigError(f"settings.{name} must be left out, got {settings[name]!r}: use {name}")
    bounded = BOUNDS[algorithm]
    bounded.load({name: value for name, value in settings.items() if name in bounded.model_fields}, "settings")
