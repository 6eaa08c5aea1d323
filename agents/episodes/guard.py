"""Agents of any origin: their actions are checked before they reach an environment."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, Protocol

import gymnasium
import numpy as np

from lanebound.agents.drivers.base import Driver, Starts, States
from lanebound.envs.core import DrivingEnv
from lanebound.envs.world import within_rounding

__all__ = ["AgentFailure", "Clock", "Failing", "Guarded", "NoClock", "checked", "error_text", "guarded"]

LONGEST = 300  # characters of a message
Failing = Literal["raised", "not_finite", "wrong_shape", "outside_space", "timeout"]
"""Kinds of failures of an agent."""


class AgentFailure(Exception):  # noqa: N818 - its status says which
    """An agent failed."""

    def __init__(self, status: Failing, message: str) -> None:
        super().__init__(message)
        self.status: Failing = status


class Clock(Protocol):
    """Measures the time of an agent; another process can end an agent that takes too long."""

    def begin(self) -> None:
        """The agent begins."""

    def end(self) -> None:
        """The agent is done."""


class NoClock:
    """Measures nothing."""

    def begin(self) -> None:
        """Nothing."""

    def end(self) -> None:
        """Nothing."""


class Guarded:
    """An agent whose actions are checked, and its decisions timed.

    Attributes
    ----------
    solve_ms : time of every decision

    Raises
    ------
    AgentFailure
        It raises, or its action is no number, of another shape or outside the space.
    """

    def __init__(self, agent: Driver, space: gymnasium.Space[Any], clock: Clock) -> None:
        self.agent, self.space, self.clock = agent, space, clock
        self.solve_ms: list[float] = []

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The checked action of the agent."""
        self.clock.begin()
        begun = perf_counter()
        try:
            answer = self.agent.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except (Exception, SystemExit) as error:
            raise AgentFailure("raised", error_text(error)) from error
        finally:
            self.solve_ms.append(1000.0 * (perf_counter() - begun))
            self.clock.end()
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise AgentFailure("wrong_shape", f"predict must return (action, state), got {_short(answer)}")
        return checked(answer[0], self.space), answer[1]


def checked(action: Any, space: gymnasium.Space[Any]) -> Any:
    """An unchanged action that an environment can execute.

    Raises
    ------
    AgentFailure
        The environment cannot execute it.
    """
    try:
        numbers = np.asarray(action)
    except ValueError:  # ragged
        numbers = np.asarray(None)
    discrete = isinstance(space, gymnasium.spaces.Discrete)
    fits = numbers.size == 1 if discrete else numbers.shape == space.shape
    if numbers.dtype.kind not in "iuf" or not fits:
        wanted = "one integer" if discrete else f"{space.dtype} numbers of shape {space.shape}"
        raise AgentFailure("wrong_shape", f"action must be {wanted}, got {_short(action)}")
    if not np.isfinite(numbers).all():
        raise AgentFailure("not_finite", f"action must be finite, got {_short(action)}")
    inside = numbers.dtype.kind in "iu" and space.contains(np.int64(numbers.item())) if discrete else None
    if inside is None:
        box: Any = space
        inside = box.contains(within_rounding(numbers.astype(box.dtype), box.low, box.high))
    if not inside:
        raise AgentFailure("outside_space", f"action must lie in {space}, got {_short(action)}")
    return action


def guarded(make: Callable[[DrivingEnv], Driver], env: DrivingEnv, seed: int, clock: Clock | None = None) -> Guarded:
    """A new agent with checks; an agent with random draws receives the seed.

    Raises
    ------
    AgentFailure
        It cannot be made.
    """
    clock = clock or NoClock()
    clock.begin()
    try:
        agent = make(env)
        if hasattr(agent, "reseed"):
            agent.reseed(seed)
    except (Exception, SystemExit) as error:
        raise AgentFailure("raised", error_text(error)) from error
    finally:
        clock.end()
    return Guarded(agent, env.action_space, clock)


def error_text(error: BaseException) -> str:
    """Kind, text and place of an error, in a line."""
    text = _short(str(error) or "no message", shown=str)
    frames = [] if isinstance(error, SyntaxError) else traceback.extract_tb(error.__traceback__)  # its text has a place
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{where}"


def _short(value: Any, shown: Callable[[Any], str] = repr) -> str:
    text = " ".join(shown(value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
