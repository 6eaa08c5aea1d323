"""What the other vehicles of a training broadcast: recorded errors where these can be, else what receivers find.

Environments with recorded neighbours step up to 19 times as fast. They are for learning only: evaluations, benchmarks
and the choice of the best checkpoint follow the configuration, whose default is receivers.
"""

from __future__ import annotations

from contextlib import closing
from typing import NamedTuple

from lanebound.agents.learning.experiment import ExperimentConfig, Others
from lanebound.envs.core import DrivingEnv
from lanebound.envs.vector.support import newcomers_of, require_supported, support_of
from lanebound.integrity.core.errors import ConfigError

__all__ = ["Chosen", "choose_others"]


class Chosen(NamedTuple):
    """An experiment whose ``others`` are decided, and a line that says what they are; "" where nobody broadcasts."""

    experiment: ExperimentConfig
    line: str


def choose_others(experiment: ExperimentConfig) -> Chosen:
    """Decide what the others broadcast in a training: as the experiment says, else surrogates where these can be.

    ``overrides.perception.others`` counts for training and evaluation alike. ``others`` is None afterwards where no
    other vehicle broadcasts.

    Raises
    ------
    ConfigError
        ``others`` contradicts ``overrides.perception.others``, surrogates are asked for and refused, or nobody
        broadcasts.
    """
    asked, own = experiment.others, experiment.own_others
    if own is not None and asked not in (None, own):
        raise ConfigError(
            f"others must be {own}, as overrides.perception.others is, got {asked}: leave one of them out (evaluations "
            "follow overrides, training follows others)"
        )
    with closing(experiment.open()) as single:
        silent = _silence(single)
    if silent:
        if asked is not None:
            raise ConfigError(f"others must be left out where nobody broadcasts ({silent}), got {asked}: leave it out")
        return Chosen(experiment, "")
    if own is not None:
        return _chosen(experiment, Others(own), "as overrides.perception.others says, in evaluations too")
    if asked is Others.FULL:
        return _chosen(experiment, Others.FULL, "as asked for")
    wanted = experiment.replace(others=Others.SURROGATE)
    try:
        with closing(wanted.as_learnt().open()) as single:
            require_supported(single)
    except ConfigError as error:
        reason = str(error).removeprefix("overrides.")
        if asked is not None:
            raise ConfigError(f"others must be full here, got {asked}: {reason}") from None
        return _chosen(experiment, Others.FULL, f"since surrogates are refused: {reason}")
    return _chosen(wanted, Others.SURROGATE, "recorded errors; evaluations are with full, as configured")


def _chosen(experiment: ExperimentConfig, others: Others, why: str) -> Chosen:
    return Chosen(experiment.replace(others=others), f"other vehicles in training: {others} ({why})")


def _silence(single: DrivingEnv) -> str:
    """Why no other vehicle broadcasts; "" where one may."""
    config = single.config
    if not config.perception.has_radio:
        return f"perception.source is {config.perception.source}"
    try:
        support = support_of(config)
    except ConfigError:  # without an engine it is not known before an episode
        return ""
    others = support.vehicles(single.world) - 1 + newcomers_of(config, support)
    return "" if min(config.slots, others) > 0 else "there are no other vehicles"
