"""The environments of an experiment, to learn and to be judged in: the vector engine where it can, else single ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecMonitor

from lanebound.agents.episodes.opening import full_id
from lanebound.agents.learning.experiment import ExperimentConfig, Shield
from lanebound.agents.learning.shield import VecShielded
from lanebound.agents.vec_env import EngineVecEnv, VecEpisodeStatistics
from lanebound.envs.wrappers import EpisodeStatistics
from lanebound.integrity.errors import ConfigError, InputError

__all__ = ["for_judging", "for_learning"]


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
    env = _shielded(experiment, env)
    env.seed(experiment.seed)
    return env


def for_judging(experiment: ExperimentConfig, episodes: int) -> VecEnv:
    """Environments for so many episodes: one for each in the engine, a single one for one after another elsewhere."""
    return _shielded(experiment, _in_engine(experiment, episodes) or DummyVecEnv([_Maker(experiment)]))


def _in_engine(experiment: ExperimentConfig, count: int) -> VecEnv | None:
    """Environments in the engine; None where it is not wanted, or need not and cannot."""
    if experiment.engine is False:
        return None
    try:
        engine = EngineVecEnv(full_id(experiment.env), count, experiment.env_overrides)
    except (ConfigError, InputError) as error:
        if experiment.engine:
            raise ConfigError(f"engine must be left out here, got true: {error}") from None
        return None
    return VecMonitor(VecEpisodeStatistics(engine))


def _shielded(experiment: ExperimentConfig, env: VecEnv) -> VecEnv:
    return VecShielded(env, experiment.open()) if experiment.shield is Shield.CBF else env


@dataclass(frozen=True)
class _Maker:
    """Makes a single environment, in whichever process."""

    experiment: ExperimentConfig

    def __call__(self) -> Any:
        return Monitor(EpisodeStatistics(self.experiment.open()))
