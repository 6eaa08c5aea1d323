"""One episode of one agent: its rows and its outcome, also where the agent fails."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.scoring import fault_figures, outcome_of
from lanebound.agents.drivers.base import Driver
from lanebound.agents.episodes import EpisodeLog, drive
from lanebound.agents.episodes.drive import Watcher
from lanebound.agents.episodes.guard import AgentFailure, Clock, Guarded, error_text, guarded
from lanebound.envs.core import DrivingEnv
from lanebound.envs.scene import duration_s

__all__ = ["allotted_s", "run_episode"]


def allotted_s(env: DrivingEnv) -> float:
    """Longest time of an episode [s]."""
    return duration_s(env.config, env.world)


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
    env : may have driven other episodes before
    make : makes the agent
    clock : measures the time of the agent
    watchers : called at every step, in addition to the log

    Returns
    -------
    The rows of all driven steps, and the outcome.
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
        status, message = "raised", f"in the environment: {error_text(error)}"
    fault = fault_figures(log.rows, env.belief_loop.info) if env.belief_loop is not None else {}
    figures = {"status": status, "message": message, **fault, **_solve_times(agent), **_counted(agent)}
    return log.rows, outcome_of(log.rows, allotted_s(env), task, env.config, **figures)


def seed_everything(seed: int) -> None:
    """Seed the global generators, so that an agent that uses them does not depend on earlier draws."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - foreign agents may use the global generator
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _solve_times(agent: Guarded | None) -> dict[str, float]:
    """Quantiles of the times of the decisions [ms]."""
    if agent is None or not agent.solve_ms:
        return {}
    median, high = np.median(agent.solve_ms), np.quantile(agent.solve_ms, 0.99)
    return {"solve_ms_median": float(median), "solve_ms_p99": float(high)}


def _counted(agent: Guarded | None) -> dict[str, int]:
    """The agent's own counts of infeasible and relaxed decisions, where it has them."""
    counts = getattr(agent and agent.agent, "counts", None)
    if not isinstance(counts, Mapping) or "decisions" not in counts:
        return {}
    return {name: int(counts.get(name, 0)) for name in ("infeasible", "relaxed")}
