"""Digests of the code and of the agents that determine an episode: results of other code are not mixed in."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from pathlib import Path

from lanebound.agents.benchmark.suite import AgentConfig
from lanebound.agents.checkpointing.folder import code_digest
from lanebound.agents.drivers.foreign import MODELS

__all__ = ["agent_digest", "source_digest"]

SOURCES = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.configs",
    "lanebound.agents.drivers",
    "lanebound.agents.episodes",
    *(f"lanebound.agents.benchmark:{name}.py" for name in ("episode", "outcome", "scoring", "suite", "work")),
)
"""Code that determines the rows and outcomes of episodes; metrics are computed when results are loaded."""


def source_digest() -> str:
    """Digest of the code and presets that determine episodes, as they are at the first call."""
    return code_digest(*SOURCES)


def agent_digest(chosen: AgentConfig) -> str:
    """Digest of an agent: its configuration, and the bytes of its model or module."""
    found = hashlib.blake2b(chosen.to_json().encode(), digest_size=8)
    for path in _files(chosen.agent):
        if path.is_file():
            found.update(path.read_bytes())
    return found.hexdigest()


def _files(agent: str) -> list[Path]:
    if agent.endswith(MODELS):
        return [Path(agent)]
    module, colon, _ = agent.partition(":")
    if not colon:
        return []
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return []
    return [Path(spec.origin)] if spec is not None and spec.origin is not None else []
