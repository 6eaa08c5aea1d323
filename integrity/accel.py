"""Numba, set up once: a versioned on-disk cache, and a parallel form only where it pays.

Numba's cache hashes the file of a kernel but not the files of its callees, so the cache directory is versioned by a
digest of every kernel file (``*_kernel.py``) of this package. Without a writable cache the kernels are compiled anew
in each process.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import prange

__all__ = ["jit", "prange", "serial", "use_parallel"]

F = TypeVar("F", bound=Callable[..., Any])
FASTMATH = {"nsz"}  # more would let a kernel compiled now and one loaded from the cache differ in the last bit
PARALLEL_FROM_BATCH = 16


@cache
def cache_directory() -> str | None:
    """A writable directory for this version of the kernel sources (``*_kernel.py``), or None."""
    digest = hashlib.blake2b(repr(sorted(FASTMATH)).encode(), digest_size=8)
    for source in sorted(Path(__file__).parent.rglob("*_kernel.py")):
        digest.update(source.read_bytes())
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    places: tuple[Callable[[], Path | str], ...] = (Path(base).expanduser, tempfile.gettempdir)
    for place in places:
        try:
            path = Path(place()) / "lanebound" / f"kernels-{digest.hexdigest()}"
            path.mkdir(parents=True, exist_ok=True)
        except (OSError, RuntimeError):  # not writable, no temporary directory, or a user without a home
            continue
        if os.access(path, os.W_OK):
            return str(path)
    return None


def jit(function: F | None = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """``numba.njit`` with this package's options: cached, C division, no loss of NaN or inf, sums in their order."""

    def wrap(f: F) -> Any:
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH, "parallel": parallel}
        if inline:
            options["inline"] = "always"
        directory = cache_directory()
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
    """Whether a batch is worth threads. Never in a daemonic worker process: a forked child would die in OpenMP."""
    if batch < PARALLEL_FROM_BATCH or _serial.get() or numba.get_num_threads() == 1:
        return False
    import multiprocessing

    return multiprocessing.parent_process() is None
