"""The runner of all resumable work: it computes missing parts, in this process or in workers, within a budget."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lanebound.agents.checkpointing.files import read_json, write_json
from lanebound.agents.checkpointing.folder import locked
from lanebound.agents.checkpointing.pool import Computation, InProcess, Lost, PartStatus, Pool
from lanebound.integrity.core.errors import InputError

__all__ = ["Advance", "Counter", "OnProgress", "RunProgress", "available_cores", "ignore", "run_parts", "run_work"]

Advance = Callable[[float], None]
"""Called by the computation of a part with the share of it that is done, 0 to 1."""
Size = Callable[[Any], float]


@dataclass
class RunProgress:
    """How far a run is.

    Attributes
    ----------
    of : all parts, in the unit of their sizes, those of earlier runs included
    done : of them the finished ones, and of those in progress the shares that are done
    left_s : about how long the rest takes, compilation apart [s]; None while nothing is known
    compiling : number of processes that compile kernels now
    failed : parts that count as failures
    stage : noun of the parts, where it changes during a run
    """

    of: float
    done: float = 0.0
    left_s: float | None = None
    compiling: int = 0
    failed: int = 0
    stage: str = ""


KNOWN_SHARE = 0.003  # of what is left at the first count; the pace of less says little
OnProgress = Callable[[RunProgress], None]


def ignore(progress: Any) -> None:
    """Report no progress."""


class Counter:
    """Turns counts into progress, and estimates the time left by the pace since the first count.

    Later seconds count more, by the square of the time before: a run may begin with work that advances it little, such
    as imitation before learning. Nothing is estimated before KNOWN_SHARE of the rest is done.

    Parameters
    ----------
    on_progress : called at every count
    progress : the progress that is kept up to date
    """

    def __init__(self, on_progress: OnProgress, progress: RunProgress) -> None:
        self.on_progress, self.progress = on_progress, progress
        self._first = math.nan  # done at the first count
        self._spent_s, self._waited_s, self._then = 0.0, 0.0, time.monotonic()
        self._made, self._took_s = 0.0, 0.0  # weighted

    def __call__(self, done: float) -> None:
        now, p = time.monotonic(), self.progress
        if math.isnan(self._first):
            self._first = done
        elif not p.compiling:
            self._waited_s += now - self._then
        if done > p.done and self._waited_s > 0.0:
            self._spent_s += self._waited_s
            weight = self._spent_s**2
            self._made += weight * (done - p.done)
            self._took_s += weight * self._waited_s
            self._waited_s = 0.0
        self._then, p.done = now, done
        known = self._made > 0.0 and done - self._first >= KNOWN_SHARE * (p.of - self._first)
        p.left_s = self._took_s / self._made * (p.of - done) if known else None
        self.on_progress(p)


def run_work(
    parts: Sequence[Any],
    work: Computation,
    jobs: int,
    counter: Counter,
    *,
    isolated: bool = False,
    budget_h: float | None = None,
    size: Size = lambda part: 1.0,
) -> Iterator[tuple[Any, Any]]:
    """Compute parts and yield each with its result when it is finished and stored.

    Parameters
    ----------
    jobs : processes; with 1 the parts are computed in this process, on all its threads, unless ``isolated``
    counter : called a few times a second; ``counter.progress.done`` is what earlier runs did
    isolated : parts are computed in worker processes in any case, which may be ended
    budget_h : no part is started after that [h]
    size : of a part, in the unit of the progress
    """
    begun, done = time.monotonic(), counter.progress.done
    pool = Pool(work, jobs) if isolated or jobs > 1 else InProcess(work)

    def in_time() -> bool:
        return budget_h is None or time.monotonic() - begun <= 3600.0 * budget_h

    def update() -> None:
        counter.progress.compiling = pool.compiling
        counter(done + sum(size(part) * share for part, share in pool.running))

    counter(done)
    for part, result in pool.run(parts, in_time, update):
        done += size(part)
        yield part, result
        update()


@dataclass
class _JsonParts:
    """Work whose parts are JSON files ``parts/NAME.json``, computed by a function of the name."""

    folder: Path
    function: Callable[[str, Advance], Any]
    infinite: bool
    timeout_s: float = math.inf

    def path(self, name: str) -> Path:
        """The file of a part."""
        return self.folder / "parts" / f"{name}.json"

    def do(self, name: str, status: PartStatus) -> None:
        """Compute a part and write its file."""
        write_json(self.path(name), self.function(name, status.advance), self.infinite)

    def lost(self, name: str, reason: Lost, message: str) -> None:
        """Stop the run."""
        raise InputError(f"part {name} of {self.folder} must be computed, but {message}: run the same command again")


def run_parts(
    folder: Path,
    names: Sequence[str],
    function: Callable[[str, Advance], Any],
    jobs: int = 1,
    on_progress: OnProgress = ignore,
    *,
    size: Size = lambda name: 1.0,
    budget_h: float | None = None,
    infinite: bool = False,
) -> dict[str, Any]:
    """Plain data of parts by name, in order: those in the folder, and ``function(name, advance)`` for the others.

    Parameters
    ----------
    function : must be picklable with more than one job; each worker computes on one thread
    size : of a part, in the unit of the progress
    budget_h : no part is started after that [h]; the parts that are missing then are missing in the result
    infinite : parts hold infinity and NaN; else None in place of them
    """
    work = _JsonParts(folder, function, infinite)
    missing = [name for name in names if not work.path(name).exists()]
    of = sum(map(size, names))
    counter = Counter(on_progress, RunProgress(of, of - sum(map(size, missing))))
    with locked(folder):
        for _ in run_work(missing, work, jobs, counter, budget_h=budget_h, size=size):
            pass
    return {name: read_json(work.path(name), object) for name in names if work.path(name).exists()}


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
