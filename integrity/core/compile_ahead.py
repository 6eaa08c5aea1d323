"""A second process that compiles some kernels while this process compiles others.

Numba compiles under one lock, so that threads do not help. The second process compiles into the cache on disk, where
this process finds the result. Both take kernels from one list: this process in the order in which it calls them, the
second one those with the most source code first. A kernel goes back on the list when the second process dies, cannot
receive it, or has finished none for ``LIMIT_S``. Without a cache, a second processor or permission to start a
process this process compiles alone; so do worker processes, of pytest-xdist too, which share the processors already.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

import atexit
import logging
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba

from lanebound.integrity.core.kernel_cache import sources_of
from lanebound.integrity.core.kernel_dispatcher import Kernel

__all__ = ["Ahead", "serve"]

VARIABLE = "LANEBOUND_COMPILE_AHEAD"
"""Environment variable; 0: no second process."""
PROGRAM = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from lanebound.integrity.core.compile_ahead import serve; serve()"
)
WORKER = "PYTEST_XDIST_WORKER"  # set in worker processes of pytest-xdist, which multiprocessing does not start
WAIT_S = 1.0  # between looks at the second process, which interrupts from the keyboard can end
LIMIT_S = 120.0  # for one kernel of the second process; a longer wait means that it hangs
LOGGER = logging.getLogger("lanebound")


class Ahead:
    """Kernels for one signature, compiled by this process and by a second one.

    Parameters
    ----------
    kernels : in the order in which they are called
    signature : types of their arguments
    limit_s : time after which a second process that has not finished its kernel is ended [s]
    """

    def __init__(self, kernels: Sequence[Any], signature: tuple[Any, ...], limit_s: float = LIMIT_S) -> None:
        self._kernels, self._signature, self._owner = kernels, signature, os.getpid()
        self._waiting = list(range(len(kernels)))
        self._heaviest_first = sorted(self._waiting, key=lambda n: -_source_bytes(kernels[n]))
        self._theirs: int | None = None
        self._given_s, self._limit_s, self._ended = 0.0, limit_s, False
        self._process: subprocess.Popen[bytes] | None = None
        self._changed = threading.Condition()

    @staticmethod
    def helps(kernels: Sequence[Any]) -> bool:
        """Whether a second process would compile some of the kernels while this one compiles others."""
        if os.environ.get(VARIABLE, "") == "0" or not sys.executable:
            return False
        if multiprocessing.parent_process() is not None or WORKER in os.environ:
            return False
        if int(numba.config.NUMBA_NUM_THREADS) < 2:  # type: ignore[attr-defined]
            return False
        return all(_is_found(kernel) for kernel in kernels) and not all(kernel.is_cached for kernel in kernels)

    def start(self) -> Ahead:
        """Start the second process."""
        threading.Thread(target=self._direct, name="lanebound-compile-ahead", daemon=True).start()
        return self

    def finish(self) -> None:
        """Compile what is left, and wait for what the second process is compiling."""
        if os.getpid() != self._owner:  # in a forked child, which has no thread to direct the second process
            return
        while (mine := self._next()) is not None:
            self._kernels[mine].compile_inner(self._signature)

    def _next(self) -> int | None:
        """The next kernel for this process; None when all are compiled."""
        with self._changed:
            while not self._waiting and self._theirs is not None:
                left_s = self._given_s + self._limit_s - time.monotonic()
                if left_s > 0.0:
                    self._changed.wait(min(WAIT_S, left_s))
                else:
                    LOGGER.warning("lanebound: a second process compiled no kernel in %g s; it is ended", self._limit_s)
                    self._end()
            return self._waiting.pop(0) if self._waiting else None

    def _give(self) -> int | None:
        """The next kernel for the second process, None for none."""
        with self._changed:
            waiting = () if self._ended else self._waiting
            self._theirs = next((n for n in self._heaviest_first if n in waiting), None)
            self._given_s = time.monotonic()
            if self._theirs is not None:
                self._waiting.remove(self._theirs)
            self._changed.notify()
            return self._theirs

    def _end(self) -> None:
        """Take back the kernel of the second process, which gets no other one, and end the process."""
        with self._changed:
            self._ended = True
            if self._theirs is not None:
                self._waiting.insert(0, self._theirs)
            self._theirs = None
            self._changed.notify()
        if self._process is not None:
            with suppress(OSError):
                self._process.kill()

    def _direct(self) -> None:
        """Hand kernels to the second process, until none is left or it fails in any way."""
        try:
            with suppress(Exception), _started() as self._process:
                atexit.register(self._process.kill)
                try:
                    self._hand_over(self._process)
                finally:
                    self._end()  # before the wait for the end of the process
                    atexit.unregister(self._process.kill)
        finally:
            self._end()

    def _hand_over(self, process: subprocess.Popen[bytes]) -> None:
        """One kernel after another, each when the one before is in the cache."""
        tasks, answers = process.stdin, process.stdout
        assert tasks is not None
        assert answers is not None
        pickle.dump(sys.path, tasks)
        while (theirs := self._give()) is not None:
            kernel = self._kernels[theirs].py_func
            pickle.dump((kernel.__module__, kernel.__qualname__, self._signature), tasks)
            tasks.flush()
            if not answers.readline():
                return


def serve() -> None:
    """Compile kernels that the standard input names, and write a line for each; the second process runs this."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stdout = sys.stderr
    while True:
        try:
            module, name, signature = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        getattr(import_module(module), name).compile_inner(signature)
        answers.write(b"done\n")
        answers.flush()


def _started() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, VARIABLE: "0"},
    )


def _is_found(kernel: Any) -> bool:
    """Whether another process finds a kernel by its module and name."""
    if not isinstance(kernel, Kernel):
        return False
    function = kernel.py_func
    return getattr(sys.modules.get(function.__module__), function.__name__, None) is kernel


def _source_bytes(kernel: Any) -> int:
    """Size of the source of a kernel and of all that it imports, which goes with the time to compile it."""
    return sum(file.stat().st_size for file in sources_of(Path(kernel.py_func.__code__.co_filename)))
