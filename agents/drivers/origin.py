"""In which environment a policy was learnt, as its file says: a policy that drives elsewhere is reported."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from lanebound.envs import IDS, make_config
from lanebound.integrity.core.accel import LOGGER

__all__ = ["EXPERIMENT", "elsewhere", "experiment_in", "report_elsewhere", "write_experiment"]

EXPERIMENT = "lanebound.experiment"
"""Name of the experiment as JSON: a member of a checkpoint, metadata of an ONNX file, an array of an NPZ file."""


def write_experiment(checkpoint: Path, text: str) -> None:
    """Add an experiment, as JSON, to a checkpoint of Stable-Baselines3, which ignores it."""
    with ZipFile(checkpoint, "a") as archive:
        archive.writestr(EXPERIMENT, text)


def experiment_in(path: Path) -> dict[str, Any] | None:
    """The experiment that a policy's file holds; None where it holds none, as files of other origin."""
    try:
        text = _text_in(path)
        found = None if text is None else json.loads(text)
    except (OSError, ValueError, LookupError, BadZipFile):
        return None  # reported where the policy is loaded
    return found if isinstance(found, dict) else None


def _text_in(path: Path) -> str | None:
    if path.suffix == ".onnx":
        from lanebound.agents.drivers.foreign import onnx_session

        found: str | None = onnx_session(path).get_modelmeta().custom_metadata_map.get(EXPERIMENT)
        return found
    with ZipFile(path) as archive:  # an NPZ file is one as well
        if EXPERIMENT in archive.namelist():
            return archive.read(EXPERIMENT).decode()
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return str(arrays[EXPERIMENT]) if EXPERIMENT in arrays.files else None
    return None


def elsewhere(name: str, base: str) -> str:
    """A warning where the policy of a file was learnt in another world than ``base``; else ""."""
    experiment = experiment_in(Path(name)) or {}
    env = str(experiment.get("env", ""))
    if not env or _base(env) == base:
        return ""
    return f"policy {name} was learnt in {env} and drives {base} here: its results say nothing of what it learnt"


@lru_cache(maxsize=64)
def report_elsewhere(name: str, base: str) -> None:
    """Log :func:`elsewhere`, once for each policy and world."""
    if warning := elsewhere(name, base):
        LOGGER.warning("lanebound: %s", warning)


def _base(env: str) -> str:
    """The world of an id; an id of highway-env is its own."""
    env_id = f"lanebound/{env.removeprefix('lanebound/')}"
    return make_config(env_id).base if env_id in IDS else env
