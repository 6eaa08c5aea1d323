"""The environments of an experiment, to learn and to be judged in: the vector engine where it can, else single ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecMonitor

from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.experiment import ExperimentConfig, Shield
from lanebound.agents.learning.shield import Shielded
from lanebound.agents.vec_env import EngineVecEnv, VecEpisodeStatistics
from lanebound.envs.vector.env import ENGINES
from lanebound.envs.wrappers import EpisodeStatistics
from lanebound.integrity.errors import ConfigError, InputError

__all__ = ["for_judging", "for_learning", "may_use_engine"]


def for_learning(experiment: ExperimentConfig, processes: int) -> VecEnv:
    """As many environments as the experiment says, their seeds set.

    Parameters
    ----------
    processes : of single environments, spawned; with 1 they run in this one

    Raises
    ------
    ConfigError, InputError
        The environment refuses its configuration, or the engine must drive and cannot.
    """
    env = _in_engine(experiment, experiment.count)
    if env is None:
        makers: list[Any] = [_Maker(experiment)] * experiment.count
        env = DummyVecEnv(makers) if processes == 1 else SubprocVecEnv(makers, start_method="spawn")
    env.seed(experiment.seed)
    return env


def for_judging(experiment: ExperimentConfig, episodes: int) -> VecEnv:
    """Environments for so many episodes: one for each in the engine, a single one for one after another elsewhere."""
    return _in_engine(experiment, episodes) or DummyVecEnv([_Maker(experiment)])


def may_use_engine(experiment: ExperimentConfig) -> bool:
    """Whether the engine would drive an experiment, as far as that is known without opening its environment."""
    known = full_id(experiment.env) in ENGINES and experiment.shield is Shield.NONE
    return known and experiment.engine is not False


def _in_engine(experiment: ExperimentConfig, count: int) -> VecEnv | None:
    """Environments in the engine; None where it is not wanted, or need not and cannot."""
    if experiment.engine is False:
        return None
    try:
        return VecMonitor(VecEpisodeStatistics(_engine(experiment, count)))
    except (ConfigError, InputError) as error:
        if experiment.engine:
            raise ConfigError(f"engine must be left out here, got true: {error}") from None
        return None


def _engine(experiment: ExperimentConfig, count: int) -> EngineVecEnv:
    if experiment.shield is not Shield.NONE:
        raise ConfigError(f"shield must be none in the vector engine, got {experiment.shield}")
    return EngineVecEnv(full_id(experiment.env), count, experiment.env_overrides)


@dataclass(frozen=True)
class _Maker:
    """Makes a single environment, in whichever process."""

    experiment: ExperimentConfig

    def __call__(self) -> Any:
        env = self.experiment.open()
        return Monitor(EpisodeStatistics(Shielded(env) if self.experiment.shield is Shield.CBF else env))
