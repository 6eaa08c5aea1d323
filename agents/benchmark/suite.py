"""Suites: the environments, skies, faults, agents and seeds of a benchmark.

Seeds are published: disjoint splits for training and tuning, and for tests.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, Final, Literal, Self

from pydantic import ValidationInfo, field_validator, model_validator

from lanebound.agents.benchmark.outcome import Place, Task
from lanebound.agents.drivers import LAYERED, bare_name
from lanebound.agents.presets import load_named
from lanebound.envs import FaultLevel
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = [
    "SPLITS",
    "TEST",
    "TRAIN",
    "AgentConfig",
    "SeedsConfig",
    "Split",
    "SuiteConfig",
    "flat_changes",
    "load_suite",
    "parse_agents",
]


Split = Literal["train", "test"]

TRAIN: Final = range(1000, 2000)
TEST: Final = range(10_000, 20_000)
SPLITS: Final[dict[Split, range]] = {"train": TRAIN, "test": TEST}


NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")
FOLDER, SKIES = "suites/", "skies/"
NEEDS: dict[str, dict[str, Any]] = {"oracle": {"observation": {"integrity": "oracle"}}}


class SeedsConfig(Config):
    """The first seeds of a published split, or those after the ones that were already inspected."""

    split: Split = Field("test", description="train (for tuning) or test (held out)")
    count: int = Field(50, ge=1, le=10_000, description="number of episodes of each agent in each cell")
    skip: int = Field(0, ge=0, description="number of first seeds of the split to leave out")

    @model_validator(mode="after")
    def _split_suffices(self) -> Self:
        there = len(SPLITS[self.split]) - self.skip
        if self.count > there:
            after = f" after the first {self.skip}" if self.skip else ""
            raise ConfigError(
                f"count must be <= {max(there, 0)} in the split {self.split}{after}, got {self.count}: take fewer"
            )
        return self

    @property
    def seeds(self) -> range:
        """The seeds themselves."""
        return SPLITS[self.split][self.skip : self.skip + self.count]


class AgentConfig(Config):
    """An agent of a suite."""

    agent: str = Field(description="name of an agent, model.zip (SB3), .onnx, .npz, or package.module:callable")
    config: Mapping[str, Any] = Field({}, description="changes of the environment's configuration for this agent")
    figures: Mapping[str, Any] = Field(
        {}, description="parameters of a packaged agent, such as {speed_share: 0.5} of cautious"
    )

    @property
    def sees_truth(self) -> bool:
        """Whether it observes the truth: it shows what is possible, and does not compete."""
        seeing = NEEDS["oracle"]["observation"]["integrity"]
        return self.agent == "oracle" or self.config.get("observation", {}).get("integrity") == seeing


class SuiteConfig(Config):
    """The content of a benchmark; its cells are envs x skies x faults x agents.

    ``agents`` may be a list of names, or a mapping from names to the ``agent`` of :class:`AgentConfig` or to all of
    its fields.

    >>> suite = SuiteConfig.load({"envs": ["LaneKeeping"], "agents": ["nominal", {"mine": "runs/model.zip"}]})
    >>> suite.envs, suite.agents["mine"].agent, suite.seeds.seeds[0]
    (('LaneKeeping-v0',), 'runs/model.zip', 10000)
    """

    title: str = Field("", description="what the suite is for")
    envs: tuple[str, ...] = Field(min_length=1, description="ids; lanebound/ may be left out")
    skies: tuple[str, ...] = Field(("urban",), min_length=1, description="presets of the sky")
    faults: tuple[FaultLevel, ...] = Field((FaultLevel.NONE,), min_length=1, description="levels of faults")
    agents: Mapping[str, AgentConfig] = Field(min_length=1, description="agents by their names in results")
    reference: str | tuple[str, ...] = Field(
        "nominal", description="agent, or list of agents, with which the others are compared seed by seed"
    )
    seeds: SeedsConfig = Field(SeedsConfig(), description="which seeds")
    overrides: Mapping[str, Any] = Field(
        {}, description="changes of the configuration of every environment, merged deeply"
    )
    episode_timeout_s: float = Field(600.0, gt=0, description="limit of the time of an agent's decisions in an episode")

    @field_validator("envs", mode="before")
    @classmethod
    def _envs_exist(cls, names: Any) -> Any:
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            return names
        from lanebound.agents.episodes.opening import full_id

        return tuple(full_id(name).removeprefix("lanebound/") for name in names)

    @field_validator("envs", "skies", "faults")
    @classmethod
    def _each_once(cls, given: tuple[str | FaultLevel, ...], info: ValidationInfo) -> tuple[str | FaultLevel, ...]:
        """A repeated cell would count its seeds twice; two names of one file or preset are one sky."""
        names = [
            name.value if isinstance(name, FaultLevel) else str(PurePath(name)).removeprefix(SKIES) for name in given
        ]
        _require_once(str(info.field_name), names, "name each once")
        return given

    @field_validator("agents", mode="before")
    @classmethod
    def _agents_in_full(cls, given: Any) -> Any:
        if isinstance(given, list | tuple):
            entries = [item if isinstance(item, Mapping) else {item: item} for item in given]
            _require_once("agents", [name for entry in entries for name in entry], "give each a name, {NAME: agent}")
            given = {name: agent for entry in entries for name, agent in entry.items()}
        if not isinstance(given, Mapping):
            example = given if isinstance(given, str) else "nominal"
            raise ConfigError(f"agents must be a list or a mapping, got {given!r}: write [{example}]")
        for place, (name, agent) in enumerate(given.items()):
            if not isinstance(name, str) or not isinstance(agent, str | Mapping | AgentConfig):
                raise ConfigError(
                    f"agents must be names or mappings {{NAME: agent}}, got {agent!r} as entry {place + 1}: "
                    "write the name of an agent"
                )
        return {name: _in_full(agent) if isinstance(agent, str) else agent for name, agent in given.items()}

    @field_validator("agents")
    @classmethod
    def _names_fit_files(cls, agents: Mapping[str, AgentConfig]) -> Mapping[str, AgentConfig]:
        for name in agents:
            if not NAME.fullmatch(name):
                raise ConfigError(
                    f"a name of an agent must be letters, digits and _.+-, got {name!r}: write 'name: {name}'"
                )
        return agents

    @field_validator("reference")
    @classmethod
    def _references_differ(cls, given: str | tuple[str, ...]) -> str | tuple[str, ...]:
        if not given or (len(set(given)) < len(given) and not isinstance(given, str)):
            raise ConfigError(f"reference must name an agent, or several once each, got {given!r}: write [nominal]")
        return given

    @property
    def references(self) -> tuple[str, ...]:
        """The agents that the others are paired with."""
        return (self.reference,) if isinstance(self.reference, str) else self.reference

    @property
    def places(self) -> list[Place]:
        """All places in order."""
        return [Place(e, s, f.value) for e in self.envs for s in self.skies for f in self.faults]

    def tasks(self) -> Iterator[Task]:
        """All episodes, env by env, and in each of them seed by seed."""
        for env in self.envs:
            here = [place for place in self.places if place.env == env]
            for seed in self.seeds.seeds:
                yield from (Task(place, agent, seed) for place in here for agent in self.agents)

    def env_overrides(self, place: Place, agent: str) -> dict[str, Any]:
        """Changes of the preset of the id for the environment of an agent."""
        chosen = self.agents[agent]
        needed = deep_merge(NEEDS.get(chosen.agent, {}), chosen.config)
        return deep_merge(deep_merge(self.overrides, {"sky": place.sky, "faults": place.faults}), needed)


def flat_changes(overrides: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """The changes of a configuration by dotted keys.

    >>> flat_changes({"duration_s": 30.0, "cost": {"hmi": 1}})
    {'duration_s': 30.0, 'cost.hmi': 1}
    """
    flat: dict[str, Any] = {}
    for key, value in overrides.items():
        flat |= flat_changes(value, f"{path}{key}.") if isinstance(value, Mapping) else {f"{path}{key}": value}
    return flat


def _in_full(agent: str) -> dict[str, Any]:
    """The fields of an agent that is given by its name."""
    if agent.endswith(LAYERED):
        return {"agent": "layer", "figures": {"over": bare_name(agent)}}
    return {"agent": agent}


def _require_once(field: str, names: Sequence[str], remedy: str) -> None:
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise ConfigError(
            f"{field} must differ from each other, got {repeated} {names.count(repeated)} times: {remedy}"
        )


def parse_agents(text: str) -> dict[str, str]:
    """Agents from a command line: ``nominal,mine=runs/model.zip``.

    Raises
    ------
    InputError
        Two of the same name.
    """
    found: dict[str, str] = {}
    for part in filter(None, (item.strip() for item in text.split(","))):
        name, equals, agent = part.partition("=")
        if name in found:
            raise InputError(f"agents must have names of their own, got {name} twice: call one NAME={agent or name}")
        found[name] = agent if equals else name
    return found


def load_suite(name: str, overrides: Mapping[str, Any] | None = None) -> SuiteConfig:
    """A packaged suite by its name, or one of your own by the path of its YAML file.

    Raises
    ------
    ConfigError
        There is none, or a value is refused.
    """
    return load_named(SuiteConfig, "suite", FOLDER, name, overrides)
