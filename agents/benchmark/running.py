"""A benchmark from its suite to its results: missing episodes are driven and stored, then all results are computed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lanebound.agents.benchmark.outcome import Task
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import DrivenEpisodes, expected_s, strangers, unfit
from lanebound.agents.checkpointing.folder import locked
from lanebound.agents.checkpointing.runner import Counter, OnProgress, RunProgress, available_cores, ignore, run_work

__all__ = ["BenchmarkPlan", "run", "run_plan"]

START_S = 6.0  # to start a worker


@dataclass(frozen=True)
class BenchmarkPlan:
    """Episodes to drive, and their expected time.

    Attributes
    ----------
    left_out : agents that cannot drive an environment, as ``(env, agent, reason)``
    tasks : missing episodes in the order of the work: all cells with the first seed, then with the next
    stored : number of finished episodes
    warnings : policies that drive environments in which they were not learnt
    expected_s : core time for an episode of each environment that lasts to its end [s]
    """

    suite: SuiteConfig
    folder: Path
    left_out: list[tuple[str, str, str]]
    tasks: list[Task]
    stored: int
    warnings: list[str]
    expected_s: dict[str, float]

    @classmethod
    def of(cls, suite: SuiteConfig, folder: Path, fresh: bool = False) -> BenchmarkPlan:
        """The plan of a suite in a folder, which is claimed for it.

        Raises
        ------
        InputError
            An agent does not exist, an environment refuses its configuration, or the folder cannot be claimed.
        """
        left_out = unfit(suite)
        out = {(env, agent) for env, agent, _ in left_out}
        store = EpisodeStore(folder)
        store.claim(suite, fresh, left_out)
        wanted = [task for task in suite.tasks() if (task.place.env, task.agent) not in out]
        missing = [task for task in wanted if not store.has(task)]
        missing.sort(key=lambda task: task.seed)  # stable: a budget leaves about as many seeds in every cell
        expected = expected_s(suite, sorted({task.place.env for task in missing}))
        return cls(suite, folder, left_out, missing, len(wanted) - len(missing), strangers(suite), expected)

    def hours(self, jobs: int) -> float:
        """About how long the plan takes with so many processes [h]."""
        working_s = sum(self.expected_s[task.place.env] for task in self.tasks)
        return (working_s / jobs + START_S) / 3600.0 if self.tasks else 0.0


def run(
    suite: SuiteConfig,
    folder: Path,
    jobs: int | None = None,
    budget_h: float | None = None,
    fresh: bool = False,
    on_progress: OnProgress = ignore,
) -> Results:
    """Drive the missing episodes of a suite, and save the results.

    Parameters
    ----------
    jobs : processes; None: one for each core
    budget_h : no episode is started after that [h]
    fresh : remove the results of an earlier run first
    on_progress : called a few times a second

    Raises
    ------
    InputError
        As :meth:`BenchmarkPlan.of`; or a worker ends while it is started, as in a script without
        ``if __name__ == "__main__":``.
    """
    return run_plan(BenchmarkPlan.of(suite, folder, fresh), jobs, budget_h, on_progress)


def run_plan(
    plan: BenchmarkPlan, jobs: int | None = None, budget_h: float | None = None, on_progress: OnProgress = ignore
) -> Results:
    """Drive the episodes of a plan, and save the results."""
    counter = Counter(on_progress, RunProgress(of=plan.stored + len(plan.tasks), done=plan.stored))
    driven = run_work(
        plan.tasks,
        DrivenEpisodes(plan.suite, plan.folder),
        available_cores() if jobs is None else jobs,
        counter,
        isolated=True,
        budget_h=budget_h,
    )
    with locked(plan.folder):
        for _, outcome in driven:
            counter.progress.failed += outcome.failed
    results = Results.load(plan.folder)
    results.save(plan.folder)
    return results
