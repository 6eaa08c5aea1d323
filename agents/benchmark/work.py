"""What a worker does: opens environments, drives an episode, stores it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from lanebound.agents.benchmark.episode import allotted_s, run_episode
from lanebound.agents.benchmark.outcome import Outcome, Place, Status, Task
from lanebound.agents.benchmark.store import Store
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.drivers import AGENTS, load_figures, make_agent, unknown_agent
from lanebound.agents.drivers.foreign import is_foreign, require_foreign
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.film import Film
from lanebound.agents.episodes.guard import Clock
from lanebound.agents.episodes.opening import naming
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["FilmedWork", "Work", "expected_s", "unfit"]

COST_OF_A_SECOND = {
    "LaneKeeping-v0": 0.03,
    "CarFollowing-v0": 0.03,
    "Highway-v0": 0.5,
    "Merge-v0": 0.02,
    "Roundabout-v0": 0.07,
    "Intersection-v0": 0.12,
    "Racetrack-v0": 0.02,
    "UrbanCanyon-v0": 0.05,
}
"""Time of a core that a second of an episode takes, measured with the nominal agent on a 2.5 GHz core of 2023 [s]."""
COST_OF_OTHERS = 0.1


class Work:
    """How episodes of a suite are driven and where they are kept.

    Travels to workers; the environments do not.

    Parameters
    ----------
    suite : what is driven
    folder : of the results; None keeps nothing
    """

    def __init__(self, suite: SuiteConfig, folder: Path | None) -> None:
        self.suite, self.folder = suite, folder
        self._env = ""
        self._open: dict[tuple[Any, ...], DrivingEnv] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": {}, "_env": ""}

    def drive(self, task: Task, clock: Clock | None = None) -> Outcome:
        """Drive an episode and store it."""
        rows, outcome = run_episode(self._environment(task), self._make(task), task, clock)
        if self.folder is not None:
            Store(self.folder).write(rows, outcome)
        return outcome

    def keep_failure(self, task: Task, status: Status, message: str) -> Outcome:
        """Store an episode of which nothing is left but how it ended."""
        outcome = Outcome(*task.place, task.agent, task.seed, status=status, message=message)
        if self.folder is not None:
            Store(self.folder).write([], outcome)
        return outcome

    def _make(self, task: Task) -> Callable[[DrivingEnv], Any]:
        chosen = self.suite.agents[task.agent]
        return lambda env: make_agent(chosen.agent, env, chosen.figures)

    def _environment(self, task: Task) -> DrivingEnv:
        """The environment of a task; those of an id are kept while the work is at that id."""
        if task.place.env != self._env:
            self._open.clear()
            self._env = task.place.env
        changes = self.suite.env_overrides(task.place, task.agent)
        key = (task.place, repr(changes))
        if key not in self._open:
            self._open[key] = open_env(task.place.env, changes)
        return self._open[key]


class FilmedWork(Work):
    """The same with a film of the episode, and nothing kept beside it.

    Parameters
    ----------
    film : where it goes, None for none; fps : its pictures in a second of the drive
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

    def drive(self, task: Task, clock: Clock | None = None) -> Outcome:
        """Drive an episode and film it."""
        if self.film is None:
            return super().drive(task, clock)
        env = open_env(task.place.env, self.suite.env_overrides(task.place, task.agent), "rgb_array")
        with Film(env, self.film, self.fps) as film:
            return run_episode(env, self._make(task), task, clock, [film])[1]


def unfit(suite: SuiteConfig) -> list[tuple[str, str, str]]:
    """Agents of ours that cannot drive an environment of a suite, as ``(env, agent, why)``.

    Those from elsewhere are not made before their episodes: nothing of theirs is run here.

    Raises
    ------
    InputError
        An agent or whom it filters does not exist, its figures are refused, or an environment refuses its
        configuration.
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


def _require_agent(agent: str) -> None:
    if is_foreign(agent):
        require_foreign(agent)
    elif agent not in AGENTS:
        raise unknown_agent(agent)


def _opened(suite: SuiteConfig, place: Place, agent: str) -> DrivingEnv:
    """The environment of an agent; what it refuses is named by its place in the suite."""
    with naming({f"agents.{agent}.config": suite.agents[agent].config, "overrides": suite.overrides}):
        return open_env(place.env, suite.env_overrides(place, agent))


def expected_s(suite: SuiteConfig, envs: Sequence[str]) -> dict[str, float]:
    """Time of a core that an episode of each environment may take [s], if it lasts to its end."""
    place = {place.env: place for place in suite.places}
    agent = next(iter(suite.agents))
    allotted = {env: allotted_s(open_env(env, suite.env_overrides(place[env], agent))) for env in envs}
    return {env: allotted[env] * COST_OF_A_SECOND.get(env, COST_OF_OTHERS) for env in envs}
