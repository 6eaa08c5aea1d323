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

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.kept import make_folder, read_kept, replace_file, require_own, write_whole
from lanebound.agents.learning.algorithms import class_of, make_model, require_known
from lanebound.agents.learning.card import write_card
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig
from lanebound.agents.learning.imitation import Teacher, imitate, teacher_of
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.plain import finite_or_none
from lanebound.envs.costs import CAUSES
from lanebound.envs.tally import EPISODE_KEY
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError

__all__ = ["Checkpoint", "is_best", "load_model", "one_thread", "train"]

MARK, PROGRESS, BEST, CARD = "experiment.json", "progress.json", "best.zip", "best.md"
LAST, REPLAY, IMITATION = "last.zip", "last-replay.pkl", "imitation.pt"
NOT_FINITE = ("Expected parameter", "without overflow")
"""What torch says of distributions whose parameters are none, as NaN, and of steps that no float holds."""
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
        ``out`` holds another experiment or damaged files, the environment does not suit the algorithm, or learning
        diverged.
    """
    require_known(experiment)
    teacher = teacher_of(experiment)
    progress = _claim(experiment, out)
    with closing(for_learning(experiment, processes)) as env, one_thread():
        model = _model(experiment, env, out)
        write_whole(out / MARK, experiment.to_dict())  # no sooner: what is refused marks no folder
        begun = (out / LAST).exists()
        if teacher is not None and not begun:
            rate = "imitation.learning_rate"
            with _shown(teacher, env, experiment, processes) as shown, _converging(model, out, rate):
                imitate(teacher, model, shown, imitated, out / IMITATION)
            begun = True
        if begun and all(row["steps"] != model.num_timesteps for row in progress):
            told(_checkpoint(experiment, model, out, progress))  # or it was kept when the last run was stopped
        if model.num_timesteps:  # a loaded model is seeded as at its beginning: it would try the same noise again
            set_random_seed(episode_seeds(experiment, model.num_timesteps, "learning"))
        env.seed(episode_seeds(experiment, model.num_timesteps))  # stable-baselines3 has seeded it otherwise
        watch = _Watch(stepped)
        while model.num_timesteps < experiment.steps:
            chunk = min(experiment.checkpoint_steps, experiment.steps - model.num_timesteps)
            with _converging(model, out, "settings.learning_rate"):
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
def _converging(model: BaseAlgorithm, out: Path, rate: str) -> Iterator[None]:
    """Within it what is learnt must stay finite, or InputError says so, names the ``rate`` and what is kept."""
    try:
        yield
        lost = not _is_finite(model)
    except (ValueError, RuntimeError) as error:
        lost = not _is_finite(model) or any(sign in str(error) for sign in NOT_FINITE)
        if not lost:
            raise
    if lost:
        kept = f"the checkpoints before are kept in {out}" if (out / LAST).exists() else "nothing is kept"
        raise InputError(
            f"learning diverged at step {model.num_timesteps}: lower {rate} and choose a new folder ({kept})"
        )


def _is_finite(model: BaseAlgorithm) -> bool:
    """Whether every parameter of every network is."""
    modules = (value for value in vars(model).values() if isinstance(value, torch.nn.Module))
    return all(bool(torch.isfinite(p).all()) for module in modules for p in module.parameters())


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


def load_model(path: Path, algorithm: Algorithm, env: VecEnv | None = None, device: str = "cpu") -> BaseAlgorithm:
    """A checkpoint, on the processor if nothing else is wanted.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        found: BaseAlgorithm = class_of(algorithm).load(path, env=env, device=device)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"checkpoint must be one of {algorithm}, got {path} ({error}): train it anew") from None
    return found


def _model(experiment: ExperimentConfig, env: VecEnv, out: Path) -> BaseAlgorithm:
    logs = str(out / "logs") if find_spec("tensorboard") else None
    if (out / LAST).exists():
        model = load_model(out / LAST, experiment.algorithm, env, experiment.settings.get("device", "cpu"))
        model.tensorboard_log = logs
        if (out / REPLAY).exists():
            _recall(model, out / REPLAY)
        return model
    return make_model(experiment, env, logs)


def _recall(model: Any, path: Path) -> None:
    """Give a model back the transitions that it had."""
    try:
        with path.open("rb") as stream:
            model.load_replay_buffer(stream)
    except (OSError, ValueError, LookupError, AttributeError, EOFError, UnpicklingError) as error:
        raise InputError(f"transitions must be as training keeps them, got {path} ({error}): learn anew") from None


def _claim(experiment: ExperimentConfig, out: Path) -> list[dict[str, Any]]:
    """A folder for an experiment, new or to go on with; the evaluations so far.

    More steps may be asked for; everything else must be as it was.
    """
    mark, progress, wanted = out / MARK, out / PROGRESS, experiment.to_dict()
    require_own(mark)
    make_folder(out)
    try:
        found = read_kept(mark, dict) if mark.exists() else wanted
        changed = sorted(key for key in wanted | found if key != "steps" and wanted.get(key) != found.get(key))
        lacking = [name for name in (MARK, LAST) if not (out / name).exists()]
        there = [name for name in (LAST, BEST, CARD, PROGRESS) if (out / name).exists()]
        rows: list[dict[str, Any]] = read_kept(progress, list) if progress.exists() and not lacking else []
    except OSError as error:
        raise InputError(f"out must be a folder that can be read, got {out} ({error}): choose another") from error
    if lacking and there:
        raise InputError(
            f"out must be empty or hold a whole training, got {out} with {', '.join(there)} "
            f"but without {' and '.join(lacking)}: choose a new folder"
        )
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
        write_card(experiment, progress[-1], out / CARD)
    write_whole(out / PROGRESS, finite_or_none(progress))
    return Checkpoint(model.num_timesteps, experiment.steps, found, best)


def _keep(model: BaseAlgorithm, out: Path, best: bool) -> None:
    """Save a checkpoint; the one before stays until the new one is whole."""
    if getattr(model, "replay_buffer", None) is not None:
        with replace_file(out / REPLAY) as draft:
            model.save_replay_buffer(draft)  # type: ignore[attr-defined]
    for path in (out / LAST, out / BEST) if best else (out / LAST,):
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
