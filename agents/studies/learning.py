"""A study of learning: arms with different observations and constraints, trained in all places, then compared.

::

    run.json                  the study
    trainings/NAME/           one resumable training each
    parts/NAME.json           results of each finished training: checkpoints, held-out episodes of its policy
    beside/ENV-SKY/           a benchmark of other drivers on the same seeds
    results.json  curves.svg  means, intervals and tests; learning curves

The expected time of a study follows from a short measurement of its environments.

A training is one draw of an arm, for any number of episodes. Trainings are few, so intervals and tests are Student's,
which assume normal means; a share that is equal in all trainings has the interval of Clopper and Pearson over all
episodes, as if all had different seeds. All trainings of a place are evaluated on the same episodes, in the environment
of their training and in those of ``judged_in``: the intervals describe a repeated training, not other episodes.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import field_validator, model_validator
from scipy.stats import binomtest

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import estimate, holm, student_ends, student_p, within
from lanebound.agents.benchmark.suite import SPLITS, SuiteConfig
from lanebound.agents.benchmark.work import run
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.evaluation import drive_all
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig, Shield
from lanebound.agents.learning.imitation import teacher_of
from lanebound.agents.learning.opening import for_learning
from lanebound.agents.learning.training import load_model, one_thread, train
from lanebound.agents.presets import load_named
from lanebound.agents.serialization import finite_or_none
from lanebound.agents.studies.study import Shown, stored
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError

Array = NDArray[np.float64]

LEARNING_S = 2e-4  # of the networks of PPO, a decision; measured
MOMENT_S = 2.0


class Pace(NamedTuple):
    """Time of a decision in training and alone [s], and decisions of an episode that lasts to its end."""

    learning_s: float
    alone_s: float
    decisions: float


def study_hours(study: LearningStudyConfig, course: Course) -> float:
    """Core time of a whole study [h]: trainings, their evaluations, and the other drivers.

    Raises
    ------
    ConfigError, InputError
        An environment is refused.
    """
    paces = {env: measured(next(one for one in course.trainings if one.env == env).experiment(study))
             for env in study.envs}  # fmt: skip
    episodes = study.test_seeds * (1 + len(study.judged_in))
    learning_s = sum(_seconds(one.experiment(study), paces[one.env], episodes) for one in course.trainings)
    alone_s = sum(paces[env].alone_s * paces[env].decisions for env, _ in study.places)
    return (learning_s + len(COMPARED) * episodes * alone_s) / 3600.0


def _seconds(planned: ExperimentConfig, pace: Pace, episodes: int) -> float:
    checkpoints = -(-planned.steps // planned.checkpoint_steps)
    shown = 0 if planned.imitation is None else planned.imitation.total(planned.count)
    checkpoints += planned.imitation is not None
    judged = (checkpoints * planned.evaluation_episodes + episodes) * pace.decisions
    return (planned.steps + shown + judged) * pace.learning_s


def measured(planned: ExperimentConfig) -> Pace:
    """Speed of an experiment's environments on this machine, with random actions."""
    with one_thread(), closing(for_learning(planned, 1)) as many, closing(planned.open()) as single:
        many.reset()
        learning_s = _each(lambda: many.step(np.stack([many.action_space.sample() for _ in range(many.num_envs)])))
        single.reset(seed=planned.seed)

        def step() -> None:
            *_, terminated, truncated, _ = single.step(single.action_space.sample())
            if terminated or truncated:
                single.reset()

        alone_s = _each(step)
        decisions = allotted_s(single) / single.dt_s
    return Pace(learning_s / planned.count + LEARNING_S, alone_s, decisions)


def _each(step: Callable[[], Any]) -> float:
    """Processor time of a step [s], after a first one that is not counted."""
    step()
    begun, count = time.process_time(), 0
    while (passed := time.process_time() - begun) < MOMENT_S:
        step()
        count += 1
    return passed / count


OWN = "own"  # the environment of the training, among those in which a policy is evaluated
SHOWN = ("return", "cost", "over_cost_limit", "harm", "collision", "off_road", "lane_departure", "throughput")
"""Metrics of the summary, by their names in the benchmark."""
PRIMARY = ("return", "cost", "harm")
"""Metrics whose differences between arms are tested together, by Holm's method."""
RATES = ("over_cost_limit", "collision", "off_road", "lane_departure")


def summarise(
    parts: Sequence[Mapping[str, Any]], arms: Mapping[str, Sequence[str]], where: str = OWN
) -> dict[str, Any]:
    """Means of each arm over its trainings with 95 % intervals, and paired differences from other arms.

    ``where`` is the environment of the episodes. In another than that of the training, each arm is also compared with
    itself in its own (``own``): the gap of generalisation.

    Trainings with the same seed are paired. ``parts`` are the finished trainings of a place, each with its ``arm``,
    ``seed``, ``limit`` of an episode's cost and ``episodes`` of :func:`~.evaluation.drive_all`; ``kept`` is the number
    of those within the limit (:func:`keeps`).
    """
    parts, in_training = evaluated_in(parts, where), parts
    episodes = sum(len(part["episodes"]) for part in parts) // max(len(parts), 1)
    kept = Counter(part["arm"] for part in parts if keeps(part))
    by_arm, own = (
        {arm: {part["seed"]: _means(part["episodes"]) for part in of if part["arm"] == arm} for arm in arms}
        for of in (parts, in_training)
    )
    return {
        "arms": {
            arm: {
                "seeds": sorted(trainings),
                "kept": kept[arm],
                "means": {key: _estimate(trainings, key, episodes * len(trainings)) for key in SHOWN},
                "less": {other: _differences(trainings, by_arm[other]) for other in arms[arm]}
                | ({OWN: _differences(trainings, own[arm])} if where != OWN else {}),
            }
            for arm, trainings in by_arm.items()
            if trainings
        }
    }


def keeps(part: Mapping[str, Any]) -> bool:
    """Whether the mean cost of a training's episodes is at most its limit."""
    return _means(part["episodes"])["cost"] <= float(part["limit"])


def kept_more_often(parts: Sequence[Mapping[str, Any]], arms: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Trainings of arms within the cost limit, in all places together, and ``p`` of no difference (McNemar, exact).

    Trainings with the same place and seed are paired: ``n`` pairs; ``first`` and ``second`` within the limit, and
    ``first_alone`` and ``second_alone`` where the other is not.
    """
    by_arm = {arm: {(p["env"], p["sky"], p["seed"]): keeps(p) for p in parts if p["arm"] == arm} for arm in arms}
    out = []
    for arm, others in arms.items():
        for other in others:
            of_arm, of_other = by_arm[arm], by_arm[other]
            pairs = [(of_arm[key], of_other[key]) for key in sorted(of_arm.keys() & of_other.keys())]
            alone, against = pairs.count((True, False)), pairs.count((False, True))
            out.append({
                "arm": arm, "other": other, "n": len(pairs),
                "first": sum(first for first, _ in pairs), "second": sum(second for _, second in pairs),
                "first_alone": alone, "second_alone": against,
                "p": float(binomtest(alone, alone + against).pvalue) if alone + against else 1.0,
            })  # fmt: skip
    return out


def higher(parts: Sequence[Mapping[str, Any]], arm: str, other: str, key: str = "return") -> tuple[int, int, int, int]:
    """Comparison of a metric of two arms, trainings with the same place and seed paired.

    Returns (pairs where the first is higher, pairs, places where its mean is higher, places).
    """
    of_arm, of_other = (
        {(p["env"], p["sky"], p["seed"]): _means(p["episodes"])[key] for p in parts if p["arm"] == name}
        for name in (arm, other)
    )
    gaps: dict[tuple[str, str], list[float]] = {}
    for place in sorted(of_arm.keys() & of_other.keys()):
        gaps.setdefault(place[:2], []).append(of_arm[place] - of_other[place])
    above = [gap > 0.0 for of in gaps.values() for gap in of]
    return sum(above), len(above), sum(sum(of) > 0.0 for of in gaps.values()), len(gaps)


def means_of(results: Results) -> dict[str, dict[str, float]]:
    """Means over the episodes of packaged drivers, by name."""
    return {
        cell.agent: {key: mean for key in SHOWN if (mean := cell.metrics[key].mean) is not None}
        for cell in results.cells
    }


def _means(episodes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means of a policy over its episodes."""
    return {key: float(np.mean([row[key] for row in episodes])) for key in SHOWN}


def _estimate(trainings: Mapping[int, Mapping[str, Any]], key: str, episodes: int) -> dict[str, Any]:
    """Mean over trainings with its 95 % interval; None where there is one training."""
    values = _column(trainings, key)
    low, high = within(student_ends(values), metric_named(key).bounds)
    if key in RATES and values.size > 1 and np.ptp(values) == 0.0:
        pooled = np.arange(episodes) < round(float(values[0]) * episodes)
        found = estimate(pooled.astype(np.float64), rate=True)
        low, high = found.low, found.high
    return {"mean": float(values.mean()), "low": low, "high": high, "n": int(values.size)}


def _column(trainings: Mapping[int, Mapping[str, Any]], key: str) -> Array:
    return np.array([trainings[seed][key] for seed in sorted(trainings)])


def _differences(own: Mapping[int, Mapping[str, Any]], others: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """Differences of each metric over common seeds; ``p`` of no difference."""
    both, out = sorted(own.keys() & others.keys()), {}
    for key in SHOWN:
        gap = np.array([own[seed][key] - others[seed][key] for seed in both])
        low, high = student_ends(gap)
        out[key] = {"difference": float(gap.mean()) if both else None, "low": low, "high": high, "n": len(both),
                    "p": student_p(gap) if gap.size > 1 else None}  # fmt: skip
    return out


def adjust(
    places: Sequence[Mapping[str, Any]], kept: Sequence[Mapping[str, Any]], families: Mapping[str, str]
) -> dict[str, int]:
    """Write ``p_holm`` next to each ``p`` of the PRIMARY metrics and of the limit; returns the numbers of tests.

    Tests of arms of a family are adjusted together, for all places and metrics.
    """
    tests: dict[str, list[Any]] = {}
    for place in places:
        for arm, found in place["arms"].items():
            of = tests.setdefault(families[arm], [])
            of += [less[key] for less in found["less"].values() for key in PRIMARY if less[key]["p"] is not None]
    for row in kept:
        if row["n"]:
            tests.setdefault(families[row["arm"]], []).append(row)
    for of in tests.values():
        for test, p in zip(of, holm([test["p"] for test in of]), strict=True):
            test["p_holm"] = p
    return {family: len(of) for family, of in tests.items()}


def spread(estimate: Mapping[str, Any]) -> str:
    """A mean with its interval as text."""
    low, high = estimate["low"], estimate["high"]
    return f"{estimate['mean']:.3g}" + ("" if low is None else f" [{low:.3g}, {high:.3g}]")


def tested(found: Mapping[str, Any]) -> str:
    """A difference with its interval and, below 1, its adjusted p as text; "" without common seeds."""
    if found["difference"] is None:
        return ""
    p = found.get("p_holm")
    return spread({**found, "mean": found["difference"]}) + ("" if p is None or p >= 1.0 else f", p {p:.2g}")


FOLDER = "studies/"
PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.drivers", "lanebound.agents.learning")
COMPARED = ("nominal", "integrity_aware")


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
    judged_in: Mapping[str, Mapping[str, Any]] = Field(
        {}, description="by a name: overrides of other environments in which all policies are also evaluated"
    )

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(full_id(name).removeprefix("lanebound/") for name in names)

    @field_validator("by_env")
    @classmethod
    def _own_is_of_ids(cls, own: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
        return {full_id(name).removeprefix("lanebound/"): value for name, value in own.items()}

    @field_validator("judged_in")
    @classmethod
    def _own_is_taken(cls, names: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Mapping[str, Any]]:
        if OWN in names:
            raise ConfigError(f"judged_in.{OWN} stands for the environment of the training: use another name")
        return names

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
        (env, sky, where): run(beside_suite(study, env, sky, where), out / "beside" / folder, jobs, left_h())
        for env, sky in study.places
        for where in (OWN, *study.judged_in)
        if (env, sky) in there and (folder := f"{env}-{sky}" + (f"-{where}" if where != OWN else ""))
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
    elsewhere = {
        name: judged(planned.replace(overrides=deep_merge(planned.overrides, changed)), folder, study.seeds_to_judge)
        for name, changed in study.judged_in.items()
    }
    hours = (time.monotonic() - begun) / 3600.0
    part = {**one._asdict(), "limit": planned.limit(), "checkpoints": rows, "episodes": episodes, "hours": hours}
    return part | ({"elsewhere": elsewhere} if elsewhere else {})


def judged(planned: ExperimentConfig, folder: Path, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Metrics of the best policy of a training on each of consecutive seeds, in the experiment's environment."""
    with one_thread():
        return drive_all(planned, load_model(folder / "best.zip", planned.algorithm), seeds)


def evaluated_in(parts: Sequence[Mapping[str, Any]], where: str) -> list[Mapping[str, Any]]:
    """Parts whose ``episodes`` are those of an environment of ``judged_in``, or as they are for ``own``."""
    return [part if where == OWN else {**part, "episodes": part["elsewhere"][where]} for part in parts]


def beside_suite(study: LearningStudyConfig, env: str, sky: str, where: str = OWN) -> SuiteConfig:
    """Packaged drivers on the held-out seeds of a place, in an environment in which policies are evaluated."""
    return SuiteConfig.load(
        {
            "title": study.title,
            "envs": [env],
            "skies": [sky],
            "agents": {name: name for name in COMPARED},
            "reference": COMPARED[0],
            "seeds": {"split": "test", "count": study.test_seeds, "skip": study.test_skip},
            "overrides": deep_merge(study.shared(env).get("overrides", {}), study.judged_in.get(where, {})),
        }
    )


def _written(
    study: LearningStudyConfig,
    course: Course,
    done: Mapping[str, Mapping[str, Any]],
    beside: Mapping[tuple[str, str, str], Results],
    out: Path,
) -> dict[str, Any]:
    from lanebound.agents.studies.learning_page import curves_figure  # the page imports this module
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
                "judged_in": where,
                **summarise(
                    [part for part in done.values() if (part["env"], part["sky"]) == (env, sky)], study.against, where
                ),
                "beside": means_of(results),
            }
            for (env, sky, where), results in beside.items()
        ],
        "kept": kept_more_often(list(done.values()), study.against),
    }
    adjust(found["places"], found["kept"], study.families)
    if done:
        save(curves_figure(list(done.values()), list(study.arms)), out / "curves.svg")
    return stored(finite_or_none(found), out)


def shown(found: Mapping[str, Any]) -> Iterator[Shown]:
    """Means and differences in each place, trainings within the limit, and what is missing."""
    for place in found["places"]:
        rows = [
            (arm, str(len(of["seeds"])), str(of["kept"]), *(spread(of["means"][key]) for key in SHOWN))
            for arm, of in place["arms"].items()
        ]
        rows += [
            (agent, "", "", *(f"{means[key]:.3g}" if key in means else "" for key in SHOWN))
            for agent, means in place["beside"].items()
        ]
        heads = ("arm", "trained", "kept limit", *(key.replace("_", " ") for key in SHOWN))
        judged_in = "" if place["judged_in"] == OWN else f", in {place['judged_in']}"
        yield f"{place['env']}, {place['sky']}{judged_in}: means over trainings, 95 %", (heads, rows)
        differences = [
            (f"{arm} - {other}", *(tested(less[key]) for key in PRIMARY))
            for arm, of in place["arms"].items()
            for other, less in of["less"].items()
        ]
        yield "differences, 95 %, p by Holm's method over all places", (("arms", *PRIMARY), differences)
    kept = [
        (f"{row['arm']}, {row['other']}", f"{row['first']}, {row['second']} of {row['n']}", f"{row['p_holm']:.2g}")
        for row in found["kept"]
        if row["n"]
    ]
    yield "trainings within the cost limit, in all places", (("arms", "kept", "p by Holm's method"), kept)
    done, planned = found["trainings"]["done"], found["trainings"]["planned"]
    if done < planned:
        yield f"{done} of {planned} trainings are done: run the same command again to resume"
