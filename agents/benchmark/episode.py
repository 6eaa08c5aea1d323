"""One episode of one agent: its rows and what it came to, whatever the agent does."""

from __future__ import annotations

import random
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.outcome import Outcome, Status, Task
from lanebound.agents.benchmark.scoring import figures
from lanebound.agents.drivers.base import Driver
from lanebound.agents.episodes import EpisodeLog, drive
from lanebound.agents.episodes.drive import Watcher
from lanebound.envs.core import DrivingEnv

__all__ = ["AgentFailure", "Clock", "Guarded", "allotted_s", "run_episode"]

ENDLESS_S = 300.0  # as an environment without a duration of its own ends
LONGEST = 300  # characters of a message


class AgentFailure(Exception):  # noqa: N818 - its status says which
    """An agent has not done its part."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status: Status = status


class Clock(Protocol):
    """Is told when an agent begins to work and when it is done, so that others can see it hang."""

    def begin(self) -> None:
        """It begins."""

    def end(self) -> None:
        """It is done."""


class NoClock:
    """Nobody watches."""

    def begin(self) -> None:
        """Nothing."""

    def end(self) -> None:
        """Nothing."""


class Guarded:
    """An agent whose actions are checked before an environment sees them, and timed.

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
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, tuple[NDArray[Any], ...] | None]:
        """The agent's own answer, checked."""
        self.clock.begin()
        begun = perf_counter()
        try:
            answer = self.agent.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except (Exception, SystemExit) as error:
            raise AgentFailure("raised", _told(error)) from error
        finally:
            self.solve_ms.append(1000.0 * (perf_counter() - begun))
            self.clock.end()
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise AgentFailure("wrong_shape", f"predict must return (action, state), got {_short(answer)}")
        return checked(answer[0], self.space), answer[1]


def checked(action: Any, space: gymnasium.Space[Any]) -> Any:
    """An action as it is, if an environment can carry it out.

    Raises
    ------
    AgentFailure
        It cannot.
    """
    try:
        numbers = np.asarray(action)
    except ValueError:  # ragged
        numbers = np.asarray(None)
    discrete = isinstance(space, gymnasium.spaces.Discrete)
    fits = numbers.size == 1 if discrete else numbers.shape == space.shape
    if numbers.dtype.kind not in "iuf" or not fits:
        raise AgentFailure("wrong_shape", f"action must be numbers of shape {space.shape}, got {_short(action)}")
    if not np.isfinite(numbers).all():
        raise AgentFailure("not_finite", f"action must be finite, got {_short(action)}")
    inside = numbers.dtype.kind in "iu" and space.contains(np.int64(numbers.item())) if discrete else None
    if inside is None:
        inside = space.contains(numbers.astype(space.dtype))
    if not inside:
        raise AgentFailure("outside_space", f"action must lie in {space}, got {_short(action)}")
    return action


def allotted_s(env: DrivingEnv) -> float:
    """How long an episode can last."""
    return float(env.config.duration_s or env.world.config.get("duration", ENDLESS_S))


def run_episode(
    env: DrivingEnv,
    make: Callable[[DrivingEnv], Driver],
    task: Task,
    clock: Clock | None = None,
    watchers: Sequence[Watcher] = (),
) -> tuple[list[dict[str, Any]], Outcome]:
    """Drive an episode with an agent made for it.

    Parameters
    ----------
    env : it may have driven other episodes before
    make : makes the agent
    clock : is told when the agent works
    watchers : see every step beside the log

    Returns
    -------
    The rows of all steps that were driven, and the outcome.
    """
    clock = clock or NoClock()
    log, status, message = EpisodeLog(), "ok", ""
    guarded: Guarded | None = None
    seed_everything(task.seed)
    env.action_space.seed(task.seed)
    try:
        guarded = Guarded(_made(make, env, task.seed, clock), env.action_space, clock)
        drive(env, guarded, [task.seed], [log, *watchers])
    except AgentFailure as failure:
        status, message = failure.status, str(failure)
    except Exception as error:
        status, message = "raised", f"in the environment: {_told(error)}"
    return log.rows, _outcome(task, status, message, log.rows, env, guarded)


def _made(make: Callable[[DrivingEnv], Driver], env: DrivingEnv, seed: int, clock: Clock) -> Driver:
    """A new agent, so that no episode depends on another; one that draws is given the seed."""
    clock.begin()
    try:
        agent = make(env)
        if hasattr(agent, "reseed"):
            agent.reseed(seed)
    except (Exception, SystemExit) as error:
        raise AgentFailure("raised", _told(error)) from error
    finally:
        clock.end()
    return agent


def seed_everything(seed: int) -> None:
    """Start the global generators anew: an agent that draws from them must not depend on who drew before."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - it is the global one that agents of others may use
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _outcome(
    task: Task, status: str, message: str, rows: Sequence[Any], env: DrivingEnv, guarded: Guarded | None
) -> Outcome:
    time_s = allotted_s(env)
    data: dict[str, Any] = figures(rows, time_s) if rows else {"allotted_s": time_s}
    data["cost_limit"] = env.config.cost_limit
    if guarded is not None and guarded.solve_ms:
        data["solve_ms_median"] = float(np.median(guarded.solve_ms))
        data["solve_ms_p99"] = float(np.quantile(guarded.solve_ms, 0.99))
    data |= _counted(guarded)
    made = Outcome(*task.place, task.agent, task.seed, status=status, message=message, **data)  # type: ignore[arg-type]
    return Outcome.from_dict(made.to_dict())


def _counted(guarded: Guarded | None) -> dict[str, int]:
    """What an agent counts of its decisions, if it does: those that were ``infeasible``, and ``relaxed``."""
    counts = getattr(guarded and guarded.agent, "counts", None)
    if not isinstance(counts, Mapping) or "decisions" not in counts:
        return {}
    return {name: int(counts.get(name, 0)) for name in ("infeasible", "relaxed")}


def _told(error: BaseException) -> str:
    """Kind, text and place of an error, in a line."""
    text = _short(str(error) or "no message", shown=str)
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{where}"


def _short(value: Any, shown: Callable[[Any], str] = repr) -> str:
    text = " ".join(shown(value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
