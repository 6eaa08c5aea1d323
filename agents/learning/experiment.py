"""Experiments: an environment, an algorithm with its settings, a limit of cost, and a duration.

Bounds of an algorithm's settings refuse a bad value by its name before anything starts. Settings have
stable-baselines3's names and defaults. Those without a bound here are judged by the algorithm itself.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import closing
from enum import StrEnum
from functools import cached_property
from typing import Any, Self

from pydantic import ValidationInfo, field_validator, model_validator

from lanebound.agents.benchmark.outcome import GROUP_COST
from lanebound.agents.drivers import AGENTS, REMEMBERING, unknown_agent
from lanebound.agents.drivers.rules import SafetyRules
from lanebound.agents.episodes.opening import full_id, naming, open_env
from lanebound.agents.learning.multiplier import MultiplierConfig
from lanebound.agents.presets import load_named
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError

__all__ = [
    "BOUNDS",
    "FLAT",
    "Algorithm",
    "ExperimentConfig",
    "ImitationConfig",
    "Others",
    "Shield",
    "load_experiment",
    "require_settings",
]

OWN = {name: name for name in ("seed", "cost_limit", "multiplier")} | {"cost_limits": "overrides.cost_limits"}
"""What algorithms take and an experiment says elsewhere: two values would contradict each other in the card."""
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
    for name, place in OWN.items():
        if name in settings:
            raise ConfigError(f"settings.{name} must be left out, got {settings[name]!r}: use {place}")
    bounded = BOUNDS[algorithm]
    bounded.load({name: value for name, value in settings.items() if name in bounded.model_fields}, "settings")


FOLDER = "experiments/"
FLAT: dict[str, Any] = {"observation": {"form": "flat"}}


class Algorithm(StrEnum):
    """Algorithms of learning."""

    PPO = "ppo"
    SAC = "sac"
    RECURRENT_PPO = "recurrent_ppo"
    PPO_LAGRANGIAN = "ppo_lagrangian"
    SAC_LAGRANGIAN = "sac_lagrangian"

    @property
    def constrained(self) -> bool:
        """Whether it respects the limit of cost."""
        return self in (Algorithm.PPO_LAGRANGIAN, Algorithm.SAC_LAGRANGIAN)

    @property
    def off_policy(self) -> bool:
        """Whether it learns from stored transitions."""
        return self in (Algorithm.SAC, Algorithm.SAC_LAGRANGIAN)


class ImitationConfig(Config):
    """Imitation of a driver before learning by reward."""

    driver: str = Field("integrity_aware", description="agent that is imitated")
    observation: Mapping[str, Any] = Field(
        {}, description="of the driver, over that of the policy, such as integrity: full over blind"
    )
    rounds: int = Field(4, ge=1, le=100, description="in the first the driver drives, then the present policy")
    decisions: int = Field(4000, ge=1, description="in each round, of all environments together")
    epochs: int = Field(20, ge=1, le=1000, description="after each round, over all labels")
    batch_size: int = Field(256, ge=1, description="decisions that a step of the fit takes")
    learning_rate: float = Field(1e-3, gt=0, le=1, description="of the fit, by Adam")
    critics_first: bool = Field(
        True,
        description="whether critics alone learn by reward until each environment has ended an episode: by critics of "
        "random values the policy would unlearn",
    )

    @field_validator("observation")
    @classmethod
    def _is_flat(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        _require_flat("imitation.observation", given)
        return given

    @field_validator("driver")
    @classmethod
    def _driver_exists(cls, name: str) -> str:
        if name not in AGENTS:
            raise ConfigError(str(unknown_agent(name)))
        if name in REMEMBERING:
            raise ConfigError(f"driver must have no memory of its commands, got '{name}': another policy drives")
        return name

    def total(self, count: int) -> int:
        """Decisions of ``count`` environments in all rounds together."""
        return self.rounds * count * -(-self.decisions // count)


class Shield(StrEnum):
    """Filters between a policy and the car."""

    NONE = "none"
    CBF = "cbf"
    LAYER = "layer"


class Others(StrEnum):
    """What the broadcasts of other vehicles come from, as in ``perception.others``."""

    FULL = "full"
    SURROGATE = "surrogate"


class ExperimentConfig(Config):
    """All inputs of a training."""

    title: str = Field("", description="what it is for, in a line")
    env: str = Field(description="id, ours without lanebound/")
    sky: str = Field("urban", description="preset of the sky")
    overrides: Mapping[str, Any] = Field({}, description="of the environment's configuration, merged deeply")
    algorithm: Algorithm = Field(Algorithm.PPO, description="how the policy is learnt")
    settings: Mapping[str, Any] = Field({}, description="of the algorithm, by stable-baselines3's names")
    cost_limit: float | None = Field(None, gt=0, description="of an episode's cost; None: the environment's own")
    multiplier: MultiplierConfig = Field(MultiplierConfig(), description="of algorithms under the limit")
    imitation: ImitationConfig | None = Field(None, description="a driver to begin from; None: from nothing")
    shield: Shield = Field(Shield.NONE, description="filter that every action passes, in training and after")
    rules: SafetyRules = Field(SafetyRules(), description="of the shield layer")
    shield_penalty: float = Field(
        1.0,
        ge=0,
        description="subtracted from the reward in training, times the mean square of the filter's change of an action "
        "(shares, -1 to 1; 1 for another meta-action): without it a policy relies on the filter and does not learn the "
        "road; chosen",
    )
    engine: bool | None = Field(None, description="whether the vector engine drives; None: where it can")
    others: Others | None = Field(
        None,
        description="perception.others in training alone; evaluations follow ``overrides``; None: those of "
        "``overrides``, else surrogate where it can be",
    )
    steps: int = Field(200_000, ge=1, description="decisions of learning by reward, of all environments")
    count: int = Field(4, ge=1, le=4096, description="environments side by side")
    seed: int = Field(0, ge=0, description="of networks, draws and environments")
    checkpoint_steps: int = Field(
        20_000,
        ge=1,
        description="decisions between checkpoints; an interruption loses at most these, or a round of ``imitation``",
    )
    evaluation_episodes: int = Field(16, ge=1, le=100, description="at each checkpoint, on the last training seeds")

    @field_validator("env")
    @classmethod
    def _env_exists(cls, name: str) -> str:
        return full_id(name).removeprefix("lanebound/")

    @field_validator("overrides")
    @classmethod
    def _is_flat(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        _require_flat("overrides.observation", given.get("observation"))
        return given

    @field_validator("settings")
    @classmethod
    def _settings_lie_in_bounds(cls, given: Mapping[str, Any], info: ValidationInfo) -> Mapping[str, Any]:
        if "algorithm" in info.data:
            require_settings(info.data["algorithm"], given)
        return given

    @field_validator("count")
    @classmethod
    def _has_a_spread(cls, count: int, info: ValidationInfo) -> int:
        algorithm, steps = info.data.get("algorithm"), info.data.get("settings", {}).get("n_steps")
        if algorithm is not None and not algorithm.off_policy and count == steps == 1:
            raise ConfigError(
                "count times settings.n_steps must be > 1, got 1: advantages of one decision have no spread, raise one"
            )
        return count

    @model_validator(mode="after")
    def _can_imitate(self) -> Self:
        if self.imitation is not None and self.algorithm not in (Algorithm.PPO, Algorithm.PPO_LAGRANGIAN):
            raise ConfigError(
                f"imitation must be null for {self.algorithm}, got a driver: write imitation: null, or choose ppo or "
                "ppo_lagrangian"
            )
        return self

    @model_validator(mode="after")
    def _layer_has_what_it_needs(self) -> Self:
        if self.shield is not Shield.LAYER:
            if self.rules != SafetyRules():
                raise ConfigError(
                    f"rules must be left out for shield {self.shield}, which ignores them, got changed ones: leave "
                    "them out, or write shield: layer"
                )
            return self
        observation = self.overrides.get("observation")
        shown = observation.get("integrity", "full") if isinstance(observation, Mapping) else "full"
        if shown != "full":
            raise ConfigError(
                f"overrides.observation.integrity must be full for shield layer, got {shown!r}: the rules read levels; "
                "leave it out, or choose another shield"
            )
        return self

    @property
    def env_overrides(self) -> dict[str, Any]:
        """Changes of the preset of the environment's id; observations are flat."""
        return deep_merge(deep_merge({"sky": self.sky}, self.overrides), FLAT)

    @property
    def own_others(self) -> str | None:
        """``perception.others`` of the overrides; None where they say nothing."""
        perception = self.overrides.get("perception")
        return perception.get("others") if isinstance(perception, Mapping) else None

    def as_learnt(self) -> ExperimentConfig:
        """The experiment in whose environments the policy learns: others broadcast as ``others`` says."""
        if self.others is None:
            return self
        return self.replace(overrides=deep_merge(self.overrides, {"perception": {"others": str(self.others)}}))

    def as_driver_sees(self) -> ExperimentConfig:
        """The experiment with the observations of the imitated driver."""
        if self.imitation is None or not self.imitation.observation:
            return self
        return self.replace(overrides=deep_merge(self.overrides, {"observation": self.imitation.observation}))

    def open(self) -> DrivingEnv:
        """The environment, without the shield."""
        with naming({"overrides": self.overrides}):
            return open_env(self.env, self.env_overrides)

    def limit(self) -> float:
        """The cost limit of an episode: that of the experiment, or of the environment."""
        return self.env_config.cost_limit if self.cost_limit is None else self.cost_limit

    def limits(self) -> dict[str, float]:
        """Limits of the costs of an episode by their names in evaluations: ``cost``, ``group_cost_lane`` and so on."""
        groups = self.env_config.cost_limits.given
        return {"cost": self.limit()} | {GROUP_COST + group: limit for group, limit in groups.items()}

    @cached_property
    def env_config(self) -> EnvConfig:
        """The configuration of the environment, opened once for it."""
        with closing(self.open()) as env:
            return env.config


def _require_flat(path: str, observation: Any) -> None:
    """Raise ConfigError for observations that are not flat."""
    form = observation.get("form", "flat") if isinstance(observation, Mapping) else "flat"
    if form != "flat":
        raise ConfigError(
            f"{path}.form must be flat where policies are learnt, got {form!r}: leave it out; checkpoints of either "
            "form can be evaluated"
        )


def load_experiment(name: str, overrides: Mapping[str, Any] | None = None) -> ExperimentConfig:
    """A packaged experiment by its name, or one of your own by the path of its YAML file.

    Raises
    ------
    ConfigError
        There is none, or a value is refused.
    """
    return load_named(ExperimentConfig, "experiment", FOLDER, name, overrides)
