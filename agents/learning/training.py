"""Resumable training: it is saved at checkpoints, and an interrupted training continues from the last one.

::

    run.json                       the experiment
    last.zip  last-replay.pkl      the newest checkpoint; transitions of off-policy algorithms
    best.zip  best.md              the best checkpoint so far (:func:`is_best`) and a card that describes it
    progress.json                  an evaluation at each checkpoint
    imitation.pt                   state of the imitation (:mod:`.imitation`), until it is finished
    logs/                          TensorBoard logs, where it is installed: costs by cause, levels, alerts, modes
"""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.checkpointing.files import make_folder, read_json, replace_file, write_json
from lanebound.agents.checkpointing.folder import ResultFolder, locked
from lanebound.agents.drivers.origin import EXPERIMENT, add_text, name_inputs
from lanebound.agents.learning.algorithms import class_of, make_model, require_known
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig, Others
from lanebound.agents.learning.imitation import Teacher, imitate, teacher_of
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.learning.others import choose_others
from lanebound.envs.costs import CAUSES
from lanebound.envs.episode_totals import EPISODE_KEY
from lanebound.integrity.core.accel import LOGGER, serial
from lanebound.integrity.core.errors import InputError

__all__ = ["Checkpoint", "is_best", "load_model", "one_thread", "train", "write_card"]

PACKAGES = ("lanebound", "stable-baselines3", "torch", "highway-env", "numpy")


def write_card(experiment: ExperimentConfig, row: Mapping[str, Any], path: Path) -> None:
    """Write the card of the checkpoint whose evaluation is ``row``."""
    c = experiment
    figures = [f"| {name} | {value if isinstance(value, int) else f'{value:.3g}'} |" for name, value in row.items()]
    lines = [
        f"# {c.algorithm} in {c.env}, {c.sky} sky",
        "",
        c.title or "A policy of lanebound.",
        "",
        f"Learnt with seed {c.seed} in {row['steps']} decisions, {c.count} environments at once, shield {c.shield}"
        + (
            "." if c.imitation is None else f", after imitating `{c.imitation.driver}` in {c.imitation.total(c.count)}."
        ),
        f"It takes flat observations of `lanebound/{c.env}` and was learnt by this experiment:",
        "",
        "```json",
        c.to_json(),
        "```",
        "",
        *_of_others(c),
        f"Means of {c.evaluation_episodes} episodes on the last training seeds, without exploration. The checkpoint",
        "was chosen by these, so they flatter it: `lanebound evaluate` takes seeds that nothing was chosen by.",
        "",
        "| | |",
        "|---|---|",
        *figures,
        "",
        f"Made with Python {platform.python_version()}, "
        + ", ".join(f"{name} {version(name)}" for name in PACKAGES)
        + ".",
        "",
        "A policy of a simulated car, for research; it has never driven a real one and must not.",
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


def _of_others(experiment: ExperimentConfig) -> list[str]:
    """Lines of a card on what the others broadcast; none where they broadcast nothing."""
    learnt, judged = experiment.others, experiment.own_others or Others.FULL
    return (
        [] if learnt is None else [f"Other vehicles (`perception.others`): {learnt} in training, {judged} below.", ""]
    )


PROGRESS, BEST, CARD = "progress.json", "best.zip", "best.md"
LAST, REPLAY, IMITATION = "last.zip", "last-replay.pkl", "imitation.pt"
POLICY_LEARNS = "policy_learns"  # attribute of models that have imitated
NOT_FINITE = ("Expected parameter", "without overflow")
"""Parts of torch's messages about distributions with NaN parameters, and about overflow."""
Judge = Callable[[ExperimentConfig, BaseAlgorithm], dict[str, float]]
INTEGRITY = ("availability", "alert_share", "alerts", "mi_steps", "hmi_steps", "pl_at_mean_m", "pl_ct_mean_m")


@dataclass(frozen=True)
class Checkpoint:
    """The progress of a training, and the evaluation of its policy.

    Attributes
    ----------
    steps : decisions so far; of : planned
    evaluation : means over episodes on seeds reserved for it
    best : whether it is the best so far
    """

    steps: int
    of: int
    evaluation: Mapping[str, float]
    best: bool


def train(
    experiment: ExperimentConfig,
    out: Path,
    processes: int | None = 1,
    on_checkpoint: Callable[[Checkpoint], None] = lambda checkpoint: None,
    stepped: Callable[[int], None] = lambda steps: None,
    imitated: Callable[[int], None] = lambda decisions: None,
    judge: Judge | None = None,
) -> list[dict[str, Any]]:
    """Carry out an experiment, or resume it in ``out``; returns the evaluations.

    Other vehicles broadcast in training as :func:`.choose_others` decides, which the manifest, the card and the
    checkpoints hold as ``others``; evaluations are in the configuration of the experiment.

    Parameters
    ----------
    processes : over which the environments are divided; with 1 they run in this one. None: as :func:`.for_learning`
    on_checkpoint : called after each checkpoint
    stepped, imitated : called with the number of decisions at every step, of learning by reward and of imitation
    judge : evaluates the policy of a checkpoint in place of :func:`.evaluate`; none is chosen as the best then

    Raises
    ------
    InputError
        ``out`` holds another experiment or damaged files, the environment does not suit the algorithm, or learning
        diverged.
    """
    require_known(experiment)
    experiment = choose_others(experiment).experiment
    teacher = teacher_of(experiment)
    progress = _progress(experiment, out)
    make_folder(out)
    with locked(out), one_thread(), closing(for_learning(experiment, processes)) as env:
        model = _model(experiment, env, out)
        _folder(experiment, out).claim()  # not earlier: a refused setting must leave no manifest
        begun = (out / LAST).exists()
        if teacher is not None and not begun:
            rate = "imitation.learning_rate"
            with _shown(teacher, env, experiment, processes) as shown, _converging(model, out, rate):
                imitate(teacher, model, shown, imitated, out / IMITATION)
            begun = True
        if begun and all(row["steps"] != model.num_timesteps for row in progress):
            on_checkpoint(
                _checkpoint(experiment, model, out, progress, judge)
            )  # an interrupted run may have it already
        if model.num_timesteps:  # a loaded model has its first seed: it would repeat the same noise
            set_random_seed(episode_seeds(experiment, model.num_timesteps, "learning"))
        env.seed(episode_seeds(experiment, model.num_timesteps))  # stable-baselines3 has seeded it otherwise
        watch: list[BaseCallback] = [_Watch(stepped)]
        waits = experiment.imitation is not None and experiment.imitation.critics_first
        if waits and not getattr(model, POLICY_LEARNS, False):
            watch.append(_CriticsFirst())
        learns = model.num_timesteps < experiment.steps
        while model.num_timesteps < experiment.steps:
            chunk = min(experiment.checkpoint_steps, experiment.steps - model.num_timesteps)
            with _converging(model, out, "settings.learning_rate"):
                model.learn(chunk, callback=watch, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="run")
            on_checkpoint(_checkpoint(experiment, model, out, progress, judge))
    if learns and waits and not getattr(model, POLICY_LEARNS, False):
        LOGGER.warning(
            "lanebound: the policy is still that of the imitation, as not every environment has ended an episode: "
            "raise steps, or set imitation.critics_first=false."
        )
    return progress


def _shown(
    teacher: Teacher, env: VecEnv, experiment: ExperimentConfig, processes: int | None
) -> AbstractContextManager[VecEnv]:
    """Environments with the observations of the teacher: those of the experiment, or others during imitation."""
    if teacher.experiment == experiment:
        return nullcontext(env)
    return closing(for_learning(teacher.experiment, processes))


@contextmanager
def _converging(model: BaseAlgorithm, out: Path, rate: str) -> Iterator[None]:
    """In this context parameters must stay finite; else InputError names the ``rate`` and the kept checkpoints."""
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
    """Whether all parameters of all networks are finite."""
    modules = (value for value in vars(model).values() if isinstance(value, torch.nn.Module))
    return all(bool(torch.isfinite(p).all()) for module in modules for p in module.parameters())


@contextmanager
def one_thread() -> Iterator[None]:
    """In this context networks and the engine compute on one thread: they are so small that threads mostly wait.

    With more threads two trainings side by side slow each other down fifteenfold.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with serial():
            yield
    finally:
        torch.set_num_threads(before)


def load_model(path: Path, algorithm: Algorithm, env: VecEnv | None = None, device: str = "cpu") -> BaseAlgorithm:
    """Load a checkpoint, by default on the processor.

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
        if hasattr(model, "multiplier"):  # the one multiplier of older versions, which learning would begin anew
            raise InputError(f"out must hold a training of this version, got an older one in {out}: learn anew")
        model.tensorboard_log = logs
        if (out / REPLAY).exists():
            _recall(model, out / REPLAY)
        return model
    return make_model(experiment, env, logs)


def _recall(model: Any, path: Path) -> None:
    """Restore the transitions of a model."""
    try:
        with path.open("rb") as stream:
            model.load_replay_buffer(stream)
    except (OSError, ValueError, LookupError, AttributeError, EOFError, UnpicklingError) as error:
        raise InputError(f"transitions must be as training keeps them, got {path} ({error}): learn anew") from None


def _folder(experiment: ExperimentConfig, out: Path) -> ResultFolder:
    """The folder of an experiment; its steps may be raised."""
    config = experiment.to_dict()
    return ResultFolder(out, "training", config, fixed={key: config[key] for key in config if key != "steps"})


def _progress(experiment: ExperimentConfig, out: Path) -> list[dict[str, Any]]:
    """Evaluations of the checkpoints in a folder that can be claimed; none in a new one."""
    _folder(experiment, out).check()
    progress, last = out / PROGRESS, out / LAST
    if not last.exists():
        there = [name for name in (BEST, CARD, PROGRESS) if (out / name).exists()]
        if there:
            raise InputError(
                f"out must be empty or hold a complete training, got {out} with {', '.join(there)} but without {LAST}: "
                "choose a new folder"
            )
        return []
    try:
        return read_json(progress, list) if progress.exists() else []
    except OSError as error:
        raise InputError(f"out must be a folder that can be read, got {out} ({error}): choose another") from error


def _checkpoint(
    experiment: ExperimentConfig, model: BaseAlgorithm, out: Path, progress: list[dict[str, Any]], judge: Judge | None
) -> Checkpoint:
    """Evaluate the present policy and store it; ``progress`` grows by its evaluation."""
    found = evaluate(experiment, model) if judge is None else judge(experiment, model)
    progress.append({"steps": model.num_timesteps, **found})
    best = judge is None and is_best(progress, _limits_of_best(experiment))
    _keep(experiment, model, out, best)
    if best:
        write_card(experiment, progress[-1], out / CARD)
    write_json(out / PROGRESS, progress)
    return Checkpoint(model.num_timesteps, experiment.steps, found, best)


def _keep(experiment: ExperimentConfig, model: BaseAlgorithm, out: Path, best: bool) -> None:
    """Save a checkpoint; the previous one stays until the new one is complete."""
    if getattr(model, "replay_buffer", None) is not None:
        with replace_file(out / REPLAY) as draft:
            model.save_replay_buffer(draft)  # type: ignore[attr-defined]
    with closing(experiment.open()) as single:
        observation = single.config.observation
    for path in (out / LAST, out / BEST) if best else (out / LAST,):
        with replace_file(path) as draft:
            model.save(draft)
            add_text(draft, EXPERIMENT, experiment.to_json())
            name_inputs(draft, observation, experiment.env)
    (out / IMITATION).unlink(missing_ok=True)


def _limits_of_best(experiment: ExperimentConfig) -> dict[str, float]:
    """The limits of the best checkpoint: those of a constrained algorithm, else that of the experiment, else none."""
    if experiment.algorithm.constrained:
        return experiment.limits()
    return {} if experiment.cost_limit is None else {"cost": experiment.cost_limit}


def is_best(progress: list[dict[str, Any]], limits: Mapping[str, float]) -> bool:
    """Whether the last evaluation is the best: the largest return within all limits, else the least excess.

    Within a limit is a checkpoint whose cost plus its standard error is at most the limit: the best of many checkpoints
    is also the luckiest, and its cost is higher on other seeds than in its own evaluation. The excess is that of the
    cost that exceeds its limit by the largest factor.

    Parameters
    ----------
    limits : positive, by the names of costs in the evaluations
    """

    def worth(row: Mapping[str, float]) -> tuple[float, float]:
        # older evaluations have no standard error
        shares = [(row[name] + row.get(f"{name}_se", 0.0)) / limit for name, limit in limits.items()]
        worst = max(shares, default=0.0)
        return (1.0, row["return"]) if worst <= 1.0 else (0.0, -worst)

    return all(worth(progress[-1]) >= worth(row) for row in progress[:-1])


class _Watch(BaseCallback):
    """Reports the progress of a training, and logs costs by cause and integrity figures of finished episodes."""

    def __init__(self, stepped: Callable[[int], None]) -> None:
        super().__init__()
        self._stepped = stepped

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if EPISODE_KEY in info:
                for name, value in _logged(info[EPISODE_KEY]):
                    self.logger.record_mean(name, value)
        self._stepped(self.num_timesteps)
        return True


class _CriticsFirst(BaseCallback):
    """Keeps the actor as it is, while critics learn, until each environment has ended an episode.

    A checkpoint holds whether they have; a training that is resumed before begins to wait anew.
    """

    def __init__(self) -> None:
        super().__init__()
        self._ended: NDArray[np.bool_] | None = None

    def _on_step(self) -> bool:
        dones = np.asarray(self.locals["dones"], dtype=np.bool_)
        self._ended = dones if self._ended is None else self._ended | dones
        return True

    def _on_rollout_end(self) -> None:
        policy: Any = self.model.policy
        learns = self._ended is not None and bool(self._ended.all())
        setattr(self.model, POLICY_LEARNS, learns)
        for module in (policy.mlp_extractor.policy_net, policy.action_net):
            module.requires_grad_(learns)
        if hasattr(policy, "log_std"):
            policy.log_std.requires_grad_(learns)


def _logged(episode: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Names and values of an episode's statistics for the log, without infinite levels."""
    for cause in CAUSES:
        yield f"cost/{cause.removeprefix('cost_')}", episode[cause]
    for name in INTEGRITY:
        if math.isfinite(episode[name]):
            yield f"integrity/{name}", episode[name]
    for mode, share in episode["mode_shares"].items():
        yield f"integrity/share_{mode}", share
