"""The result folder of a benchmark: a manifest and one Parquet file for each finished episode.

::

    run.json                                          the suite, versions, digests of the agents
    episodes/<env>/<sky>-<faults>/<agent>/<seed>.parquet
    results.json  results.csv  episodes.parquet       metrics of all episodes
    clips/                                            films in the report, reused while their episodes stay the same

Digests of the code and of the agents that determine an episode: results of other code are not mixed in.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.suite import AgentConfig, SuiteConfig
from lanebound.agents.checkpointing.files import replace_file
from lanebound.agents.checkpointing.folder import MANIFEST, ResultFolder, code_digest, package_versions, plugin_digests
from lanebound.agents.drivers.foreign import MODELS
from lanebound.agents.episodes.columns import Column, columns
from lanebound.agents.episodes.log import schema_of
from lanebound.integrity.core.errors import InputError

__all__ = ["CLIPS", "EPISODES", "KIND", "EpisodeStore", "agent_digest", "source_digest", "stored_columns"]


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


KIND = "benchmark"
EPISODES, CLIPS, KEY = "episodes", "clips", b"lanebound.outcome"
RESULTS = ("results.json", "results.csv", "episodes.parquet", "report.html")
LEFT_OUT = ("episode", "seed", "rtk", "tta_s", "hdop", "satellites", "since_rtk_s", "corrections_age_s")


def stored_columns() -> tuple[Column, ...]:
    """The columns of a stored episode."""
    return tuple(column for column in columns() if column.name not in LEFT_OUT)


class EpisodeStore:
    """Episodes of a benchmark in its result folder.

    Parameters
    ----------
    folder : it need not exist before :meth:`claim`
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    # The suite

    def claim(self, suite: SuiteConfig, fresh: bool = False, left_out: Sequence[tuple[str, str, str]] = ()) -> None:
        """Make the folder that of a suite, or resume it.

        Agents and seeds may be added to a suite or removed. All else must be the same: other values of the suite, the
        definition of each agent, the code, and the versions of numerical packages.

        Parameters
        ----------
        fresh : remove the results of an earlier run first
        left_out : agents that cannot drive an environment, as ``(env, agent, reason)``

        Raises
        ------
        InputError
            The folder holds other work, results of another version or foreign files, or cannot be written.
        """
        anew = fresh and (self.folder / MANIFEST).exists()
        if anew:
            self.manifest()
            self._clear()
        config, agents = suite.to_dict(), {name: _named(name, suite) for name in suite.agents}
        fixed = {key: value for key, value in config.items() if key not in ("agents", "reference", "title")}
        ResultFolder(
            self.folder,
            KIND,
            config,
            source_digest(),
            fixed={**fixed, "seeds": {"split": suite.seeds.split}, "agents": agents},
            growing=("agents",),
            extra={"left_out": [list(row) for row in left_out]},
            remedy="choose a new folder, or drive anew with --fresh",
        ).claim(anew)

    def _clear(self) -> None:
        for name in (EPISODES, CLIPS):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name in RESULTS:
            (self.folder / name).unlink(missing_ok=True)

    def suite(self) -> SuiteConfig:
        """The suite of the folder.

        Raises
        ------
        InputError
            The folder holds no benchmark, or its manifest is damaged or refused.
        """
        manifest = self.manifest()
        try:
            return SuiteConfig.load(manifest["config"])
        except (InputError, LookupError, TypeError, AttributeError) as error:
            raise InputError(
                f"{self.folder / MANIFEST} must hold a valid suite, got {'; '.join(str(error).splitlines())}: restore "
                f"the file, or drive anew by 'lanebound benchmark SUITE --out {self.folder} --fresh'"
            ) from None

    def same_version(self) -> bool:
        """Whether the code and the packages are those that the episodes were driven with."""
        found = self.manifest()
        then = found.get("source"), found.get("plugins"), found.get("packages")
        return then == (source_digest(), plugin_digests(), package_versions())

    def manifest(self) -> dict[str, Any]:
        """The manifest: versions of the code and of packages, and the suite."""
        return ResultFolder(self.folder, KIND).manifest()

    def left_out(self) -> list[tuple[str, str, str]]:
        """Agents that cannot drive an environment of the suite, as ``(env, agent, reason)``."""
        return [(env, agent, reason) for env, agent, reason in self.manifest().get("left_out", [])]

    # Episodes

    def path(self, task: Task) -> Path:
        """The file of an episode."""
        return self.folder / EPISODES / f"{task.id}.parquet"

    def has(self, task: Task) -> bool:
        """Whether an episode is finished."""
        return self.path(task).exists()

    def write(self, rows: Sequence[Mapping[str, Any]], outcome: Outcome) -> None:
        """Write an episode."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        shown = stored_columns()
        schema = schema_of(shown).with_metadata({KEY: json.dumps(outcome.to_dict(), allow_nan=False).encode()})
        stored = [{column.name: row[column.name] for column in shown} for row in rows]
        path = self.path(outcome.task)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as draft:
            pq.write_table(pa.Table.from_pylist(stored, schema=schema), draft, compression="zstd")

    def outcome(self, task: Task) -> Outcome:
        """The outcome of a finished episode."""
        import pyarrow.parquet as pq

        return Outcome.from_dict(json.loads(pq.read_metadata(self.path(task)).metadata[KEY]))

    def rows(self, task: Task) -> Any:
        """The rows of a finished episode, a pyarrow Table of :func:`stored_columns`; the first row is the start."""
        import pyarrow.parquet as pq

        return pq.ParquetFile(self.path(task)).read()


def _named(name: str, suite: SuiteConfig) -> str:
    """An agent and its digest, as the manifest has them."""
    chosen = suite.agents[name]
    return f"{chosen.agent}, {agent_digest(chosen)}"
