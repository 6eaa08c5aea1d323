"""What a policy's file holds of its training: the experiment, or the environment, and its observation entries.

A policy in another environment than that of its training is reported, and one that does not name it.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from lanebound.agents.drivers.inputs import INPUTS, PolicyInputs
from lanebound.agents.drivers.normalization import NORMALIZATION, Normalization, require_plain
from lanebound.envs.observation import ObservationConfig
from lanebound.envs.registration import base_of
from lanebound.integrity.core.accel import LOGGER

__all__ = [
    "EXPERIMENT", "add_text", "elsewhere", "environment_in", "experiment_in", "inputs_in", "name_inputs",
    "normalization_in", "report_elsewhere",
]  # fmt: skip

EXPERIMENT = "lanebound.experiment"
"""Name of the experiment as JSON: a member of a checkpoint, metadata of an ONNX file, an array of an NPZ file."""
ENVIRONMENT = "lanebound.environment"
"""Name of the environment's id in a checkpoint without an experiment."""


def add_text(checkpoint: Path, name: str, text: str) -> None:
    """Add a member to a checkpoint of Stable-Baselines3, which ignores it."""
    with ZipFile(checkpoint, "a") as archive:
        archive.writestr(name, text)


def name_inputs(checkpoint: str | Path, config: ObservationConfig, env_id: str, normalize: Any = None) -> None:
    """Add the names of the observation entries and the environment to a checkpoint.

    It can then drive where there are more entries, and is reported where it drives in another environment.
    ``lanebound train`` does so; call it after ``model.save`` in a training of your own.

    Parameters
    ----------
    config : of the observations in training, ``env.unwrapped.config.observation``
    env_id : of the environment in training, such as ``lanebound/LaneKeeping-v0``
    normalize : the ``VecNormalize`` around the environments in training; its statistics then go with the policy, which
        is refused without them

    Raises
    ------
    InputError
        ``normalize`` is something else.
    """
    statistics = None if normalize is None else Normalization.of(normalize)
    add_text(Path(checkpoint), INPUTS, PolicyInputs.of(config).to_json())
    add_text(Path(checkpoint), ENVIRONMENT, env_id)
    if statistics is not None:
        add_text(Path(checkpoint), NORMALIZATION, statistics.to_json())


def experiment_in(path: Path) -> dict[str, Any] | None:
    """The experiment in a policy's file; None without one, as in files of other origin."""
    try:
        text = _text_in(path, EXPERIMENT)
        found = None if text is None else json.loads(text)
    except (OSError, ValueError, LookupError, BadZipFile):
        return None  # reported where the policy is loaded
    return found if isinstance(found, dict) else None


def environment_in(path: Path) -> str:
    """The id of the environment in which a file's policy was learnt; "" where the file does not name it."""
    if experiment := experiment_in(path):
        return str(experiment.get("env", ""))
    try:
        return _text_in(path, ENVIRONMENT) or ""
    except (OSError, ValueError, LookupError, BadZipFile):
        return ""  # reported where the policy is loaded


def inputs_in(checkpoint: Path) -> PolicyInputs | None:
    """The observation entries of a checkpoint's policy; None where it does not name them.

    Raises
    ------
    InputError
        What it holds is damaged.
    """
    text = _text_in(checkpoint, INPUTS)
    return None if text is None else PolicyInputs.from_json(text, f"agent {checkpoint}")


def normalization_in(checkpoint: Path, model: Any) -> Normalization | None:
    """The statistics of a checkpoint's normalized observations; None where it was trained on those of the environment.

    Raises
    ------
    InputError
        What it holds is damaged, or it was trained on normalized observations and holds no statistics.
    """
    text, name = _text_in(checkpoint, NORMALIZATION), f"agent {checkpoint}"
    if text is not None:
        return Normalization.from_json(text, model.observation_space, name)
    require_plain(model, name)
    return None


def _text_in(path: Path, name: str) -> str | None:
    """A text of that name in a policy's file; None where it has none."""
    if path.suffix == ".onnx":
        from lanebound.agents.drivers.foreign import onnx_session

        found: str | None = onnx_session(path).get_modelmeta().custom_metadata_map.get(name)
        return found
    with ZipFile(path) as archive:  # an NPZ file is one as well
        if name in archive.namelist():
            return archive.read(name).decode()
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return str(arrays[name]) if name in arrays.files else None
    return None


def elsewhere(name: str, base: str) -> str:
    """A warning where the policy of a file was learnt in another world than ``base``, or names none; else ""."""
    env = environment_in(Path(name))
    if not env:
        return f"policy {name} does not say where it was learnt and drives {base} here"
    if base_of(env) == base:
        return ""
    return f"policy {name} was learnt in {env} and drives {base} here: its results say nothing of what it learnt"


@lru_cache(maxsize=64)
def report_elsewhere(name: str, base: str) -> None:
    """Log :func:`elsewhere`, once for each policy and world."""
    if warning := elsewhere(name, base):
        LOGGER.warning("lanebound: %s", warning)
