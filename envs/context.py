"""The context-aware monitor in a drive: a verdict a second on the road of the map, for the driver and for agents.

>>> import gymnasium, lanebound.envs
>>> config = {"sky": "open", "navigator": {"gnss": {"undifferenced": True}}}
>>> env = ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config=config))
>>> observation, info = env.reset(seed=1)
>>> sorted(info["context"])
['light', 'link_probability', 'phases', 'reason', 'road', 'score', 'warn']

The position that it guards is one of codes without a reference station, not the RTK position that the ego drives by.
The map is the road network of the world.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from lanebound.envs.core import DrivingEnv
from lanebound.envs.records import enu_of
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.context.code_fix import code_fix
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextReason, Light
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["CONTEXT_ENTRIES", "ContextMonitoring", "DriveContext", "road_map_of"]

Env = gymnasium.Env[Any, Any]
SAMPLE_M = 5.0
EPOCH_S = 1.0  # between verdicts, as S5
CONTEXT_ENTRIES = ("phases", "score", "link_probability", "warn")
"""Observation entries in [0, 1]: phases passed over 3, score over 100, probability of the link, warning."""


def road_map_of(network: Any) -> tuple[RoadMap, tuple[str, ...]]:
    """The road network of highway-env as a map, and the name of each link: its lanes side by side are one link."""
    nodes: dict[str, int] = {}
    places: list[Any] = []
    ends, lines, limits, names = [], [], [], []
    for start, onward in network.graph.items():
        for end, lanes in onward.items():
            middle, length = lanes[len(lanes) // 2], float(lanes[0].length)
            at = np.linspace(0.0, length, max(2, int(np.ceil(length / SAMPLE_M)) + 1))
            line = enu_of(np.array([middle.position(float(s), 0.0) for s in at]))
            for node, place in ((start, line[0]), (end, line[-1])):
                if node not in nodes:
                    nodes[node] = len(places)
                    places.append(place)
            ends.append((nodes[start], nodes[end]))
            lines.append(line)
            limits.append(float(middle.speed_limit or 0.0))
            names.append(f"{start}-{end}")
    return RoadMap.of_lines(np.array(places), ends, lines, limit_mps=limits), tuple(names)


class DriveContext:
    """The monitor of the ego of an environment; :meth:`look` after every reset and step.

    Raises
    ------
    InputError
        The ego has no navigator, or its receiver computes no undifferenced codes.
    """

    def __init__(self, env: DrivingEnv, config: ContextConfig | None = None) -> None:
        self.env, self.config = env, config or ContextConfig()
        self.every = max(1, round(EPOCH_S / env.dt_s))
        self.begin()

    def begin(self) -> None:
        """A new episode begins, with an empty log."""
        self.log: list[dict[str, Any]] = []
        self._monitor: ContextMonitor | None = None
        self._step, self._wheels = 0, [0.0]
        self.now: dict[str, Any] = _blank()

    def look(self) -> dict[str, Any]:
        """The verdict of now, which changes once a second: plain data of :data:`info`."""
        loop = self.env.belief_loop
        m = None if loop is None else loop.measurements
        if m is None or m.gnss.raw_code_m is None:
            raise InputError(
                "navigator.gnss.undifferenced must be true and navigation.source navigator, are not: the context-aware "
                "monitor needs code positions"
            )
        if self._monitor is None:
            road_map, self._names = road_map_of(self.env.world.road.network)
            self._monitor = ContextMonitor(self.config, road_map, 1, self.every * self.env.dt_s)
        self._wheels.append(float(m.odometer.speed_mps[0]))
        if self._step % self.every == 0:
            fix = code_fix(m, self.config.codes, slice(0, 1))
            verdict = self._monitor.step(fix, np.array([np.mean(self._wheels[-self.every :])]))
            self._note(float(m.time_s), verdict)
        self._step += 1
        return self.now

    def _note(self, time_s: float, verdict: Any) -> None:
        """Keep the verdict, and log it where the light or the reason changes."""
        reason, link = ContextReason.from_code(int(verdict.reason[0])), int(verdict.link[0])
        before = self.now
        self.now = {
            "warn": bool(verdict.warn[0]), "reason": reason.name, "light": Light(int(verdict.light[0])).name.lower(),
            "phases": int(verdict.phases[0]), "score": float(verdict.score[0]),
            "link_probability": float(verdict.match.probability[0]),
            "road": "" if link == NO_LINK else self._names[link],
        }  # fmt: skip
        if (self.now["light"], self.now["reason"]) != (before["light"], before["reason"]):
            self.log.append({"time_s": time_s, **self.now})

    @property
    def advice(self) -> str:
        """What the driver reads."""
        return "" if self.now["reason"] == "" else str(ContextReason[self.now["reason"]].value)

    def entries(self) -> NDArray[np.float32]:
        """The values of CONTEXT_ENTRIES, in [0, 1]."""
        n = self.now
        return np.array([n["phases"] / 3.0, n["score"] / 100.0, n["link_probability"], n["warn"]], np.float32)


def _blank() -> dict[str, Any]:
    return {
        "warn": True,
        "reason": "",
        "light": "amber",
        "phases": 0,
        "score": 0.0,
        "link_probability": 0.0,
        "road": "",
    }


class ContextMonitoring(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """``info["context"]`` and four observation entries of the context-aware monitor (:data:`CONTEXT_ENTRIES`).

    A ``Dict`` observation gets the group ``context``, a flat one the entries at its end.

    Parameters
    ----------
    env : an environment of lanebound with ``navigator.gnss.undifferenced``
    config : of the monitor
    warning_cost : added to ``info["cost"]`` for each second of a warning; ``info["cost_context"]`` has the seconds
    """

    def __init__(self, env: Env, config: ContextConfig | None = None, warning_cost: float = 0.0) -> None:
        if not warning_cost >= 0.0:
            raise InputError(f"warning_cost must be >= 0, got {warning_cost}: a warning costs something or nothing")
        RecordConstructorArgs.__init__(self, config=config, warning_cost=warning_cost)
        super().__init__(env)
        self.warning_cost = float(warning_cost)
        base = env.unwrapped
        if not isinstance(base, DrivingEnv):
            raise InputError(f"env must be an environment of lanebound, got {env}: make one of lanebound.envs")
        self.context = DriveContext(base, config)
        space, more = env.observation_space, gymnasium.spaces.Box(0.0, 1.0, (len(CONTEXT_ENTRIES),), np.float32)
        if isinstance(space, gymnasium.spaces.Dict):
            self.observation_space = gymnasium.spaces.Dict({**space.spaces, "context": more})
        elif isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1:
            self.observation_space = gymnasium.spaces.Box(
                np.concatenate([space.low, more.low]), np.concatenate([space.high, more.high]), dtype=np.float32
            )
        else:
            raise InputError(f"observation must be a Dict or flat, got {space}: set observation.history to 1")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.context.begin()
        return self._with(observation), {**info, "context": dict(self.context.now)}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Carry out a command until the next decision."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        observation = self._with(observation)
        now, warned_s = self.context.now, self.context.env.dt_s * self.context.now["warn"]
        cost = float(info["cost"]) + self.warning_cost * warned_s
        info = {**info, "context": dict(now), "cost_context": warned_s, "cost": cost}
        return observation, reward, terminated, truncated, info

    def _with(self, observation: Any) -> Any:
        self.context.look()
        more = self.context.entries()
        return (
            {**observation, "context": more} if isinstance(observation, dict) else np.concatenate([observation, more])
        )
