"""A study of learning: arms with different observations and constraints, trained in all places, then compared.

::

    run.json                  the study
    trainings/NAME/           one resumable training each
    parts/NAME.json           results of each finished training: checkpoints, held-out episodes of its policy
    beside/ENV-SKY/           a benchmark of other drivers on the same seeds
    results.json  curves.svg  means, intervals and tests; learning curves
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

from gymnasium import spaces
from pydantic import field_validator, model_validator

from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.running import run
from lanebound.agents.benchmark.seeds import SPLITS
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.evaluation import drive_all
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig, Shield
from lanebound.agents.learning.imitation import teacher_of
from lanebound.agents.learning.study_tables import adjust, kept_oftener, means_of, summarise
from lanebound.agents.learning.training import load_model, one_thread, train
from lanebound.agents.presets import load_named
from lanebound.agents.serialization import finite_or_none
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError

__all__ = [
    "BESIDE", "ArmConfig", "Course", "LearningStudyConfig", "Training", "beside_suite", "judged", "load_study",
    "plan", "run_learning_study", "study_folder",
]  # fmt: skip

FOLDER = "studies/"
PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.drivers", "lanebound.agents.learning")
BESIDE = ("nominal", "integrity_aware")


class ArmConfig(Config):
    """The differences of an arm from the others."""

    title: str = Field("", description="what it is, in a line")
    overrides: Mapping[str, Any] = Field({}, description="of the environment's configuration, merged deeply")
    algorithm: Algorithm = Field(Algorithm.PPO, description="how its policies are learnt")
    shield: Shield = Field(Shield.NONE, description="filter between policy and car")
    experiment: Mapping[str, Any] = Field({}, description="of its trainings, over that of all")
    against: tuple[str, ...] = Field((), description="arms that it is compared with; one may be a name alone")
    family: str = Field("", description="of its comparisons: those of a family are tested together, by Holm's method")

    @field_validator("against", mode="before")
    @classmethod
    def _one_or_several(cls, against: Any) -> Any:
        return () if against is None else (against,) if isinstance(against, str) else against


class LearningStudyConfig(Config):
    """All inputs of a study."""

    title: str = Field("", description="its question, in a line")
    hypotheses: tuple[str, ...] = Field((), description="expectations, written before any training")
    arms: Mapping[str, ArmConfig] = Field(min_length=1, description="by the names they go by in results")
    envs: tuple[str, ...] = Field(min_length=1, description="ids, ours without lanebound/")
    skies: tuple[str, ...] = Field(min_length=1, description="presets of the sky")
    seeds: int = Field(5, ge=1, le=100, description="trainings of each arm in each place")
    test_seeds: int = Field(50, ge=1, le=1000, description="held-out episodes of each policy")
    test_skip: int = Field(0, ge=0, le=9000, description="first held-out seeds left out, as they were inspected")
    experiment: Mapping[str, Any] = Field({}, description="common to all trainings: steps, settings ...")
    by_env: Mapping[str, Mapping[str, Any]] = Field({}, description="of the trainings of an id, over that")

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(full_id(name).removeprefix("lanebound/") for name in names)

    @field_validator("by_env")
    @classmethod
    def _own_is_of_ids(cls, own: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
        return {full_id(name).removeprefix("lanebound/"): value for name, value in own.items()}

    @model_validator(mode="after")
    def _arms_are_compared_with_arms(self) -> Self:
        for name, arm in self.arms.items():
            others = [other for other in self.arms if other != name]
            for against in arm.against:
                if against not in others:
                    raise ConfigError(
                        f"arms.{name}.against must be one of {', '.join(others)}, got {against}: name another arm"
                    )
        return self

    @property
    def seeds_to_judge(self) -> Sequence[int]:
        """Held-out seeds of every policy."""
        return SPLITS["test"][self.test_skip : self.test_skip + self.test_seeds]

    def shared(self, env: str) -> dict[str, Any]:
        """The common experiment of all trainings in an environment."""
        return deep_merge(self.experiment, self.by_env.get(env, {}))

    @property
    def against(self) -> dict[str, tuple[str, ...]]:
        """Arms that each arm is compared with."""
        return {name: arm.against for name, arm in self.arms.items()}

    @property
    def families(self) -> dict[str, str]:
        """Families of the comparisons of each arm."""
        return {name: arm.family for name, arm in self.arms.items()}

    @property
    def places(self) -> Iterator[tuple[str, str]]:
        """Environments and skies."""
        return ((env, sky) for env in self.envs for sky in self.skies)


class Training(NamedTuple):
    """A policy to be trained."""

    env: str
    sky: str
    arm: str
    seed: int

    @property
    def name(self) -> str:
        """Of its folder and part."""
        return f"{self.env}-{self.sky}-{self.arm}-{self.seed}"

    @property
    def agent(self) -> str:
        """Name of its policy in the benchmark of its place."""
        return f"{self.arm}-{self.seed}"

    def experiment(self, study: LearningStudyConfig) -> ExperimentConfig:
        """The experiment of the training."""
        arm = study.arms[self.arm]
        own = {"env": self.env, "sky": self.sky, "algorithm": arm.algorithm, "shield": arm.shield, "seed": self.seed}
        shared = deep_merge(study.shared(self.env), arm.experiment)
        return ExperimentConfig.load(deep_merge(shared, {"overrides": arm.overrides}) | own)


class Course(NamedTuple):
    """All trainings in the order of the work, and arms without suitable actions in an environment."""

    trainings: tuple[Training, ...]
    left_out: tuple[tuple[str, str], ...]


def load_study(name: str, overrides: Mapping[str, Any] | None = None) -> LearningStudyConfig:
    """A packaged study by its name, or one of your own by the path of its YAML file.

    Raises
    ------
    ConfigError
        There is none, or a value is refused.
    """
    return load_named(LearningStudyConfig, "study", FOLDER, name, overrides, "learning_study")


def plan(study: LearningStudyConfig) -> Course:
    """The trainings of a study: every place and arm with the first seed, then with the next.

    Raises
    ------
    ConfigError, InputError
        An experiment or environment is refused.
    """
    steered = {env: _accelerates(study, env) for env in study.envs}
    left_out = tuple(
        (env, name)
        for env in study.envs
        for name, arm in study.arms.items()
        if arm.shield is Shield.CBF and not steered[env]
    )
    trainings = tuple(
        Training(env, sky, arm, seed)
        for seed in range(study.seeds)
        for env, sky in study.places
        for arm in study.arms
        if (env, arm) not in left_out
    )
    for one in trainings:
        if one.seed == 0 and one.sky == study.skies[0]:
            teacher_of(one.experiment(study))
    return Course(trainings, left_out)


def _accelerates(study: LearningStudyConfig, env: str) -> bool:
    """Whether actions include steering and acceleration, which the filter needs."""
    world = Training(env, study.skies[0], next(iter(study.arms)), 0).experiment(study).open()
    space = world.action_space
    world.close()
    return isinstance(space, spaces.Box) and space.shape == (2,)


def study_folder(study: LearningStudyConfig, out: Path) -> ResultFolder:
    """The folder of a study's results; its ``check`` refuses foreign files and other work, before any time is spent."""
    return ResultFolder(out, "learning study", study.to_dict(), code_digest(*PACKAGES))


def run_learning_study(
    study: LearningStudyConfig,
    out: Path,
    jobs: int = 1,
    budget_h: float | None = None,
    on_progress: OnProgress = ignore,
) -> dict[str, Any]:
    """Carry out the missing trainings, drive other drivers on the same seeds, and write ``results.json``.

    Parameters
    ----------
    jobs : trainings at a time, a process each
    budget_h : no training or episode is started after that [h]
    on_progress : called with the number of trainings

    Returns
    -------
    The data of ``results.json``.

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or an experiment is refused.
    """
    begun = time.monotonic()
    course = plan(study)
    study_folder(study, out).claim()
    by_name = {one.name: one for one in course.trainings}

    def left_h() -> float | None:
        return None if budget_h is None else max(budget_h - (time.monotonic() - begun) / 3600.0, 0.0)

    done = run_parts(out, list(by_name), partial(_learn, study, out, by_name), jobs, on_progress, budget_h=budget_h)
    there = {(part["env"], part["sky"]) for part in done.values()}
    beside = {
        (env, sky): run(beside_suite(study, env, sky), out / "beside" / f"{env}-{sky}", jobs, left_h())
        for env, sky in study.places
        if (env, sky) in there
    }
    return _written(study, course, done, beside, out)


def _learn(
    study: LearningStudyConfig, out: Path, by_name: Mapping[str, Training], name: str, advance: Advance
) -> dict[str, Any]:
    """Carry out or resume one training; its evaluations, and episodes of its policy on held-out seeds."""
    one, folder = by_name[name], out / "trainings" / name
    begun, planned = time.monotonic(), one.experiment(study)
    rows = train(planned, folder, stepped=lambda steps: advance(min(steps / planned.steps, 1.0)))
    episodes = judged(planned, folder, study.seeds_to_judge)
    hours = (time.monotonic() - begun) / 3600.0
    return {**one._asdict(), "limit": planned.limit(), "checkpoints": rows, "episodes": episodes, "hours": hours}


def judged(planned: ExperimentConfig, folder: Path, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Metrics of the best policy of a training on each of consecutive seeds."""
    with one_thread():
        return drive_all(planned, load_model(folder / "best.zip", planned.algorithm), seeds)


def beside_suite(study: LearningStudyConfig, env: str, sky: str) -> SuiteConfig:
    """Packaged drivers on the held-out seeds of a place."""
    return SuiteConfig.load(
        {
            "title": study.title,
            "envs": [env],
            "skies": [sky],
            "agents": {name: name for name in BESIDE},
            "reference": BESIDE[0],
            "seeds": {"split": "test", "count": study.test_seeds, "skip": study.test_skip},
            "overrides": study.shared(env).get("overrides", {}),
        }
    )


def _written(
    study: LearningStudyConfig,
    course: Course,
    done: Mapping[str, Mapping[str, Any]],
    beside: Mapping[tuple[str, str], Results],
    out: Path,
) -> dict[str, Any]:
    from lanebound.agents.learning.study_figure import curves_figure
    from lanebound.integrity.assessment.plotting import save

    found: dict[str, Any] = {
        "study": study.to_dict(),
        "trainings": {"planned": len(course.trainings), "done": len(done)},
        "left_out": [list(pair) for pair in course.left_out],
        "hours": sum(part["hours"] for part in done.values()),
        "places": [
            {
                "env": env,
                "sky": sky,
                **summarise(
                    [part for part in done.values() if (part["env"], part["sky"]) == (env, sky)], study.against
                ),
                "beside": means_of(results),
            }
            for (env, sky), results in beside.items()
        ],
        "kept": kept_oftener(list(done.values()), study.against),
    }
    adjust(found["places"], found["kept"], study.families)
    found = finite_or_none(found)
    write_json(out / "results.json", found)
    if done:
        save(curves_figure(list(done.values()), list(study.arms)), out / "curves.svg")
    return dict(found)
