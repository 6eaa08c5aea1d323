"""The folder of a benchmark: its suite, one Parquet file for each finished episode, and nothing half written.

::

    suite.json                                        what is driven, by which version
    episodes/<env>/<sky>-<faults>/<agent>/<seed>.parquet
    results.json  results.csv  episodes.parquet       what it comes to
    clips/                                            films in the report, kept while their episodes stay
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.parts import EPISODES
from lanebound.agents.benchmark.source import agent_digest, package_versions, source_digest
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.episodes.columns import COLUMNS
from lanebound.agents.episodes.log import schema_of
from lanebound.agents.kept import replace_file, require_own
from lanebound.integrity.core.errors import InputError

__all__ = ["CLIPS", "STORED", "Store"]

SUITE, UNFIT, KEY = "suite.json", "left_out.json", b"lanebound.outcome"
CLIPS = "clips"
RESULTS = ("results.json", "results.csv", "episodes.parquet", "report.html")
LEFT_OUT = ("episode", "seed", "rtk", "tta_s", "hdop", "satellites", "since_rtk_s", "corrections_age_s")
STORED = tuple(column for column in COLUMNS if column.name not in LEFT_OUT)
"""The columns of a stored episode."""


class Store:
    """A folder of results.

    Parameters
    ----------
    folder : it need not exist before :meth:`claim`
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    # The suite

    def claim(self, suite: SuiteConfig, fresh: bool = False) -> None:
        """Make the folder that of a suite, or go on with it.

        Agents and seeds may be added to a suite or left out; everything else must be as it was, agents that go by the
        same name, the version of the code and those of numerical packages included.

        Raises
        ------
        InputError
            It holds another suite, or one driven by another version, or cannot be written.
        """
        mark = self.folder / SUITE
        require_own(mark)
        try:
            if fresh:
                self._clear()
            self.folder.mkdir(parents=True, exist_ok=True)
            new = self._mark(suite)
            old = self._read_mark()
            if mark.exists() and (found := _differing(old, new)):
                raise InputError(
                    f"out must be empty or hold the same suite, got {self.folder} with another {found}: "
                    "choose a new folder, or drive anew with --fresh"
                )
            new["agents"] = {**old.get("agents", {}), **new["agents"]}
            _write_text(mark, json.dumps(new, indent=1) + "\n")
        except OSError as error:
            raise InputError(
                f"out must be a folder that can be written, got {self.folder} ({error}): choose another"
            ) from None

    def _mark(self, suite: SuiteConfig) -> dict[str, Any]:
        from importlib.metadata import version

        return {
            "version": version("lanebound"),
            "source": source_digest(),
            "packages": package_versions(),
            "agents": {name: agent_digest(chosen) for name, chosen in suite.agents.items()},
            "suite": suite.to_dict(),
        }

    def _read_mark(self) -> dict[str, Any]:
        """What the folder is marked with; nothing where the mark is none of ours."""
        try:
            found = json.loads((self.folder / SUITE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _clear(self) -> None:
        """Remove an earlier suite and nothing else."""
        if (self.folder / SUITE).exists():
            for name in (EPISODES, CLIPS):
                shutil.rmtree(self.folder / name, ignore_errors=True)
            for name in (*RESULTS, UNFIT, SUITE):
                (self.folder / name).unlink(missing_ok=True)

    def suite(self) -> SuiteConfig:
        """The suite that the folder is of.

        Raises
        ------
        InputError
            It is no folder of a benchmark, or what says of which one is damaged or refused.
        """
        mark = self.folder / SUITE
        if not mark.exists():
            found = (
                f"{self.folder} without its {SUITE}" if self.folder.exists() else f"{self.folder}, which is not there"
            )
            raise InputError(
                f"DIR must be a folder that 'lanebound benchmark' wrote, got {found}: name what was its --out"
            )
        try:
            return SuiteConfig.load(json.loads(mark.read_text(encoding="utf-8"))["suite"])
        except (OSError, ValueError, LookupError, TypeError) as error:  # refusals of a suite among them
            raise InputError(
                f"{mark} must be as 'lanebound benchmark' wrote it, got {_reason(error)}: restore the file, or drive "
                f"anew by 'lanebound benchmark SUITE --out {self.folder} --fresh'"
            ) from None

    def same_version(self) -> bool:
        """Whether its episodes were driven by the code and the packages that are here now."""
        mark = self._read_mark()
        return (mark.get("source"), mark.get("packages")) == (source_digest(), package_versions())

    def packages(self) -> dict[str, str]:
        """Versions of the packages that its episodes were driven with; none where they were not recorded."""
        found = self._read_mark().get("packages")
        return dict(found) if isinstance(found, dict) else {}

    def left_out(self) -> list[tuple[str, str, str]]:
        """Agents that cannot drive an environment of the suite, as ``(env, agent, why)``."""
        path = self.folder / UNFIT
        rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
        return [(env, agent, why) for env, agent, why in rows]

    def leave_out(self, unfit: Sequence[tuple[str, str, str]]) -> None:
        """Remember who cannot drive what."""
        _write_text(self.folder / UNFIT, json.dumps(unfit, indent=1) + "\n")

    # Episodes

    def path(self, task: Task) -> Path:
        """Where an episode is kept."""
        return self.folder / EPISODES / f"{task.id}.parquet"

    def has(self, task: Task) -> bool:
        """Whether an episode is finished."""
        return self.path(task).exists()

    def write(self, rows: Sequence[Mapping[str, Any]], outcome: Outcome) -> None:
        """Keep an episode; the file appears when it is whole."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        schema = schema_of(STORED).with_metadata({KEY: json.dumps(outcome.to_dict(), allow_nan=False).encode()})
        kept = [{column.name: row[column.name] for column in STORED} for row in rows]
        path = self.path(outcome.task)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as draft:
            pq.write_table(pa.Table.from_pylist(kept, schema=schema), draft, compression="zstd")

    def outcome(self, task: Task) -> Outcome:
        """What a finished episode came to."""
        import pyarrow.parquet as pq

        return Outcome.from_dict(json.loads(pq.read_metadata(self.path(task)).metadata[KEY]))

    def rows(self, task: Task) -> Any:
        """The rows of a finished episode, a pyarrow Table with the columns ``STORED``, its start first."""
        import pyarrow.parquet as pq

        return pq.ParquetFile(self.path(task)).read()


def _write_text(path: Path, text: str) -> None:
    with replace_file(path) as draft:
        draft.write_text(text, encoding="utf-8")


def _reason(error: Exception) -> str:
    """What is wrong with a mark, in a line."""
    if isinstance(error, LookupError | TypeError):
        return "JSON without a suite"
    damaged = isinstance(error, OSError | UnicodeDecodeError | json.JSONDecodeError)
    return f"{'damaged data' if damaged else 'a suite that is refused'} ({'; '.join(str(error).splitlines())})"


def _differing(old: Any, new: Mapping[str, Any]) -> str:
    """What of a folder's mark does not agree with a suite; "" when an episode would come out the same."""
    try:
        before, after = dict(old["suite"]), dict(new["suite"])
        for key in ("agents", "reference", "title"):
            before.pop(key, None), after.pop(key, None)
        if old["source"] != new["source"]:
            return f"version of the code ({old['version']}, {old['source']})"
        moved = [name for name, now in new["packages"].items() if old.get("packages", {}).get(name) != now]
        if moved:
            return f"version of {moved[0]} ({old.get('packages', {}).get(moved[0], 'not recorded')})"
        other = [name for name, digest in new["agents"].items() if old["agents"].get(name, digest) != digest]
        if other:
            return f"agent under the name '{other[0]}'"
        before["seeds"], after["seeds"] = before["seeds"]["split"], after["seeds"]["split"]
        return next((f"value of {key}" for key in after if before.get(key) != after[key]), "")
    except (KeyError, TypeError, AttributeError):
        return "kind of suite.json"
