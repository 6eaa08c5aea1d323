"""Training that goes on where it stopped: chunks between checkpoints, each kept whole or not at all.

::

    experiment.json                what is learnt
    last.zip  last-replay.pkl      the newest checkpoint; transitions of algorithms that keep them
    best.zip  best.md              the best so far (:func:`is_best`), and a card about it; before any learning by reward
                                   perhaps, where the policy began from a driver (:mod:`.imitation`)
    progress.json                  an evaluation at each checkpoint
    imitation.pt                   until that is over, what it has come to
    logs/                          for TensorBoard, where it is installed: costs by cause, levels, alerts, modes
"""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.kept import replace_file, require_own, write_whole
from lanebound.agents.learning.card import write_card
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig
from lanebound.agents.learning.imitation import Teacher, imitate, teacher_of
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.plain import finite_or_none
from lanebound.envs.costs import CAUSES
from lanebound.envs.tally import EPISODE_KEY
from lanebound.integrity.accel import serial
from lanebound.integrity.errors import InputError
from lanebound.integrity.presets import nearest

__all__ = ["Checkpoint", "is_best", "load_model", "one_thread", "train"]

CLASSES = {
    Algorithm.PPO: "stable_baselines3:PPO",
    Algorithm.SAC: "stable_baselines3:SAC",
    Algorithm.RECURRENT_PPO: "sb3_contrib:RecurrentPPO",
    Algorithm.PPO_LAGRANGIAN: "lanebound.agents.learning.ppo_lagrangian:PPOLagrangian",
    Algorithm.SAC_LAGRANGIAN: "lanebound.agents.learning.sac_lagrangian:SACLagrangian",
}
LAST, REPLAY, IMITATION = "last.zip", "last-replay.pkl", "imitation.pt"
INTEGRITY = ("availability", "alert_share", "alerts", "mi_steps", "hmi_steps", "pl_at_mean_m", "pl_ct_mean_m")


@dataclass(frozen=True)
class Checkpoint:
    """How far training is, and what the policy of then came to.

    Attributes
    ----------
    steps : decisions so far; of : planned
    evaluation : means over episodes on seeds kept for it
    best : whether it is the best so far
    """

    steps: int
    of: int
    evaluation: Mapping[str, float]
    best: bool


def train(
    experiment: ExperimentConfig,
    out: Path,
    processes: int = 1,
    told: Callable[[Checkpoint], None] = lambda checkpoint: None,
    stepped: Callable[[int], None] = lambda steps: None,
    imitated: Callable[[int], None] = lambda decisions: None,
) -> list[dict[str, Any]]:
    """Carry out an experiment, or what is left of it in ``out``; returns the evaluations.

    Parameters
    ----------
    processes : of single environments, spawned; with 1, or in the vector engine, they run in this one
    told : called after each checkpoint
    stepped, imitated : called with the decisions so far at every step, of learning by reward and of imitation before it

    Raises
    ------
    InputError
        ``out`` holds another experiment, or the environment does not suit the algorithm.
    """
    _require_known(experiment)
    teacher = teacher_of(experiment)
    progress = _claim(experiment, out)
    with closing(for_learning(experiment, processes)) as env, one_thread():
        model = _model(experiment, env, out)
        begun = (out / LAST).exists()
        if teacher is not None and not begun:
            with _shown(teacher, env, experiment, processes) as shown:
                imitate(teacher, model, shown, imitated, out / IMITATION)
            begun = True
        if begun and all(row["steps"] != model.num_timesteps for row in progress):
            told(_checkpoint(experiment, model, out, progress))  # or it was kept when the last run was stopped
        env.seed(episode_seeds(experiment, model.num_timesteps))  # stable-baselines3 has seeded it otherwise
        watch = _Watch(stepped)
        while model.num_timesteps < experiment.steps:
            chunk = min(experiment.checkpoint_steps, experiment.steps - model.num_timesteps)
            model.learn(chunk, callback=watch, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="run")
            told(_checkpoint(experiment, model, out, progress))
    return progress


def _shown(
    teacher: Teacher, env: VecEnv, experiment: ExperimentConfig, processes: int
) -> AbstractContextManager[VecEnv]:
    """Environments that show what the teacher needs: those of the experiment, or others while it teaches."""
    if teacher.experiment == experiment:
        return nullcontext(env)
    return closing(for_learning(teacher.experiment, processes))


@contextmanager
def one_thread() -> Iterator[None]:
    """Within it networks and the engine compute on one thread: both are so small that threads wait more than they do.

    Two trainings side by side are slowed fifteenfold by each other's threads.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with serial():
            yield
    finally:
        torch.set_num_threads(before)


def load_model(path: Path, algorithm: Algorithm, env: VecEnv | None = None) -> BaseAlgorithm:
    """A checkpoint, on the processor.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        found: BaseAlgorithm = _class(algorithm).load(path, env=env, device="cpu")
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"checkpoint must be one of {algorithm}, got {path} ({error}): train it anew") from None
    return found


def _class(algorithm: Algorithm) -> Any:
    module, _, name = CLASSES[algorithm].partition(":")
    try:
        return getattr(import_module(module), name)
    except ImportError:
        raise InputError(
            f"algorithm {algorithm} needs the package {module}, got none: pip install 'lanebound[learning]'"
        ) from None


def _model(experiment: ExperimentConfig, env: VecEnv, out: Path) -> BaseAlgorithm:
    logs = str(out / "logs") if find_spec("tensorboard") else None
    if (out / LAST).exists():
        model = load_model(out / LAST, experiment.algorithm, env)
        model.tensorboard_log = logs
        if (out / REPLAY).exists():
            model.load_replay_buffer(out / REPLAY)  # type: ignore[attr-defined]
        return model
    settings: dict[str, Any] = {"seed": experiment.seed, "device": "cpu", "tensorboard_log": logs}
    if experiment.algorithm.constrained:
        settings |= {"cost_limit": experiment.limit(), "multiplier": experiment.multiplier}
    policy = "MlpLstmPolicy" if experiment.algorithm is Algorithm.RECURRENT_PPO else "MlpPolicy"
    try:
        made: BaseAlgorithm = _class(experiment.algorithm)(policy, env, **{**settings, **experiment.settings})
    except (TypeError, AssertionError) as error:
        raise InputError(
            f"settings must suit {experiment.algorithm} and {experiment.env}, got {dict(experiment.settings)} "
            f"({error}): see stable-baselines3"
        ) from None
    return made


def _require_known(experiment: ExperimentConfig) -> None:
    """Raise InputError for a setting that the algorithm, and what it is built on, does not take."""
    built_on = _class(experiment.algorithm).__mro__
    taken = (p for one in built_on for p in inspect.signature(one.__init__).parameters.values())
    known = {p.name for p in taken if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)} - {"self"}
    for name in experiment.settings:
        if name not in known:
            raise InputError(
                f"settings.{name} must be one that {experiment.algorithm} takes, got one it does not: "
                f"{nearest(name, known)}"
            )


def _claim(experiment: ExperimentConfig, out: Path) -> list[dict[str, Any]]:
    """Mark a folder with an experiment, or go on with it; the evaluations so far.

    More steps may be asked for; everything else must be as it was.
    """
    mark, progress, wanted = out / "experiment.json", out / "progress.json", experiment.to_dict()
    require_own(mark)
    try:
        found = json.loads(mark.read_text(encoding="utf-8")) if mark.exists() else wanted
        changed = sorted(key for key in wanted | found if key != "steps" and wanted.get(key) != found.get(key))
        if not changed:
            write_whole(mark, wanted)
        kept = (out / LAST).exists() and progress.exists()
        rows: list[dict[str, Any]] = json.loads(progress.read_text(encoding="utf-8")) if kept else []
    except (OSError, ValueError) as error:
        raise InputError(f"out must be a folder that can be written, got {out} ({error}): choose another") from error
    if changed:
        raise InputError(
            f"out must be empty or hold the same experiment, got {out}, which differs in {', '.join(changed)}: "
            "choose a new folder"
        )
    return rows


def _checkpoint(
    experiment: ExperimentConfig, model: BaseAlgorithm, out: Path, progress: list[dict[str, Any]]
) -> Checkpoint:
    """Judge the policy as it is now and keep it; ``progress`` grows by its evaluation."""
    found = evaluate(experiment, model)
    progress.append({"steps": model.num_timesteps, **found})
    best = is_best(progress, _limit_of_best(experiment))
    _keep(model, out, best)
    if best:
        write_card(experiment, progress[-1], out / "best.md")
    write_whole(out / "progress.json", finite_or_none(progress))
    return Checkpoint(model.num_timesteps, experiment.steps, found, best)


def _keep(model: BaseAlgorithm, out: Path, best: bool) -> None:
    """Save a checkpoint; the one before stays until the new one is whole."""
    if getattr(model, "replay_buffer", None) is not None:
        with replace_file(out / REPLAY) as draft:
            model.save_replay_buffer(draft)  # type: ignore[attr-defined]
    for path in (out / LAST, out / "best.zip") if best else (out / LAST,):
        with replace_file(path) as draft:
            model.save(draft)
    (out / IMITATION).unlink(missing_ok=True)


def _limit_of_best(experiment: ExperimentConfig) -> float:
    """What the best checkpoint must keep: the limit where learning heeds one or one is named, else nothing."""
    heeded = experiment.algorithm.constrained or experiment.cost_limit is not None
    return experiment.limit() if heeded else math.inf


def is_best(progress: list[dict[str, Any]], limit: float) -> bool:
    """Whether the last evaluation is: the largest return among those within the limit of cost, else the least cost.

    Within it is who keeps it with the cost's standard error to spare: the best of many checkpoints is the luckiest too,
    and costs more on other seeds than in its own evaluation.
    """

    def worth(row: Mapping[str, float]) -> tuple[float, float]:
        high = row["cost"] + row.get("cost_se", 0.0)  # older evaluations have none
        return (1.0, row["return"]) if high <= limit else (0.0, -high)

    return all(worth(progress[-1]) >= worth(row) for row in progress[:-1])


class _Watch(BaseCallback):
    """Tells how far training is, and logs of finished episodes what they cost by cause, and how far to be trusted."""

    def __init__(self, stepped: Callable[[int], None]) -> None:
        super().__init__()
        self._told = stepped

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if EPISODE_KEY in info:
                for name, value in _logged(info[EPISODE_KEY]):
                    self.logger.record_mean(name, value)
        self._told(self.num_timesteps)
        return True


def _logged(episode: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """What is logged of an episode's statistics: names and values, without levels that are infinite."""
    for cause in CAUSES:
        yield f"cost/{cause.removeprefix('cost_')}", episode[cause]
    for name in INTEGRITY:
        if math.isfinite(episode[name]):
            yield f"integrity/{name}", episode[name]
    for mode, share in episode["mode_shares"].items():
        yield f"integrity/share_{mode}", share
