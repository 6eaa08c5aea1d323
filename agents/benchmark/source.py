"""Names for the code and the models that an episode follows from: what others made must not be mixed in."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib import resources
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from lanebound.agents.benchmark.suite import AgentConfig
from lanebound.agents.drivers.foreign import MODELS

__all__ = ["agent_digest", "package_versions", "source_digest"]

FOLDERS = (
    "lanebound.integrity",
    "lanebound.envs",
    "lanebound.configs",
    "lanebound.agents.drivers",
    "lanebound.agents.episodes",
)
FILES = ("episode.py", "outcome.py", "scoring.py", "suite.py", "work.py")
"""Those beside this one from which an episode's rows and figures follow; metrics are taken when results are loaded."""
PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "highway-env")


@cache
def source_digest() -> str:
    """A digest of the code and presets that episodes follow from, as they were first asked for."""
    found = hashlib.blake2b(digest_size=8)
    for package in FOLDERS:
        root = Path(str(resources.files(package)))
        for source in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".yaml")):
            if "suites" not in source.parts:
                found.update(source.read_bytes())
    for name in FILES:
        found.update((Path(__file__).parent / name).read_bytes())
    return found.hexdigest()


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages whose arithmetic an episode follows from."""
    return {"Python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def agent_digest(chosen: AgentConfig) -> str:
    """A digest of what an agent is: its name or path, what it needs, and the bytes of its model or module."""
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
