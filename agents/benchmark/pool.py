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
from contextlib import contextmanager, suppress
from ctypes import c_bool, c_double
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any

from lanebound.agents.benchmark.compiling import CompileClock
from lanebound.agents.benchmark.outcome import Outcome, Status, Task
from lanebound.agents.benchmark.work import Work
from lanebound.agents.kept import STARTING, one_thread
from lanebound.integrity.core.errors import InputError

__all__ = ["Pool"]

LOOK_S = 0.2  # between looks at the clocks


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

    Attributes
    ----------
    driven_s : time that finished episodes took their processes, without starting these and compiling kernels
    compiling : how many processes compile kernels now
    """

    def __init__(self, work: Work, jobs: int) -> None:
        self.work, self.jobs = work, jobs
        self.driven_s, self.compiling = 0.0, 0

    def run(
        self,
        tasks: Iterable[Task],
        may_start: Callable[[], bool] = lambda: True,
        looked: Callable[[], None] = lambda: None,
    ) -> Iterator[Outcome]:
        """Drive episodes and give the outcome of each as it is finished and stored, in whatever order.

        Parameters
        ----------
        may_start : asked before every episode; after a no, those under way are finished and no other is begun
        looked : called a few times a second
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
                ready = _ready(busy)
                self.compiling = sum(worker.compiles.at_work for worker in busy)
                looked()
                for worker in ready:
                    found = worker.outcome()
                    self.driven_s += worker.driven_s
                    yield found
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
        self.driven_s = 0.0

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        agents, compilers = context.RawArray(c_double, 2), context.RawArray(c_double, 2)
        self.serves = context.RawValue(c_bool, False)
        self.clock, self.compiles = SharedClock(agents), CompileClock(compilers)
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, agents, compilers, self.serves), daemon=True)
        with STARTING, one_thread(), _deaf_to_interrupts():
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
        """What came of its episode; a process that cannot tell any more is replaced.

        Raises
        ------
        InputError
            It ended before it served, as it does where a script that it imports begins the run anew.
        """
        task, self.task = self.task, None
        assert task is not None
        self.driven_s = self.clock.spent_s
        try:
            if self.pipe.poll():
                found: Outcome
                found, self.driven_s = self.pipe.recv()
                return found
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode
            if not self.serves.value:
                raise InputError(
                    f"a process for episodes ended while it was started (exit code {code}; what it printed is above): "
                    "in a script the run must stand below if __name__ == '__main__':"
                ) from None
            return self._replaced(task, "raised", f"its process died with exit code {code}")
        limit = self.work.suite.episode_timeout_s
        message = f"it took longer than episode_timeout_s = {limit:g} in all: no answer was waited for"
        return self._replaced(task, "timeout", message)

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
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that are started within never hear Ctrl-C, not even while they import; the parent answers it.

    The signal is blocked for this thread, which those processes inherit. Handlers can be set in the main thread alone.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # when it starts it lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# From here on: the worker's side


def _serve(pipe: Connection[Any, Any], agents: Any, compilers: Any, serves: Any) -> None:
    """Drive what comes through the pipe until it is closed."""
    serves.value = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it cannot be blocked
    Thread(target=_end_with_parent, daemon=True).start()
    os.dup2(2, 1)  # what agents print must not get into what the command prints
    clock, compiles = SharedClock(agents), CompileClock(compilers)
    compiles.watch()
    with suppress(EOFError, ConnectionError):  # the parent has gone
        work: Work = pipe.recv()
        while True:
            task = pipe.recv()
            begun, compiled_s = time.monotonic(), compiles.spent_s
            outcome = work.drive(task, clock)
            pipe.send((outcome, time.monotonic() - begun - (compiles.spent_s - compiled_s)))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
