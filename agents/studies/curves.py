"""Learning curves: a policy learns under a cost limit in each id as it is shipped, and is judged as it learns.

::

    run.json            the study
    trainings/ENV/      a resumable training each; it has no best.zip, because held-out seeds must not choose
    judged/ENV/         episodes on held-out seeds: of the checkpoints by their decisions, of others by their names
    parts/ENV.json      all of an id that is finished
    results.json  curves.png

Trainings are packaged experiments with recorded neighbours; every policy is judged with receivers of all neighbours.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import field_validator

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.statistics import Estimate, estimate
from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.checkpointing.files import make_folder, read_json, write_json
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.learnt import policies
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.evaluation import drive_all
from lanebound.agents.learning.experiment import ExperimentConfig, load_experiment
from lanebound.agents.learning.training import load_model, one_thread, train
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.study import claim, stored
from lanebound.envs import make_config
from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPARED = {"nominal": "#9A9A9A", "ppo": "#D55E00"}
"""Drivers that the policy is compared with, and their colours; ``ppo`` is the shipped policy."""
LEARNT, OWN = "learnt", "#0072B2"
SHOWN = ("return", "cost", "over_cost_limit", "success", "mean_speed")
CURVES = (("return", "return"), ("cost", "cost"), ("over_cost_limit", "share over the limit"), ("success", "success"))
PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.drivers", "lanebound.agents.learning")
SECTIONS = ("final values", "checkpoints", "budget")
FIGURE = "learning-curves.png"
COUNT = 64  # environments at once
FAST = {"n_steps": 128, "batch_size": 1024}  # five decisions a second
SLOW = {"n_steps": 32, "batch_size": 256}  # two
PACE: dict[str, tuple[int, int, dict[str, int]]] = {
    "LaneKeeping": (100_000, 5_000, FAST),
    "CarFollowing": (100_000, 5_000, FAST),
    "Merge": (48_000, 2_000, SLOW),
    "Roundabout": (44_000, 2_000, SLOW),
    "Racetrack": (66_000, 5_000, FAST),
    "Highway": (56_000, 2_000, SLOW),
    "Intersection": (49_000, 2_000, SLOW),
    "UrbanCanyon": (45_000, 2_000, SLOW),
    "WorkZone": (45_000, 2_000, SLOW),
    "Guidance": (45_000, 2_000, SLOW),
    "Tolling": (68_000, 2_000, SLOW),
}
"""Of each id, the fastest to judge first: decisions that a core learns from in a minute (measured), those of a round of
imitation, and settings."""


class CurvesConfig(Config):
    """All inputs of the study."""

    envs: tuple[str, ...] = Field(tuple(PACE), min_length=1, description="ids, ours without lanebound/")
    minutes: float = Field(6.0, gt=0, description="of one core that learning by reward takes about, in each id")
    checkpoints: int = Field(7, ge=1, le=100, description="after the imitation, which is judged as well")
    seeds: int = Field(12, ge=1, le=1000, description="held-out episodes of each checkpoint")
    final_seeds: int = Field(32, ge=1, le=1000, description="of the last policy and of the others")
    skip: int = Field(3000, ge=0, le=9000, description="first held-out seeds left out, as they were inspected")
    experiment: Mapping[str, Any] = Field({}, description="changes of all trainings, such as seed")

    @field_validator("envs")
    @classmethod
    def _envs_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        found = tuple(full_id(name).removeprefix("lanebound/").removesuffix("-v0") for name in names)
        for name in found:
            if name not in PACE:
                raise ConfigError(f"envs must be of {', '.join(PACE)}, got {name}: choose from these")
        return found

    def held_out(self, count: int) -> Sequence[int]:
        """So many held-out seeds."""
        return SPLITS["test"][self.skip : self.skip + count]


def experiment_of(config: CurvesConfig, env: str) -> ExperimentConfig:
    """The packaged experiment of an id, in the id as it is shipped, many environments at once.

    Raises
    ------
    ConfigError
        A change is refused.
    """
    name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in env).lstrip("_")
    packaged = load_experiment(f"{name}_ppo_lagrangian")
    decisions, shown, settings = PACE[env]
    rollout = COUNT * settings["n_steps"]
    each = rollout * max(round(config.minutes * decisions / config.checkpoints / rollout), 1)
    own = make_config(full_id(env))
    shipped: dict[str, Any] = {
        "sky": own.sky,
        "overrides": {"perception": {"source": own.perception.source}},
        "count": COUNT,
        "checkpoint_steps": each,
        "steps": config.checkpoints * each,
        "settings": settings,
        "imitation": {"rounds": 4, "decisions": shown, "epochs": 10},
    }
    return packaged.replace(**deep_merge(shipped, config.experiment))


def run_curves(config: CurvesConfig, out: Path, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Train and judge in the ids that are missing, one after another on one thread; returns the data of results.json.

    Parameters
    ----------
    on_progress : called with the number of ids

    Raises
    ------
    InputError
        ``out`` cannot be claimed, or an experiment is refused.
    """
    for env in config.envs:
        experiment_of(config, env)
    claim(out, "learning curves", config, PACKAGES, "ids", config.envs)
    parts = run_parts(out, list(config.envs), partial(_learn, config, out), 1, on_progress)
    return stored({"config": config.to_dict(), "ids": parts}, out)


def _learn(config: CurvesConfig, out: Path, env: str, advance: Advance) -> dict[str, Any]:
    """Carry out or resume a training, judge its checkpoints and others, and return all episodes and times."""
    planned, folder = experiment_of(config, env), out / "judged" / env
    make_folder(folder)
    spent = time.process_time()

    def judge(experiment: ExperimentConfig, model: Any) -> dict[str, float]:
        nonlocal spent
        learning_s, begun = time.process_time() - spent, time.process_time()
        rows = drive_all(experiment, model, config.held_out(config.seeds))
        write_json(folder / f"{model.num_timesteps}.json", rows)
        means = {key: float(np.mean([row[key] for row in rows])) for key in SHOWN}
        spent = time.process_time()
        return {**means, "learning_s": learning_s, "judging_s": spent - begun}

    with one_thread():
        shown = planned.imitation.total(COUNT) if planned.imitation is not None else 1
        checkpoints = train(
            planned, out / "trainings" / env, judge=judge,
            imitated=lambda decisions: advance(0.1 * decisions / shown),
            stepped=lambda steps: advance(0.1 + 0.7 * steps / planned.steps),
        )  # fmt: skip
        model = load_model(out / "trainings" / env / "last.zip", planned.algorithm)
        rest = config.held_out(config.final_seeds)
        with closing(planned.open()) as single:
            drivers: dict[str, Any] = {
                LEARNT: model,
                **{
                    name: make_agent(name, single)
                    for name in COMPARED
                    if name != "ppo" or single.config.base in policies()
                },
            }
        final = {}
        for n, (name, driver) in enumerate(drivers.items()):
            final[name] = _kept(folder / f"{name}.json", partial(drive_all, planned, driver, rest))
            advance(0.8 + 0.2 * (n + 1) / len(drivers))
    steps = [row["steps"] for row in checkpoints]
    judged = [read_json(folder / f"{step}.json", list) for step in steps]
    return {
        "env": env, "sky": planned.sky, "limit": planned.limit(), "experiment": planned.to_dict(),
        "checkpoints": [row | {"episodes": rows} for row, rows in zip(checkpoints, judged, strict=True)],
        "final": final,
    }  # fmt: skip


def _kept(path: Path, make: Callable[[], Any]) -> Any:
    """The data of a file, which is made where it is missing."""
    if not path.exists():
        write_json(path, make())
    return read_json(path, list)


def _estimate(episodes: Sequence[Mapping[str, float]], key: str) -> Estimate:
    """Mean of a metric over episodes, with its 95 % interval."""
    metric = metric_named(key)
    return estimate(np.array([row[key] for row in episodes], dtype=np.float64), metric.rate, metric.bounds)


def tables(found: Mapping[str, Any]) -> dict[str, Table]:
    """Tables of the results: final values of each driver, return and cost at each checkpoint, and the budget."""
    return dict(zip(SECTIONS, (_final(found), _course(found), _budget(found)), strict=True))


def _final(found: Mapping[str, Any]) -> Table:
    rows = [
        (part["env"], f"{part['limit']:g}", f"`{name}`", *(_shown(_estimate(episodes, key), key) for key in SHOWN))
        for part in found["ids"].values()
        for name, episodes in part["final"].items()
    ]
    return ("id", "limit", "driver", *(key.replace("_", " ") for key in SHOWN)), rows


def _course(found: Mapping[str, Any]) -> Table:
    """Return and cost at each checkpoint."""
    rows = [
        (part["env"], *(f"{row['return']:.3g} at {row['cost']:.3g}" for row in part["checkpoints"]))
        for part in found["ids"].values()
    ]
    most = max((len(part["checkpoints"]) for part in found["ids"].values()), default=1)
    return ("id", "imitation", *(f"{n} of {most - 1}" for n in range(1, most))), rows


def _budget(found: Mapping[str, Any]) -> Table:
    rows = []
    for part in found["ids"].values():
        first, *later = part["checkpoints"]
        seconds = sum(row["learning_s"] for row in later)
        imitated = part["experiment"]["imitation"]
        shown = 0 if imitated is None else imitated["rounds"] * imitated["decisions"]
        judging = sum(row["judging_s"] for row in part["checkpoints"])
        rows.append(
            (part["env"], part["sky"], f"{shown:,}", f"{first['learning_s'] / 60.0:.1f}", f"{later[-1]['steps']:,}",
             f"{seconds / 60.0:.1f}", f"{later[-1]['steps'] / seconds:,.0f}", f"{judging / 60.0:.1f}")
        )  # fmt: skip
    heads = ("id", "sky", "decisions of imitation", "min", "decisions of learning", "min", "a second", "judging, min")
    return heads, rows


def save_curves(found: Mapping[str, Any], folder: Path) -> Path:
    """Write the picture into a folder."""
    from lanebound.integrity.assessment.plotting import save

    return save(curves_figure(found), folder / FIGURE)


def _shown(value: Estimate, key: str) -> str:
    """A mean; of return and cost with its interval."""
    shown = key in ("return", "cost") and value.low is not None
    ends = f" [{value.low:.3g}, {value.high:.3g}]" if shown else ""
    return f"{value.mean:.3g}{ends}"


def curves_figure(found: Mapping[str, Any]) -> Figure:
    """A row of axes for each id: the learnt policy at its checkpoints with intervals, others as lines."""
    from lanebound.integrity.assessment.plotting import INK, new_figure, tidy

    parts = list(found["ids"].values())
    figure = new_figure(3.0 * len(CURVES), 1.9 * len(parts) + 0.5)
    axes = figure.subplots(len(parts), len(CURVES), squeeze=False)
    for row, part in zip(axes, parts, strict=True):
        steps = [point["steps"] / 1000.0 for point in part["checkpoints"]]
        for axis, (key, title) in zip(row, CURVES, strict=True):
            points = [_estimate(point["episodes"], key) for point in part["checkpoints"]]
            means = [point.mean for point in points]
            low = [point.mean if point.low is None else point.low for point in points]
            high = [point.mean if point.high is None else point.high for point in points]
            axis.fill_between(steps, low, high, color=OWN, alpha=0.15, linewidth=0)
            axis.plot(steps, means, color=OWN, marker="o", markersize=3, linewidth=1.4, label=LEARNT)
            for name, colour in COMPARED.items():
                if name in part["final"]:  # ids without a shipped policy have no ppo
                    level = _estimate(part["final"][name], key).mean
                    axis.axhline(level, color=colour, linewidth=1.2, linestyle="--", label=name)
            if key == "cost":
                axis.axhline(part["limit"], color=INK, linewidth=1.0, linestyle=":", label="limit")
                axis.set_yscale("symlog", linthresh=max(part["limit"], 1.0))
                axis.set_ylim(bottom=0.0)
            tidy(axis, title=title if part is parts[0] else "", ylabel=part["env"] if key == "return" else "",
                 xlabel="thousand decisions" if part is parts[-1] else "")  # fmt: skip
            if key in ("over_cost_limit", "success"):
                axis.set_ylim(-0.05, 1.05)
    handles, labels = max((row[1].get_legend_handles_labels() for row in axes), key=lambda shown: len(shown[1]))
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure
