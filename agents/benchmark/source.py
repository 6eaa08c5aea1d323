"""Names for the code and the models that an episode follows from: what others made must not be mixed in."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

from lanebound.agents.benchmark.suite import AgentConfig

__all__ = ["agent_digest", "source_digest"]

FOLDERS = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.configs",
    "lanebound.agents.drivers",
    "lanebound.agents.episodes",
)


@cache
def source_digest() -> str:
    """A digest of the code and presets that episodes follow from, as they were first asked for."""
    found = hashlib.blake2b(digest_size=8)
    for package in FOLDERS:
        root = Path(str(resources.files(package)))
        for source in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".yaml")):
            if "suites" not in source.parts:
                found.update(source.read_bytes())
    for name in ("episode.py", "outcome.py"):
        found.update((Path(__file__).parent / name).read_bytes())
    return found.hexdigest()


def agent_digest(chosen: AgentConfig) -> str:
    """A digest of what an agent is: its name or path, what it needs, and the bytes of its model or module."""
    found = hashlib.blake2b(chosen.to_json().encode(), digest_size=8)
    for path in _files(chosen.agent):
        if path.is_file():
            found.update(path.read_bytes())
    return found.hexdigest()


def _files(agent: str) -> list[Path]:
    if agent.endswith((".zip", ".onnx")):
        return [Path(agent)]
    module, colon, _ = agent.partition(":")
    if not colon:
        return []
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return []
    return [Path(spec.origin)] if spec is not None and spec.origin is not None else []
