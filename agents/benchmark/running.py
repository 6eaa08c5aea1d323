"""A benchmark from its suite to its results: what is missing is driven, stored as it comes, and put together."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.pool import Pool
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import Store
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import Work, expected_s, unfit

__all__ = ["Plan", "Progress", "run", "run_plan"]

START_S = 6.0  # until a worker is at work


@dataclass(frozen=True)
class Plan:
    """What is to be driven, and about how long that takes.

    Attributes
    ----------
    left_out : agents that cannot drive an environment, as ``(env, agent, why)``
    tasks : episodes that are missing, in the order of the work; stored : how many are there already
    expected_s : time of a core that an episode of each environment may take, if it lasts to its end
    """

    suite: SuiteConfig
    folder: Path
    left_out: list[tuple[str, str, str]]
    tasks: list[Task]
    stored: int
    expected_s: dict[str, float]

    @classmethod
    def of(cls, suite: SuiteConfig, folder: Path, fresh: bool = False) -> Plan:
        """The plan of a suite in a folder, which then belongs to it.

        Raises
        ------
        InputError
            An agent does not exist, an environment refuses its configuration, or the folder holds another suite.
        """
        left_out = unfit(suite)
        out = {(env, agent) for env, agent, _ in left_out}
        store = Store(folder)
        store.claim(suite, fresh)
        store.leave_out(left_out)
        wanted = [task for task in suite.tasks() if (task.place.env, task.agent) not in out]
        missing = [task for task in wanted if not store.has(task)]
        expected = expected_s(suite, sorted({task.place.env for task in missing}))
        return cls(suite, folder, left_out, missing, len(wanted) - len(missing), expected)

    def hours(self, jobs: int) -> float:
        """About how long it takes with so many processes [h]."""
        work_s = sum(self.expected_s[task.place.env] for task in self.tasks)
        return (work_s / jobs + START_S) / 3600.0 if self.tasks else 0.0


@dataclass
class Progress:
    """How far a run is.

    Attributes
    ----------
    done, of : episodes of this run
    failures : those in which an agent failed
    left_s : about how long the rest takes, kernels that are still to be compiled apart; None while nothing is finished
    compiling : how many processes compile kernels now
    out_of_time : whether the budget is used up
    """

    of: int
    done: int = 0
    failures: list[Outcome] = field(default_factory=list)
    left_s: float | None = None
    compiling: int = 0
    out_of_time: bool = False


def run(
    suite: SuiteConfig,
    folder: Path,
    jobs: int | None = None,
    budget_h: float | None = None,
    fresh: bool = False,
    told: Callable[[Progress], None] = lambda progress: None,
) -> Results:
    """Drive what is missing of a suite, and save results.

    Parameters
    ----------
    jobs : processes, one for each core when None
    budget_h : no episode is begun after that
    fresh : what the folder holds of an earlier run is thrown away
    told : called a few times a second

    Raises
    ------
    InputError
        As :meth:`Plan.of`; or a process ends as it is started, as in a script without ``if __name__ == "__main__":``.
    """
    return run_plan(Plan.of(suite, folder, fresh), jobs, budget_h, told)


def run_plan(
    plan: Plan,
    jobs: int | None = None,
    budget_h: float | None = None,
    told: Callable[[Progress], None] = lambda progress: None,
) -> Results:
    """The same from a plan."""
    begun = time.monotonic()
    jobs = cores() if jobs is None else jobs
    progress, left = Progress(len(plan.tasks)), Counter(task.place.env for task in plan.tasks)
    pool = Pool(Work(plan.suite, plan.folder), jobs)

    def in_time() -> bool:
        progress.out_of_time = budget_h is not None and time.monotonic() - begun > 3600.0 * budget_h
        return not progress.out_of_time

    def looked() -> None:
        progress.compiling = pool.compiling
        told(progress)

    whole_s = _sum_s(left, plan.expected_s)
    for outcome in pool.run(plan.tasks, in_time, looked):
        left[outcome.env] -= 1
        progress.done += 1
        progress.failures += [outcome] if outcome.failed else []
        rest_s = _sum_s(left, plan.expected_s)
        at_a_time = max(1, min(jobs, progress.of - progress.done))
        progress.left_s = pool.driven_s / (whole_s - rest_s) * rest_s / at_a_time
        told(progress)
    results = Results.load(plan.folder)
    results.save(plan.folder)
    return results


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _sum_s(counts: Counter[str], each_s: dict[str, float]) -> float:
    return sum(count * each_s[env] for env, count in counts.items())
