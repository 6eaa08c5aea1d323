"""One episode of one agent: its rows and what it came to, whatever the agent does."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.scoring import figures
from lanebound.agents.drivers.base import Driver
from lanebound.agents.episodes import EpisodeLog, drive
from lanebound.agents.episodes.drive import Watcher
from lanebound.agents.episodes.guard import AgentFailure, Clock, Guarded, guarded, told
from lanebound.envs.core import DrivingEnv

__all__ = ["allotted_s", "run_episode"]

ENDLESS_S = 300.0  # as an environment without a duration of its own ends


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
    log, status, message = EpisodeLog(), "ok", ""
    agent: Guarded | None = None
    seed_everything(task.seed)
    env.action_space.seed(task.seed)
    try:
        agent = guarded(make, env, task.seed, clock)
        drive(env, agent, [task.seed], [log, *watchers])
    except AgentFailure as failure:
        status, message = failure.status, str(failure)
    except Exception as error:
        status, message = "raised", f"in the environment: {told(error)}"
    return log.rows, _outcome(task, status, message, log.rows, env, agent)


def seed_everything(seed: int) -> None:
    """Start the global generators anew: an agent that draws from them must not depend on who drew before."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - it is the global one that agents of others may use
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _outcome(
    task: Task, status: str, message: str, rows: Sequence[Any], env: DrivingEnv, agent: Guarded | None
) -> Outcome:
    time_s = allotted_s(env)
    data: dict[str, Any] = figures(rows, time_s) if rows else {"allotted_s": time_s}
    data["cost_limit"] = env.config.cost_limit
    if agent is not None and agent.solve_ms:
        data["solve_ms_median"] = float(np.median(agent.solve_ms))
        data["solve_ms_p99"] = float(np.quantile(agent.solve_ms, 0.99))
    data |= _counted(agent)
    made = Outcome(*task.place, task.agent, task.seed, status=status, message=message, **data)  # type: ignore[arg-type]
    return Outcome.from_dict(made.to_dict())


def _counted(agent: Guarded | None) -> dict[str, int]:
    """What an agent counts of its decisions, if it does: those that were ``infeasible``, and ``relaxed``."""
    counts = getattr(agent and agent.agent, "counts", None)
    if not isinstance(counts, Mapping) or "decisions" not in counts:
        return {}
    return {name: int(counts.get(name, 0)) for name in ("infeasible", "relaxed")}
