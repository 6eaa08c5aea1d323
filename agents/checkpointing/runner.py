"""The runner of all resumable work: it computes missing parts, in this process or in workers, within a budget.

Workers compute one part at a time each, observed by the parent, and are ended and replaced when a part takes too long.
A worker starts from nothing (``spawn``), computes on one thread, ignores interrupts, and ends with its parent.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import pickle
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from ctypes import c_bool, c_double
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from threading import Lock, Thread
from typing import Any, Literal, Protocol

from lanebound.agents.checkpointing.files import read_json, write_json
from lanebound.agents.checkpointing.folder import locked
from lanebound.agents.plugins import load_plugins, loaded_plugins
from lanebound.integrity.core.errors import InputError

Lost = Literal["died", "timeout"]
STARTING = Lock()
"""Held while a process is started. Acquire it before ending this process at once: no process is half started then."""
POLL_S = 0.2
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class PartStatus:
    """What a process reports of the part that it computes, in memory that its parent reads.

    Parameters
    ----------
    shared : array of ``SIZE`` zeros that both processes see: time used and when its measurement began (0: it is off),
        share of the part that is done, depth of compilations in progress
    advanced : called when a share is reported
    """

    SIZE = 4

    def __init__(self, shared: Any, advanced: Callable[[], None] = lambda: None) -> None:
        self._shared, self._advanced = shared, advanced

    def clear(self) -> None:
        """Another part begins."""
        self._shared[0] = self._shared[1] = self._shared[2] = 0.0

    def begin(self) -> None:
        """Begin the measurement of the time that a timeout limits."""
        self._shared[1] = time.monotonic()

    def end(self) -> None:
        """End that measurement."""
        begun, self._shared[1] = self._shared[1], 0.0
        self._shared[0] += time.monotonic() - begun

    @property
    def used_s(self) -> float:
        """Time measured so far [s]."""
        used, begun = self._shared[0], self._shared[1]
        return float(used + (time.monotonic() - begun if begun > 0.0 else 0.0))

    def advance(self, share: float) -> None:
        """Report the share of the part that is done, 0 to 1."""
        self._shared[2] = share
        self._advanced()

    @property
    def share(self) -> float:
        """The share of the part that is done, as last reported."""
        return float(self._shared[2])

    def watch_compilation(self) -> None:
        """Note from now on whether kernels are compiled."""
        from numba.core import event

        class Listener(event.Listener):
            """Kernels that call kernels are compiled within each other."""

            def on_start(listener, event: Any) -> None:  # noqa: N805 - self is the status
                self._shared[3] += 1.0

            def on_end(listener, event: Any) -> None:  # noqa: N805
                self._shared[3] -= 1.0

        event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]

    @property
    def compiles(self) -> bool:
        """Whether a kernel is being compiled."""
        return bool(self._shared[3] > 0.0)


class Computation(Protocol):
    """What is computed for each part; pickled once for each worker.

    Attributes
    ----------
    timeout_s : largest :attr:`PartStatus.used_s` of a part [s]
    """

    @property
    def timeout_s(self) -> float: ...

    def do(self, part: Any, status: PartStatus) -> Any:
        """Compute a part and write its file; returns its result."""

    def lost(self, part: Any, reason: Lost, message: str) -> Any:
        """The result of a part whose worker died or was ended; called in the parent. It may raise instead."""


class InProcess:
    """Computes parts one after another in this process, on all its threads; same interface as :class:`Pool`."""

    compiling = 0  # accel logs a compilation in this process

    def __init__(self, work: Computation) -> None:
        self.work = work
        self._part: tuple[Any, PartStatus] | None = None

    def run(
        self, parts: Sequence[Any], may_start: Callable[[], bool], polled: Callable[[], None]
    ) -> Iterator[tuple[Any, Any]]:
        """Finished parts, in order, with their results."""
        for part in parts:
            if not may_start():
                return
            status = PartStatus([0.0] * PartStatus.SIZE, polled)
            self._part = (part, status)
            result = self.work.do(part, status)
            self._part = None
            yield part, result

    @property
    def running(self) -> list[tuple[Any, float]]:
        """The part in progress, with the share of it that is done."""
        return [] if self._part is None else [(self._part[0], self._part[1].share)]


class Pool:
    """Computes parts in worker processes.

    Parameters
    ----------
    jobs : number of processes
    """

    def __init__(self, work: Computation, jobs: int) -> None:
        self.work, self.jobs = work, jobs
        self._workers: list[_Worker] = []

    def run(
        self,
        parts: Sequence[Any],
        may_start: Callable[[], bool] = lambda: True,
        polled: Callable[[], None] = lambda: None,
    ) -> Iterator[tuple[Any, Any]]:
        """Finished parts, in the order in which they end, with their results.

        Parameters
        ----------
        may_start : called before every part; after False the parts in progress are finished and no other is started
        polled : called a few times a second
        """
        waiting = deque(parts)
        self._workers = [_Worker(self.work) for _ in range(min(self.jobs, len(waiting)))]
        try:
            while True:
                for worker in self._workers:
                    if worker.part is None and waiting:
                        if not may_start():
                            waiting.clear()  # nobody is asked again: how often a pool looks depends on the machine
                            break
                        worker.give(waiting.popleft())
                if not self._busy:
                    return
                ready = wait([worker.pipe for worker in self._busy], timeout=POLL_S)
                polled()
                for worker in [worker for worker in self._busy if worker.pipe in ready or worker.late]:
                    yield worker.part, worker.result()  # in this order: result() clears the part
        finally:
            for worker in self._workers:
                worker.kill()

    @property
    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.part is not None]

    @property
    def running(self) -> list[tuple[Any, float]]:
        """Parts in progress, with the shares of them that are done."""
        return [(worker.part, worker.status.share) for worker in self._busy]

    @property
    def compiling(self) -> int:
        """Number of processes that compile kernels now."""
        return sum(worker.status.compiles for worker in self._busy)


class _Worker:
    """A worker process, seen from its parent."""

    def __init__(self, work: Computation) -> None:
        self.work = work
        self.part: Any = None
        self.alive = False

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        shared = context.RawArray(c_double, PartStatus.SIZE)
        self.serves = context.RawValue(c_bool, False)
        self.status = PartStatus(shared)
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(theirs, shared, self.serves, [*loaded_plugins()]), daemon=True
        )
        with STARTING, one_thread(), _interrupts_blocked():
            self.process.start()
        theirs.close()
        self.alive = True
        self.pipe.send(self.work)

    def give(self, part: Any) -> None:
        """Start a part; a missing process is started."""
        if not self.alive:
            self._start()
        self.part = part
        self.status.clear()
        self.pipe.send(part)

    @property
    def late(self) -> bool:
        """Whether the part has used its time."""
        return self.status.used_s > self.work.timeout_s

    def result(self) -> Any:
        """The result of the part; a process that is dead or late is replaced at the next part.

        Raises
        ------
        InputError
            The process ended before it served, as where a script that it imports starts the run again.
        Exception
            What the work raised.
        """
        part, self.part = self.part, None
        try:
            answer = self.pipe.recv() if self.pipe.poll() else None
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode
            if not self.serves.value:
                raise InputError(
                    f"a worker process ended while it was started (exit code {code}; its output is above): "
                    "in a script the run must stand below if __name__ == '__main__':"
                ) from None
            return self._lost(part, "died", f"its process died with exit code {code}")
        if answer is None:
            return self._lost(part, "timeout", f"it took longer than {self.work.timeout_s:g} s in all")
        result, error = answer
        if error is not None:
            raise error
        return result

    def _lost(self, part: Any, reason: Lost, message: str) -> Any:
        self.kill()
        return self.work.lost(part, reason, message)

    def kill(self) -> None:
        """End the process at once; files are complete at any time."""
        if self.alive:
            self.process.kill()
            self.process.join()
            self.pipe.close()
        self.alive = False


@contextmanager
def one_thread() -> Iterator[None]:
    """Processes started in this context compute on one thread: libraries read these variables once, when loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes started in this context never receive Ctrl-C, even while they import; the parent handles it.

    The signal is blocked for this thread, which child processes inherit. Handlers can be set in the main thread only.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# In the worker process


def _serve(pipe: Connection[Any, Any], shared: Any, serves: Any, plugins: list[str]) -> None:
    """Compute the parts that come through the pipe until it is closed."""
    serves.value = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it cannot be blocked
    Thread(target=_end_with_parent, daemon=True).start()
    os.dup2(2, 1)  # what the work prints must not get into the output of the command
    logging.getLogger("lanebound").setLevel(logging.ERROR)  # the parent reports compilations
    status = PartStatus(shared)
    status.watch_compilation()
    with suppress(EOFError, ConnectionError):  # the parent has ended
        load_plugins(plugins)
        work = pipe.recv()
        while True:
            pipe.send(_answer(work, pipe.recv(), status))


def _answer(work: Computation, part: Any, status: PartStatus) -> tuple[Any, Exception | None]:
    """The result of a part, or the exception that it raised, with its traceback as a note."""
    try:
        return work.do(part, status), None
    except Exception as error:
        text = "".join(traceback.format_exception(error))
        error.add_note(text)
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # exceptions of other packages need not be picklable
            return None, RuntimeError(text)
        return None, error


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


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
