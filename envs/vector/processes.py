"""The vector engine in several processes: each drives a block of the environments on one thread, with the same results.

Python and NumPy between kernels hold the interpreter's lock, so that threads gain little where environments are few;
processes do not share it. Commands go through pipes; outcomes and observations come back in memory that all share.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.records_kernel import OUTCOME
from lanebound.envs.core import DrivingEnv
from lanebound.envs.info import info_entries
from lanebound.envs.vector.engine import Engine, meta_codes
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.sensors.faults import Fault

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

__all__ = ["EngineProcesses", "require_processes"]

Rows = NDArray[np.int64]
IDLE_S = 0.02  # without a command, after which a process prepares episodes; a step of a policy takes less
LEAVE_S = 5.0  # time that a process has to end
SPAWN = multiprocessing.get_context("spawn")  # a fork would copy threads in any state


class _Shared(NamedTuple):
    """What the engine and its processes share.

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
    def of(cls, memory: Any, count: int, entries: int, own: int) -> _Shared:
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


class _Worker(NamedTuple):
    """A process and the environments ``first`` to ``end`` that it drives."""

    process: BaseProcess
    pipe: Connection
    first: int
    end: int


class EngineProcesses:
    """N environments that step together in several processes; in each an :class:`Engine` has a block of them.

    Parameters
    ----------
    single : one environment of the configuration; it must be picklable
    count : number N of environments
    processes : at most N
    initialize : called first in each process, such as to import plug-ins; None: nothing

    Attributes
    ----------
    outcome : (N,) OUTCOME of the last step
    frame : (N, E) newest observations
    own_info : (N,) each, numbers of ``info`` that plug-ins add, by name
    codes : (A,) code of each meta-action of the action space, none under continuous actions

    Raises
    ------
    InputError
        The configuration or ``initialize`` cannot be given to another process.
    """

    def __init__(
        self, single: DrivingEnv, count: int, processes: int, initialize: Callable[[], object] | None = None
    ) -> None:
        self.single, self.count, self.codes = single, count, meta_codes(single)
        names = [entry.name for entry in info_entries()]
        sizes = count, len(single.observer.index), len(names)
        memory = SPAWN.RawArray("b", _Shared.size(*sizes))
        self.outcome, own, self.frame, self._ready = _Shared.of(memory, *sizes)
        self.own_info: Mapping[str, NDArray[np.float64]] = dict(zip(names, own, strict=True))
        ends = [count * k // processes for k in range(processes + 1)]
        try:  # before a process starts: a half-written message would leave it waiting
            job = pickle.dumps(initialize), pickle.dumps(single)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(f"processes must be 1 here, got {processes}: the configuration cannot be given to another "
                             f"process ({error})") from None  # fmt: skip
        self._workers = [_start(memory, sizes, *block) for block in itertools.pairwise(ends)]
        self._owed = [0] * processes  # answers to come; more than one after an interruption
        try:
            self._ask("open", [(*job, w.end - w.first) for w in self._workers])
        except BaseException:
            self.close()
            raise

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

    def step(self, actions: NDArray[Any], rows: Rows | None = None) -> None:
        """:meth:`Engine.step`."""
        if rows is None:
            self._ask("step", [(actions[w.first : w.end], None) for w in self._workers])
            return
        self._ask(
            "step",
            [
                (actions[w.first : w.end], rows[p] - w.first) if rows[p].size else None
                for w, p in self._places(rows)
            ],
        )  # fmt: skip

    def sensible(self) -> NDArray[np.bool_]:
        """:meth:`Engine.sensible`."""
        return np.concatenate(self._ask("sensible", [()] * len(self._workers)))

    @property
    def bytes_per_environment(self) -> int:
        """:attr:`Engine.bytes_per_environment`, of the process that needs most."""
        return int(max(self._ask("__getattribute__", [("bytes_per_environment",)] * len(self._workers))))

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.pipe.close()  # they end when they read from it
        for worker in self._workers:
            worker.process.join(LEAVE_S)
            if worker.process.is_alive():  # in the middle of a long step
                worker.process.terminate()
                worker.process.join()

    # Messages

    def _places(self, rows: Rows) -> list[tuple[_Worker, slice]]:
        """Of each process, the part of ``rows``, which ascend, that it drives."""
        ends = np.searchsorted(rows, [w.end for w in self._workers]).tolist()
        return [(w, slice(a, b)) for w, a, b in zip(self._workers, [0, *ends[:-1]], ends, strict=True)]

    def _ask(self, method: str, arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """Answers of all processes that have arguments; an error of one is raised when all have answered."""
        asked = [k for k, given in enumerate(arguments) if given is not None]
        for k in asked:
            while self._owed[k]:  # an interrupted call is forgotten
                self._receive(k)
            self._send(k, (method, arguments[k]))
        answers = [self._receive(k) for k in asked]
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return answers

    def _send(self, k: int, message: tuple[str, tuple[Any, ...] | None]) -> None:
        with self._alive(k):
            self._workers[k].pipe.send(message)
        self._owed[k] += 1

    def _receive(self, k: int) -> Any:
        with self._alive(k):
            answer = self._workers[k].pipe.recv()
        self._owed[k] -= 1
        return answer

    @contextlib.contextmanager
    def _alive(self, k: int) -> Any:
        """Raise RuntimeError when the process of a pipe has ended."""
        try:
            yield
        except (EOFError, ConnectionError, BrokenPipeError):
            worker = self._workers[k]
            worker.process.join(LEAVE_S)
            raise RuntimeError(
                f"the process of environments {worker.first} to {worker.end - 1} has ended "
                f"(exit code {worker.process.exitcode}; -9 often means too little memory): make the environments anew"
            ) from None


def require_processes(processes: object, count: int) -> int:
    """A number of processes for N environments.

    Raises
    ------
    InputError
        It is no whole number from 1 to N.
    """
    if isinstance(processes, bool) or not isinstance(processes, int | np.integer) or not 1 <= processes <= count:
        raise InputError(
            f"processes must be an int from 1 to num_envs = {count}, got {processes!r}: give 1 for none but this one"
        )
    if processes > 1 and multiprocessing.current_process().daemon:
        raise InputError(f"processes must be 1 in a worker process, which cannot have its own, got {processes}: give 1")
    return int(processes)


def _start(memory: Any, sizes: tuple[int, int, int], first: int, end: int) -> _Worker:
    ours, theirs = SPAWN.Pipe()
    process = SPAWN.Process(target=_serve, args=(theirs, memory, sizes, first), daemon=True, name=f"lanebound-{first}")
    process.start()
    theirs.close()  # so that ours reads the end of the file when the process ends
    return _Worker(process, ours, first, end)


def _serve(pipe: Connection, memory: Any, sizes: tuple[int, int, int], first: int) -> None:
    """Answer until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted, and closes the pipe
    shared, engine = _Shared.of(memory, *sizes), None
    rows = slice(first, first)
    while True:
        try:
            if engine is not None and not pipe.poll(IDLE_S):  # such as while a policy is updated
                with contextlib.suppress(Exception):  # it is raised where the episode is asked for
                    engine.prepare()
                shared.take(engine, rows)
            method, arguments = pipe.recv()
        except (EOFError, ConnectionError):
            return
        answer: Any = None
        try:
            if method == "open":
                engine = _open(*arguments)
                rows = slice(first, first + engine.count)
            else:
                assert engine is not None
                answer = getattr(engine, method)(*arguments)
        except Exception as error:
            error.add_note(traceback.format_exc())
            answer = error
        if engine is not None:
            shared.take(engine, rows)
        with contextlib.suppress(ConnectionError):  # the parent has gone; so the next message ends this loop
            pipe.send(answer)


def _open(initialize: bytes, single: bytes, count: int) -> Engine:
    """The engine of a block; what ``initialize`` imports is there before the environment is read."""
    first = pickle.loads(initialize)
    if first is not None:
        first()
    return Engine(pickle.loads(single), count)
