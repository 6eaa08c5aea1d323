"""The vector engine in several processes: each drives a block of the environments on one thread, with the same results.

Python and NumPy between kernels hold the interpreter's lock, so that threads gain little where environments are few;
processes do not share it. Commands go through pipes; outcomes and observations come back in memory that all share. Each
process makes its own environment: what highway-env stores in classes when it makes a world is there too.
"""

from __future__ import annotations

import itertools
import multiprocessing
import pickle
import signal
import traceback
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.records_kernel import OUTCOME
from lanebound.envs.core import DrivingEnv
from lanebound.envs.info import own_info
from lanebound.envs.vector.engine import Engine, meta_codes
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.sensors.faults import Fault

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

__all__ = ["EngineProcesses", "require_processes"]

Rows = NDArray[np.int64]
IDLE_S = 0.02  # without a command, after which a process prepares episodes, such as while a policy is updated
LEAVE_S = 5.0  # time that a process has to end
SPAWN = multiprocessing.get_context("spawn")  # a fork would copy threads in any state
GUARD = (
    'make environments below `if __name__ == "__main__":` in a script, and not in one that is read from standard input'
)


class _Board(NamedTuple):
    """The memory that the engine and its processes share.

    outcome : (N,) OUTCOME
    own : (K, N) own entries of infos
    frame : (N, E) newest observations
    ready : (N,) which environments have a next episode that waits
    """

    outcome: Records
    own: NDArray[np.float64]
    frame: NDArray[np.float32]
    ready: NDArray[np.bool_]

    @classmethod
    def of(cls, memory: Any, count: int, entries: int, own: int) -> _Board:
        """Views of a block of memory of :meth:`size`."""
        ends = np.cumsum([count * OUTCOME.itemsize, count * own * 8, count * entries * 4])
        outcome, extra, frame, ready = np.split(np.frombuffer(memory, dtype=np.uint8), ends)
        return cls(
            outcome.view(OUTCOME),
            extra.view(np.float64).reshape(own, count),
            frame.view(np.float32).reshape(count, entries),
            ready.view(np.bool_),
        )

    @staticmethod
    def size(count: int, entries: int, own: int) -> int:
        """Bytes for so many environments, entries of an observation and own entries of infos."""
        return count * (OUTCOME.itemsize + own * 8 + entries * 4 + 1)

    def take(self, engine: Engine, rows: slice) -> None:
        """Store what a step of some environments has come to."""
        self.outcome[rows], self.frame[rows], self.ready[rows] = engine.outcome, engine.frame, engine.ready
        for place, values in zip(self.own, engine.own_info.values(), strict=True):
            place[rows] = values


class _Block(NamedTuple):
    """A process and the environments ``first`` to ``end`` that it drives."""

    process: BaseProcess
    pipe: Connection
    first: int
    end: int


class EngineProcesses:
    """N environments that step together in several processes; in each an :class:`Engine` has a block of them.

    Parameters
    ----------
    make : makes an environment of the configuration, in any process; it must be picklable
    single : what it makes
    count : number N of environments
    processes : at most N
    initialize : called first in each process, such as to import plug-ins; None: nothing

    Attributes
    ----------
    outcome : (N,) OUTCOME of the last step
    frame : (N, E) newest observations
    own_info : (N,) each, numbers of ``info`` that not all environments have, by name
    codes : (A,) code of each meta-action of the action space, none under continuous actions

    Raises
    ------
    InputError
        ``make`` or ``initialize`` cannot be given to another process, or that one lacks a plug-in.
    RuntimeError
        A process has ended.
    """

    def __init__(
        self,
        make: Callable[[], DrivingEnv],
        single: DrivingEnv,
        count: int,
        processes: int,
        initialize: Callable[[], object] | None = None,
    ) -> None:
        self.count, self.codes = count, meta_codes(single)
        names, entries = list(own_info(single.config)), [entry.column for entry in single.observer.index]
        sizes = count, len(entries), len(names)
        memory = SPAWN.RawArray("b", _Board.size(*sizes))
        self.outcome, own, self.frame, self._ready = _Board.of(memory, *sizes)
        self.own_info: Mapping[str, NDArray[np.float64]] = dict(zip(names, own, strict=True))
        ends = [count * k // processes for k in range(processes + 1)]
        try:  # before a process starts
            job = pickle.dumps(initialize), pickle.dumps(make)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(f"processes must be 1 here, got {processes}: the configuration cannot be given to another "
                             f"process ({error})") from None  # fmt: skip
        self._numbers, self._opened, self._torn = itertools.count(), False, False
        self._workers = [_start(memory, sizes, *block) for block in itertools.pairwise(ends)]
        self._end = weakref.finalize(self, _end_all, self._workers)
        try:
            self._ask("open", [(*job, w.end - w.first, names, entries) for w in self._workers])
        except BaseException:
            self.close()
            raise
        self._opened = True

    def reset(
        self, rows: Rows, seeds: list[int | None], faults: Sequence[Sequence[Fault] | None] = ()
    ) -> None:  # fmt: skip
        """:meth:`Engine.reset`."""
        follows = np.array([seed is None for seed in seeds], dtype=np.bool_)
        if not self._ready[rows[follows]].all():  # all processes at once: one that prepares alone delays the others
            self._ask("prepare", [()] * len(self._workers))
        places = self._places(rows)
        self._ask(
            "reset", [(rows[p] - w.first, seeds[p], list(faults[p])) if rows[p].size else None for w, p in places]
        )
        self._torn = self._torn and rows.size < self.count

    def step(self, actions: NDArray[Any], rows: Rows | None = None) -> None:
        """:meth:`Engine.step`.

        Raises
        ------
        InputError
            The last step was interrupted, and not all environments have been reset since.
        """
        if self._torn:
            raise InputError(
                "reset must come first, got step() after one that was interrupted or failed: reset all environments"
            )
        where = np.arange(self.count) if rows is None else rows
        parts = [(w, where[p]) for w, p in self._places(where)]
        self._torn = True  # until all have answered
        self._ask("step", [(actions[w.first : w.end], own - w.first) if own.size else None for w, own in parts])
        self._torn = False

    def sensible(self) -> NDArray[np.bool_]:
        """:meth:`Engine.sensible`."""
        return np.concatenate(self._ask("sensible", [()] * len(self._workers)))

    @property
    def bytes_per_environment(self) -> int:
        """:attr:`Engine.bytes_per_environment`, of the process that needs most."""
        return int(max(self._ask("__getattribute__", [("bytes_per_environment",)] * len(self._workers))))

    def close(self) -> None:
        """End all processes."""
        self._end()

    # Messages

    def _places(self, rows: Rows) -> list[tuple[_Block, slice]]:
        """Of each process, the part of ``rows``, which ascend, that it drives."""
        ends = np.searchsorted(rows, [w.end for w in self._workers]).tolist()
        return [(w, slice(a, b)) for w, a, b in zip(self._workers, [0, *ends[:-1]], ends, strict=True)]

    def _ask(self, method: str, arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """Answers of all processes that have arguments; an error of one is raised when all have answered."""
        number = next(self._numbers)
        messages = [None if given is None else (number, method, pickle.dumps(given)) for given in arguments]
        asked = [worker for worker, message in zip(self._workers, messages, strict=True) if message is not None]
        for worker, message in zip(self._workers, messages, strict=True):
            if message is not None:
                with self._alive(worker), _whole():
                    worker.pipe.send(message)
        answers = [self._answer(worker, number) for worker in asked]
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return answers

    def _answer(self, worker: _Block, number: int) -> Any:
        """The answer to a message; those to earlier ones, whose wait was interrupted, are left aside."""
        with self._alive(worker):
            while True:
                worker.pipe.poll(None)  # may be interrupted, and takes nothing out
                with _whole():
                    answered, answer = worker.pipe.recv()
                if answered == number:
                    return answer

    @contextmanager
    def _alive(self, worker: _Block) -> Iterator[None]:
        """Raise RuntimeError when the process of a pipe has ended."""
        try:
            yield
        except (EOFError, ConnectionError):
            worker.process.join(LEAVE_S)
            code = worker.process.exitcode
            remedy = "make the environments anew"
            if code == -signal.SIGKILL:
                remedy += "; where memory is short the system kills processes"
            elif not self._opened:
                remedy = GUARD
            raise RuntimeError(f"the process of environments {worker.first} to {worker.end - 1} has ended, exit code "
                               f"{code}: {remedy}") from None  # fmt: skip


def require_processes(processes: object, count: int) -> int:
    """A number of processes for N environments.

    Raises
    ------
    InputError
        It is no whole number from 1 to N, or more than 1 in a worker process.
    """
    if isinstance(processes, bool) or not isinstance(processes, int | np.integer) or not 1 <= processes <= count:
        raise InputError(
            f"processes must be an int from 1 to num_envs = {count}, got {processes!r}: give 1 to drive in this process"
        )
    here = multiprocessing.current_process()
    if processes > 1 and here.daemon:
        raise InputError(f"processes must be 1 in a worker process, which cannot have its own, got {processes}: give 1")
    if processes > 1 and getattr(here, "_inheriting", False):  # a worker that imports the script of its parent
        raise InputError(f"processes must be 1 while a worker process starts, got {processes}: {GUARD}")
    return int(processes)


@contextmanager
def _whole() -> Iterator[None]:
    """Hold interruptions back until a message is written or read whole."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start(memory: Any, sizes: tuple[int, int, int], first: int, end: int) -> _Block:
    ours, theirs = SPAWN.Pipe()
    process = SPAWN.Process(target=_serve, args=(theirs, memory, sizes, first), daemon=True, name=f"lanebound-{first}")
    resource_tracker.ensure_running()  # which would allow interruptions again
    with _whole():  # the process has this mask for good: its parent is interrupted, and closes the pipe
        process.start()
    theirs.close()  # so that ours reads the end of the file when the process ends
    return _Block(process, ours, first, end)


def _end_all(workers: Sequence[_Block]) -> None:
    for worker in workers:
        worker.pipe.close()  # they end when they read from it
    for worker in workers:
        worker.process.join(LEAVE_S)
        if worker.process.is_alive():  # in the middle of a long step
            worker.process.terminate()
            worker.process.join()


def _serve(pipe: Connection, memory: Any, sizes: tuple[int, int, int], first: int) -> None:
    """Answer until the pipe is closed."""
    shared, engine, rows = _Board.of(memory, *sizes), None, slice(first, first)
    while True:
        number, answer = -1, None
        try:
            if engine is not None and not pipe.poll(IDLE_S):
                with suppress(Exception):  # it is raised where the episode is asked for
                    engine.prepare()
                shared.take(engine, rows)
            number, method, given = pipe.recv()
            arguments = pickle.loads(given)
            if method == "open":
                engine = _open(*arguments)
                rows = slice(first, first + engine.count)
            else:
                answer = getattr(engine, method)(*arguments)
            if engine is not None:
                shared.take(engine, rows)
        except (EOFError, ConnectionError):
            return
        except Exception as error:
            answer = _portable(error)
        with suppress(ConnectionError):  # the parent has gone; so the next message ends this loop
            pipe.send((number, answer))


def _open(initialize: bytes, make: bytes, count: int, names: list[str], entries: list[str]) -> Engine:
    """The engine of a block; what ``initialize`` imports is there before the environment is made."""
    first = pickle.loads(initialize)
    if first is not None:
        first()
    engine = Engine(pickle.loads(make)(), count)
    theirs = [entry.column for entry in engine.single.observer.index]
    for what, here, there in (("info", list(engine.own_info), names), ("the observation", theirs, entries)):
        if here != there:
            odd = sorted(set(here) ^ set(there)) or there
            raise InputError(
                f"processes must be 1 where workers have other entries of {what} than this process, got {odd[0]!r} in "
                "one alone or in another order: register it in initialize"
            )
    return engine


def _portable(error: Exception) -> Exception:
    """The error with its traceback, as one that another process can read."""
    text = traceback.format_exc()
    try:
        if type(pickle.loads(pickle.dumps(error))) is not type(error):
            raise TypeError(error)
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(text)
    return error
