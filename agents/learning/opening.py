"""The environments of an experiment: the vector engine where possible, else single environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import current_process
from typing import Any

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.checkpointing.runner import available_cores
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.experiment import ExperimentConfig, Shield
from lanebound.agents.learning.others import choose_others
from lanebound.agents.learning.shield import VecShielded
from lanebound.agents.plugins import load_plugins, loaded_plugins
from lanebound.agents.safety_layer import VecSafetyLayer
from lanebound.agents.vec_env import EngineVecEnv, engine_of
from lanebound.envs.vector.env import engines
from lanebound.envs.wrappers import EpisodeStatistics
from lanebound.integrity.core.accel import LOGGER
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator

__all__ = ["episode_seeds", "for_judging", "for_learning"]

LEAST = 32  # environments in a process


def for_learning(experiment: ExperimentConfig, processes: int | None) -> VecEnv:
    """The environments of a training, seeded for its beginning; others broadcast as :func:`.choose_others` decides.

    Parameters
    ----------
    processes : over which the environments of the engine are divided; single ones have one each with more than 1. None:
        for the engine one for each core, with 32 environments each at least, as fewer are mostly overhead; else 1

    Raises
    ------
    ConfigError, InputError
        The environment refuses its configuration, or the engine must drive and cannot.
    """
    experiment = choose_others(experiment).experiment.as_learnt()
    env = _in_engine(experiment, experiment.count, processes)
    if env is None:
        makers: list[Any] = [_Maker(experiment)] * experiment.count
        env = DummyVecEnv(makers) if processes in (None, 1) else SubprocVecEnv(makers, start_method="spawn")
    env = _shielded(experiment, env, experiment.shield_penalty)
    env.seed(episode_seeds(experiment, 0))
    return env


def episode_seeds(experiment: ExperimentConfig, steps: int, purpose: str = "traffic") -> int:
    """Seed of the first environment of a training that begins or resumes after so many steps; the others count on.

    Trainings of different seeds share no episodes, nor with evaluations and benchmarks, and a resumed training or
    another purpose has other episodes: the seed is drawn from the training's seed, the steps and a stream of that name,
    above all seeds of the splits.
    """
    least = max(max(split) for split in SPLITS.values()) + 1
    drawn = named_generator([experiment.seed, steps], purpose).integers(least, 2**31 - experiment.count)
    return int(drawn)


def for_judging(experiment: ExperimentConfig, episodes: int) -> VecEnv:
    """Environments for so many episodes: one for each in the engine, else a single one for all in turn."""
    return _shielded(experiment, _in_engine(experiment, episodes) or DummyVecEnv([_Maker(experiment)]), 0.0)


def _in_engine(experiment: ExperimentConfig, count: int, processes: int | None = 1) -> VecEnv | None:
    """Environments in the engine; None where it is switched off, or optional and not possible."""
    name, config = full_id(experiment.env), experiment.env_overrides
    if experiment.engine is False:
        return None
    if engine_of(name) is None:
        if experiment.engine:
            known = ", ".join(env_id.removeprefix("lanebound/").removesuffix("-v0") for env_id in engines())
            raise ConfigError(
                f"engine must be left out for {experiment.env}, got true: the vector engine supports {known}"
            )
        return None
    try:
        return _divided(name, count, config, processes)
    except ConfigError as error:
        if experiment.engine:
            raise ConfigError(f"engine must be left out here, got true: {error}") from None
        return None


def _divided(name: str, count: int, config: Mapping[str, Any], processes: int | None) -> VecEnv:
    """Environments in the engine over so many processes; None: as :func:`for_learning` chooses."""
    make = partial(EngineVecEnv, name, count, config, keys=("cost", "costs"), statistics=True)
    if processes is not None:
        return make(processes=min(processes, count))
    parts = 1 if current_process().daemon else max(1, min(available_cores(), count // LEAST))
    if parts > 1:
        try:
            return make(processes=parts)
        except (InputError, RuntimeError) as error:  # such as plug-ins of a notebook, which other processes lack
            env = make()  # raises what this process refuses as well
            LOGGER.warning("lanebound: environments are in one process, as %d processes failed: %s", parts, error)
            return env
    return make()


def _shielded(experiment: ExperimentConfig, env: VecEnv, penalty: float) -> VecEnv:
    if experiment.shield is Shield.LAYER:
        return VecSafetyLayer(env, experiment.rules, penalty)
    return VecShielded(env, experiment.open(), penalty) if experiment.shield is Shield.CBF else env


@dataclass(frozen=True)
class _Maker:
    """Makes a single environment, in any process."""

    experiment: ExperimentConfig
    plugins: tuple[str, ...] = field(default_factory=lambda: tuple(loaded_plugins()))

    def __call__(self) -> Any:
        load_plugins(self.plugins)
        return Monitor(EpisodeStatistics(self.experiment.open()))
