"""Export of a learnt policy: as an ONNX network, or as the arrays that the driver ``ppo`` reads.

Both go from flat observations to actions, without exploration.

The environment scales its observations, so the network is all there is between observation and action.
"""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import nn

from lanebound.agents.checkpointing.files import replace_file
from lanebound.agents.drivers.foreign import load_checkpoint
from lanebound.agents.drivers.inputs import INPUTS, PolicyInputs
from lanebound.agents.drivers.normalization import Normalization
from lanebound.agents.drivers.origin import EXPERIMENT, inputs_in, normalization_in
from lanebound.agents.learning.evaluation import trained
from lanebound.agents.learning.experiment import ExperimentConfig, Shield
from lanebound.integrity.core.errors import InputError

__all__ = ["export_arrays", "export_onnx"]


def export_onnx(source: Path, path: Path, env: str | None = None, changes: Mapping[str, Any] | None = None) -> Path:
    """Write a learnt policy as a network with one input and one output; returns its path.

    The input ``observation`` (B, n) is the flat observation, the output ``action`` (B, m) the action within [-1, 1], or
    for discrete actions a value of each, of which the largest counts. Its metadata hold the experiment
    (``lanebound.experiment``) and the entries of the observation, their scales and the history
    (``lanebound.observation``), as JSON.

    Parameters
    ----------
    source, env, changes : as of :func:`~lanebound.agents.learning.evaluation.trained`

    Raises
    ------
    InputError
        ``source`` has no checkpoint, the policy has a memory or a filter after it, a package is missing, or ``path``
        cannot be written.
    """
    experiment, best = trained(source, env, changes)
    model = load_checkpoint(best)
    _require_plain(experiment, model)
    inputs = _inputs(experiment, model, best)
    policy, statistics = model.policy, normalization_in(best, model)
    network: nn.Module = _Unsquashed(policy) if hasattr(policy, "mlp_extractor") else _Squashed(policy.actor)
    network = (network if statistics is None else nn.Sequential(_Normalized(statistics), network)).eval()
    shape = model.observation_space.shape
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as draft, _quiet():
            torch.onnx.export(
                network,
                (torch.zeros(2, *shape),),
                draft,
                input_names=["observation"],
                output_names=["action"],
                dynamic_shapes=({0: torch.export.Dim("batch")},),
                dynamo=True,
                verbose=False,
                external_data=False,
            )
            _describe(draft, experiment, inputs)
    except OSError as error:
        raise _unwritable(path, error) from None
    return path


def _describe(path: Path, experiment: ExperimentConfig, inputs: PolicyInputs) -> None:
    """Write into a network its experiment and the names of its observation entries."""
    import onnx

    network = onnx.load(path)
    onnx.helper.set_model_props(network, {EXPERIMENT: json.dumps(experiment.to_dict()), INPUTS: inputs.to_json()})
    onnx.save(network, path)


def _inputs(experiment: ExperimentConfig, model: Any, checkpoint: Path) -> PolicyInputs:
    """The observation entries of a policy: as its checkpoint names them, else those of the experiment's environment.

    Raises
    ------
    InputError
        The policy takes another number of them.
    """
    with closing(experiment.open()) as env:
        inputs = inputs_in(checkpoint) or PolicyInputs.of(env.config.observation)
    if model.observation_space.shape != (inputs.size,):
        raise InputError(
            f"the policy must be learnt on flat observations of {experiment.env}, {(inputs.size,)}, got "
            f"{model.observation_space.shape}: name its environment (--env) and what was changed there (--set)"
        )
    return inputs


def export_arrays(source: Path, path: Path, env: str | None = None, changes: Mapping[str, Any] | None = None) -> Path:
    """Write a learnt policy as ``ppo`` reads it (see :mod:`.drivers.learnt`); returns its path.

    Raises
    ------
    InputError
        As :func:`export_onnx`, or the network is other than PPO's usual one, layers with tanh between them
        alone, or sees more than one observation.
    """
    experiment, best = trained(source, env, changes)
    model = load_checkpoint(best)
    _require_plain(experiment, model, ())
    inputs, policy = _inputs(experiment, model, best), model.policy
    _require_layers(policy, inputs)
    if normalization_in(best, model) is not None:
        raise InputError(f"a policy to export as arrays must see plain observations, got {best} with statistics of "
                         "normalized ones: use .onnx")  # fmt: skip
    layers = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]
    discrete = isinstance(model.action_space, spaces.Discrete)
    arrays: dict[str, Any] = {"columns": inputs.columns, "scales": inputs.scales, "discrete": discrete}
    arrays[EXPERIMENT] = experiment.to_json()
    for n, layer in enumerate([*layers, policy.action_net]):
        arrays[f"weight_{n}"] = layer.weight.detach().numpy()
        arrays[f"bias_{n}"] = layer.bias.detach().numpy()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as draft, draft.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
    except OSError as error:
        raise _unwritable(path, error) from None
    return path


def _require_layers(policy: Any, inputs: PolicyInputs) -> None:
    """Raise InputError for what arrays cannot hold: other layers, a squashed output, a history of observations."""
    if not hasattr(policy, "mlp_extractor") or policy.activation_fn is not nn.Tanh:
        raise InputError(
            f"a policy to export as arrays must be PPO's with tanh, got {type(policy).__name__}: use .onnx"
        )
    if policy.squash_output:
        raise InputError("a policy to export as arrays must not squash its output, got squash_output: true: use .onnx")
    if inputs.history != 1:
        raise InputError(
            f"a policy to export as arrays must see one observation, got a history of {inputs.history}: use .onnx"
        )


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"out must be a file that can be written, got {path} ({error}): choose another")


def _require_plain(
    experiment: ExperimentConfig, model: Any, packages: tuple[str, ...] = ("onnx", "onnxscript")
) -> None:
    """Raise InputError for a policy that is more than a network, and for missing packages."""
    policy, kind = model.policy, type(model).__name__
    if hasattr(policy, "lstm_actor"):
        raise InputError(f"a policy to export must have no memory, got {kind}: drive with its checkpoint instead")
    if not (hasattr(policy, "mlp_extractor") or hasattr(getattr(policy, "actor", None), "latent_pi")):
        raise InputError(
            f"a policy to export must be of PPO, A2C or SAC, got {kind}: drive with its checkpoint instead"
        )
    if isinstance(model.observation_space, spaces.Dict):
        raise InputError(
            "a policy to export must take flat observations, got one that takes their groups "
            f"({', '.join(model.observation_space)}): learn it with observation.form=flat, or drive with its checkpoint"
        )
    if experiment.shield is not Shield.NONE:
        raise InputError(
            f"a policy to export must stand alone, got one under the filter {experiment.shield}: "
            "drive with its checkpoint and that filter instead"
        )
    for package in packages:
        if find_spec(package) is None:
            raise InputError(f"an export needs the package {package}, got none: pip install {package}")


class _Normalized(nn.Module):
    """Observations as a policy takes them that was trained under ``VecNormalize``."""

    def __init__(self, statistics: Normalization) -> None:
        super().__init__()
        self.mean = torch.tensor(statistics.mean[""], dtype=torch.float32)
        self.sigma = torch.tensor(statistics.variance[""] + statistics.epsilon, dtype=torch.float32).sqrt()
        self.limit = statistics.limit

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return ((observation - self.mean) / self.sigma).clamp(-self.limit, self.limit)


class _Unsquashed(nn.Module):
    """The mean of PPO's policy, or the values of its discrete actions."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy, self.discrete = policy, isinstance(policy.action_space, spaces.Discrete)
        self.squashed = bool(policy.squash_output)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        policy = self.policy
        features = policy.extract_features(observation, policy.pi_features_extractor)
        found: torch.Tensor = policy.action_net(policy.mlp_extractor.forward_actor(features))
        if self.discrete:
            return found
        return torch.tanh(found) if self.squashed else found.clamp(-1.0, 1.0)


class _Squashed(nn.Module):
    """The mean of SAC's policy."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        features = self.actor.extract_features(observation, self.actor.features_extractor)
        return torch.tanh(self.actor.mu(self.actor.latent_pi(features)))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what torch says of itself: deprecations within it, and packages that it could take but need not."""
    logger = logging.getLogger("torch.onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(before)
