"""The results of a benchmark: outcomes, cells with estimates, paired differences; saved and loaded."""

from __future__ import annotations

import csv
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.benchmark.fault_rates import FaultCell, FaultRate, fault_cells, fault_rates
from lanebound.agents.benchmark.metrics import METRICS, Metric
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.statistics import (
    METHOD,
    RESAMPLES,
    VERDICT_SEEDS,
    Difference,
    Estimate,
    difference,
    estimate,
    is_clear,
)
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.untuned import is_untuned
from lanebound.agents.checkpointing.files import replace_file
from lanebound.integrity.core.errors import InputError

__all__ = ["FILES", "Cell", "Estimate", "Paired", "Results"]

FILES = ("results.json", "results.csv", "episodes.parquet")
VERSION = 1  # of the form of results.json
CSV_COLUMNS = ("env", "sky", "faults", "agent", "metric", "unit", "episodes", "failed")
ESTIMATE_COLUMNS = ("mean", "low", "high", "iqm", "iqm_low", "iqm_high", "n")
PAIRED_COLUMNS = ("against", "p")  # empty where a row is of an agent alone


@dataclass(frozen=True)
class Cell:
    """An agent in an environment under a sky with faults: estimates over its seeds by the keys of the metrics.

    ``untuned`` where its margins were not tuned for this place.
    """

    env: str
    sky: str
    faults: str
    agent: str
    episodes: int
    failed: int
    metrics: dict[str, Estimate]
    untuned: bool = False

    @property
    def place(self) -> Place:
        """The place of the cell."""
        return Place(self.env, self.sky, self.faults)


@dataclass(frozen=True)
class Paired:
    """A metric of an agent less that of another in the same cell, seed by seed, with its 95 % interval.

    ``better`` is the share of the n seeds in which the difference is for the better; None without a good direction.
    ``p`` is the p-value of no difference, for this metric alone. ``failed`` counts the episodes in which either agent
    failed: their seeds, perhaps the hard ones, are not among the n, so that nothing is clear then.
    """

    env: str
    sky: str
    faults: str
    agent: str
    against: str
    metric: str
    difference: float | None
    low: float | None
    high: float | None
    n: int
    better: float | None
    p: float | None = None
    failed: int = 0

    @property
    def place(self) -> Place:
        """The place of the comparison."""
        return Place(self.env, self.sky, self.faults)

    @property
    def clear(self) -> bool:
        """Whether the interval excludes 0, with enough seeds, and no agent failed."""
        return not self.failed and is_clear(self.low, self.high, self.n)

    def verdict(self, better: str | None) -> str:
        """``better``, ``worse``, ``differs`` (no direction is better), ``unclear``, or why there is no verdict."""
        if self.failed:
            return f"no verdict, {self.failed} failed"
        if self.n < VERDICT_SEEDS:
            return "too few seeds"
        if not self.clear or self.difference is None:
            return "unclear"
        if better is None:
            return "differs"
        return "better" if (self.difference > 0.0) == (better == "higher") else "worse"


@dataclass(frozen=True)
class Results:
    """The results of the driven episodes of a suite.

    Attributes
    ----------
    suite : the whole suite
    outcomes : one for each finished episode, in the order of the suite's tasks
    cells, paired : estimates and differences, in the same order
    fault_cells, fault_rates : of cells with ``faults: one``, by kind of fault and at nominal rates
    missing : ids of the episodes that were not driven
    left_out : agents that cannot drive an environment, as ``(env, agent, reason)``; their episodes are not missing
    folder : of the results; None for results without files
    """

    suite: SuiteConfig
    outcomes: list[Outcome]
    cells: list[Cell]
    paired: list[Paired]
    missing: list[str] = field(default_factory=list)
    left_out: list[tuple[str, str, str]] = field(default_factory=list)
    folder: Path | None = None
    fault_cells: list[FaultCell] = field(default_factory=list)
    fault_rates: list[FaultRate] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        suite: SuiteConfig,
        outcomes: Iterable[Outcome],
        left_out: Sequence[tuple[str, str, str]] = (),
        folder: Path | None = None,
    ) -> Results:
        """Results from the outcomes of a suite.

        Raises
        ------
        InputError
            Two outcomes are of the same agent and seed at the same place.
        """
        outcomes = list(outcomes)
        _require_once(outcomes)
        found = {outcome.id: outcome for outcome in outcomes}
        unfit = {(env, agent) for env, agent, _ in left_out}
        tasks = [task for task in suite.tasks() if (task.place.env, task.agent) not in unfit]
        ordered = [found[task.id] for task in tasks if task.id in found]
        missing = [task.id for task in tasks if task.id not in found]
        groups = _groups(ordered)
        own = _cells(suite, groups), _pairs(suite, groups)
        given = fault_cells(groups), fault_rates(groups)
        return cls(suite, ordered, *own, missing, list(left_out), folder, *given)

    @classmethod
    def load(cls, folder: Path | str) -> Results:
        """The results of a folder, read from its episodes; the run need not be finished.

        Raises
        ------
        InputError
            It is no folder of a benchmark, or its suite is damaged or refused.
        """
        store = EpisodeStore(Path(folder))
        suite = store.suite()
        outcomes = [store.outcome(task) for task in suite.tasks() if store.has(task)]
        return cls.of(suite, outcomes, store.left_out(), Path(folder))

    @property
    def failures(self) -> list[Outcome]:
        """Episodes in which the agent failed."""
        return [outcome for outcome in self.outcomes if outcome.failed]

    def rows(self, outcome: Outcome) -> Any:
        """The stored rows of an episode, a pyarrow Table; None for results without files."""
        return None if self.folder is None else EpisodeStore(self.folder).rows(outcome.task)

    def cell(self, place: Place, agent: str) -> Cell:
        """The cell of an agent at a place."""
        return next(c for c in self.cells if c.place == place and c.agent == agent)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the form of results.json."""
        return {
            "format": VERSION,
            "suite": self.suite.to_dict(),
            "statistics": {
                "interval": 0.95,
                "method": METHOD,
                "resamples": RESAMPLES,
                "seeds_for_a_verdict": VERDICT_SEEDS,
            },
            "metrics": [_described(metric) for metric in METRICS],
            "cells": [asdict(cell) for cell in self.cells],
            "paired": [asdict(pair) for pair in self.paired],
            "fault_cells": [asdict(cell) for cell in self.fault_cells],
            "fault_rates": [asdict(rate) for rate in self.fault_rates],
            "failures": [{"id": o.id, "status": o.status, "message": o.message} for o in self.failures],
            "left_out": [{"env": env, "agent": agent, "why": why} for env, agent, why in self.left_out],
            "missing": self.missing,
            "outcomes": [outcome.to_dict() for outcome in self.outcomes],
        }

    def save(self, folder: Path) -> list[Path]:
        """Write results.json, results.csv and episodes.parquet; returns their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / name for name in FILES]
        for path, write in zip(paths, (self._write_json, self._write_csv, self._write_parquet), strict=True):
            with replace_file(path) as draft:
                write(draft)
        return paths

    def _write_json(self, path: Path) -> None:
        path.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")

    def _write_csv(self, path: Path) -> None:
        units = {metric.key: metric.unit for metric in METRICS}
        with path.open("w", encoding="utf-8", newline="") as file:
            out = csv.writer(file)
            out.writerow([*CSV_COLUMNS, *ESTIMATE_COLUMNS, *PAIRED_COLUMNS])
            for cell in self.cells:
                for key, found in cell.metrics.items():
                    head = [*cell.place, cell.agent, key, units[key], cell.episodes, cell.failed]
                    out.writerow([*head, *(getattr(found, name) for name in ESTIMATE_COLUMNS), None, None])
            for p in self.paired:
                head = [*p.place, p.agent, p.metric, units[p.metric], self.cell(p.place, p.agent).episodes, p.failed]
                out.writerow([*head, p.difference, p.low, p.high, None, None, None, p.n, p.against, p.p])

    def _write_parquet(self, path: Path) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        rows = [outcome.flat() for outcome in self.outcomes]
        names = list(dict.fromkeys(name for row in rows for name in row))
        pq.write_table(pa.table({name: [row.get(name) for row in rows] for name in names}), path)


def _require_once(outcomes: Sequence[Outcome]) -> None:
    """Refuse repeated episodes: intervals would be too narrow."""
    counts = Counter(outcome.id for outcome in outcomes)
    ident, count = counts.most_common(1)[0] if counts else ("", 1)
    if count > 1:
        raise InputError(f"outcomes must have a place, agent and seed of their own, got {count} of {ident}: keep one")


Group = dict[tuple[Place, str], list[Outcome]]


def _groups(outcomes: Iterable[Outcome]) -> Group:
    groups: Group = defaultdict(list)
    for outcome in outcomes:
        groups[(outcome.task.place, outcome.agent)].append(outcome)
    return groups


def _cells(suite: SuiteConfig, groups: Group) -> list[Cell]:
    found = []
    for place in suite.places:
        for agent in suite.agents:
            here = groups.get((place, agent), [])
            if here:
                metrics = {m.key: _estimate(m, here) for m in METRICS}
                untuned = is_untuned(suite.agents[agent], place)
                found.append(Cell(*place, agent, len(here), _failed(here), metrics, untuned))
    return found


def _estimate(metric: Metric, outcomes: Sequence[Outcome]) -> Estimate:
    values = [value for outcome in outcomes if (value := metric.take(outcome)) is not None]
    return estimate(np.array(values, dtype=np.float64), metric.rate, metric.bounds)


def _failed(outcomes: Iterable[Outcome]) -> int:
    return sum(outcome.failed for outcome in outcomes)


def _pairs(suite: SuiteConfig, groups: Group) -> list[Paired]:
    found = []
    for place in suite.places:
        by_seed = {agent: {o.seed: o for o in groups.get((place, agent), [])} for agent in suite.agents}
        for reference in suite.references:
            theirs = by_seed.get(reference, {})
            for agent, ours in by_seed.items():
                if theirs and ours and agent != reference:
                    found += _paired(place, agent, reference, ours, theirs)
    return found


def _paired(
    place: Place, agent: str, reference: str, ours: Mapping[int, Outcome], theirs: Mapping[int, Outcome]
) -> list[Paired]:
    failed = _failed(ours.values()) + _failed(theirs.values())
    differences = {metric.key: _difference(metric, ours, theirs) for metric in METRICS}
    return [Paired(*place, agent, reference, key, **asdict(d), failed=failed) for key, d in differences.items()]


def _difference(metric: Metric, ours: Mapping[int, Outcome], theirs: Mapping[int, Outcome]) -> Difference:
    pairs = [(metric.take(ours[seed]), metric.take(theirs[seed])) for seed in ours if seed in theirs]
    both = np.array([pair for pair in pairs if None not in pair], dtype=np.float64).reshape(-1, 2)
    return difference(both[:, 0], both[:, 1], metric.better, metric.rate)


def _described(metric: Metric) -> dict[str, Any]:
    return {key: getattr(metric, key) for key in ("key", "title", "unit", "better", "meaning")}
