"""Settings are refused by their names before anything starts; the defaults that messages name are the library's."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from experiments import experiment

from lanebound.agents.learning.algorithms import class_of
from lanebound.agents.learning.experiment import BOUNDS, Algorithm
from lanebound.integrity.core.errors import ConfigError

REFUSED = [
    ("ppo", "learning_rate", -1, "> 0, got -1"),
    ("ppo", "learning_rate", "fast", "a number, got 'fast'"),
    ("ppo", "learning_rate", float("inf"), "finite, got inf"),
    ("ppo", "gamma", 2, r"\(0, 1\], got 2"),
    ("ppo", "gae_lambda", -0.1, r"\[0, 1\], got -0.1"),
    ("ppo", "n_steps", 0, ">= 1, got 0"),
    ("ppo", "batch_size", 0, ">= 1, got 0"),
    ("ppo", "n_epochs", 0, ">= 1, got 0"),
    ("ppo", "clip_range", 0, "> 0, got 0"),
    ("ppo", "ent_coef", -1, ">= 0, got -1"),
    ("ppo_lagrangian", "cost_gamma", 1.5, r"\(0, 1\], got 1.5"),
    ("sac", "tau", 0, r"\(0, 1\], got 0"),
    ("sac", "buffer_size", 0, ">= 1, got 0"),
    ("sac", "ent_coef", "automatic", ">= 0, auto or auto_X .*, got 'automatic'"),
    ("sac_lagrangian", "n_steps", 5, r"\[1, 1\], got 5"),
    ("sac_lagrangian", "optimize_memory_usage", True, "false for sac_lagrangian, got true: leave it out"),
    ("ppo", "seed", 5, "left out, got 5: use seed"),
    ("sac_lagrangian", "cost_limit", 5, "left out, got 5: use cost_limit"),
]


@pytest.mark.parametrize(("algorithm", "name", "value", "bound"), REFUSED)
def test_what_cannot_be_is_refused_by_its_name(algorithm: str, name: str, value: Any, bound: str) -> None:
    with pytest.raises(ConfigError, match=rf"^settings\.{name} must (be |lie in )?{bound}"):
        experiment(algorithm=algorithm, settings={name: value})


def test_what_can_be_is_left_as_it_is() -> None:
    on = {"gamma": 1.0, "gae_lambda": 0, "clip_range_vf": None, "learning_rate": 1, "device": "auto"}
    off = {"ent_coef": "auto_0.1", "tau": 1, "gradient_steps": -1}
    assert experiment(settings=on).settings == on
    assert experiment(algorithm="sac", settings=off).settings == off


def test_one_decision_is_too_few_to_learn_from() -> None:
    with pytest.raises(ConfigError, match=r"^count times settings\.n_steps must be > 1, got 1: .* raise one$"):
        experiment(settings={"n_steps": 1}, count=1)
    assert experiment(settings={"n_steps": 1}, count=2).count == 2
    assert experiment(algorithm="sac", settings={"n_steps": 1}, count=1).count == 1


def test_policies_are_learnt_from_flat_observations_alone() -> None:
    dictionary, flat = {"observation": {"form": "dict"}}, {"observation": {"form": "flat", "history": 2}}
    with pytest.raises(ConfigError, match=r"^overrides\.observation\.form must be flat .*, got 'dict': leave it out; "):
        experiment(overrides=dictionary)
    with pytest.raises(ConfigError, match=r"^imitation\.observation\.form must be flat .*, got 'dict': leave it out; "):
        experiment(imitation=dictionary)
    assert experiment(overrides=flat).overrides == flat


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_defaults_that_messages_name_are_those_of_the_algorithm(algorithm: Algorithm) -> None:
    parameters = [inspect.signature(one.__init__).parameters for one in class_of(algorithm).__mro__]
    for name, field in BOUNDS[algorithm].model_fields.items():
        found = next((p[name].default for p in parameters if name in p), field.default)
        assert field.default == found, name
