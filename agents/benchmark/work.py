"""Episodes of a benchmark as work for the runner: open the environment, drive the agent, store the episode.

Missing episodes are driven and stored, then all results are computed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lanebound.agents.benchmark.episode import allotted_s, run_episode
from lanebound.agents.benchmark.outcome import Outcome, Place, Status, Task
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.checkpointing.folder import locked
from lanebound.agents.checkpointing.runner import (
    Counter,
    Lost,
    OnProgress,
    PartStatus,
    RunProgress,
    available_cores,
    ignore,
    run_work,
)
from lanebound.agents.drivers import AGENTS, load_figures, make_agent, unknown_agent
from lanebound.agents.drivers.foreign import MODELS, is_foreign, require_foreign
from lanebound.agents.drivers.importing import require_importable
from lanebound.agents.drivers.origin import elsewhere
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.film import Film
from lanebound.agents.episodes.opening import full_id, naming
from lanebound.envs.core import DrivingEnv
from lanebound.envs.ids import Preset, preset_of
from lanebound.integrity.core.errors import InputError

__all__ = ["BenchmarkPlan", "DrivenEpisodes", "FilmedEpisodes", "expected_s", "run", "run_plan", "strangers", "unfit"]


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
        for _, outcome in driven:  # the generator drives the episodes here, under the lock
            counter.progress.failed += outcome.failed
    results = Results.load(plan.folder)
    results.save(plan.folder)
    return results


MOST_OPEN = 40  # environments that a worker keeps open; each takes some MB
LOST_STATUS: dict[Lost, Status] = {"died": "raised", "timeout": "timeout"}


class DrivenEpisodes:
    """Drives episodes of a suite and stores them. It is pickled for workers; the open environments are not.

    Parameters
    ----------
    folder : of the results; None stores nothing
    """

    def __init__(self, suite: SuiteConfig, folder: Path | None) -> None:
        self.suite, self.folder = suite, folder
        self._open: dict[tuple[Any, ...], DrivingEnv] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": {}}

    @property
    def timeout_s(self) -> float:
        """Time that an agent may take in an episode [s]."""
        return self.suite.episode_timeout_s

    def do(self, task: Task, status: PartStatus) -> Outcome:
        """Drive an episode and store it."""
        rows, outcome = run_episode(self._environment(task), self._make(task), task, status)
        if self.folder is not None:
            EpisodeStore(self.folder).write(rows, outcome)
        return outcome

    def lost(self, task: Task, reason: Lost, message: str) -> Outcome:
        """Store an episode without rows, whose worker died or was ended."""
        if reason == "timeout":
            message = f"it took longer than episode_timeout_s = {self.timeout_s:g} in all: its process was ended"
        outcome = Outcome(*task.place, task.agent, task.seed, status=LOST_STATUS[reason], message=message)
        if self.folder is not None:
            EpisodeStore(self.folder).write([], outcome)
        return outcome

    def _make(self, task: Task) -> Callable[[DrivingEnv], Any]:
        chosen = self.suite.agents[task.agent]
        return lambda env: make_agent(chosen.agent, env, chosen.figures)

    def _environment(self, task: Task) -> DrivingEnv:
        """The environment of a task; the most recent ones stay open."""
        changes = self.suite.env_overrides(task.place, task.agent)
        key = (task.place, repr(changes))
        env = self._open.pop(key, None) or open_env(task.place.env, changes)
        self._open[key] = env
        if len(self._open) > MOST_OPEN:
            del self._open[next(iter(self._open))]
        return env


class FilmedEpisodes(DrivenEpisodes):
    """Drives episodes, films them and stores nothing else.

    Parameters
    ----------
    film : file of the film; None makes no film
    fps : pictures in a second of the drive
    """

    def __init__(self, suite: SuiteConfig, film: Path | None, fps: int) -> None:
        super().__init__(suite, None)
        self.film, self.fps = film, fps

    def check(self, task: Task) -> None:
        """Refuse a film that cannot be made.

        Raises
        ------
        InputError
            By its name or its rate.
        """
        if self.film is not None:
            Film(self._environment(task), self.film, self.fps)

    def do(self, task: Task, status: PartStatus) -> Outcome:
        """Drive an episode and film it."""
        if self.film is None:
            return super().do(task, status)
        env = open_env(task.place.env, self.suite.env_overrides(task.place, task.agent), "rgb_array")
        with Film(env, self.film, self.fps) as film:
            return run_episode(env, self._make(task), task, status, [film])[1]


def unfit(suite: SuiteConfig) -> list[tuple[str, str, str]]:
    """Agents of ours that cannot drive an environment of a suite, as ``(env, agent, reason)``.

    Agents from files and modules are made at their episodes only, so that none of their code runs here. Modules are
    imported once in another process, to refuse those that fail.

    Raises
    ------
    InputError
        An agent, or the agent that it filters, does not exist or cannot be imported, its figures are refused, or an
        environment refuses its configuration.
    """
    for name, chosen in suite.agents.items():
        _require_agent(chosen.agent)
        figures = load_figures(chosen.agent, chosen.figures, f"agents.{name}.figures")
        if (over := getattr(figures, "over", None)) is not None:
            _require_agent(over)
    for place in suite.places:
        _opened(suite, place, next(iter(suite.agents)))
    found = []
    for place in {place.env: place for place in suite.places}.values():
        for name, chosen in suite.agents.items():
            env = _opened(suite, place, name)
            try:
                if not is_foreign(chosen.agent):
                    make_agent(chosen.agent, env, chosen.figures)
            except InputError as error:
                found.append((place.env, name, str(error)))
    return found


def strangers(suite: SuiteConfig) -> list[str]:
    """A warning for each policy of a file that drives an environment in which it was not learnt."""
    files = {
        name: [agent for agent in (chosen.agent, str(chosen.figures.get("over", ""))) if agent.endswith(MODELS)]
        for name, chosen in suite.agents.items()
    }
    places = {place.env: place for place in suite.places}.values()
    found = (
        elsewhere(file, _opened(suite, place, name).config.base)
        for name, there in files.items()
        for file in there
        for place in places
    )
    return [warning for warning in dict.fromkeys(found) if warning]


def _require_agent(agent: str) -> None:
    if is_foreign(agent):
        require_foreign(agent)
        if not agent.endswith(MODELS):
            require_importable(agent)
    elif agent not in AGENTS:
        raise unknown_agent(agent)


def _opened(suite: SuiteConfig, place: Place, agent: str) -> DrivingEnv:
    """The environment of an agent; refused keys are named by their path in the suite."""
    with naming({f"agents.{agent}.config": suite.agents[agent].config, "overrides": suite.overrides}):
        return open_env(place.env, suite.env_overrides(place, agent))


def expected_s(suite: SuiteConfig, envs: Sequence[str]) -> dict[str, float]:
    """Core time for an episode of each environment that lasts to its end [s]."""
    place = {place.env: place for place in suite.places}
    agent = next(iter(suite.agents))
    allotted = {env: allotted_s(open_env(env, suite.env_overrides(place[env], agent))) for env in envs}
    return {env: allotted[env] * (preset_of(full_id(env)) or Preset).CORE_S for env in envs}
