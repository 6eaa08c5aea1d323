"""What an id declares: the class :class:`Preset`, and parts that presets share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.worlds import world_kind
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["CONTINUOUS", "INSTANT", "META", "SPEEDS", "Preset", "has_engine", "id_of", "refuse_misplaced"]

CONTINUOUS: dict[str, Any] = {"action": "continuous", "policy_hz": 5}
META: dict[str, Any] = {"action": "meta", "policy_hz": 2}
INSTANT: dict[str, Any] = {"actuators": {"steering_rate_radps": None}}  # as highway-env's own control expects
SPEEDS: dict[str, Any] = {"action_options": {"target_speeds": [0, 5, 10, 15, 20, 25, 30]}}  # slow enough in an alert

ELSEWHERE = {
    "autoreset_mode": "where environments run one by one pass vector_kwargs={'autoreset_mode': ...} to make_vec",
    "max_episode_steps": "pass config={'duration_s': ...}",
}


def refuse_misplaced(misplaced: Mapping[str, Any], allowed: str) -> None:
    """Refuse unknown arguments, with the place where each one belongs.

    Raises
    ------
    InputError
        There is one.
    """
    for key, value in misplaced.items():
        fields = EnvConfig.model_fields
        advice = f"pass config={{{key!r}: {value!r}}}" if key in fields else nearest(key, ["config", *fields])
        raise InputError(f"arguments must be {allowed}, got {key}={value!r}: {ELSEWHERE.get(key, advice)}")


class Preset(DrivingEnv):
    """An environment with a preset configuration; the user's configuration is merged deeply over it.

    A subclass declares ``PRESET``; the others have defaults.

    Attributes
    ----------
    PRESET : the configuration; what it leaves out is as in :class:`~lanebound.envs.config.EnvConfig`
    ID : of the environment; ``lanebound/Name-v0`` by default
    CORE_S : core time that a second of an episode takes, with the agent ``nominal`` on a 2.5 GHz core of 2023 [s];
        the expected durations of benchmarks follow from it
    """

    PRESET: ClassVar[Mapping[str, Any]]
    ID: ClassVar[str | None] = None
    CORE_S: ClassVar[float] = 0.1

    def __init__(
        self, config: Mapping[str, Any] | None = None, render_mode: str | None = None, **misplaced: Any
    ) -> None:
        refuse_misplaced(misplaced, "config and render_mode")
        if config is not None and not isinstance(config, Mapping):
            raise InputError(f"config must be a mapping of what to change, got {config!r}: pass a dict")
        super().__init__(EnvConfig.build(self.PRESET, config), render_mode)


def has_engine(kind: type[Preset]) -> bool:
    """Whether an id has engine support."""
    world = world_kind(str(kind.PRESET["base"]))
    return world is not None and world.support is not None


def id_of(kind: type[Preset]) -> str:
    """The id of a class: its ``ID``, or ``lanebound/Name-v0``."""
    return kind.ID or f"lanebound/{kind.__name__}-v0"
