"""The card of a checkpoint: description, experiment, evaluation and intended use."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lanebound.agents.learning.experiment import ExperimentConfig

__all__ = ["write_card"]

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
