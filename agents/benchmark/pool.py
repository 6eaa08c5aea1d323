"""Worker processes: one episode at a time each, watched from outside, killed and replaced when an agent hangs.

A worker is a process of its own that begins from nothing (``spawn``), computes on one thread, and keeps its
environments until the work comes to another id. It ends with its parent, whatever happens to that.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from ctypes import c_double
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any

from lanebound.agents.benchmark.outcome import Outcome, Status, Task
from lanebound.agents.benchmark.work import Work

__all__ = ["Pool"]

LOOK_S = 0.2  # between looks at the clocks
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class SharedClock:
    """How long an agent has worked in this episode, as two processes see it."""

    def __init__(self, shared: Any) -> None:
        self._shared = shared

    def begin(self) -> None:
        """The agent begins."""
        self._shared[1] = time.monotonic()

    def end(self) -> None:
        """The agent is done."""
        begun, self._shared[1] = self._shared[1], 0.0
        self._shared[0] += time.monotonic() - begun

    def clear(self) -> None:
        """Another episode."""
        self._shared[0] = self._shared[1] = 0.0

    @property
    def spent_s(self) -> float:
        """Its time, what it is at now included."""
        done, begun = self._shared[0], self._shared[1]
        return float(done + (time.monotonic() - begun if begun > 0.0 else 0.0))


class Pool:
    """Processes that drive episodes.

    Parameters
    ----------
    work : what an episode is driven by
    jobs : number of processes
    """

    def __init__(self, work: Work, jobs: int) -> None:
        self.work, self.jobs = work, jobs

    def run(self, tasks: Iterable[Task], may_start: Callable[[], bool] = lambda: True) -> Iterator[Outcome]:
        """Drive episodes and give the outcome of each as it is finished and stored, in whatever order.

        Parameters
        ----------
        may_start : asked before every episode; after a no, those under way are finished and no other is begun
        """
        waiting = deque(tasks)
        workers = [_Worker(self.work) for _ in range(min(self.jobs, len(waiting)))]
        try:
            while True:
                for worker in workers:
                    if worker.task is None and waiting and may_start():
                        worker.give(waiting.popleft())
                busy = [worker for worker in workers if worker.task is not None]
                if not busy:
                    return
                for worker in _ready(busy):
                    yield worker.outcome()
        finally:
            for worker in workers:
                worker.kill()


def _ready(busy: list[_Worker]) -> list[_Worker]:
    """Workers that have something to tell, have died or have taken too long; waits a little for them."""
    told = wait([worker.pipe for worker in busy], timeout=LOOK_S)
    return [worker for worker in busy if worker.pipe in told or worker.late]


class _Worker:
    """A process from its parent's side."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.task: Task | None = None
        self.alive = False

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        shared = context.RawArray(c_double, 2)
        self.clock = SharedClock(shared)
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, shared), daemon=True)
        with _one_thread():
            self.process.start()
        theirs.close()
        self.alive = True
        self.pipe.send(self.work)

    def give(self, task: Task) -> None:
        """Have an episode driven."""
        if not self.alive:
            self._start()
        self.task = task
        self.clock.clear()
        self.pipe.send(task)

    @property
    def late(self) -> bool:
        """Whether the agent has taken more time than it has."""
        return self.clock.spent_s > self.work.suite.episode_timeout_s

    def outcome(self) -> Outcome:
        """What came of its episode; a process that cannot tell any more is replaced."""
        task, self.task = self.task, None
        assert task is not None
        try:
            if self.pipe.poll():
                found: Outcome = self.pipe.recv()
                return found
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode
            return self._replaced(task, "raised", f"its process died with exit code {code}")
        limit = self.work.suite.episode_timeout_s
        return self._replaced(task, "timeout", f"it took longer than {limit:g} s in all: no answer was waited for")

    def _replaced(self, task: Task, status: Status, message: str) -> Outcome:
        self.kill()
        return self.work.keep_failure(task, status, message)

    def kill(self) -> None:
        """End the process at once; files are whole at any time."""
        if self.alive:
            self.process.kill()
            self.process.join()
            self.pipe.close()
        self.alive = False


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes that are started within compute on one thread: libraries ask once, when they are loaded."""
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


# From here on: the worker's side


def _serve(pipe: Connection[Any, Any], shared: Any) -> None:
    """Drive what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent answers Ctrl-C
    Thread(target=_end_with_parent, daemon=True).start()
    os.dup2(2, 1)  # what agents print must not get into what the command prints
    clock = SharedClock(shared)
    try:
        work: Work = pipe.recv()
        while True:
            pipe.send(work.drive(pipe.recv(), clock))
    except EOFError:
        return


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
