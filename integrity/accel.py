"""Numba, set up once: a versioned on-disk cache, and a parallel form only where it pays.

Numba's cache hashes the file of a kernel but not the files of its callees, so the cache directory of a layer is
versioned by a digest of every kernel file (``*_kernel.py``) of this package and of that layer. What lies in it is
loaded as machine code, so below the temporary directory, which all users share, only a directory that is ours alone is
used. Without a writable cache the kernels are compiled anew in each process.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import prange

__all__ = ["is_compiled", "jit", "one_or_many_runs", "prange", "serial", "use_parallel"]

F = TypeVar("F", bound=Callable[..., Any])
FASTMATH = {"nsz"}  # more would let a kernel compiled now and one loaded from the cache differ in the last bit
PARALLEL_FROM_BATCH = 16
FORGOTTEN_S = 30 * 86400.0
OWNER = os.getpid()


@cache
def cache_directory(layer: str = "integrity") -> str | None:
    """A writable directory for this version of a layer's kernel sources (``*_kernel.py``), or None.

    Kernels of another layer call those of this one, so both count there.
    """
    digest = hashlib.blake2b(repr(sorted(FASTMATH)).encode(), digest_size=8)
    here = Path(__file__).parent
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


def jit(function: F | None = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """``numba.njit`` with this package's options: cached, C division, no loss of NaN or inf, sums in their order."""

    def wrap(f: F) -> Any:
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH, "parallel": parallel}
        if inline:
            options["inline"] = "always"
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


_serial: ContextVar[bool] = ContextVar("serial", default=False)


@contextmanager
def serial() -> Iterator[None]:
    """Inside this context nothing uses threads: for loops whose own work between kernels leaves threads to cool."""
    token = _serial.set(True)
    try:
        yield
    finally:
        _serial.reset(token)


def use_parallel(batch: int) -> bool:
    """Whether a batch is worth threads. Never in a worker process: a forked child would die in OpenMP."""
    if batch < PARALLEL_FROM_BATCH or _serial.get() or numba.get_num_threads() == 1 or os.getpid() != OWNER:
        return False
    import multiprocessing

    return multiprocessing.parent_process() is None


def one_or_many_runs(batch: int, serially: Any, side_by_side: Any) -> tuple[Any, int]:
    """The kernel for a batch and its first argument: all in one run from 0 on, or in a run for each thread."""
    return (side_by_side, numba.get_num_threads()) if use_parallel(batch) else (serially, 0)
