"""Numba, set up once: a versioned on-disk cache, and threads of our own where they pay.

Kernels run in threads of Python's, which wait for work without using a processor: Numba's own threads spin between
kernels, and a second busy process on the machine would slow them fiftyfold. A kernel that :func:`run_rows` may share
among threads has the signature ``kernel(first, last, *arguments)``, treats the rows ``first`` to ``last - 1`` alone and
releases the interpreter's lock.

Numba's cache hashes the file of a kernel but not the files of its callees, so the cache directory of a layer is
versioned by a digest of every kernel file (``*_kernel.py``) of this package and of that layer. What lies in it is
loaded as machine code, so below the temporary directory, which all users share, only a directory that is ours alone is
used. Without a writable cache the kernels are compiled anew in each process.
"""

from __future__ import annotations

import atexit
import hashlib
import itertools
import logging
import multiprocessing
import os
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar, overload

import numba
from numba.core import event

__all__ = ["LOGGER", "is_compiled", "jit", "kernels_are_cached", "run_chain", "run_rows", "serial", "thread_count"]

F = TypeVar("F", bound=Callable[..., Any])
FASTMATH = {"nsz"}  # more would let a kernel compiled now and one loaded from the cache differ in the last bit
PIECE_US = 80.0  # to wake a thread and to hear from it takes some 40 us
PIECES_PER_THREAD = 4
FORGOTTEN_S = 30 * 86400.0
LOGGER = logging.getLogger("lanebound")
NOTICE_S = 2.0  # a shorter compilation is not reported
CACHED_AT_LEAST = 100  # kernels in the cache after any drive; about 200


@cache
def cache_directory(layer: str = "integrity") -> str | None:
    """A writable directory for this version of a layer's kernel sources (``*_kernel.py``), or None.

    Kernels of another layer call those of this one, so both count there.
    """
    digest = hashlib.blake2b(repr(("nogil", *sorted(FASTMATH))).encode(), digest_size=8)
    here = Path(__file__).parents[1]
    for folder in dict.fromkeys((here, here.parent / layer)):
        for source in sorted(folder.rglob("*_kernel.py")):
            digest.update(source.read_bytes())
    name = f"kernels-{digest.hexdigest()}"
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    places: tuple[Callable[[], Path], ...] = (lambda: Path(base).expanduser() / "lanebound", _shared, _fresh)
    for place in places:
        try:
            path = place() / name
            if not path.exists():
                _forget(path.parent)
            path.mkdir(parents=True, exist_ok=True)
            os.utime(path)
        except (OSError, RuntimeError):  # not writable, not ours, no temporary directory, or a user without a home
            continue
        if os.access(path, os.W_OK):
            return str(path)
    return None


def _forget(folder: Path) -> None:
    """Remove the kernels of other versions that no process has begun with for a month; each begins with a touch."""
    for old in folder.glob("kernels-*"):
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > FORGOTTEN_S:
                shutil.rmtree(old, ignore_errors=True)


def _shared() -> Path:
    """This user's directory below the temporary directory, made when missing.

    Raises
    ------
    OSError
        It cannot be made, or another user could have put something into it.
    """
    path = Path(tempfile.gettempdir()) / f"lanebound-{_user()}"
    with suppress(FileExistsError):
        path.mkdir(mode=0o700)
    if not _is_private(path):
        raise PermissionError(f"{path} must be a directory of this user alone")
    return path


def _user() -> int:
    """Number of the user, 0 where users have none (Windows, whose temporary directory is not shared)."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_private(path: Path) -> bool:
    """Whether path is itself a directory, no link to one, that belongs to this user with mode 0700."""
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    return os.name == "nt" or (found.st_uid == _user() and stat.S_IMODE(found.st_mode) == 0o700)


def _fresh() -> Path:
    """A new private directory of this process, removed when it ends."""
    path = tempfile.mkdtemp(prefix="lanebound-")
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not in a forked child
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(remove)
    return Path(path)


def _layer_of(function: Callable[..., Any]) -> str:
    """The layer of lanebound that a kernel belongs to."""
    package, _, rest = (function.__module__ or "").partition(".")
    return rest.partition(".")[0] if package == "lanebound" else "integrity"


@overload
def jit(function: F) -> Any: ...
@overload
def jit(*, inline: bool = False, forceinline: bool = False, borrows: bool = False) -> Callable[[F], Any]: ...
def jit(function: F | None = None, *, inline: bool = False, forceinline: bool = False, borrows: bool = False) -> Any:
    """``numba.njit`` with this package's options: cached, C division, no loss of NaN or inf, sums in their order.

    Kernels release the interpreter's lock while they run. They are compiled at their first call by one thread.

    Parameters
    ----------
    inline : Numba inlines the function before type inference and does not compile it by itself; for small functions
    forceinline : LLVM inlines the function; for a function with a NamedTuple of many arrays and few callers, as each
        array passed costs some 2 ns
    borrows : do not count references to arrays, which costs some 5 ns for each array that a function takes or finds in
        a NamedTuple; for functions that allocate no array and return none
    """

    def wrap(f: F) -> Any:
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH, "nogil": True}
        if inline:
            options["inline"] = "always"
        if forceinline:
            options["forceinline"] = True
        if borrows:
            options["_nrt"] = False
        directory = cache_directory(_layer_of(f))
        if directory is None:
            return numba.njit(**options)(f)
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = directory  # type: ignore[attr-defined]
        try:
            return numba.njit(cache=True, **options)(f)
        except RuntimeError:  # no locator for this file (interactive use): compile in memory
            return numba.njit(**options)(f)
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return wrap if function is None else wrap(function)


def is_compiled(kernel: Any) -> bool:
    """Whether a kernel, as :func:`jit` returns it, lies in the cache; its callees do then as well."""
    directory, source = cache_directory(_layer_of(kernel)), Path(kernel.__code__.co_filename)
    return directory is not None and any(Path(directory).glob(f"*/{source.stem}.{kernel.__name__}-*.nbi"))


def kernels_are_cached() -> bool:
    """Whether kernels of this version were compiled before, so that work starts without a long compilation."""
    directory = cache_directory()
    return directory is not None and sum(1 for _ in Path(directory).glob("*/*.nbi")) >= CACHED_AT_LEAST


class _CompilationNotice(event.Listener):
    """Logs one warning when this process has compiled kernels for ``NOTICE_S``; loading from the cache is no event.

    Kernels that call kernels are compiled within each other.
    """

    def __init__(self) -> None:
        self._depth, self._begun, self._spent_s, self._logged = 0, 0.0, 0.0, False

    def on_start(self, event: Any) -> None:
        """A compilation begins."""
        if self._depth == 0:
            self._begun = time.monotonic()
        self._depth += 1
        self._notice()

    def on_end(self, event: Any) -> None:
        """A compilation ends."""
        self._notice()
        self._depth -= 1
        if self._depth == 0:
            self._spent_s += time.monotonic() - self._begun

    def _notice(self) -> None:
        if self._logged or self._spent_s + time.monotonic() - self._begun < NOTICE_S:
            return
        self._logged = True
        cached = "once for this version" if cache_directory() else "in every process: set NUMBA_CACHE_DIR to a folder"
        LOGGER.warning("lanebound: compiling kernels, %s. This takes some minutes.", cached)


event.register("numba:compile", _CompilationNotice())  # type: ignore[no-untyped-call]

_serial: ContextVar[bool] = ContextVar("serial", default=False)


@contextmanager
def serial() -> Iterator[None]:
    """Inside this context :func:`run_rows` uses no threads: to measure one core, or for several trainings at once."""
    token = _serial.set(True)
    try:
        yield
    finally:
        _serial.reset(token)


def thread_count(pieces: int) -> int:
    """Threads for so many pieces of work: one for a single piece, in a :func:`serial` context and in worker processes.

    At most ``NUMBA_NUM_THREADS``, which is the number of processors unless the environment says otherwise.
    """
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if pieces < 2 or _serial.get() or most == 1 or multiprocessing.parent_process() is not None:
        return 1
    return most


def run_rows(kernel: Any, rows: int, *arguments: Any, row_us: float) -> None:
    """Call ``kernel(first, last, *arguments)`` for all rows: at once, or in pieces that threads take in turn.

    The pieces are smaller than a thread's share, so that a thread that is held up by another process leaves its work
    to the others. What comes out does not depend on the number of threads, as rows do not depend on each other.

    Parameters
    ----------
    row_us : about how long a row takes on one thread [us]; a piece is to be worth waking a thread for
    """
    run_chain([(kernel, arguments)], rows, row_us=row_us)


def run_chain(links: Sequence[tuple[Any, tuple[Any, ...]]], rows: int, *, row_us: float) -> None:
    """:func:`run_rows` of several kernels one after another, for each piece of rows: threads are woken once for all.

    Parameters
    ----------
    links : kernels with their arguments after ``first`` and ``last``
    row_us : about how long a row takes in all kernels together on one thread [us]
    """
    pieces = int(rows * row_us / PIECE_US)
    threads = thread_count(pieces)
    if threads == 1:
        for kernel, arguments in links:
            kernel(0, rows, *arguments)
        return
    pieces = min(threads * PIECES_PER_THREAD, pieces, rows)
    turn = itertools.count()

    def work() -> None:
        while (piece := next(turn)) < pieces:
            for kernel, arguments in links:
                kernel(piece * rows // pieces, (piece + 1) * rows // pieces, *arguments)

    _crew(threads - 1, os.getpid()).share(work)


class _Crew:
    """Threads that wait for work; they end with the process."""

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

    def share(self, work: Callable[[], None]) -> None:
        """Run ``work`` in every thread and in the caller's; raises what any of them raised."""
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
def _crew(size: int, process: int) -> _Crew:
    """The threads of a process: a forked one does not inherit any."""
    return _Crew(size)
