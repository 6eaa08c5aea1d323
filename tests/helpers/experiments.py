"""Experiments that take seconds."""

from __future__ import annotations

from typing import Any

from lanebound.agents.learning.experiment import ExperimentConfig

__all__ = ["experiment"]

SHORT: dict[str, Any] = {
    "env": "LaneKeeping",
    "sky": "open",
    "overrides": {"navigation": {"source": "perfect"}, "duration_s": 4.0},
    "steps": 128,
    "count": 2,
    "checkpoint_steps": 64,
    "evaluation_episodes": 1,
    "settings": {"n_steps": 32, "batch_size": 32, "n_epochs": 1},
}


def experiment(**changes: Any) -> ExperimentConfig:
    return ExperimentConfig.load({**SHORT, **changes})
