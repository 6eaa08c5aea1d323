"""Configuration of Numba: options of all kernels, and threads.

Kernels run in Python threads, which wait for work without using a processor. Numba's own threads spin between kernels;
a second busy process on the machine makes them about fifty times slower. A kernel for :func:`run_rows` has the
signature ``kernel(first, last, *arguments)``, processes only the rows ``first`` to ``last - 1``, and releases the
interpreter lock.

Compiled kernels are cached on disk (:mod:`lanebound.integrity.core.kernel_cache`).
"""

from __future__ import annotations

import inspect
import itertools
import logging
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar, overload

import numba
from numba.core import event

from lanebound.integrity.core.kernel_cache import cache_directory, cache_root, locating
from lanebound.integrity.core.kernel_dispatcher import LEVEL, kernel_of

__all__ = ["LOGGER", "jit", "kernels_are_cached", "run_rows", "serial", "thread_count"]

F = TypeVar("F", bound=Callable[..., Any])
FASTMATH = {"nsz"}  # with more flags a fresh kernel and a cached one could differ in the last bit
PIECE_US = 80.0  # a thread needs about 40 us to start and to report its end
PIECES_PER_THREAD = 4
LOGGER = logging.getLogger("lanebound")
NOTICE_S = 2.0  # a shorter compilation is not reported


@overload
def jit(function: F) -> Any: ...
@overload
def jit(*, inline: bool = False, forceinline: bool = False, borrows: bool = False) -> Callable[[F], Any]: ...
def jit(function: F | None = None, *, inline: bool = False, forceinline: bool = False, borrows: bool = False) -> Any:
    """Compile with ``numba.njit`` and the options of this package: cached, C division, NaN and inf kept, sums in order.

    Kernels release the interpreter lock while they run. They are compiled by one thread at their first call.

    Parameters
    ----------
    inline : Numba inlines the function before type inference and does not compile it separately; for small functions
    forceinline : LLVM inlines the function; for functions with a NamedTuple of many arrays and few callers, because
        each array costs about 2 ns in a call
    borrows : no reference counting of arrays, which costs about 5 ns for each array of the arguments or their
        NamedTuples; only for functions that neither allocate nor return an array
    """

    def wrap(f: F) -> Any:
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH, "nogil": True}
        if inline:
            options["inline"] = "always"
        if forceinline:
            options["forceinline"] = True
        if borrows:
            options["_nrt"] = False
        kernel, directory = kernel_of(f, **options), _directory(f)
        if directory is None or kernel is f:
            return kernel
        try:
            with locating(directory):
                kernel.enable_caching()
        except RuntimeError:  # no locator for this file (interactive use): compile in memory
            pass
        return kernel

    return wrap if function is None else wrap(function)


@cache
def _directory_of(file: str) -> str | None:
    """Cache directory of the kernels of a file."""
    return cache_directory(Path(file), repr(("nogil", LEVEL, *sorted(FASTMATH))))


def _directory(function: Callable[..., Any]) -> str | None:
    """Cache directory of a kernel; None without a file (interactive use) or without a writable directory."""
    file = inspect.getfile(function)
    return _directory_of(file) if Path(file).is_file() else None


def kernels_are_cached(module: str) -> bool:
    """Whether kernels of the file of a module are in the cache, so that they need no compilation."""
    directory = _directory_of(module)
    return directory is not None and any(Path(directory).glob("*.nbi"))


class _CompilationNotice(event.Listener):
    """Logs one warning after ``NOTICE_S`` of compilation in this process; loading from the cache is not an event.

    The compilation of a callee is nested in that of its caller.
    """

    def __init__(self) -> None:
        self._depth, self._begun, self._spent_s, self._logged = 0, 0.0, 0.0, False

    def on_start(self, event: Any) -> None:
        """Record the start of a compilation."""
        if self._depth == 0:
            self._begun = time.monotonic()
        self._depth += 1
        self._notice()

    def on_end(self, event: Any) -> None:
        """Record the end of a compilation."""
        self._notice()
        self._depth -= 1
        if self._depth == 0:
            self._spent_s += time.monotonic() - self._begun

    def _notice(self) -> None:
        if self._logged or self._spent_s + time.monotonic() - self._begun < NOTICE_S:
            return
        self._logged = True
        cached = "once for this version" if cache_root() else "in every process: set NUMBA_CACHE_DIR to a folder"
        LOGGER.warning("lanebound: compiling kernels, %s. This takes some minutes.", cached)


event.register("numba:compile", _CompilationNotice())  # type: ignore[no-untyped-call]

_serial: ContextVar[bool] = ContextVar("serial", default=False)


@contextmanager
def serial() -> Iterator[None]:
    """Context in which :func:`run_rows` uses no threads, for measurements of one core and for parallel trainings."""
    token = _serial.set(True)
    try:
        yield
    finally:
        _serial.reset(token)


def thread_count(pieces: int) -> int:
    """Number of threads for some pieces of work: 1 for one piece, in a :func:`serial` context and in worker processes.

    Otherwise ``NUMBA_NUM_THREADS``, which is by default the number of processors.
    """
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if pieces < 2 or _serial.get() or most == 1 or multiprocessing.parent_process() is not None:
        return 1
    return most


def run_rows(kernel: Any, rows: int, *arguments: Any, row_us: float) -> None:
    """Call ``kernel(first, last, *arguments)`` for all rows, in one call or in pieces on several threads.

    The only place where rows are handed to threads, which costs about 40 us; a function can call several kernels.

    There are more pieces than threads: if another process delays one thread, the other threads process its pieces. The
    result does not depend on the number of threads, because rows are independent of each other.

    Parameters
    ----------
    row_us : approximate time of a row on one thread [us]; it determines the size of a piece
    """
    pieces = int(rows * row_us / PIECE_US)
    threads = 1 if pieces < 2 else thread_count(pieces)
    if threads == 1:
        kernel(0, rows, *arguments)
        return
    pieces = min(threads * PIECES_PER_THREAD, pieces, rows)
    numbers = itertools.count()

    def work() -> None:
        while (piece := next(numbers)) < pieces:
            kernel(piece * rows // pieces, (piece + 1) * rows // pieces, *arguments)

    _thread_pool(threads - 1, os.getpid()).run(work)


class _ThreadPool:
    """Daemon threads that wait for work."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._tasks: SimpleQueue[tuple[Callable[[], None], SimpleQueue[BaseException | None]]] = SimpleQueue()
        for _ in range(size):
            threading.Thread(target=self._serve, name="lanebound", daemon=True).start()

    def _serve(self) -> None:
        while True:
            work, done = self._tasks.get()
            error: BaseException | None = None
            try:
                work()
            except BaseException as caught:
                error = caught
            done.put(error)

    def run(self, work: Callable[[], None]) -> None:
        """Run ``work`` in every thread and in the calling thread; an exception of any thread is raised."""
        done: SimpleQueue[BaseException | None] = SimpleQueue()
        for _ in range(self._size):
            self._tasks.put((work, done))
        try:
            work()
        finally:
            errors = [done.get() for _ in range(self._size)]
        for error in errors:
            if error is not None:
                raise error


@cache
def _thread_pool(size: int, process: int) -> _ThreadPool:
    """The threads of a process; a forked process needs new ones."""
    return _ThreadPool(size)
